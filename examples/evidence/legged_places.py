"""Contact points, frames and IMUs that are not where a log says: in which motions they are found.

Logs of Go1, A1 and Solo12 in MuJoCo as in `legged.py`, other links and friction laws for each seed.
One mistake at a time is made in each of them, and the checks of the inspection that look at places,
axes and units of sensors and feet tell what they find.

* ``legged_places.csv``: how many logs a mistake is named in, how far off the number is that is
  told, and how many logs have findings that are not it.

    python examples/evidence/legged_places.py --out results
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from legged import Walker
from legged_defects import Change, Log, feet, imu, shank

import sdpid
from sdpid._common.progress import progress
from sdpid._common.tables import Table
from sdpid.experiment.inspection import base_checks, feet_checks
from sdpid.experiment.inspection.kinds import Finding, explained
from sdpid.experiment.inspection.subject import Check, Subject

MOTIONS = ("stand", "trot", "walk", "hang")
ROBOTS = ("go1", "a1", "solo12")
COLUMNS = (
    "defect",
    "motion",
    "logs",
    "named",
    "told",
    "median_off_percent",
    "worst_off_percent",
    "others",
)
CHECKS: tuple[Check, ...] = (
    base_checks.orientation,
    base_checks.imu_channels,
    base_checks.imu,
    feet_checks.feet,
)
GRAVITY, BIAS, HIGH = 9.81, 0.2, 1.05


@dataclass(frozen=True)
class Mistake:
    """A mistake in a log, what is to be found, and the number that is to be told."""

    change: Change
    kind: str
    number: str = ""
    truth: Callable[[Log], float] = lambda log: 1.0


def _radius(log: Log) -> float:
    return float(np.linalg.norm(log.contacts.offset[0])) if log.contacts is not None else 0.0


def _arm(log: Log) -> float:
    assert log.base is not None
    assert log.base.imu is not None
    return float(np.linalg.norm(log.base.imu.translation))


def _angle(log: Log) -> float:
    assert log.base is not None
    assert log.base.imu is not None
    return float(np.arccos((np.trace(log.base.imu.rotation) - 1.0) / 2.0))


MISTAKES = {
    "nothing": Mistake(lambda log: log, ""),
    "contact at the ball's center": Mistake(
        feet(lambda c: {"offset": np.zeros(3)}), "contact_point", "distance", _radius
    ),
    "shanks for feet": Mistake(
        feet(lambda c: {"frames": [shank(name) for name in c.frames]}), "contact_frame"
    ),
    "IMU's place ignored": Mistake(
        imu(lambda i: {"translation": np.zeros(3)}), "imu_place", "distance", _arm
    ),
    "IMU's axes ignored": Mistake(
        imu(lambda i: {"rotation": np.eye(3)}), "imu_axes", "angle", _angle
    ),
    "gyroscope in deg/s": Mistake(
        imu(lambda i: {"gyroscope": np.degrees(i.gyroscope)}), "imu_gyroscope"
    ),
    "gyroscope 5 % high": Mistake(
        imu(lambda i: {"gyroscope": HIGH * i.gyroscope}), "imu_scale", "scale", lambda log: HIGH
    ),
    "accelerometer in g": Mistake(
        imu(lambda i: {"accelerometer": i.accelerometer / GRAVITY}), "imu_accelerometer"
    ),
    "accelerometer off by 0.2 m/s²": Mistake(
        imu(lambda i: {"accelerometer": i.accelerometer + np.array([BIAS, 0.0, 0.0])}),
        "imu_bias",
        "bias",
        lambda log: BIAS,
    ),
}


def told(robot: sdpid.RobotModel, log: Log) -> list[Finding]:
    """Return what the checks find."""
    subject = Subject.of(log, robot)
    found = [each for look in CHECKS for each in look(subject)]
    return [each for each in found if not explained(each, found)]


def row(name: str, motion: str, logs: Sequence[tuple[sdpid.RobotModel, Log]]) -> tuple[object, ...]:
    """Return the row of a mistake in all logs of a motion."""
    mistake = MISTAKES[name]
    named, others, numbers = 0, 0, []
    for robot, log in logs:
        found = told(robot, mistake.change(log))
        right = [each for each in found if each.kind == mistake.kind]
        named += bool(right)
        # Shanks that move are frames that move: the same mistake.
        others += any(each.kind not in (mistake.kind, "foot_moves") for each in found)
        if mistake.number:
            truth = mistake.truth(log)
            numbers += [100.0 * abs(each.numbers[mistake.number] / truth - 1.0) for each in right]
    off = (float(np.median(numbers)), max(numbers)) if numbers else (None, None)
    return (name, motion, len(logs), named if mistake.kind else None, mistake.kind, *off, others)


def rows(walkers: Sequence[Walker], motions: Sequence[str]) -> Iterator[tuple[object, ...]]:
    """Yield all rows."""
    for motion in motions:
        logs = [(each.robot, each.run(motion).recording) for each in walkers]
        for name in MISTAKES:
            yield row(name, motion, logs)


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--quick", action="store_true", help="one short log of two motions")
    parser.add_argument("--out", type=Path, default=Path("results"))
    chosen = parser.parse_args()
    robots, motions = ROBOTS, MOTIONS
    if chosen.quick:
        robots, motions, chosen.seeds, chosen.seconds = ("solo12",), MOTIONS[:1], 1, 2.0
    chosen.out.mkdir(parents=True, exist_ok=True)
    walkers = [Walker(name, s, chosen.seconds) for name in robots for s in range(chosen.seeds)]
    lines = []
    with progress(len(MISTAKES) * len(motions), "legged_places") as advance:
        for line in rows(walkers, motions):
            lines.append(line)
            print(*line, flush=True)
            advance(1)
    order = list(MISTAKES)
    lines.sort(key=lambda line: order.index(str(line[0])))
    Table(COLUMNS, tuple(lines)).write(chosen.out / "legged_places.csv")


if __name__ == "__main__":
    main()
