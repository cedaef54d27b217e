"""Fixtures and Hypothesis profiles of the whole suite."""

from __future__ import annotations

import os

# Workers fight for the cores where each starts threads of its own: said before NumPy is loaded.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Nor does joblib start processes of its own, each of which would import everything, unless asked.
os.environ.setdefault("LOKY_MAX_CPU_COUNT", "1")

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from tests.helpers.kernels import compile_kernels

# On GitHub CI is "without-records": there is a server, and no public recordings.
_CI = os.environ.get("CI", "").lower()

# Examples take milliseconds to a second depending on the robot, so no deadline is right for all.
_QUIET = [HealthCheck.too_slow]
settings.register_profile("dev", max_examples=25, deadline=None, suppress_health_check=_QUIET)
settings.register_profile(
    "ci",
    # All of CI is to end within a quarter of an hour on two cores.
    max_examples=20,
    deadline=None,
    derandomize=True,
    print_blob=True,
    suppress_health_check=_QUIET,
)
# For a second run of the same tests, under other linear algebra.
settings.register_profile(
    "brief", max_examples=10, deadline=None, derandomize=True, suppress_health_check=_QUIET
)
settings.load_profile("ci" if _CI in ("true", "without-records") else "dev")

_TESTS = Path(__file__).resolve().parent
_REPOSITORY = _TESTS.parent
# Tests that take over a second of computing, and how much a test may take before it is named.
_SLOW = _TESTS / "slow.txt"
_UNLISTED_SECONDS = 5.0
_UNKNOWN = pytest.StashKey[list[str]]()


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile what Numba compiles once, before workers would each do so."""
    if not hasattr(session.config, "workerinput") and session.config.getoption("numprocesses", 0):
        compile_kernels()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark what `tests/slow.txt` lists; keep what it lists and nobody collected."""
    listed = set(_SLOW.read_text(encoding="utf-8").split("\n")) - {""}
    found = set()
    for item in items:
        names = {item.nodeid, item.nodeid.partition("[")[0]} & listed
        found |= names
        if names:
            item.add_marker(pytest.mark.slow)
    roots = {str(_TESTS), _TESTS.name, f"{_TESTS.name}/"}
    whole = config.args_source is not pytest.Config.ArgsSource.ARGS or bool(roots & {*config.args})
    config.stash[_UNKNOWN] = sorted(listed - found) if whole else []


@pytest.fixture
def unknown_slow_tests(request: pytest.FixtureRequest) -> list[str]:
    """Return the entries of `tests/slow.txt` that are no test; none where only some were asked."""
    return request.config.stash[_UNKNOWN]


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Name the tests that are slow and not listed as such."""
    for report in terminalreporter.stats.get("passed", ()):
        listed = {"slow", "examples", "studies"} & {*report.keywords}
        if report.when == "call" and report.duration > _UNLISTED_SECONDS and not listed:
            took = f"{report.nodeid} took {report.duration:.1f} s"
            terminalreporter.write_line(f"{took}: list it in tests/slow.txt if it is slow alone")


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Return the folder of real recordings; they are too large to ship with the tests."""
    folder = Path(os.environ.get("SDPID_DATA", _REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        reason = f"no recordings in {folder}; set SDPID_DATA to their folder"
        if _CI == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    return folder


@pytest.fixture(scope="session")
def denso() -> RobotModel:
    """Return the arm of the case study."""
    return load_robot("denso_vp6242")


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Heed signals that shells and nohup let processes in the background ignore."""
    usual: dict[signal.Signals, Any] = {signal.SIGINT: signal.default_int_handler}
    if os.name == "posix":
        usual[signal.SIGHUP] = signal.SIG_DFL
    before = {number: signal.signal(number, handler) for number, handler in usual.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture(scope="module")
def dask_client() -> Iterator[Any]:
    """Return a client of two worker processes.

    A cluster that waits takes a tenth of a core, so none outlives its module.
    """
    distributed = pytest.importorskip("distributed", reason="the extra dask is not installed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=":0", processes=True
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client
