"""Do intervals of quadrupeds hold the truth? Simulated logs of many seeds, and what it rests on.

Go1, Solo12, A1 and Talos in MuJoCo, their links 15 % off the description, with friction, rotor
inertia and noise (`sdpid.simulate_legged`). Of every seed the share of true base parameters inside
their 95 % intervals, whether the total mass is inside its own, and how much of the force on the
base is, over the motion of the log:

* ``residuals``: what the residuals show, and no more;
* ``noise``: with the bias by noise in the motion;
* ``default``: with that by landings, too, where they are kept: of a gait, alone or beside
  one other motion; that by the filter elsewhere; and that by friction's law where the data
  chose its speeds.

Friction is *known* where the estimate is given its terms and speeds, *chosen* where `identify` fits
the width of its own sign to a law with a Stribeck peak that differs from seed to seed. Channels are
on time, and are not searched for delays.

    python examples/evidence/legged_intervals.py --out results
"""

from __future__ import annotations

import argparse
import csv
import pickle
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from legged import Walker

import sdpid
from sdpid._common.arrays import Array
from sdpid._common.tables import Table
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.motion_noise import with_motion_bias
from sdpid.estimation.posterior import Posterior
from sdpid.estimation.problem import Problem
from sdpid.experiment.plant.legged.truth import DryFriction, changed_parameters
from sdpid.experiment.preparation.prepare import prepare
from sdpid.workflow.formulate import formulate

ROBOTS = ("go1", "solo12", "a1")
MOTIONS = ("stand", "trot", "hang")
# On soles, which step in place of the trot.
HUMANOIDS, STEPS = ("talos_reduced",), ("stand", "step", "hang")
KNOWN = (sdpid.friction.Coulomb(width=0.02), "viscous", "rotor_inertia")
# What is measured: motions, seconds each, friction, and how many of the seeds.
SETS = (
    (("trot",), 4.0, "known", 10),
    (MOTIONS, 4.0, "known", 10),
    (("trot", "hang"), 4.0, "known", 3),
    (("trot",), 10.0, "known", 3),
    (("trot",), 4.0, "chosen", 3),
    (MOTIONS, 4.0, "chosen", 1),
    (("stand", "trot"), 4.0, "known", 3),
    (MOTIONS, 10.0, "known", 3),
    (STEPS, 3.0, "known", 1),
)
ON_TIME = {f"{channel}_delay_s": 0.0 for channel in ("effort", "imu", "base", "contacts")}
LEVEL = 0.95
# Samples of the log at which the force on the base is asked for.
INSTANTS = 20
CELL = (
    "robot", "motions", "seconds", "friction", "intervals", "seed",
    "within_percent", "mass_within", "force_within_percent", "mass_error_percent", "half_width",
)  # fmt: skip
COLUMNS = (
    "robot", "motions", "seconds", "friction", "intervals", "seeds",
    "within_percent", "within_worst_percent", "mass_within_percent", "force_within_percent",
    "mass_error_percent", "half_width",
)  # fmt: skip


def recorded(
    robot: sdpid.RobotModel,
    theta: Array,
    motion: str,
    seed: int,
    seconds: float,
    kept: Path,
    law: DryFriction | None = None,
) -> sdpid.Recording:
    """Return a simulated log; those that are kept are not simulated again."""
    path = kept / f"{robot.name}_{seed}_{motion}_{seconds:g}{'_law' if law else ''}.pickle"
    if path.exists():
        log: sdpid.Recording = pickle.loads(path.read_bytes())
        return log
    number = 10 * seed + (STEPS if motion in STEPS else MOTIONS).index(motion)
    run = sdpid.simulate_legged(
        robot, motion, theta=theta, duration=seconds, seed=number, friction=law
    )
    kept.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickle.dumps(run.recording))
    return run.recording


def formulated(
    robot: sdpid.RobotModel, logs: Sequence[sdpid.Recording], friction: str
) -> tuple[Problem, sdpid.Processing]:
    """Return the problem that `identify` solves, channels being on time."""
    prepared = prepare(robot, logs, ON_TIME)
    problem = formulate(
        robot, prepared, friction=KNOWN if friction == "known" else None, effects="none"
    )
    return problem, prepared.processing


def asked(problem: Problem) -> tuple[Array, Array, Array]:
    """Return functions (k, p) of theta: base parameters, the total mass, forces on the base.

    Of friction that is not the robot's, coefficients have no truth: they are left out.
    """
    links = 10 * problem.robot.n_links
    masses = np.zeros((1, problem.n_theta))
    masses[0, :links:10] = 1.0
    rows = problem.require_rows_here("forces on the base")
    at = np.linspace(0, problem.n_samples - 1, INSTANTS).astype(int)
    forces = np.concatenate([rows.rows(slice(k, k + 1))[0, :3, :-1] for k in at])
    base = problem.base.matrix
    if problem.origin.profiled:
        friction = [name.startswith("F") for name in problem.base.theta_names]
        base = base[~np.any(base[:, friction] != 0.0, axis=1)]
    return base, masses, forces @ problem.base.matrix


def half_widths(estimate: Estimate, functions: Array) -> Array:
    """Return half the widths (k,) of intervals of functions (k, p) of theta."""
    from scipy.special import stdtrit

    variance, _, freedom = Posterior.of(estimate).spread(functions)
    return np.asarray(stdtrit(freedom, 0.5 * (1.0 + LEVEL)) * np.sqrt(variance))


def cells(
    robot: sdpid.RobotModel, name: str, seed: int, number: int, kept: Path
) -> Iterator[tuple[object, ...]]:
    """Yield what one set of motions of one robot and seed says."""
    motions, seconds, friction, _ = SETS[number]
    theta = changed_parameters(robot, seed=seed)
    law = Walker(name, seed, seconds).law if friction == "chosen" else None
    logs = [recorded(robot, theta, motion, seed, seconds, kept, law) for motion in motions]
    problem, processing = formulated(robot, logs, friction)
    estimate = sdpid.solve_sdp(problem)
    default = with_motion_bias(problem, logs, processing)
    base, masses, forces = asked(problem)
    error = np.vstack([base, masses, forces]) @ (np.asarray(estimate.theta) - theta)
    first = None
    for intervals, counted in (
        ("residuals", problem),
        ("noise", replace(default, errors=default.errors[:1])),
        ("default", default),
    ):
        half = half_widths(replace(estimate, problem=counted), np.vstack([base, masses, forces]))
        inside = np.abs(error) <= half
        first = half if first is None else first
        count = len(base)
        yield (
            name, ", ".join(motions), f"{seconds:g}", friction, intervals, seed,
            100.0 * inside[:count].mean(),
            int(inside[count]),
            100.0 * inside[count + 1 :].mean(),
            100.0 * abs(error[count]) / theta[: 10 * robot.n_links : 10].sum(),
            float(np.median(half[:count] / first[:count])),
        )  # fmt: skip


def summary(found: Sequence[dict[str, str]]) -> Iterator[tuple[object, ...]]:
    """Yield one row a set of motions and kind of intervals, and one a robot of the default."""
    names = ["all", *dict.fromkeys(row["robot"] for row in found)]
    sets = dict.fromkeys(tuple(row[column] for column in CELL[1:5]) for row in found)
    for kind in sorted(sets, key=lambda each: each[2] != "known"):
        for name in names:
            own = [
                row
                for row in found
                if tuple(row[column] for column in CELL[1:5]) == kind
                and name in (row["robot"], "all")
            ]
            if not own or (name != "all" and kind[3] != "default"):
                continue
            within, mass, force, error, half = (
                np.array([float(row[column]) for row in own]) for column in CELL[6:]
            )
            yield (
                name, *kind, len(own), within.mean(), within.min(), 100.0 * mass.mean(),
                force.mean(), np.median(error), np.median(half),
            )  # fmt: skip


def main() -> None:
    """Write the table; what is in the file of cells already is not run again."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10, help="at most so many of each set")
    parser.add_argument("--robots", nargs="+", default=ROBOTS)
    parser.add_argument("--sets", nargs="+", type=int, default=range(len(SETS)))
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--logs", type=Path, help="folder that keeps simulated logs")
    parser.add_argument("--quick", action="store_true", help="one seed of a trot of one robot")
    options = parser.parse_args()
    if options.quick:
        options.seeds, options.robots, options.sets = 1, ["go1"], [0]
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "cells.csv"
    if not path.exists():
        path.write_text(",".join(CELL) + "\n")
    for number in options.sets:
        motions, seconds, friction, seeds = SETS[number]
        for seed in range(min(options.seeds, seeds)):
            for name in HUMANOIDS if motions == STEPS else options.robots:
                own = (name, ", ".join(motions), f"{seconds:g}", friction, str(seed))
                with path.open() as file:
                    done = {
                        tuple(row[column] for column in (*CELL[:4], "seed"))
                        for row in csv.DictReader(file)
                    }
                if own in done:
                    continue
                robot = sdpid.load_robot(name, root="free_flyer")
                rows = list(cells(robot, name, seed, number, options.logs or options.out / "logs"))
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
