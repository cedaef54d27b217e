"""Do intervals of quadrupeds hold the truth? Simulated logs of many seeds, and what it rests on.

Go1, Solo12 and A1 in MuJoCo, their links 15 % off the description, with friction, rotor inertia and
noise (`sdpid.simulate_legged`). Of every seed the share of true base parameters inside their 95 %
intervals, and whether the total mass is inside its own:

* ``before``: of a trot alone, a cut-off of 15 times the motion;
* ``all``: a cut-off that noise of joint positions lowers, and all samples;
* ``landings``: of stand, trot and hang, without the samples whose filter sees a landing;
* ``bias``: the default, with intervals that count the bias by noise in the motion.

    python examples/studies/legged_intervals.py --seeds 10 --out results
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import sdpid
from sdpid._common.tables import Table
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.motion_noise.bias import with_motion_bias
from sdpid.estimation.posterior import Posterior
from sdpid.estimation.problem import Problem
from sdpid.experiment.plant.legged.truth import changed_parameters
from sdpid.experiment.preparation.several import prepare_recordings
from sdpid.experiment.processing.motion import motion_frequency
from sdpid.workflow.formulate import formulate

ROBOTS = ("go1", "solo12", "a1")
MOTIONS = ("stand", "trot", "hang")
SETS = (("trot",), MOTIONS)
LEVEL = 0.95
CELL = (
    "robot", "motions", "chain", "seed",
    "within_percent", "mass_within", "mass_error_percent", "half_width",
)  # fmt: skip
COLUMNS = (
    "robot", "motions", "chain", "seeds", "within_percent", "within_worst_percent",
    "mass_within_percent", "mass_error_percent", "half_width",
)  # fmt: skip


def formulated(
    robot: sdpid.RobotModel, logs: Sequence[sdpid.Recording], settings: dict[str, Any]
) -> tuple[Problem, sdpid.Processing]:
    """Return the problem that `identify` solves, the terms of friction being known."""
    prepared = prepare_recordings(robot, logs, settings)
    problem = formulate(
        robot,
        prepared,
        friction=(sdpid.friction.Coulomb(width=0.02), "viscous", "rotor_inertia"),
        weighting=None,
        consistency="pseudo_inertia",
        constraints=None,
        prior=None,
        effects="none",
    )
    return problem, prepared.processing


def judged(estimate: Estimate, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return errors of base parameters and of the total mass, and half widths of intervals."""
    from scipy.special import stdtrit

    problem = estimate.problem
    masses = np.zeros(problem.n_theta)
    masses[: 10 * problem.robot.n_links : 10] = 1.0
    functions = np.vstack([problem.base.matrix, masses])
    variance, _, freedom = Posterior.of(estimate).spread(functions)
    half = stdtrit(freedom, 0.5 * (1.0 + LEVEL)) * np.sqrt(variance)
    assert estimate.theta is not None
    return np.asarray(functions @ (np.asarray(estimate.theta) - theta)), np.asarray(half)


def cells(name: str, seed: int, seconds: float) -> Iterator[tuple[object, ...]]:
    """Yield what one robot of one seed says."""
    robot = sdpid.load_robot(name, root="free_flyer")
    theta = changed_parameters(robot, seed=seed)
    logs = {
        motion: sdpid.simulate_legged(
            robot, motion, theta=theta, duration=seconds, seed=10 * seed + number
        ).recording
        for number, motion in enumerate(MOTIONS)
    }
    for motions in SETS:
        own = [logs[motion] for motion in motions]
        fast = {"impact_s": None}
        chains: list[tuple[str, dict[str, Any]]] = [("all", fast), ("landings", {})]
        if len(own) == 1:
            cutoff = 15.0 * motion_frequency(own[0])
            # The default keeps the landings of a trot alone.
            chains = [("before", {**fast, "cutoff_hz": cutoff}), ("all", {})]
        estimates = []
        for chain, settings in chains:
            problem, processing = formulated(robot, own, settings)
            estimates.append((chain, sdpid.solve_sdp(problem)))
        biased = with_motion_bias(problem, own, processing)
        estimates.append(("bias", replace(estimates[-1][1], problem=biased)))
        widths = None
        for chain, estimate in estimates:
            error, half = judged(estimate, theta)
            inside = np.abs(error) <= half
            widths = half if widths is None else widths
            yield (
                name, ", ".join(motions), chain, seed, 100.0 * inside[:-1].mean(),
                int(inside[-1]),
                100.0 * abs(error[-1]) / theta[: 10 * robot.n_links : 10].sum(),
                float(np.median(half / widths)),
            )  # fmt: skip


def summary(found: Sequence[dict[str, str]]) -> Iterator[tuple[object, ...]]:
    """Yield one row a robot, set of motions and chain."""
    keys = dict.fromkeys((row["robot"], row["motions"], row["chain"]) for row in found)
    for key in keys:
        own = [row for row in found if (row["robot"], row["motions"], row["chain"]) == key]
        within, mass, error, half = (
            np.array([float(row[column]) for row in own]) for column in CELL[4:]
        )
        yield (
            *key, len(own), within.mean(), within.min(), 100.0 * mass.mean(),
            np.median(error), np.median(half),
        )  # fmt: skip


def main() -> None:
    """Write the table; seeds that are in the file of cells already are not run again."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--robots", nargs="+", default=ROBOTS)
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--quick", action="store_true", help="one seed of one robot, 2 s")
    options = parser.parse_args()
    if options.quick:
        options.seeds, options.seconds, options.robots = 1, 2.0, ["go1"]
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "cells.csv"
    if not path.exists():
        path.write_text(",".join(CELL) + "\n")
    for seed in range(options.seeds):
        for name in options.robots:
            with path.open() as file:
                done = {(row["robot"], row["seed"]) for row in csv.DictReader(file)}
            if (name, str(seed)) in done:
                continue
            rows = list(cells(name, seed, options.seconds))
            with path.open("a", newline="") as file:
                csv.writer(file).writerows(rows)
            for row in rows:
                print(*row, flush=True)
    with path.open() as file:
        found = list(csv.DictReader(file))
    table = Table(COLUMNS, tuple(summary(found)))
    print(table.text(4))
    table.write(options.out / "legged_intervals.csv")


if __name__ == "__main__":
    main()
