"""Fixtures and Hypothesis profiles of the whole suite."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel

_CI = os.environ.get("CI", "").lower() == "true"

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
settings.load_profile("ci" if _CI else "dev")

_REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Return the folder of real recordings; they are too large to ship with the tests."""
    folder = Path(os.environ.get("SDPID_DATA", _REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        reason = f"no recordings in {folder}; set SDPID_DATA to their folder"
        if _CI:
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


@pytest.fixture(scope="session")
def dask_client() -> Iterator[Any]:
    """Return a client of two worker processes; tests that use it share the group ``dask``."""
    distributed = pytest.importorskip("distributed", reason="the extra dask is not installed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=":0", processes=True
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client
