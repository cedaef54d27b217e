"""The sides of the comparison with FIGAROH, each in a process of its own.

FIGAROH is configured as for the benchmark, whose adapter this uses: a median filter of 5 samples
and a zero-phase Butterworth filter of order 4 at 100 Hz, `numpy.gradient` twice, efforts not
filtered; viscous and Coulomb friction, rotor inertia, offset, and three columns of the coupled
wrist, which FIGAROH leaves to its user; rows decimated by 10; no plots and no files.
"""

from __future__ import annotations

import contextlib
import io
import platform
import sys
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

_ADAPTERS = Path(__file__).resolve().parents[2] / "benchmark" / "adapters"
_RATE_HZ, _CUTOFF_HZ = 5000.0, 100.0
_JOINTS = tuple(f"joint_{k}" for k in range(1, 7))
_WRIST = _JOINTS[4:]
# As the coupling's friction is smoothed in examples/evidence/real_robots.py, rad/s.
_WIDTH = 0.05
_LIBRARIES = ("sdpid", "figaroh", "numpy", "scipy", "pin", "clarabel", "numba")

Job = Callable[[str, str], None]


def sdpid_job(everything: bool) -> Job:
    """Import sdpid and return its job: to the certificate, or all that `identify` does."""
    import sdpid

    def job(log_file: str, robot_file: str) -> None:
        from sdpid.experiment.preparation.prepare import default_friction
        from sdpid.workflow.formulate import formulate
        from sdpid.workflow.identify import identify

        log = sdpid.read_recording(log_file)
        robot = sdpid.load_robot(robot_file)
        wrist = sdpid.friction.Coupling(*_WRIST, width=_WIDTH)
        friction = (*default_friction(log), "rotor_inertia", wrist)
        if everything:
            certificate = identify(robot, log, friction=friction).certificate
        else:
            problem = formulate(robot, log, friction=friction)
            certificate = sdpid.certify(sdpid.solve_sdp(problem))
        assert certificate.passed, certificate.summary()

    return job


def figaroh_job(weighted: bool, wrist: bool = True) -> Job:
    """Import FIGAROH and return its job, with the columns of the wrist or without."""
    sys.path.append(str(_ADAPTERS))
    import figaroh_tool
    from protocol import Rows, Task

    if not wrist:
        # The step that fails with columns of one's own is left out only where there are such.
        del figaroh_tool.Fit._compute_validation_metrics
    nothing = Rows(*[np.zeros((0, len(_JOINTS)))] * 3)

    def job(log_file: str, robot_file: str) -> None:
        with np.load(log_file, allow_pickle=False) as stored:
            log = {"time": stored["t"], "position": stored["q"], "effort": stored["tau"]}
        task = Task(
            name="tx40",
            urdf=robot_file,
            joints=_JOINTS,
            rate_hz=_RATE_HZ,
            cutoff_hz=_CUTOFF_HZ,
            log=log,
            common=nothing,
            asked=nothing,
            wrist=_WRIST if wrist else (),
        )
        figaroh_tool.fit(task, own=True, weighted=weighted)

    return job


SIDES: dict[str, Callable[[], Job]] = {
    "sdpid": partial(sdpid_job, False),
    "sdpid, identify": partial(sdpid_job, True),
    "FIGAROH, ordinary": partial(figaroh_job, False),
    "FIGAROH, weighted": partial(figaroh_job, True),
    "FIGAROH, without the wrist": partial(figaroh_job, False, wrist=False),
}


def twice(side: str, began: float, log_file: str, robot_file: str) -> dict[str, Any]:
    """Do a side's job twice, in the process that is this one and was started at a time."""
    # Reports go to the terminal.
    with contextlib.redirect_stdout(io.StringIO()):
        job = SIDES[side]()
        start = time.perf_counter()
        job(log_file, robot_file)
        first = time.perf_counter() - start
        whole = time.time() - began
        start, used = time.perf_counter(), time.process_time()
        job(log_file, robot_file)
        second, processor = time.perf_counter() - start, time.process_time() - used
    versions = {"python": platform.python_version()}
    for name in _LIBRARIES:
        with contextlib.suppress(PackageNotFoundError):
            versions[name] = version(name)
    times = {"first": first, "whole": whole, "second": second, "processor": processor}
    return times | {"versions": versions}
