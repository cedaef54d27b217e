"""The folder that results are written into: every file of a run, or none."""

import errno
import hashlib
import json
import os
import resource
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

import sdpid
from sdpid._common import files as _files
from sdpid.assurance.certificate.certificate import Certificate
from sdpid.errors import ExportError
from sdpid.output.report import report
from sdpid.plots.figures import save_figure
from sdpid.plots.reconstruction import plot_fit
from sdpid.workflow.result import NAMES, Identification
from tests.helpers.forged import contents
from tests.helpers.refusals import refuses
from tests.helpers.runs import arm, recorded

# Events of Python's audit that change a disk. "open" counts where it is for writing.
CHANGES = ("open", "os.rename", "os.mkdir", "os.remove", "os.chmod", "os.link")


class Injector:
    """Make the n-th change below a folder fail, whatever function makes it."""

    def __init__(self) -> None:
        self.folder: str | None = None
        self.left = 0
        sys.addaudithook(self._hook)

    def _hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.folder is None or event not in CHANGES:
            return
        if event == "open":
            _, mode, flags = arguments
            writes = (flags or 0) & (os.O_WRONLY | os.O_RDWR)
            if not writes and not (isinstance(mode, str) and set(mode) & set("wax+")):
                return
        paths = [os.fspath(a) for a in arguments if isinstance(a, (str, os.PathLike))]
        if not any(str(path).startswith(self.folder) for path in paths):
            return
        self.left -= 1
        if self.left == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def arm(self, folder: Path | None, number: int = 0) -> None:
        self.folder, self.left = (None if folder is None else str(folder)), number

    def writes(self, folder: Path, number: int, write: Callable[[], object]) -> tuple[bool, bool]:
        """Write with a change that fails; return whether it was written, and the change reached."""
        self.arm(folder, number)
        try:
            write()
            done = True
        except ExportError:
            done = False
        reached = self.left <= 0
        self.arm(None)
        return done, reached


@pytest.fixture(scope="module")
def injector() -> Injector:
    return Injector()


@pytest.fixture(scope="module")
def result() -> Identification:
    return sdpid.identify(arm(), recorded(1))


@pytest.fixture(scope="module")
def other() -> Identification:
    """Return the result of another run, of which no robot can be written."""
    return sdpid.identify(arm(), recorded(2), consistency="none")


@pytest.fixture(autouse=True)
def _disarmed(injector: Injector) -> Iterator[None]:
    yield
    injector.arm(None)


def test_a_run_replaces_what_an_earlier_one_wrote(
    result: Identification, other: Identification, tmp_path: Path
) -> None:
    first = {path.name for path in result.save(tmp_path, figures=True)}
    listed = json.loads((tmp_path / "manifest.json").read_text())["files"]
    assert {*listed, "manifest.json"} == first
    for name, entry in listed.items():
        assert hashlib.sha256((tmp_path / name).read_bytes()).hexdigest() == entry["sha256"]
        assert (tmp_path / name).stat().st_size == entry["bytes"]
    assert {"identified.urdf", "identified.xml", "training.png"} <= first <= set(NAMES)
    # Files of others stay, also under the name of a result: where no run wrote it, or it was
    # changed since.
    kept = {"notes.txt": "mine", "validation.png": "drawn by hand"}
    urdf = tmp_path / "identified.urdf"
    kept[urdf.name] = urdf.read_text() + "<!-- tuned -->\n"
    for name, text in kept.items():
        (tmp_path / name).write_text(text)
    notes: list[str] = []
    second = {path.name for path in other.save(tmp_path, figures=False, report=notes.append)}
    assert {path.name for path in tmp_path.iterdir()} == second | {*kept}
    assert not second & {"identified.urdf", "identified.xml", "training.png"}
    assert all((tmp_path / name).read_text() == text for name, text in kept.items())
    assert any("identified.urdf of an earlier run was changed" in note for note in notes)


@pytest.mark.parametrize(
    "text", ["", "[]", '{"files": 1}', '{"files": {"../x": "0"}}', "[" * 10_000]
)
def test_a_list_of_files_that_is_none(other: Identification, tmp_path: Path, text: str) -> None:
    (tmp_path / "x").write_text("kept")
    out = tmp_path / "out"
    out.mkdir()
    (out / "manifest.json").write_text(text)
    other.save(out, figures=False)
    assert (tmp_path / "x").exists()


@pytest.mark.parametrize("earlier", [False, True])
def test_whatever_fails_all_or_none(
    result: Identification,
    other: Identification,
    injector: Injector,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    earlier: bool,
) -> None:
    """Every change of the disk fails once: opening for writing, making, moving and removing."""
    first, out = tmp_path / "first", tmp_path / "out"
    # The same page each time: it is made fifty times here, and made anew it takes half of the time.
    html = report.report_html(other)
    monkeypatch.setattr(report, "report_html", lambda *_, **__: html)
    result.save(first, figures=False)
    for number in range(1, 150):
        shutil.rmtree(out, ignore_errors=True)
        if earlier:
            shutil.copytree(first, out)
        before = contents(out) if earlier else {}
        saved, reached = injector.writes(out, number, lambda: other.save(out, figures=False))
        if saved:
            # What failed was the removal of what is not needed, or nothing did.
            listed = json.loads((out / "manifest.json").read_text())["files"]
            names = {path.name for path in out.iterdir() if not path.name.startswith(".sdpid-")}
            assert {*listed, "manifest.json"} == names
        elif (out / "manifest.json").exists():
            # Before the moves or amid them there are no results but those of before.
            assert contents(out) == before, number
        if not reached:
            break
    assert saved
    assert 20 < number < 149


@pytest.mark.parametrize("suffix", ["txt", "parquet", "png", "urdf"])
def test_a_single_file_is_written_whole_or_not_at_all(
    result: Identification, injector: Injector, tmp_path: Path, suffix: str
) -> None:
    """Every change of the disk fails once, and the file that was there before stays."""
    pytest.importorskip("matplotlib")
    target = tmp_path / f"file.{suffix}"
    writers: dict[str, Callable[[], object]] = {
        "txt": lambda: _files.atomic_write_text(target, "new"),
        "parquet": lambda: recorded(1).to_parquet(target),
        "png": lambda: save_figure(plot_fit(result.problem.samples, result.training), target),
        "urdf": lambda: sdpid.write_urdf(result.estimate, target=target),
    }
    for number in range(1, 20):
        target.write_text("old")
        saved, reached = injector.writes(tmp_path, number, writers[suffix])
        assert [path.name for path in tmp_path.iterdir()] == [target.name]
        assert saved == (target.read_bytes() != b"old")
        if not reached:
            break
    assert saved
    assert 2 < number < 19


@pytest.mark.parametrize("limit", [0, 100, 3000, 20_000])
def test_a_disk_that_is_full_in_the_midst_of_a_file(
    result: Identification, tmp_path: Path, limit: int
) -> None:
    result.save(tmp_path / "out", figures=False)
    sizes = {path.stat().st_size for path in (tmp_path / "out").iterdir()}
    assert max(sizes) > limit
    before = contents(tmp_path / "out")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    try:
        refuses(ExportError, "too large", result.save, tmp_path / "out")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert contents(tmp_path / "out") == before


@pytest.mark.parametrize("name", ["report.html", "training.png", "result.json"])
def test_a_folder_in_the_place_of_a_file(result: Identification, tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    why = f"{name}: it is a folder"
    refuses(ExportError, why, result.save, tmp_path, figures=True)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_what_cannot_be_written_leaves_nothing(
    result: Identification, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Certificate, "to_json", Mock(side_effect=ExportError("no")))
    new, file = tmp_path / "new", tmp_path / "file"
    file.write_text("")
    refuses(ExportError, "^no$", result.save, new, figures=False)
    refuses(ExportError, "name a folder", result.save, file, figures=False)
    assert [*tmp_path.iterdir()] == [file]
