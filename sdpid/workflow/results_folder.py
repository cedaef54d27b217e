"""The folder that results are written into: every file of a run, or none."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
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
    """Write an identification into a folder; arguments and errors are those of its `save`."""
    target = Path(folder)
    note = report or (lambda _: None)
    require_writable(target, writes_config=config is not None)
    exports: list[ExportReport] = []

    def fill(stage: Path) -> dict[str, Any]:
        writer = _Writer(result, stage, intervals, note, exports, offsets)
        writer.write(figures=figures, command=command, config=config)
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

    files = _FOLDER.write(target, fill, note)
    if exported is not None:
        for export in exports:
            exported(export)
    return files


@dataclass(frozen=True)
class _Writer:
    """Writes the files of a result into an empty folder."""

    result: Judged
    folder: Path
    intervals: Intervals | None
    note: Callable[[str], None]
    exports: list[ExportReport]
    offsets: bool

    def write(self, *, figures: bool, command: str | None, config: str | None) -> None:
        """Write all files but the manifest."""
        steps: list[Callable[[], object]] = [
            self._tables,
            lambda: self.result.certificate.to_json(self.folder / "certificate.json"),
            self._robots,
            self._friction,
            lambda: self._figures() if figures else None,
            lambda: self._report(command),
            lambda: self._config(config),
            self._result,
        ]
        with progress(len(steps), "writing results") as advance:
            for step in steps:
                step()
                advance(1)

    def _tables(self) -> None:
        from sdpid.output.tables.parameter_tables import base_table, theta_table
        from sdpid.output.tables.parameters_file import write_parameters

        estimate = self.result.estimate
        for name, table in (
            ("base_parameters.csv", base_table(estimate, self.result.wls, self.intervals)),
            ("parameters.csv", theta_table(estimate, self.intervals)),
        ):
            table.write(self.folder / name)
        path, certificate = self.folder / "parameters.json", self.result.certificate
        write_parameters(estimate, path, intervals=self.intervals, certificate=certificate)

    def _result(self) -> None:
        exports = [export.to_dict() for export in self.exports]
        content = {**self.result.to_dict(), "exports": exports}
        path = self.folder / "result.json"
        path.write_text(json_text(content) + "\n", encoding="utf-8")

    def _robots(self) -> None:
        """Write the robot as URDF and MJCF where that can be, and note what they leave out."""
        from sdpid.output.robots.mjcf import write_mjcf
        from sdpid.output.robots.urdf import write_urdf

        problem, estimate = self.result.problem, self.result.estimate
        if problem.consistency == "none":
            self.note(
                "no identified.urdf, no identified.xml: without consistency links need be no bodies"
            )
            return
        exports = []
        if problem.robot.urdf is not None:
            exports.append(write_urdf(estimate, target=self.folder / "identified.urdf"))
        mjcf, missing = self.folder / "identified.xml", None
        try:
            exports.append(write_mjcf(estimate, target=mjcf, offsets=self.offsets))
        except MissingExtraError:
            missing = f"mujoco is not installed ({installation('sim')})"
        except Exception as reason:
            # It is optional, so nothing that MuJoCo does may cost the run, but a full disk does.
            if isinstance(reason.__cause__ or reason, OSError):
                raise
            known = isinstance(reason, SdpidError)
            missing = str(reason) if known else f"MuJoCo failed: {type(reason).__name__}: {reason}"
        if (fresh := self.result.validation_samples) is not None:
            exports = [export.with_validation(fresh) for export in exports]
        self.exports.extend(exports)
        for statement in _statements(exports):
            self.note(statement)
        if missing is not None:
            self.note(f"no {mjcf.name} (MJCF): {missing}")

    def _friction(self) -> None:
        """Write friction as code, which has room for every term of ours."""
        from sdpid.output.robots.friction_files import write_friction

        if not self.result.problem.friction.terms:
            return
        left_out: dict[str, None] = {}
        for name in FRICTION_FILES:
            path = self.folder / name
            try:
                said = write_friction(
                    self.result.estimate, path, certificate=self.result.certificate
                )
            except ExportError as reason:
                # A full disk, that is; else it is a term that no file can hold.
                if isinstance(reason.__cause__, OSError):
                    raise
                self.note(f"no {' and no '.join(FRICTION_FILES)}: {reason}")
                return
            left_out |= dict.fromkeys(said)
        for each in left_out:
            self.note(each)

    def _figures(self) -> None:
        """Draw measured and predicted efforts."""
        from sdpid.plots.figures import save_figure

        result = self.result
        fits = [("training", result.training)]
        if result.validation is not None:
            fits.append(("validation", result.validation))
        for name, fit in fits:
            save_figure(fit.plot(), self.folder / f"{name}.png", dpi=_DPI)

    def _report(self, command: str | None) -> None:
        if importlib.util.find_spec("jinja2") is None:
            self.note(f"no report.html: jinja2 is not installed ({installation('report')})")
            return
        from sdpid.output.report.report import write_report

        write_report(
            self.result,
            self.folder / "report.html",
            command=command,
            intervals=self.intervals,
            exports=self.exports,
            sha256=self.result.certificate.to_dict()["sha256"],
        )

    def _config(self, config: str | None) -> None:
        if config is not None:
            (self.folder / _CONFIG).write_text(config, encoding="utf-8")


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
