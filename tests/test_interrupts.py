"""A run that a signal ends leaves earlier results whole."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from sdpid import _files
from sdpid._files import move_into, undisturbed
from sdpid.workflow.folder import Stage
from tests.helpers.arm_files import ARM_URDF, arm_log

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")


def identify(folder: Path, *more: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "sdpid", "identify", "log.npz", "--robot", "arm.urdf"]
    return subprocess.Popen(
        [*command, "--out", "out", *more],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a robot, a log, and results of an earlier run."""
    folder = tmp_path_factory.mktemp("interrupted")
    (folder / "arm.urdf").write_text(ARM_URDF)
    t, q, tau = arm_log(folder / "arm.urdf")
    np.savez(folder / "log.npz", t=t, q=q, tau=tau)
    run = identify(folder)
    _, said = run.communicate(timeout=120)
    assert run.returncode == 0, said
    return folder


@pytest.mark.parametrize("delay", [0.0, 0.1])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_earlier_results_stay(folder: Path, number: signal.Signals, delay: float) -> None:
    before = contents(folder / "out")
    # Another margin, so that files of this run would differ.
    run = identify(folder, "--margin", "1e-4")
    ends = time.monotonic() + 60.0
    while not any(path.name.startswith(".sdpid-") for path in (folder / "out").iterdir()):
        assert run.poll() is None, run.communicate()
        assert time.monotonic() < ends
        time.sleep(0.002)
    time.sleep(delay)
    run.send_signal(number)
    _, said = run.communicate(timeout=60)
    assert run.returncode == 128 + number
    assert "Traceback" not in said
    assert contents(folder / "out") == before


def test_a_first_run_leaves_nothing(folder: Path) -> None:
    fresh = folder / "fresh"
    run = identify(folder, "--out", "fresh")
    ends = time.monotonic() + 60.0
    while not fresh.exists():
        assert run.poll() is None
        assert time.monotonic() < ends
        time.sleep(0.002)
    run.terminate()
    _, said = run.communicate(timeout=60)
    assert run.returncode == 128 + signal.SIGTERM
    assert said == ""
    assert not fresh.exists()


@pytest.mark.parametrize("mistake", [False, True])
def test_an_end_that_comes_amid_a_callback_is_quiet(mistake: bool) -> None:
    amid = "1 / 0" if mistake else "os.kill(os.getpid(), signal.SIGTERM)"
    code = f"""
import os, signal, weakref
from sdpid._files import end_if_told
from sdpid.cli.errors import clean_up_when_ended
class Thing: pass
clean_up_when_ended()
thing = Thing()
gone = weakref.ref(thing, lambda _: {amid})
del thing
end_if_told()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == (0 if mistake else 128 + signal.SIGTERM)
    assert ("ZeroDivisionError" in done.stderr) if mistake else (done.stderr == "")


def test_files_move_together(tmp_path: Path) -> None:
    stage = tmp_path / "stage"
    stage.mkdir()
    files = [stage / name for name in "abc"]

    def given() -> list[Path]:
        # The signal comes when one file has moved.
        return [file for file in files if file.write_text(file.name)]

    def moved():  # type: ignore[no-untyped-def]
        for i, file in enumerate(given()):
            if i == 1:
                os.kill(os.getpid(), signal.SIGINT)
            yield file

    with pytest.raises(KeyboardInterrupt):
        move_into(tmp_path, moved())
    assert [(tmp_path / file.name).read_text() for file in files] == ["a", "b", "c"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_nothing_is_held_back_without_a_signal() -> None:
    with undisturbed():
        pass
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_nothing_is_moved_once_a_signal_was_to_end_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even where what the handler raised was swallowed, as some imports do."""
    monkeypatch.setattr(_files, "_ending", [])
    with pytest.raises(SystemExit) as ended:
        _files.end_by(signal.SIGTERM)
    assert ended.value.code == 128 + signal.SIGTERM
    stage = tmp_path / "stage"
    stage.mkdir()
    (stage / "a").write_text("a")
    with pytest.raises(SystemExit):
        move_into(tmp_path, [stage / "a"])
    assert not (tmp_path / "a").exists()


def test_a_stage_takes_away_what_was_made_for_it(tmp_path: Path) -> None:
    stage = Stage(tmp_path / "deep" / "out")
    stage.remove()  # before anything is made
    (stage.make() / "half").write_text("")
    stage.remove()
    stage.remove()
    assert list(tmp_path.iterdir()) == []
    stage = Stage(tmp_path / "deep" / "out")
    stage.make()
    (tmp_path / "deep" / "other").write_text("kept")
    stage.remove()
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["other"]
