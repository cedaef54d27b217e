"""Output error on simulated arms: wrong gains of the controller, far starts, and time.

Arms with Coulomb and viscous friction under a PD controller at 5 kHz that differences noisy
positions. Two tables:

* ``controller_check.csv``: how often a controller is refused whose gains are right, or off.
* ``output_error.csv``: how far efforts of the parameters found are off, in how many runs the
  controller is refused, iterations, and seconds of the processor.

    python examples/evidence/output_error.py --runs 3 --out results
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from bias_test import CONTROL_HZ, MASKED, processing_of, sized, solved
from study import Study, grouped

import sdpid
from sdpid.errors import DataError
from sdpid.estimation.closed_loop.loop import ClosedLoop, ControllerCheck
from sdpid.estimation.closed_loop.solve import CONTROLLER
from sdpid.experiment.preparation.twin import Twin

# Deviation of the encoders' noise, rad.
NOISE = 1e-5

RATE_HZ, CUTOFF_HZ = 250.0, 30.0

ROBOTS = ("ur10_robot", "kinova_description/kinova")

# Only the check is measured on these.
MORE = ("panda_description/panda",)

# Deviations of the noise of encoders (rad), factors of gains, and logs a run of the other table,
# for the table of the check.
NOISES, CHECKED, LOGS = (1e-6, 1e-5, 5e-5), (1.0, 0.95, 1.05, 0.9, 1.1), 4

# Factors of the controller's gains. Half the gains, and spreads of the start's parameters, are for
# the first robot: the other does not follow its commands then, which is told.
GAINS, SPREADS = (1.0, 1.05, 1.2), (0.15, 0.3, 0.6)
HALF = 0.5

METHODS = ("instruments", "didim", "closed_loop")

HEADER = (
    "robot", "method", "gains", "start_percent", "runs", "refused", "error_percent", "iterations",
    "seconds",
)  # fmt: skip

CHECK = (
    "robot", "noise_rad", "runs", "misfit_percent", "error_percent",
    *(f"refused_{round(100 * gain)}_percent" for gain in CHECKED),
)  # fmt: skip

Case = tuple[str, str, float, float]


def cases(robots: tuple[str, ...], gains: tuple[float, ...]) -> list[Case]:
    """Return robots, methods, factors of the gains, and spreads of starts."""
    found: list[Case] = []
    for robot in robots:
        found.append((robot, "least squares", 1.0, 0.0))
        first = robot == ROBOTS[0] and len(gains) > 1
        for method in METHODS:
            own = (*gains, HALF) if first else gains
            found += [(robot, method, gain, 0.0) for gain in own]
            if first and method != "instruments":
                found += [(robot, method, 1.0, spread) for spread in SPREADS]
    return found


def rows(case: Case, seed: int) -> Iterator[tuple[Any, ...]]:
    """Yield error, number of linear problems, and seconds of a case on a log."""
    robot, method, gain, spread = case
    processing = processing_of(RATE_HZ, CUTOFF_HZ, MASKED)
    arm = sized(robot, RATE_HZ, ("coulomb", "viscous"))
    truth, log = arm.model.theta, arm.log(seed, NOISE)
    problem = arm.problem(log, processing)
    law = sdpid.controllers.PD(gain * arm.controller.kp, gain * arm.controller.kd)
    start = truth * (1.0 + spread * np.random.default_rng((seed, 2)).uniform(-1.0, 1.0, len(truth)))
    common = {"controller": law, "processing": processing, "solver": solved}
    closed = {"method": method, "control_hz": CONTROL_HZ, **common}
    if spread:
        closed["start"] = start
    refused, begin = False, time.process_time()
    if method == "least squares":
        estimate = solved(problem)
    elif method == "instruments":
        estimate = sdpid.solve_instrumental(problem, log, **common)
    else:
        try:
            estimate = sdpid.solve_output_error(problem, log, **closed)
        except DataError:
            refused, begin = True, time.process_time()
            closed["controller_tolerance"] = np.inf
            estimate = sdpid.solve_output_error(problem, log, **closed)
    seconds = time.process_time() - begin
    right = problem.A @ problem.base_of(truth)
    error = np.linalg.norm(problem.A @ estimate.base - right) / np.linalg.norm(right)
    # Linear problems that were solved.
    own = 1 if method == "least squares" else estimate.iterations
    count = getattr(estimate, "rounds", own)
    name = robot.rpartition("/")[2]
    yield name, method, gain, 100.0 * spread, refused, 100.0 * error, count, seconds


def check_rows(robot: str, noise: float, seed: int) -> Iterator[tuple[Any, ...]]:
    """Yield which controllers are refused on a log.

    The misfit of the right one's efforts and the standard error of their ratio are those of the
    joint that has most.
    """
    processing = processing_of(RATE_HZ, CUTOFF_HZ, MASKED)
    arm = sized(robot, RATE_HZ, ("coulomb", "viscous"))
    right, size, refused = arm.controller, (0.0, 0.0), []
    twin = Twin.of(arm.model.robot, arm.log(seed, noise), processing)
    for gain in CHECKED:
        law = sdpid.controllers.PD(gain * right.kp, gain * right.kd)
        check = ControllerCheck(ClosedLoop(twin, law, control_hz=CONTROL_HZ))
        if gain == 1.0:
            size = float(check.misfit.max()), float(check.error.max())
        try:
            check.require(CONTROLLER)
            refused.append(False)
        except DataError:
            refused.append(True)
    yield robot.rpartition("/")[2], noise, *size, *refused


def main() -> None:
    """Write the tables: medians over runs."""
    study = Study(
        __doc__,
        quick={"runs": 1, "robots": [ROBOTS[0]], "gains": [GAINS[0]], "more": 0},
        runs=3,
        robots=[*ROBOTS],
        gains=[*GAINS],
        more=(len(MORE), "robots that only the check is measured on"),
    )
    robots = (*study.robots, *MORE[: study.more])
    refused = CHECK[5:]
    found = study.rows(
        "checks.csv",
        ("robot", "noise_rad", "misfit", "error", *refused),
        itertools.product(robots, NOISES, range(LOGS * study.runs)),
        lambda case: check_rows(*case),
    )
    lines = []
    for key, own in grouped(found, "robot", "noise_rad"):
        medians = (100.0 * np.median(own[name]) for name in ("misfit", "error"))
        shares = (100.0 * own[name].mean() for name in refused)
        lines.append((*key, len(own["misfit"]), *medians, *shares))
    study.write("controller_check.csv", CHECK, lines)
    found = study.rows(
        "runs.csv",
        (*HEADER[:4], *HEADER[5:]),
        itertools.product(cases(tuple(study.robots), tuple(study.gains)), range(study.runs)),
        lambda case: rows(*case),
    )
    lines = []
    for key, own in grouped(found, *HEADER[:4]):
        medians = (np.median(own[name]) for name in HEADER[6:])
        lines.append((*key, study.runs, int(own["refused"].sum()), *medians))
    study.write("output_error.csv", HEADER, lines)


if __name__ == "__main__":
    main()
