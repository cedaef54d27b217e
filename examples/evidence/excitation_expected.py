"""Does a run buy what its plan expects? Expected intervals against those of simulated runs.

For each robot a plan is made from its description alone. Twenty robots that differ from the
description (inertias by 15 %, friction within a factor of two) run it in closed loop
(`sdpid.simulate`), and `sdpid.identify` is given the logs without any hint: as one record, or as
periods that are averaged. Compared are the intervals that it states, and its errors, with what
the plan expected. A second table names what a prediction loses that leaves something out. A third
repeats a first run, or runs a plan made from the first run's estimate.

    python examples/evidence/excitation_expected.py --out results

It takes some twenty minutes on one core. The LWR 4+ is read from the folder of
docs/evidence/data.md, named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from simulated_logs import described, perturbed, there
from study import Rows, Study, grouped

import sdpid
from sdpid._common.arrays import Array
from sdpid.assurance.intervals.delta_method import friction_curve
from sdpid.estimation.compression.covariance import JointRows
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.problem import Problem
from sdpid.excitation.criterion.belief import ExpectedNoise, usual_effort
from sdpid.excitation.expected.expect import expect, rehearse
from sdpid.experiment.plant.simulate import plant_parts
from sdpid.experiment.trajectory.drawn import default_motion
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.robot.consistent import raise_second_moments
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.base_parameters import BaseParameters, structural_base

ROBOTS = ("ur10", "panda", "lwr4")

# Periods of a record, and of one that is averaged over them.
PERIODS = {"record": 1, "periods": 4}

# Noise of the efforts, as a share of each joint's usual effort, at the trajectory's rate.
NOISE = 0.03

# Of a first run and the one after it, s; and of the motion on which widths are compared.
SHORT, LONG = 10.0, 20.0

# Standard deviation of the logarithms by which inertias differ from the description's, and the
# radius of gyration that every link has at least, m.
PERTURBED, RADIUS = 0.15, 0.02

# Drives that follow the plan: the default's velocity loop this many times as stiff, and the
# position loop's pole, 1/s. The default's lags by 10 to 20 % of the motion, and stiff wrists stick.
STIFFER, POSITION_POLE = 2.0, 200.0

# Coulomb, sigmoid and viscous friction beside each other: single coefficients say little.
TRADED = ("Fs", "Fsg", "Fv")

# What a search may take, and where all is to be quick, s.
SEARCH, QUICK_SEARCH = 15.0, 4.0

# What the ratio of simulated to expected intervals must lie within.
LEAST, MOST = 0.8, 1.25


# Of one parameter of one run: half its interval as expected and as simulated, and its error.
ROW = ("robot", "reading", "seed", "name", "expected", "simulated", "error")
Row = Mapping[str, Any]


def plan_of(
    robot: sdpid.RobotModel, seed: int, duration: float, quick: bool, **given: Any
) -> Trajectory:
    """Return a plan from the robot's description, and from what else is given."""
    how = {"time_limit": QUICK_SEARCH if quick else SEARCH, "progress": False, **given}
    return sdpid.design_excitation(robot, duration=duration, seed=seed, **how).trajectory


def usual_of(robot: sdpid.RobotModel, bodies: Array, trajectory: Trajectory) -> Array:
    """Return the usual efforts of bodies on a motion, N·m; noise is a share of them."""
    rigid = robot.inverse_dynamics(bodies, *trajectory.sample())
    return usual_effort(np.sqrt(np.mean(rigid**2, axis=0)))


def twin_of(robot: sdpid.RobotModel, trajectory: Trajectory, seed: int) -> Array:
    """Draw the parameters of a robot that the description is of."""
    rng = np.random.default_rng(seed)
    bodies = np.array(robot.prior)
    bodies = perturbed(raise_second_moments(bodies, RADIUS**2 * bodies[:, 0]), PERTURBED, rng)
    coulomb = rng.uniform(0.05, 0.2, robot.n) * usual_of(robot, bodies, trajectory)
    viscous = rng.uniform(0.5, 1.5, robot.n) * coulomb
    return np.concatenate([bodies.ravel(), coulomb, viscous])


def log_of(
    robot: sdpid.RobotModel, trajectory: Trajectory, theta: Array, noise: Array, seed: int
) -> sdpid.Recording:
    """Return what a run records, with noise of the efforts, N·m."""
    _, drives = plant_parts(robot, trajectory, theta, None)
    drives = replace(
        drives,
        current_noise=noise / drives.effort_scale,
        velocity_gain=STIFFER * drives.velocity_gain,
        proportional_gain=np.full(robot.n, POSITION_POLE),
    )
    known = {"theta": theta, "drives": drives, "seed": seed, "progress": False}
    return sdpid.simulate(robot, trajectory, **known)


def as_record(log: sdpid.Recording) -> sdpid.Recording:
    """Return a log whose periods are not told."""
    return replace(log, period=None, start=None, periods=None)


def truth(base: BaseParameters, theta: Array, n: int) -> Array:
    """Return the base parameters of a twin; terms that it does not have are zero."""
    tail = theta[-2 * n :].reshape(2, n)
    known = {f"{kind}{j + 1}": tail[k, j] for k, kind in enumerate(("Fs", "Fv")) for j in range(n)}
    links = theta[: -2 * n]
    names = base.theta_names[len(links) :]
    return np.asarray(base.matrix @ np.concatenate([links, [known.get(x, 0.0) for x in names]]))


@cache
def planned(name: str, reading: str, duration: float, quick: bool) -> tuple[Any, ...]:
    """Return a robot, its plan, the noise and what is expected."""
    robot = described(name)
    trajectory = plan_of(robot, 0, duration, quick).with_periods(PERIODS[reading])
    deviation = NOISE * usual_of(robot, robot.prior, trajectory)
    noise = ExpectedNoise.white(deviation, trajectory.rate_hz)
    expected = expect(robot, trajectory, noise=noise, reading=reading)
    return robot, trajectory, noise, expected


def run(name: str, reading: str, seed: int, duration: float, quick: bool) -> Rows:
    """Simulate a run, identify, and compare with what was expected."""
    robot, trajectory, noise, expected = planned(name, reading, duration, quick)
    theta = twin_of(robot, trajectory, seed)
    log = log_of(robot, trajectory, theta, noise.deviation, seed)
    try:
        log = log if reading == "periods" else as_record(log)
        result = sdpid.identify(robot, log, effects="none")
    except sdpid.errors.SdpidError as error:
        print(f"{name} {reading} {seed}: {error}", flush=True)
        return
    if result.intervals is None:
        print(f"{name} {reading} {seed}: {result.intervals_note}", flush=True)
        return
    half = dict(zip(result.intervals.names, 0.5 * result.intervals.width, strict=True))
    base = result.problem.base
    wrong = np.abs(result.estimate.base - truth(base, theta, robot.n))
    errors = dict(zip(base.names, wrong, strict=True))
    widths = 0.5 * (expected.upper - expected.lower)
    for each, own in zip(expected.base.names, widths, strict=True):
        if each in half:
            yield name, reading, seed, each, own, half[each], errors[each]
    friction, half_widths = friction_curve(result.estimate, expected.speeds)
    coulomb, viscous = theta[-2 * robot.n :].reshape(2, robot.n)
    for k, speed in enumerate(expected.speeds.tolist()):
        wrong = np.abs(friction[k] - coulomb - viscous * speed)
        for j in range(robot.n):
            widths = expected.friction_half_widths[k, j], half_widths[k, j]
            yield name, reading, seed, f"friction {j + 1} at {speed:g}", *widths, wrong[j]


def traded(row: Row) -> bool:
    """Return whether a coefficient trades with others by a speed that the data choose.

    Coulomb friction, a sigmoid and viscous friction beside each other are a curve: that is told,
    and its coefficients are not.
    """
    return row["reading"] == "record" and row["name"].rstrip("0123456789") in TRADED


def summary(rows: Sequence[Row]) -> Rows:
    """Yield the table of ratios."""
    curves = [{**row, "of": "friction curves"} for row in rows if "friction" in row["name"]]
    base = [row for row in rows if not traded(row) and "friction" not in row["name"]]
    parameters = [{**row, "of": "base parameters"} for row in base]
    for key, own in grouped((*parameters, *curves), "robot", "reading", "of"):
        ratio, names = own["simulated"] / own["expected"], own["name"]
        medians = np.array([np.median(ratio[names == name]) for name in np.unique(names)])
        inside = 100.0 * np.mean((medians >= LEAST) & (medians <= MOST))
        held = 100.0 * np.mean(own["error"] <= own["expected"])
        low, middle, high = np.quantile(ratio, [0.1, 0.5, 0.9])
        yield *key, len(medians), middle, f"{low:.2f} to {high:.2f}", inside, held


# A run after a first one: the widest interval of the first, and the widest of all after it.
NEXT = (
    *("robot", "first", "seed", "widest", "before", "repeated", "planned", "all_repeated"),
    "all_planned",
)


def next_run(name: str, first: str, seed: int, quick: bool) -> Rows:
    """Run a first motion, then the same again, or a plan made from the first run's estimate."""
    robot = described(name)
    if first == "plan":
        motion = plan_of(robot, 0, SHORT, quick)
    else:
        motion = default_motion(robot, seed, period=SHORT, periods=1)
    theta = twin_of(robot, motion, seed)
    noise = NOISE * usual_of(robot, robot.prior, motion)

    def recorded(trajectory: Trajectory, number: int) -> sdpid.Recording:
        return as_record(log_of(robot, trajectory, theta, noise, 100 * seed + number))

    once, again = recorded(motion, 0), recorded(motion, 1)
    known = sdpid.identify(robot, once, effects="none")
    plan = plan_of(robot, seed, motion.duration, quick, previous=known)
    other = recorded(plan, 2)
    found = [
        known,
        *(sdpid.identify(robot, [once, run], effects="none") for run in (again, other)),
    ]
    sizes = effort_sizes(robot, known.problem)
    widths = []
    for result in found:
        pairs = zip(result.intervals.names, result.intervals.width.tolist(), strict=True)
        widths.append({each: width * sizes[each] for each, width in pairs if each in sizes})
    widest = max(widths[0], key=lambda each: widths[0][each])
    of_widest = (each[widest] for each in widths)
    yield widest, *of_widest, *(max(each.values()) for each in widths[1:])


def effort_sizes(robot: sdpid.RobotModel, problem: Problem) -> dict[str, float]:
    """Return the rms efforts that base parameters move per unit, on one motion for all runs.

    Widths of intervals are compared in these units, N·m: parameters of an arm have many. Left out
    are coefficients of friction that trade with each other (see `traded`).
    """
    q, v, a = (each[::25] for each in default_motion(robot, 77, period=LONG, periods=1).sample())
    links = robot.regressor(q, v, a)
    W = np.concatenate([links, problem.friction.columns(v, a)], axis=2)[:, :, problem.base.kept]
    sizes = np.sqrt(np.mean(np.sum(W**2, axis=1), axis=0))
    return {
        name: float(size)
        for name, size in zip(problem.base.names, sizes, strict=True)
        if name.rstrip("0123456789") not in TRADED
    }


def next_summary(rows: Sequence[Row]) -> Rows:
    """Yield the table of second runs."""
    for key, own in grouped(rows, "robot", "first"):
        again, planned = (np.median(own[each] / own["before"]) for each in ("repeated", "planned"))
        yield *key, again, planned, np.median(own["all_planned"] / own["all_repeated"])


def left_out(
    robot: sdpid.RobotModel, trajectory: Trajectory, noise: ExpectedNoise, rows: Sequence[Row]
) -> dict[str, float]:
    """Return the median ratio of predictions that leave something out to simulated intervals.

    Of base parameters of a record, one effect more at a time.
    """
    run = rehearse(robot, trajectory, noise=noise)
    problem = run.problem
    stated: dict[str, list[float]] = defaultdict(list)
    for row in rows:
        if row["reading"] == "record" and not traded(row):
            stated[row["name"]].append(row["simulated"])
    q, v, a = trajectory.sample()
    every = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=np.zeros_like(v))
    terms = (*(term for term in problem.friction.terms if "Sigmoid" not in type(term).__name__),)
    few = FrictionModel.from_terms(terms, robot.joint_names)
    kept = 1.0 / float(np.median(np.diff(problem.samples.time)))

    def of_rows(friction: FrictionModel, samples: sdpid.Samples, rate: float) -> dict[str, float]:
        base = structural_base(robot, friction)
        joints = JointRows.of(RowSource(robot, friction, base, samples))
        R = joints.joined(noise.density * rate).R[:, :-1]
        errors = np.sqrt(np.diag(np.linalg.inv(R.T @ R)))
        return dict(zip(base.names, errors.tolist(), strict=True))

    weighted = np.sqrt(np.diag(run.spectrum.covariance))
    whole = expect(robot, trajectory, noise=noise, repetitions=())
    found = {
        "every sample of the plan": of_rows(few, every, trajectory.rate_hz),
        "and the friction terms of identify": of_rows(problem.friction, every, trajectory.rate_hz),
        "and its filter and mask": of_rows(problem.friction, problem.samples, kept),
        "and its weights": dict(zip(problem.base.names, weighted.tolist(), strict=True)),
        "and its prior: what is expected": dict(
            zip(whole.names, whole.standard_errors.tolist(), strict=True)
        ),
    }
    return {
        what: float(
            np.median([1.96 * e[name] / np.median(s) for name, s in stated.items() if name in e])
        )
        for what, e in found.items()
    }


def main() -> None:
    """Run everything and write the tables."""
    study = Study(
        __doc__,
        quick={"robots": ["ur10"], "seeds": 1, "next": 1, "duration": SHORT, "firsts": ["plan"]},
        robots=[name for name in ROBOTS if name in there()],
        seeds=(20, "runs of each robot"),
        next=(3, "second runs of each robot"),
        firsts=["random", "plan"],
        duration=(20.0, "of a period, s"),
        jobs=1,
    )
    asked = study.duration, study.quick
    rows = study.rows(
        "runs.csv",
        ROW,
        lambda *case: run(*case, *asked),
        *(study.robots, PERIODS, range(study.seeds)),
        jobs=study.jobs,
    )
    header = (
        *("robot", "read as", "of", "number", "simulated / expected, median"),
        *("10 to 90 % of all runs", f"medians within {LEAST} to {MOST}, %"),
        "errors within the expected interval, %",
    )
    study.write("excitation_expected.csv", header, summary(rows), digits=3)
    lost = {}
    for name in study.robots:
        own = [row for row in rows if row["robot"] == name]
        lost[name] = left_out(*planned(name, "record", *asked)[:3], own)
    every = ([what, *(each[what] for each in lost.values())] for what in lost[study.robots[0]])
    study.write("left_out.csv", ("predicted from", *lost), every, digits=3)
    seconds = study.rows(
        "seconds.csv",
        NEXT,
        lambda *case: next_run(*case, study.quick),
        *(study.robots, study.firsts, range(study.next)),
        jobs=study.jobs,
    )
    header = (
        *("robot", "first run", "its widest interval after repeating it, of before"),
        *("after a plan from its estimate", "widest of all, plan / repeated"),
    )
    study.write("next_run.csv", header, next_summary(seconds), digits=3)


if __name__ == "__main__":
    main()
