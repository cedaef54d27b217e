"""From a log to a result, beside FIGAROH: the record of a Staubli TX40 (docs/evidence/data.md).

FIGAROH needs an environment of its own (``pip install figaroh==1.0.2``). Both sides read the same
24750 rows from the NPZ and the robot from the same URDF, and every measurement is a fresh process;
the sides take turns. sdpid's job ends with a certified optimum of the semidefinite program, with
its default settings and the terms of this robot's drives; FIGAROH's ends with its unconstrained fit
and its own report of it, with the settings of its example for this robot, as for the benchmark,
whose adapter is used here: a median filter of 5 samples and a zero-phase Butterworth filter of
order 4 at 100 Hz, `numpy.gradient` twice, efforts not filtered; viscous and Coulomb friction, rotor
inertia, offset, and three columns of the coupled wrist, which FIGAROH leaves to its user; rows
decimated by 10; no plots and no files.

FIGAROH 1.0.2 looks at its fit again at the end, with a regressor that it builds without the
columns of the wrist, and fails there. That step is left out where they are present, to FIGAROH's
advantage; as a third way, its fit runs as it is without those columns (`FIGAROH, without the
wrist`), which costs accuracy at joints 5 and 6.

Three times are compared: the second job in a process (nothing is imported or loaded for the first
time); the first job (what is imported on first use counts); and from the start of the process to
the first result (interpreter and imports count).
"""

from __future__ import annotations

import contextlib
import io
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

ADAPTERS = Path(__file__).resolve().parents[2] / "benchmark" / "adapters"
JOINTS = tuple(f"joint_{k}" for k in range(1, 7))
WRIST = JOINTS[4:]
TIMES = {
    "second": "second job in a process",
    "first": "first job in a process",
    "whole": "start of the process to the result",
}

Job = Callable[[str, str], None]


def sdpid_job() -> Job:
    """Import sdpid and return its job."""
    import sdpid

    def job(log_file: str, robot_file: str) -> None:
        from sdpid.experiment.preparation.prepare import default_friction
        from sdpid.workflow.formulate import formulate

        log = sdpid.read_recording(log_file)
        # The coupling's friction is smoothed as in examples/evidence/real_robots.py, rad/s.
        wrist = sdpid.friction.Coupling(*WRIST, width=0.05)
        friction = (*default_friction(log), "rotor_inertia", wrist)
        problem = formulate(sdpid.load_robot(robot_file), log, friction=friction)
        certificate = sdpid.certify(sdpid.solve_sdp(problem))
        assert certificate.passed, certificate.summary()

    return job


def figaroh_job(weighted: bool, wrist: bool = True) -> Job:
    """Import FIGAROH and return its job, with the columns of the wrist or without."""
    sys.path.append(str(ADAPTERS))
    import figaroh_tool
    from protocol import Rows, Task

    if not wrist:
        # The step that fails with columns of one's own is left out only where there are such.
        del figaroh_tool.Fit._compute_validation_metrics
    nothing = Rows(*[np.zeros((0, len(JOINTS)))] * 3)

    def job(log_file: str, robot_file: str) -> None:
        with np.load(log_file, allow_pickle=False) as stored:
            log = {"time": stored["t"], "position": stored["q"], "effort": stored["tau"]}
        task = Task(
            name="tx40",
            urdf=robot_file,
            joints=JOINTS,
            rate_hz=5000.0,
            cutoff_hz=100.0,
            log=log,
            common=nothing,
            asked=nothing,
            wrist=WRIST if wrist else (),
        )
        figaroh_tool.fit(task, own=True, weighted=weighted)

    return job


SIDES: dict[str, Callable[[], Job]] = {
    "sdpid": sdpid_job,
    "FIGAROH, ordinary": partial(figaroh_job, False),
    "FIGAROH, weighted": partial(figaroh_job, True),
    "FIGAROH, without the wrist": partial(figaroh_job, False, wrist=False),
}


def twice(side: str, began: float, *files: str) -> dict[str, float]:
    """Do a side's job twice, in the process that is this one and was started at a time."""
    # Reports go to the terminal.
    with contextlib.redirect_stdout(io.StringIO()):
        job = SIDES[side]()
        start = time.perf_counter()
        job(*files)
        first, whole = time.perf_counter() - start, time.time() - began
        start = time.perf_counter()
        job(*files)
        return {"first": first, "whole": whole, "second": time.perf_counter() - start}


def measure(bench: Any) -> Iterator[tuple[object, ...]]:
    """Yield the others' times as ratios to sdpid's."""
    from harness import apart, ratio

    if bench.figaroh_python is None or not bench.data.is_dir():
        print("left out: needs --figaroh-python and --data")
        return
    folder = bench.data / "staubli_tx40"
    files = [str(folder / "tx40_rows_0_24750.npz"), str(folder / "tx40.urdf")]

    def side(name: str) -> dict[str, float]:
        python = sys.executable if name == "sdpid" else bench.figaroh_python
        return apart(twice, name, time.time(), *files, python=python)

    # Once before: numba compiles into its cache, and files are read from disk.
    found = bench.in_turn({name: partial(side, name) for name in SIDES})
    ours = found.pop("sdpid")
    for name, runs in found.items():
        for key, what in TIMES.items():
            seconds, reference = (np.array([run[key] for run in each]) for each in (runs, ours))
            yield ratio(f"{name}: {what}", seconds, "sdpid, certified", reference)
