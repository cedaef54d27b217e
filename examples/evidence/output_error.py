"""Output error on simulated arms: wrong gains of the controller, far starts, and time.

Arms with Coulomb and viscous friction under a PD controller at 5 kHz that differences noisy
positions. Two tables:

* ``controller_check.csv``: how often a controller is refused whose gains are right, or off.
* ``output_error.csv``: how far efforts of the parameters found are off, in how many runs the
  controller is refused, iterations, and seconds of the processor.

    python examples/evidence/output_error.py --runs 3 --out results
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from bias_test import CONTROL_HZ, MASKED, Arm, processing_of, solved

import sdpid
from sdpid._common.progress import progress
from sdpid._common.tables import Table
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


def rows(wanted: list[Case], runs: int) -> Iterator[tuple[Any, ...]]:
    """Yield the medians over runs of each case."""
    processing = processing_of(RATE_HZ, CUTOFF_HZ, MASKED)
    for robot in dict.fromkeys(case[0] for case in wanted):
        arm = Arm(robot, RATE_HZ, ("coulomb", "viscous"))
        logs = [arm.log(seed, NOISE) for seed in range(runs)]
        problems = [arm.problem(log, processing) for log in logs]
        truth = arm.model.theta
        for _, method, gain, spread in (case for case in wanted if case[0] == robot):
            law = sdpid.controllers.PD(gain * arm.controller.kp, gain * arm.controller.kd)
            found, refused = [], 0
            for seed, (log, problem) in enumerate(zip(logs, problems, strict=True)):
                rng = np.random.default_rng((seed, 2))
                start = truth * (1.0 + spread * rng.uniform(-1.0, 1.0, len(truth)))
                common = {"controller": law, "processing": processing, "solver": solved}
                closed = {"method": method, "control_hz": CONTROL_HZ, **common}
                if spread:
                    closed["start"] = start
                begin = time.process_time()
                if method == "least squares":
                    estimate = solved(problem)
                elif method == "instruments":
                    estimate = sdpid.solve_instrumental(problem, log, **common)
                else:
                    try:
                        estimate = sdpid.solve_output_error(problem, log, **closed)
                    except DataError:
                        refused += 1
                        begin = time.process_time()
                        closed["controller_tolerance"] = np.inf
                        estimate = sdpid.solve_output_error(problem, log, **closed)
                seconds = time.process_time() - begin
                right = problem.A @ problem.base_of(truth)
                error = np.linalg.norm(problem.A @ estimate.base - right) / np.linalg.norm(right)
                # Linear problems that were solved.
                own = 1 if method == "least squares" else estimate.iterations
                count = getattr(estimate, "rounds", own)
                found.append((100.0 * float(error), count, seconds))
            medians = [float(each) for each in np.median(np.array(found), axis=0)]
            yield robot.rpartition("/")[2], method, gain, 100.0 * spread, runs, refused, *medians


def check_rows(robots: tuple[str, ...], runs: int) -> Iterator[tuple[Any, ...]]:
    """Yield how often controllers are refused, at each noise.

    The misfit of the right one's efforts and the standard error of their ratio are medians of the
    joint that has most.
    """
    processing = processing_of(RATE_HZ, CUTOFF_HZ, MASKED)
    for robot in robots:
        arm = Arm(robot, RATE_HZ, ("coulomb", "viscous"))
        right = arm.controller
        for noise in NOISES:
            refused, size = np.zeros(len(CHECKED)), []
            for seed in range(runs):
                twin = Twin.of(arm.model.robot, arm.log(seed, noise), processing)
                for k, gain in enumerate(CHECKED):
                    law = sdpid.controllers.PD(gain * right.kp, gain * right.kd)
                    check = ControllerCheck(ClosedLoop(twin, law, control_hz=CONTROL_HZ))
                    if gain == 1.0:
                        size.append((check.misfit.max(), check.error.max()))
                    try:
                        check.require(CONTROLLER)
                    except DataError:
                        refused[k] += 1
            medians = 100.0 * np.median(np.array(size), axis=0)
            shares = 100.0 * refused / runs
            yield robot.rpartition("/")[2], noise, runs, *medians.tolist(), *shares.tolist()


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--quick", action="store_true", help="one robot and log, the right gains")
    parser.add_argument("--out", type=Path, default=Path("results"))
    chosen = parser.parse_args()
    runs, robots, wanted = chosen.runs, (*ROBOTS, *MORE), cases(ROBOTS, GAINS)
    if chosen.quick:
        runs, robots, wanted = 1, ROBOTS[:1], cases(ROBOTS[:1], GAINS[:1])
    chosen.out.mkdir(parents=True, exist_ok=True)
    checked = []
    with progress(len(robots) * len(NOISES), "controller_check.csv") as advance:
        for row in check_rows(robots, LOGS * runs):
            checked.append(row)
            print(*row, flush=True)
            advance(1)
    Table(CHECK, tuple(checked)).write(chosen.out / "controller_check.csv")
    kept = []
    with progress(len(wanted), "output_error.csv") as advance:
        for row in rows(wanted, runs):
            kept.append(row)
            print(*row, flush=True)
            advance(1)
    Table(HEADER, tuple(kept)).write(chosen.out / "output_error.csv")


if __name__ == "__main__":
    main()
