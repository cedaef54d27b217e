"""The folder that results are written into: every file of a run, or none."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import secrets
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sdpid._files import atomic_write_text, move_into
from sdpid._progress import progress
from sdpid.errors import ExportError, MissingExtraError, SdpidError
from sdpid.output.intervals_shown import GivenIntervals

if TYPE_CHECKING:
    from sdpid.output.urdf import ExportReport
    from sdpid.workflow.identification import Identification

# Steps of writing that are counted on a terminal; drawing takes most of the time.
_STEPS = 6

# Stands for the kind of a file while statements are compared.
_KIND = "\0"

# Of the figures: a screen's width, and 170 dots an inch on a printed page.
_DPI = 110.0

Tell = Callable[[str], None]


class Stage:
    """An empty folder within the one that results go to, both made when asked.

    Its name is chosen before anything is made, so that whoever is interrupted, however early,
    knows what to remove: call `remove` in the ``finally`` of a ``try`` that `make` is called in.

    Parameters
    ----------
    folder : Path
        Where the results go.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / f".sdpid-{secrets.token_hex(6)}"
        # Folders that are not there yet, the innermost first.
        self._missing = [f for f in (folder, *folder.parents) if not f.exists()]

    def make(self) -> Path:
        """Make the folders.

        Raises
        ------
        ExportError
            When they cannot be made.
        """
        try:
            self.path.mkdir(parents=True)
        except OSError as cause:
            raise ExportError(
                f"cannot write into {self.path.parent}: {cause.strerror}; choose another folder."
            ) from None
        return self.path

    def remove(self) -> None:
        """Remove it, and the folders that were made for it and hold nothing."""
        shutil.rmtree(self.path, ignore_errors=True)
        with contextlib.suppress(OSError):
            for folder in self._missing:
                folder.rmdir()


def save(
    result: Identification,
    folder: str | os.PathLike[str],
    *,
    figures: bool = True,
    report: Tell | None = None,
    command: str | None = None,
    intervals: GivenIntervals | None = None,
) -> tuple[Path, ...]:
    """Write an identification into a folder; arguments and errors are those of its `save`."""
    target = Path(folder)
    tell = report or (lambda _: None)
    stage = Stage(target)
    try:
        stage.make()
        try:
            with progress(_STEPS, "writing results") as advance:
                files = list(
                    _written(result, stage.path, figures, tell, command, intervals, advance)
                )
            move_into(target, files)
        except OSError as cause:
            raise ExportError(
                f"cannot write into {target}: {cause.strerror}; choose another folder."
            ) from None
    finally:
        try:
            stage.remove()
        finally:
            stage.remove()  # for a signal may have come in the midst of the first
    return tuple(target / file.name for file in files)


def _written(
    result: Identification,
    out: Path,
    figures: bool,
    tell: Tell,
    command: str | None,
    intervals: GivenIntervals | None,
    advance: Callable[[float], None],
) -> Iterator[Path]:
    """Write the files into an empty folder, and yield each."""
    from sdpid.output.parameters_file import write_parameters
    from sdpid.output.tables import base_table, theta_table

    for name, table in (
        ("base_parameters.csv", base_table(result.estimate, result.wls, intervals)),
        ("parameters.csv", theta_table(result.estimate, intervals)),
    ):
        table.write(out / name)
        yield out / name
    advance(1)
    yield write_parameters(result.estimate, out / "parameters.json", intervals=intervals)
    text = json.dumps(result.to_dict(), indent=1, allow_nan=False)
    atomic_write_text(out / "result.json", text + "\n")
    yield out / "result.json"
    advance(1)
    certificate = out / "certificate.json"
    result.certificate.to_json(certificate)
    yield certificate
    advance(1)
    yield from _robots(result, out, tell)
    advance(1)
    if figures:
        yield from _figures(result, out)
    advance(1)
    if importlib.util.find_spec("jinja2") is None:
        tell("no report.html: jinja2 is not installed (pip install 'sdpid[report]')")
    else:
        from sdpid.output.report import certificate_digest, write_report

        yield write_report(
            result,
            out / "report.html",
            command=command,
            intervals=intervals,
            figures=figures,
            sha256=certificate_digest(certificate),
        )
    advance(1)


def _robots(result: Identification, out: Path, tell: Tell) -> Iterator[Path]:
    """Write the robot as URDF and MJCF where that can be, and say what they leave out."""
    from sdpid.output.mjcf import write_mjcf
    from sdpid.output.urdf import write_urdf

    problem = result.problem
    if problem.consistency == "none":
        tell("no identified.urdf, no identified.xml: without consistency links need be no bodies")
        return
    exports = []
    if problem.robot.urdf is not None:
        exports.append(write_urdf(result.estimate, target=out / "identified.urdf"))
    mjcf, missing = out / "identified.xml", None
    try:
        exports.append(write_mjcf(result.estimate, target=mjcf))
    except MissingExtraError:
        missing = "mujoco is not installed (pip install 'sdpid[sim]')"
    except SdpidError as reason:
        missing = str(reason)
    for statement in _statements(exports):
        tell(statement)
    if missing is not None:
        tell(f"no {mjcf.name} (MJCF): {missing}")
    for export in exports:
        yield export.path


def _statements(exports: Sequence[ExportReport]) -> Iterator[str]:
    """Yield what files do not hold as identified; what is true of several is said once."""
    said: dict[str, list[ExportReport]] = {}
    for export in exports:
        for statement in export.describe().splitlines()[1:]:
            said.setdefault(statement.replace(export.kind, _KIND), []).append(export)
    for statement, concerned in said.items():
        files = ", ".join(export.path.name for export in concerned)
        kinds = " or ".join(export.kind for export in concerned)
        yield f"{files}: {statement.replace(_KIND, kinds)}"


def _figures(result: Identification, out: Path) -> Iterator[Path]:
    """Draw measured and predicted efforts."""
    from sdpid.output.plots import plot_fit, save_figure

    pairs = [("training", result.problem.samples, result.training)]
    if result.validation is not None and result.validation_samples is not None:
        pairs.append(("validation", result.validation_samples, result.validation))
    for name, samples, fit in pairs:
        yield save_figure(plot_fit(samples, fit), out / f"{name}.png", dpi=_DPI)
