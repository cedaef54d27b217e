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

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from legged import ROBOTS as EVERY
from legged import THREE, Walker
from scipy.special import stdtrit
from study import Rows, Study

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.motion_noise import with_motion_bias
from sdpid.estimation.posterior import Posterior
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.prepare import prepare
from sdpid.workflow.formulate import formulate

ROBOTS = ("go1", "solo12", "a1")
# On soles, which steps in place of the trot.
HUMANOID = "talos_reduced"
KNOWN = (sdpid.friction.Coulomb(width=0.02), "viscous", "rotor_inertia")
# What is measured: motions, seconds each, friction, and how many of the seeds.
SETS = (
    (("trot",), 4.0, "known", 10),
    (THREE, 4.0, "known", 10),
    (("trot", "hang"), 4.0, "known", 3),
    (("trot",), 10.0, "known", 3),
    (("trot",), 4.0, "chosen", 3),
    (THREE, 4.0, "chosen", 1),
    (("stand", "trot"), 4.0, "known", 3),
    (THREE, 10.0, "known", 3),
    (EVERY[HUMANOID], 3.0, "known", 1),
)
ON_TIME = {f"{channel}_delay_s": 0.0 for channel in ("effort", "imu", "base", "contacts")}
LEVEL = 0.95
# Samples of the log at which the force on the base is asked for.
INSTANTS = 20
# Robots with their runs, which several sets have.
walker = cache(Walker)


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
    variance, _, freedom = Posterior.of(estimate).spread(functions)
    return np.asarray(stdtrit(freedom, 0.5 * (1.0 + LEVEL)) * np.sqrt(variance))


def cells(name: str, seed: int, number: int) -> Rows:
    """Yield what one set of motions of one robot and seed says."""
    motions, seconds, friction, _ = SETS[number]
    own = walker(name, seed, seconds, None, friction == "known")
    logs = own.logs(*motions)
    problem, processing = formulated(own.robot, logs, friction)
    estimate = sdpid.solve_sdp(problem)
    default = with_motion_bias(problem, logs, processing)
    base, masses, forces = asked(problem)
    functions, count = np.vstack([base, masses, forces]), len(base)
    error = functions @ (np.asarray(estimate.theta) - own.theta)
    mass = 100.0 * abs(error[count]) / own.masses.sum()
    first = None
    for intervals, counted in (
        ("residuals", problem),
        ("noise", replace(default, errors=default.errors[:1])),
        ("default", default),
    ):
        half = half_widths(replace(estimate, problem=counted), functions)
        inside = np.abs(error) <= half
        first = half if first is None else first
        shares = 100.0 * inside[:count].mean(), inside[count], 100.0 * inside[count + 1 :].mean()
        wider = np.median(half[:count] / first[:count])
        labels = name, ", ".join(motions), f"{seconds:g}", friction, intervals
        yield *labels, seed, *shares, mass, wider


def main() -> None:
    """Write the table: a row a set of motions and kind of intervals, and a robot of the default."""
    study = Study(
        __doc__,
        quick={"seeds": 1, "robots": ["go1"], "sets": [0]},
        seeds=(10, "at most so many of each set"),
        robots=[*ROBOTS],
        sets=[*range(len(SETS))],
    )
    wanted = [
        (name, seed, number)
        for number in study.sets
        for seed in range(min(study.seeds, SETS[number][-1]))
        for name in ([HUMANOID] if SETS[number][0] == EVERY[HUMANOID] else study.robots)
    ]
    by = ("robot", "motions", "seconds", "friction", "intervals")
    header = (*by, "seed", "within", "mass_within", "force_within", "mass_error", "half_width")
    found = study.rows("cells.csv", header, cells, wanted)
    # All robots of a set, and of the default each by itself.
    shown: list[dict[str, Any]] = []
    for kind in dict.fromkeys(tuple(row[name] for name in by[1:]) for row in found):
        own = [row for row in found if tuple(row[name] for name in by[1:]) == kind]
        shown += [{**row, "robot": "all"} for row in own]
        if kind[-1] == "default":
            shown += sorted(own, key=lambda row: str(row["robot"]))
    columns = {
        "seeds": "count within",
        "within_percent": "mean within",
        "within_worst_percent": "min within",
        "mass_within_percent": "percent mass_within",
        "force_within_percent": "mean force_within",
        "mass_error_percent": "median mass_error",
        "half_width": "median half_width",
    }
    shown.sort(key=lambda row: bool(row["friction"] != "known"))
    study.summary("legged_intervals.csv", shown, by, columns)


if __name__ == "__main__":
    main()
