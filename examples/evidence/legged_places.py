"""Contact points, frames and IMUs that are not where a log says: in which motions they are found.

Logs of Go1, A1 and Solo12 in MuJoCo as in `legged.py`, other links and friction laws for each seed.
One mistake at a time is made in each of them, and the checks of the inspection that look at places,
axes and units of sensors and feet tell what they find.

* ``legged_places.csv``: how many logs a mistake is named in, how far off the number is that is
  told, and how many logs have findings that are not it.

    python examples/evidence/legged_places.py --out results
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
from legged import Walker
from legged_defects import OFF, PLACES, Log, imu
from study import Study

import sdpid
from sdpid.experiment.inspection import base_checks, feet_checks
from sdpid.experiment.inspection.kinds import Finding, explained
from sdpid.experiment.inspection.subject import Check, Subject

MOTIONS = ("stand", "trot", "walk", "hang")
ROBOTS = ("go1", "a1", "solo12")
COLUMNS = (
    *("defect", "motion", "logs", "named", "told"),
    *("median_off_percent", "worst_off_percent", "others"),
)
CHECKS: tuple[Check, ...] = (
    base_checks.orientation,
    base_checks.imu_channels,
    base_checks.imu,
    feet_checks.feet,
)


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


# A scale of the gyroscope stands beside mistakes of the other study.
HIGH = 1.05
SCALED = "gyroscope 5 % high"
CHANGES = {**PLACES, SCALED: imu(lambda i: {"gyroscope": HIGH * i.gyroscope})}
# What is to be found, and the number that is to be told, where there is one.
EXPECTED: dict[str, tuple[str, str, Callable[[Log], float]]] = {
    "contact at the ball's center": ("contact_point", "distance", _radius),
    "shanks for feet": ("contact_frame", "", lambda log: 1.0),
    "IMU's place ignored": ("imu_place", "distance", _arm),
    "IMU's axes ignored": ("imu_axes", "angle", _angle),
    "gyroscope in deg/s": ("imu_gyroscope", "", lambda log: 1.0),
    SCALED: ("imu_scale", "scale", lambda log: HIGH),
    "accelerometer in g": ("imu_accelerometer", "", lambda log: 1.0),
    "accelerometer off by 0.2 m/s²": ("imu_bias", "bias", lambda log: OFF),
    "nothing": ("", "", lambda log: 1.0),
}


def told(robot: sdpid.RobotModel, log: Log) -> list[Finding]:
    """Return what the checks find."""
    subject = Subject.of(log, robot)
    found = [each for look in CHECKS for each in look(subject)]
    return [each for each in found if not explained(each, found)]


def row(name: str, motion: str, logs: Sequence[tuple[sdpid.RobotModel, Log]]) -> tuple[object, ...]:
    """Return the row of a mistake in all logs of a motion."""
    kind, number, truth = EXPECTED[name]
    named, others, numbers = 0, 0, []
    for robot, log in logs:
        found = told(robot, CHANGES[name](log))
        right = [each for each in found if each.kind == kind]
        named += bool(right)
        # Shanks that move are frames that move: the same mistake.
        others += any(each.kind not in (kind, "foot_moves") for each in found)
        if number:
            numbers += [100.0 * abs(each.numbers[number] / truth(log) - 1.0) for each in right]
    off = (float(np.median(numbers)), max(numbers)) if numbers else (None, None)
    return (name, motion, len(logs), named if kind else None, kind, *off, others)


def main() -> None:
    """Write the table, mistake by mistake."""
    study = Study(
        __doc__,
        quick={"robots": ["solo12"], "motions": ["stand"], "seeds": 1, "seconds": 2.0},
        seeds=4,
        seconds=5.0,
        robots=[*ROBOTS],
        motions=[*MOTIONS],
    )
    every = itertools.product(study.robots, range(study.seeds))
    walkers = [Walker(name, seed, study.seconds) for name, seed in every]

    @cache
    def logs(motion: str) -> list[tuple[sdpid.RobotModel, Log]]:
        return [(each.robot, each.run(motion).recording) for each in walkers]

    study.rows(
        "legged_places.csv",
        COLUMNS,
        itertools.product(CHANGES, study.motions),
        lambda case: [row(*case, logs(case[1]))],
    )


if __name__ == "__main__":
    main()
