"""A run that a signal ends leaves earlier results whole."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.arm_files import write_arm
from tests.helpers.commands import python
from tests.helpers.forged import contents

pytestmark = [
    pytest.mark.skipif(os.name != "posix", reason="signals of POSIX"),
    pytest.mark.usefixtures("interruptible"),
]


def identify(folder: Path, *more: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "sdpid", "identify", "log.npz", "--robot", "arm.urdf"]
    pipes: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([*command, "--out", "out", *more], cwd=folder, **pipes)


def wait(run: subprocess.Popen[str], begun: Callable[[], bool]) -> None:
    """Wait until a run has begun, which must not end before."""
    ends = time.monotonic() + 300.0
    while not begun():
        assert run.poll() is None, run.communicate()
        assert time.monotonic() < ends
        time.sleep(0.002)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a robot, a log, and results of an earlier run."""
    folder = tmp_path_factory.mktemp("interrupted")
    write_arm(folder)
    run = identify(folder)
    _, stderr = run.communicate(timeout=300)
    assert run.returncode == 0, stderr
    return folder


@pytest.mark.parametrize(
    ("number", "delay"), [(signal.SIGINT, 0.0), (signal.SIGTERM, 0.1), (signal.SIGHUP, 0.0)]
)
def test_earlier_results_stay(folder: Path, number: signal.Signals, delay: float) -> None:
    before = contents(folder / "out")
    # Another margin, so that files of this run would differ.
    run = identify(folder, "--margin", "1e-4")
    wait(run, lambda: any((folder / "out").glob(".sdpid-*")))
    time.sleep(delay)
    run.send_signal(number)
    run.communicate(timeout=300)
    # Of SIGINT Python may end by the signal itself, which shells call the same.
    assert run.returncode in (128 + number, -number)
    assert contents(folder / "out") == before


def test_a_first_run_leaves_nothing(folder: Path) -> None:
    fresh = folder / "fresh"
    run = identify(folder, "--out", "fresh")
    wait(run, fresh.exists)
    run.terminate()
    run.communicate(timeout=300)
    assert run.returncode == 128 + signal.SIGTERM
    assert not fresh.exists()


def test_the_command_starts_no_children_by_which_mujoco_looks_for_a_window() -> None:
    pytest.importorskip("mujoco")
    code = """
import sys, sdpid.cli
sys.argv = ["sdpid", "--version"]
try:
    sdpid.cli.main()
except SystemExit:
    import mujoco
    sys.exit("glfw" in sys.modules)
"""
    done = python("-c", code)
    assert (done.returncode, done.stderr) == (0, "")
