"""The folder that results are written into: every file of a run, or none."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sdpid import __version__
from sdpid._common.extras import installation
from sdpid._common.progress import progress
from sdpid._common.staging import RunFolder
from sdpid._common.tables import json_text
from sdpid.assurance.intervals.intervals import Intervals
from sdpid.errors import ExportError, MissingExtraError, SdpidError
from sdpid.output.report.subject import Judged
from sdpid.output.robots.friction_files import NAMES as FRICTION_FILES
from sdpid.verifier.manifest import SCHEMA, VERSION, sealed

if TYPE_CHECKING:
    from sdpid.output.robots.export_report import ExportReport

# Stands for the kind of a file while statements are compared.
_KIND = "\0"

# Of the figures: a screen's width, and 170 dots an inch on a printed page.
_DPI = 110.0

# Written last: it seals the other files.
MANIFEST = "manifest.json"

# The options of the run.
_CONFIG = "run.toml"

# Every file that a run may write.
NAMES = (
    "base_parameters.csv",
    "parameters.csv",
    "parameters.json",
    "certificate.json",
    "identified.urdf",
    "identified.xml",
    *FRICTION_FILES,
    "training.png",
    "validation.png",
    "report.html",
    _CONFIG,
    "result.json",
    MANIFEST,
)


_FOLDER = RunFolder(NAMES, MANIFEST, _CONFIG, seal=sealed)

require_writable = _FOLDER.require_writable


def save(
    result: Judged,
    folder: str | os.PathLike[str],
    *,
    figures: bool = False,
    offsets: bool = False,
    report: Callable[[str], None] | None = None,
    command: str | None = None,
    config: str | None = None,
    intervals: Intervals | None = None,
    exported: Callable[[ExportReport], None] | None = None,
) -> tuple[Path, ...]:
    """Write tables, robots, certificate and a report into a folder: all, or none.

    The robot is written as identified.urdf where it came from one, and as identified.xml
    (MJCF) where MuJoCo is installed and can hold it.

    Parameters
    ----------
    folder : path
        Created when it is not there.
    figures : bool, optional
        Write training.png and validation.png too (extra ``plot``).
    offsets : bool, optional
        Write offsets into identified.xml, as actuators with a constant force.
    report : callable, optional
        Called with a sentence for all that the files leave out of the estimate (see
        `ExportReport`), and for every file that is not written.
    command : str, optional
        The command line, for report.html.
    config : str, optional
        The options of the command in TOML, for run.toml.
    intervals : Intervals, optional
        Shown in place of the result's own.
    exported : callable, optional
        Called with the `ExportReport` of each robot that was written.

    Returns
    -------
    tuple of Path
        The files.

    Raises
    ------
    ExportError
        When the folder cannot be written to, or the estimate cannot be exported.
    """
    note = report or (lambda _: None)
    require_writable(Path(folder), writes_config=config is not None)
    if intervals is not None:
        result = replace(result, intervals=intervals)
    exports: list[ExportReport] = []

    def fill(stage: Path) -> dict[str, Any]:
        steps: list[Callable[[], object]] = [
            lambda: _tables(result, stage),
            lambda: result.certificate.to_json(stage / "certificate.json"),
            lambda: exports.extend(_robots(result, stage, note, offsets)),
            lambda: _friction(result, stage, note),
            lambda: _figures(result, stage) if figures else None,
            lambda: _report(result, stage, note, command, exports),
            lambda: config and (stage / _CONFIG).write_text(config, encoding="utf-8"),
            lambda: _result(result, stage, exports),
        ]
        with progress(len(steps), "writing results") as advance:
            for step in steps:
                step()
                advance(1)
        if result.recipe_note is not None:
            note(result.recipe_note)
        return {
            "schema": SCHEMA,
            "version": VERSION,
            "metadata": {"software": f"sdpid {__version__}"},
            "inputs": list(result.inputs),
            "recipe": None if result.recipe is None else result.recipe.to_dict(),
            "certificate": result.certificate.to_dict()["sha256"],
        }

    files = _FOLDER.write(Path(folder), fill, note)
    if exported is not None:
        for export in exports:
            exported(export)
    return files


def _tables(result: Judged, folder: Path) -> None:
    from sdpid.output.tables.parameter_tables import base_table, theta_table
    from sdpid.output.tables.parameters_file import write_parameters

    estimate, intervals = result.estimate, result.intervals
    base_table(estimate, result.wls, intervals).write(folder / "base_parameters.csv")
    theta_table(estimate, intervals).write(folder / "parameters.csv")
    path = folder / "parameters.json"
    write_parameters(estimate, path, intervals=intervals, certificate=result.certificate)


def _result(result: Judged, folder: Path, exports: Sequence[ExportReport]) -> None:
    content = {**result.to_dict(), "exports": exports}
    (folder / "result.json").write_text(json_text(content) + "\n", encoding="utf-8")


def _robots(
    result: Judged, folder: Path, note: Callable[[str], None], offsets: bool
) -> list[ExportReport]:
    """Write the robot as URDF and MJCF where that can be, and note what they leave out."""
    from sdpid.output.robots.mjcf import write_mjcf
    from sdpid.output.robots.urdf import write_urdf

    problem, estimate = result.problem, result.estimate
    if problem.consistency == "none":
        note("no identified.urdf, no identified.xml: without consistency links need be no bodies")
        return []
    exports = []
    if problem.robot.urdf is not None:
        exports.append(write_urdf(estimate, target=folder / "identified.urdf"))
    mjcf, missing = folder / "identified.xml", None
    try:
        exports.append(write_mjcf(estimate, target=mjcf, offsets=offsets))
    except MissingExtraError:
        missing = f"mujoco is not installed ({installation('sim')})"
    except Exception as reason:
        # It is optional, so nothing that MuJoCo does may cost the run, but a full disk does.
        if isinstance(reason.__cause__ or reason, OSError):
            raise
        known = isinstance(reason, SdpidError)
        missing = str(reason) if known else f"MuJoCo failed: {type(reason).__name__}: {reason}"
    if (fresh := result.validation_samples) is not None:
        exports = [export.with_validation(fresh) for export in exports]
    for statement in _statements(exports):
        note(statement)
    if missing is not None:
        note(f"no {mjcf.name} (MJCF): {missing}")
    return exports


def _friction(result: Judged, folder: Path, note: Callable[[str], None]) -> None:
    """Write friction as code, which has room for every term of ours."""
    from sdpid.output.robots.friction_files import write_friction

    left_out: dict[str, None] = {}
    for name in FRICTION_FILES if result.problem.friction.terms else ():
        try:
            said = write_friction(result.estimate, folder / name, certificate=result.certificate)
        except ExportError as reason:
            # A full disk, that is; else it is a term that no file can hold.
            if isinstance(reason.__cause__, OSError):
                raise
            note(f"no {' and no '.join(FRICTION_FILES)}: {reason}")
            return
        left_out |= dict.fromkeys(said)
    for each in left_out:
        note(each)


def _figures(result: Judged, folder: Path) -> None:
    """Draw measured and predicted efforts."""
    from sdpid.plots.figures import save_figure

    for name, fit in (("training", result.training), ("validation", result.validation)):
        if fit is not None:
            save_figure(fit.plot(), folder / f"{name}.png", dpi=_DPI)


def _report(
    result: Judged,
    folder: Path,
    note: Callable[[str], None],
    command: str | None,
    exports: Sequence[ExportReport],
) -> None:
    if importlib.util.find_spec("jinja2") is None:
        note(f"no report.html: jinja2 is not installed ({installation('report')})")
        return
    from sdpid.output.report.report import write_report

    write_report(
        result,
        folder / "report.html",
        command=command,
        intervals=result.intervals,
        exports=exports,
        sha256=result.certificate.to_dict()["sha256"],
    )


def _statements(exports: Sequence[ExportReport]) -> Iterator[str]:
    """Yield what files leave out of the estimate; what holds for several is yielded once."""
    concerned: dict[str, list[ExportReport]] = {}
    for export in exports:
        for statement in export.describe().splitlines()[1:]:
            concerned.setdefault(statement.replace(export.kind, _KIND), []).append(export)
    for statement, several in concerned.items():
        files = ", ".join(export.path.name for export in several)
        kinds = " or ".join(export.kind for export in several)
        yield f"{files}: {statement.replace(_KIND, kinds)}"
