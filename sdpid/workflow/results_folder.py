"""The folder that results are written into: every file of a run, or none."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import importlib.util
import json
import os
import secrets
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sdpid._common.files import PathLike, atomic_path, require_other_files
from sdpid._common.json import json_text
from sdpid._common.progress import progress
from sdpid._common.signals import end_if_signaled
from sdpid.errors import ExportError, MissingExtraError, SdpidError
from sdpid.output.tables.intervals_shown import GivenIntervals

if TYPE_CHECKING:
    from sdpid.output.robots.urdf import ExportReport
    from sdpid.workflow.result import Identification

# Steps of writing that are counted on a terminal; drawing takes most of the time.
_STEPS = 6

# Stands for the kind of a file while statements are compared.
_KIND = "\0"

# Of the figures: a screen's width, and 170 dots an inch on a printed page.
_DPI = 110.0

# Written last: it lists the other files.
_RESULT = "result.json"

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
    "training.png",
    "validation.png",
    "report.html",
    _CONFIG,
    _RESULT,
)

# Hidden folders within the one that results go to, in which they are prepared.
_STAGE = ".sdpid-"

# Seconds to wait for another run that writes into the same folder.
_PATIENCE = 60.0

Tell = Callable[[str], None]


def require_writable(
    folder: Path, inputs: Iterable[PathLike | None] = (), *, config: Path | None = None
) -> None:
    """Refuse a folder that results cannot be written into, before the work is done.

    Parameters
    ----------
    folder : Path
        Need not exist yet.
    inputs : iterable of path
        Files that the run reads: results must not replace them.
    config : Path, optional
        The options of the run. Results replace it only where an earlier run wrote it.

    Raises
    ------
    ExportError
        When the folder is a file, one of the results is a folder or no regular file, or a result
        would replace an input.
    """
    if folder.exists() and not folder.is_dir():
        raise ExportError(f"cannot write into {folder}: it is a file; name a folder.")
    for name in NAMES:
        if (folder / name).exists() and not (folder / name).is_file():
            raise ExportError(
                f"cannot write {folder / name}: it is a folder or a device; move it away, or "
                "choose another folder."
            )
    if config is not None and config.is_file():
        listed = _listed(folder)
        if listed.get(_CONFIG) != _digest(config):
            inputs = (*inputs, config)
    require_other_files("--out", (folder / name for name in NAMES), inputs)


def save(
    result: Identification,
    folder: str | os.PathLike[str],
    *,
    figures: bool = True,
    report: Tell | None = None,
    command: str | None = None,
    config: str | None = None,
    intervals: GivenIntervals | None = None,
) -> tuple[Path, ...]:
    """Write an identification into a folder; arguments and errors are those of its `save`."""
    target = Path(folder)
    tell = report or (lambda _: None)
    require_writable(target)
    try:
        with _stage(target) as stage, progress(_STEPS, "writing results") as advance:
            files = list(_written(result, stage, figures, tell, command, intervals, advance))
            if config is not None:
                (stage / _CONFIG).write_text(config, encoding="utf-8")
                files.append(stage / _CONFIG)
            digests = {file.name: _digest(file) for file in files}
            content = {**result.to_dict(), "files": digests}
            (stage / _RESULT).write_text(json_text(content) + "\n", encoding="utf-8")
            new = [*digests, _RESULT]
            stale = _left_by_earlier_run(target, new, tell)
            _exchange(stage, target, new, stale)
    except OSError as cause:
        raise ExportError(
            f"cannot write into {target}: {cause.strerror or cause}; choose another folder."
        ) from cause
    return tuple(target / name for name in new)


@contextlib.contextmanager
def _stage(folder: Path) -> Iterator[Path]:
    """Yield an empty hidden folder within `folder`, both made when they are not there.

    In the end it is removed, and so are folders that were made for it and hold nothing. While the
    folder is locked, every other hidden folder in it was left by a run that was killed, and is
    removed too.
    """
    made = [each for each in (folder, *folder.parents) if not each.exists()]
    own = f"{_STAGE}{secrets.token_hex(6)}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with _locked(folder) as alone:
            pattern = f"{_STAGE}*" if alone else own
            try:
                _remove(folder, pattern)
                (folder / own).mkdir()
                yield folder / own
            finally:
                try:
                    _remove(folder, pattern)
                finally:
                    _remove(folder, own)  # a signal may have come in the midst of the first
    finally:
        with contextlib.suppress(OSError):
            for each in made:
                each.rmdir()


def _remove(folder: Path, pattern: str) -> None:
    for path in folder.glob(pattern):
        shutil.rmtree(path, ignore_errors=True)


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[bool]:
    """Let one process at a time write into a folder; yield False where it cannot be locked.

    The lock is one of the operating system: it ends with the process, however that ends.
    """
    try:
        import fcntl

        handle = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError):  # no POSIX
        yield False
        return
    try:
        end = time.monotonic() + _PATIENCE
        locked = False
        while not locked:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                locked = True
            except BlockingIOError:
                if time.monotonic() > end:
                    raise ExportError(
                        f"cannot write into {folder}: another run has been writing into it for "
                        f"more than {_PATIENCE:g} s; choose another folder."
                    ) from None
                time.sleep(0.05)
            except OSError:  # a file system without locks
                break
        yield locked
    finally:
        os.close(handle)


def _digest(file: Path) -> str:
    """Return the SHA-256 of a file's content in hexadecimal digits."""
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _listed(folder: Path) -> dict[str, object]:
    """Return the digests of the files that an earlier run wrote, by name; empty without one."""
    try:
        listed = json.loads((folder / _RESULT).read_text(encoding="utf-8"))["files"]
        return {name: listed[name] for name in NAMES if name in listed}
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return {}  # no earlier run, or a file of somebody else


def _left_by_earlier_run(folder: Path, new: Sequence[str], tell: Tell) -> list[str]:
    """Return the files of an earlier run that this one does not replace.

    They are those that its result.json lists, with the content that it wrote: a file that was
    changed since is somebody's work and stays, which `tell` is called with.
    """
    stale = []
    for name, digest in _listed(folder).items():
        if name in new or not (folder / name).is_file():
            continue
        if _digest(folder / name) == digest:
            stale.append(name)
        else:
            tell(f"{name} of an earlier run was changed since and stays; this run writes none")
    return stale


def _exchange(stage: Path, folder: Path, new: Sequence[str], stale: Sequence[str]) -> None:
    """Move `new` files from the stage into the folder and remove `stale` ones: all, or nothing.

    Whatever interrupts it, also a signal, the files that were there before are put back. Symbolic
    links stay, and the files that they point to are replaced.
    """
    end_if_signaled()
    kept = stage / "replaced"
    kept.mkdir()
    targets = {name: Path(os.path.realpath(folder / name)) for name in (*new, *stale)}
    for name, target in targets.items():
        if target.exists():
            shutil.copy2(target, kept / name)
    try:
        for name in new:
            _move(stage / name, targets[name])
        for name in stale:
            (folder / name).unlink()
    except BaseException:
        for name, target in targets.items():
            with contextlib.suppress(OSError):
                if (kept / name).exists():
                    _move(kept / name, target)
                elif not (stage / name).exists():
                    target.unlink(missing_ok=True)
        raise


def _move(source: Path, target: Path) -> None:
    """Move a file over another, which may lie on another disk."""
    try:
        source.replace(target)
    except OSError as cause:
        if cause.errno != errno.EXDEV:
            raise
        with atomic_path(target) as temporary:
            shutil.copyfile(source, temporary)
        source.unlink()


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
    from sdpid.output.tables.parameter_tables import base_table, theta_table
    from sdpid.output.tables.parameters_file import write_parameters

    for name, table in (
        ("base_parameters.csv", base_table(result.estimate, result.wls, intervals)),
        ("parameters.csv", theta_table(result.estimate, intervals)),
    ):
        table.write(out / name)
        yield out / name
    advance(1)
    yield write_parameters(result.estimate, out / "parameters.json", intervals=intervals)
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
        from sdpid.output.report.report import certificate_digest, write_report

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
    from sdpid.output.robots.mjcf import write_mjcf
    from sdpid.output.robots.urdf import write_urdf

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
    except Exception as reason:
        # It is optional, so nothing that MuJoCo does may cost the run, but a full disk does.
        if isinstance(reason.__cause__ or reason, OSError):
            raise
        known = isinstance(reason, SdpidError)
        missing = str(reason) if known else f"MuJoCo failed: {type(reason).__name__}: {reason}"
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
    from sdpid.output.plots.figures import save_figure
    from sdpid.output.plots.reconstruction import plot_fit

    pairs = [("training", result.problem.samples, result.training)]
    if result.validation is not None and result.validation_samples is not None:
        pairs.append(("validation", result.validation_samples, result.validation))
    for name, samples, fit in pairs:
        yield save_figure(plot_fit(samples, fit), out / f"{name}.png", dpi=_DPI)
