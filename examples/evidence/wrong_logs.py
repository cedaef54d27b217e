"""Spoil good logs in known ways, and see whether the inspection names what is wrong.

Simulated logs of robots whose parameters are known (simulated_logs.py), inertias 15 % off the
description's, and the first public recording of every real arm of docs/evidence/data.md are
spoiled in some twenty ways. Each must be found and named; findings on the logs as they are are
counted as well.

    python examples/evidence/wrong_logs.py --data /path/to/data [--seeds 3] [--quick]

The folder of the data may also be named by the environment variable SDPID_DATA; without it only
simulated robots that come with the package's dependencies are looked at.
"""

from __future__ import annotations

import itertools
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path

import numpy as np
from data_sets import SETS, part, records_of
from simulated_logs import drawn, log_of, there, with_gravity
from study import Rows, Study, grouped, pivot

import sdpid
from sdpid._common.arrays import Array
from sdpid.experiment.inspection.inspect import inspect_recordings
from sdpid.experiment.inspection.kinds import Finding
from sdpid.experiment.plant.simulate import true_parameters
from sdpid.experiment.recording.joints import match_joints

# N·m per ampere at the joints of arms of this size, from the first joint to the last.
TORQUE_CONSTANTS = (14.0, 9.0)
DELAY_S = 0.06
# A load of this share of the arm's mass, its center of mass so far off (m) along each axis.
LOAD_SHARE, LOAD_OFFSET = 0.1, 0.1


Spoiled = tuple[list[sdpid.Recording], sdpid.RobotModel]


@dataclass(frozen=True, kw_only=True)
class Good:
    """A log that is right, and its robot.

    Attributes
    ----------
    name : str
        Of the robot, and where the log is from.
    robot : RobotModel
        As it is described.
    log : Recording
        In the robot's order, with velocities.
    joint : int
        The joint that carries most.
    """

    name: str
    robot: sdpid.RobotModel
    log: sdpid.Recording
    joint: int


def changed(good: Good, **arrays: Array) -> Spoiled:
    """Return a log with other arrays; positions without the old velocities."""
    if "position" in arrays and "velocity" not in arrays:
        arrays["velocity"] = np.gradient(arrays["position"], good.log.time, axis=0)
    return [replace(good.log, notes=(), **arrays)], good.robot


def flipped(good: Good, *quantities: str) -> Spoiled:
    """Return a log in which some quantities of one joint have the wrong sign."""
    arrays = {name: getattr(good.log, name).copy() for name in quantities}
    for values in arrays.values():
        values[:, good.joint] *= -1.0
    return changed(good, **arrays)


def ordered(good: Good, order: Sequence[int], *quantities: str) -> Spoiled:
    """Return a log with columns in another order."""
    return changed(good, **{name: getattr(good.log, name)[:, list(order)] for name in quantities})


def scaled(good: Good, factor: float | Array) -> Spoiled:
    """Return a log with efforts in another unit."""
    return changed(good, effort=factor * good.log.effort)


def late(good: Good, quantity: str) -> Spoiled:
    """Return a log in which signals of a quantity come late."""
    time, values = good.log.time, getattr(good.log, quantity)
    columns = [np.interp(time - DELAY_S, time, column) for column in values.T]
    return changed(good, **{quantity: np.column_stack(columns)})


def clipped(good: Good, quantity: str) -> Spoiled:
    """Return a log in which one channel of one joint is clipped."""
    values = getattr(good.log, quantity).copy()
    column = values[:, good.joint]
    low, high = np.percentile(column, (10.0, 90.0))
    values[:, good.joint] = np.clip(column, low, high)
    return changed(good, **{quantity: values})


def standing(good: Good) -> Spoiled:
    """Return a log in which one joint does not move."""
    position = good.log.position.copy()
    noise = np.random.default_rng(0).standard_normal(good.log.n_samples)
    position[:, good.joint] = position[0, good.joint] + 1e-5 * noise
    return changed(good, position=position)


def held(good: Good) -> Spoiled:
    """Return a log whose rows repeat: the robot measures at a quarter of the rate."""
    rows = np.arange(good.log.n_samples) // 4 * 4
    return changed(good, position=good.log.position[rows], effort=good.log.effort[rows])


def rested(good: Good) -> Spoiled:
    """Return a log that goes on as long as it was, the robot at rest."""
    log, count = good.log, good.log.n_samples
    rows = np.r_[np.arange(count), np.full(count, count - 1)]
    rng = np.random.default_rng(0)
    still = np.r_[np.zeros(count), np.ones(count)][:, None]
    noise = rng.standard_normal((2 * count, log.n)) * still
    rested = replace(
        log,
        reference=None,
        time=log.time[0] + log.step * np.arange(2 * count),
        position=log.position[rows] + 1e-6 * noise,
        effort=log.effort[rows] + 1e-3 * noise,
        velocity=log.velocity[rows] * (1.0 - still),
    )
    return [rested], good.robot


def spiked(good: Good, quantity: str, size: float) -> Spoiled:
    """Return a log with one value far off."""
    values = getattr(good.log, quantity).copy()
    values[good.log.n_samples // 3, good.joint] += size
    return changed(good, **{quantity: values})


def loaded(good: Good) -> Spoiled:
    """Return both halves of a log, the second with a load at the last link."""
    robot, log, half = good.robot, good.log, good.log.n_samples // 2
    mass = LOAD_SHARE * float(robot.prior[:, 0].sum())
    arm, both = np.zeros_like(robot.prior), np.zeros_like(robot.prior)
    both[-1, :4] = mass * np.array([1.0, *3 * (LOAD_OFFSET,)])
    both[-1, [4, 6, 9]] = 2.0 * mass * LOAD_OFFSET**2
    both[-1, [5, 7, 8]] = -mass * LOAD_OFFSET**2
    # Accelerations hardly matter: gravity bears the load.
    states = log.position, log.velocity, np.zeros_like(log.position)
    load = replace(robot, prior=arm + both).described_efforts(*states)
    log = replace(log, reference=None)
    heavy = replace(log, effort=log.effort + load)
    return [part(log, 0, half), part(heavy, half, log.n_samples)], robot


def hanging(good: Good) -> Spoiled:
    """Return a log, and the robot described upside down."""
    robot = with_gravity(good.robot, -good.robot.gravity)
    return [good.log], replace(robot, prior=good.robot.prior)


def constants(good: Good) -> Array:
    """Return N·m per ampere of each joint."""
    return np.linspace(*TORQUE_CONSTANTS, good.log.n)


def exchanged(good: Good) -> list[int]:
    """Return the order of columns in which the first and the third joint are exchanged."""
    return [2, 1, 0, *range(3, good.log.n)]


def turned(good: Good) -> list[int]:
    """Return the order of columns that begins with the last joint."""
    return [good.log.n - 1, *range(good.log.n - 1)]


def zeroed(good: Good) -> Array:
    """Return positions in which one joint's zero is a quarter of a turn off."""
    position = good.log.position.copy()
    position[:, good.joint] += np.pi / 2.0
    return position


def retimed(good: Good, factor: float) -> Spoiled:
    """Return a log whose stamps are in another unit."""
    return [replace(good.log, time=factor * good.log.time, velocity=None)], good.robot


ALL = ("position", "velocity", "effort")
# What is wrong, kinds of findings that name it, and the way to do it.
KINDS: tuple[tuple[str, str, Callable[[Good], Spoiled]], ...] = (
    ("currents (A) named torque", "effort_scale", lambda g: scaled(g, 1.0 / constants(g))),
    ("N·mm", "effort_scale", lambda g: scaled(g, 1e3)),
    ("motors' torques, before gears of 100", "effort_scale", lambda g: scaled(g, 1e-2)),
    ("sign of all efforts", "effort_sign", lambda g: scaled(g, -1.0)),
    ("joints 1 and 3 exchanged", "joint_order", lambda g: ordered(g, exchanged(g), *ALL)),
    ("columns one on", "joint_order", lambda g: ordered(g, turned(g), *ALL)),
    ("columns of efforts one on", "effort_order", lambda g: ordered(g, turned(g), "effort")),
    ("degrees", "position_in_degrees", lambda g: changed(g, position=np.degrees(g.log.position))),
    ("hangs, described as standing", "gravity_direction", hanging),
    ("ms read as s", "time_unit", lambda g: retimed(g, 1e3)),
    ("s read as ms", "time_unit position_jumps", lambda g: retimed(g, 1e-3)),
    ("rows repeated four times", "repeated_rows", held),
    ("half at rest", "long_rest", rested),
    ("efforts 60 ms late", "effort_late", lambda g: late(g, "effort")),
    ("velocities 60 ms late", "velocity_late", lambda g: late(g, "velocity")),
    ("half with a load of a tenth", "payload_differs", loaded),
    # Those of one joint, which must be named.
    ("sign of one effort", "effort_sign", lambda g: flipped(g, "effort")),
    ("sign of one position", "position_sign", lambda g: flipped(g, "position", "velocity")),
    ("signs of one position and effort", "axis_sign", lambda g: flipped(g, *ALL)),
    ("zero off by 90°", "position_zero", lambda g: changed(g, position=zeroed(g))),
    ("one joint at rest", "joint_at_rest", standing),
    ("effort clipped", "effort_clipped", lambda g: clipped(g, "effort")),
    ("velocity clipped", "velocity_clipped", lambda g: clipped(g, "velocity")),
    ("one effort far off", "effort_spike", lambda g: spiked(g, "effort", 1e5)),
    (
        "one position off by 2 rad",
        "position_lone position_jumps",
        lambda g: spiked(g, "position", 2.0),
    ),
)
# The first that is of one joint.
OF_ONE = [words for words, *_ in KINDS].index("sign of one effort")


def good(name: str, robot: sdpid.RobotModel, log: sdpid.Recording) -> Good:
    """Return a log in its robot's order, with velocities."""
    log = match_joints(robot, log)
    if log.velocity is None:
        log = replace(log, velocity=np.gradient(log.position, log.time, axis=0))
    rows = np.linspace(0, log.n_samples - 1, 200).astype(int)
    q = log.position[rows]
    gravity = robot.described_efforts(q, np.zeros_like(q), np.zeros_like(q))
    return Good(name=name, robot=robot, log=log, joint=int(np.argmax(gravity.std(axis=0))))


def simulated(seeds: int) -> Iterator[Good]:
    """Yield simulated logs of every robot that is there."""
    for robot, seed in itertools.product(there(), range(seeds)):
        log, truth = log_of(drawn(robot, seed), seed)
        described = truth.robot
        if robot == "denso":  # its description gives no masses
            bodies = true_parameters("denso_vp6242")[: 10 * described.n_links]
            described = replace(described, prior=bodies.reshape(-1, 10))
        yield good(f"{robot}, simulated", described, log)


def recorded(data: Path) -> Iterator[Good]:
    """Yield the first recording of every real arm."""
    for arm in records_of(data, SETS):
        yield good(arm.name, arm.robot, arm.logs()[0])


def named(number: int, log: Good, findings: Sequence[Finding]) -> bool:
    """Return whether findings name what is wrong, or name it as one of what does as well."""
    joint, kinds = log.robot.joint_names[log.joint], KINDS[number][1].split()
    what = {
        "position_sign": f"position of {joint} has the wrong sign",
        "axis_sign": f"position and effort of {joint} count the other way round",
    }.get(kinds[0], "\n")
    for finding in findings:
        another = number >= OF_ONE and finding.joint not in (None, joint)
        told = finding.severity != "note" or finding.kind.startswith("velocity")
        if (finding.kind in kinds and told and not another) or what in finding.message:
            return True
    return False


def main() -> int:
    """Inspect, and write the tables."""
    study = Study(
        __doc__,
        data=True,
        quick={"seeds": 1, "good": 1, "most": 1},
        seeds=(3, "simulated logs of each robot"),
        good=(20, "of these, to count false alarms"),
        most=(0, "logs that are spoiled; 0 for all"),
    )
    every = [*simulated(study.seeds), *recorded(study.data)]
    logs = every[: study.most or None]

    def spoiled(number: int, of: int) -> Rows:
        words, _, spoil = KINDS[number]
        findings = inspect_recordings(*spoil(logs[of]))
        kinds = ", ".join(f"{f.kind} {f.joint or ''}".strip() for f in findings)
        yield words, logs[of].name, named(number, logs[of], findings), kinds or "nothing"

    header = ("what is wrong", "log", "named", "found")
    found = study.rows("spoiled.csv", header, spoiled, range(len(KINDS)), range(len(logs)))
    cells = [
        {"what is wrong": words, "log": name, "share": f"{own['named'].sum()}/{len(own['named'])}"}
        for (words, name), own in grouped(found, "what is wrong", "log")
    ]
    shares = pivot(cells, "what is wrong", "log", itemgetter("share"))
    study.write("wrong_logs.csv", *shares)
    alarms: Counter[str] = Counter()
    for log in (*simulated(study.good), *recorded(study.data)):
        for finding in inspect_recordings([log.log], log.robot):
            alarms[f"{finding.severity} {finding.kind}: {log.name}"] += 1
    study.write("alarms.csv", ("finding on logs as they are", "logs"), sorted(alarms.items()))
    return int(any(what.startswith("refuse") for what in alarms))


if __name__ == "__main__":
    sys.exit(main())
