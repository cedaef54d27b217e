"""Wrong logs of robots on legs: what a mistake costs, and what the inspection says of it.

Stand, trot and hang of a quadruped in MuJoCo as in `legged.py`, with an IMU and force sensors in
the feet, friction terms known. One mistake at a time is made in these logs, in all three of them.
Contact forces are then either left out, so that those of closed contacts are eliminated
(*projection*), or measurements (*fusion*). Where the log is refused, the error is what one gets
who overrules that (`accept`).

* ``legged_defects.csv``: errors on a held-out walk, and findings that the right logs do not have.

    python examples/evidence/legged_defects.py --out results
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from legged import THREE, Walker
from study import Study

import sdpid
from sdpid._common.arrays import Array
from sdpid.experiment.inspection.inspect import REFUSED
from sdpid.experiment.plant.legged.sensors import Sensors
from sdpid.experiment.recording.floating import BaseMotion, Contacts, Imu

Log = sdpid.Recording
Change = Callable[[Log], Log]
CELL = ("robot", "defect", "fused", "joints", "mass", "kinds", "refused")
COLUMNS = (
    "robot", "defect", "projection_joints_percent", "projection_mass_percent", "projection_named",
    "fusion_joints_percent", "fusion_mass_percent", "fusion_named",
)  # fmt: skip
# Of the weight: below it, a foot is said to be up; and what a force sensor shows without a load.
THRESHOLD, BIAS = 0.1, 0.05
# What an accelerometer is off by, m/s², and what it shows at rest.
OFF, GRAVITY = 0.2, 9.81
SENSORS = Sensors(forces=True)


class Sensed(Walker):
    """A quadruped with force sensors in its feet."""

    sensors = SENSORS

    @property
    def weight(self) -> float:
        """Of the robot as it is, N."""
        return float(self.theta[: 10 * self.robot.n_links : 10].sum()) * GRAVITY


def effort(change: Callable[[Array], Array]) -> Change:
    """Change joint torques."""
    return lambda log: replace(log, effort=change(log.effort))


def base(change: Callable[[BaseMotion], dict[str, Any]]) -> Change:
    """Change fields of the base's motion."""

    def changed(log: Log) -> Log:
        assert log.base is not None
        return replace(log, base=replace(log.base, **change(log.base)))

    return changed


def imu(change: Callable[[Imu], dict[str, Any]]) -> Change:
    """Change fields of the IMU."""

    def changed(motion: BaseMotion) -> dict[str, Any]:
        assert motion.imu is not None
        return {"imu": replace(motion.imu, **change(motion.imu))}

    return base(changed)


def feet(change: Callable[[Contacts], dict[str, Any]]) -> Change:
    """Change fields of the feet's contacts; not of the stand that holds a base."""

    def changed(log: Log) -> Log:
        assert log.contacts is not None
        if log.contacts.n == 1:
            return log
        return replace(log, contacts=replace(log.contacts, **change(log.contacts)))

    return changed


def shank(foot: str) -> str:
    """Return the link before a foot, by the names of Go1, A1 and Solo12."""
    return foot.replace("_foot", "_calf").replace("_FOOT", "_LOWER_LEG")


def late(values: Array, samples: int) -> Any:
    """Return values that many samples late."""
    return values[np.maximum(np.arange(len(values)) - samples, 0)]


def exchanged(order: Sequence[int]) -> Change:
    """Give feet the flags and forces of others."""
    columns = list(order)
    return feet(lambda c: {"down": c.down[:, columns], "forces": c.forces[:, columns]})


def in_base_axes(log: Log) -> Log:
    """Give forces in the axes of the base, in place of the world's."""
    assert log.base is not None
    turns = log.base.rotations
    return feet(lambda c: {"forces": np.einsum("kji,kcj->kci", turns, c.forces)})(log)


def one_foot_always_down(contacts: Contacts) -> dict[str, Any]:
    """Return flags with one that never opens."""
    down = np.array(contacts.down)
    down[:, 0] = True
    return {"down": down}


# Mistakes in where things are, and in units and axes of sensors.
PLACES: dict[str, Change] = {
    "nothing": lambda log: log,
    "contact at the ball's center": feet(lambda c: {"offset": np.zeros(3)}),
    "shanks for feet": feet(lambda c: {"frames": [shank(name) for name in c.frames]}),
    "IMU's place ignored": imu(lambda i: {"translation": np.zeros(3)}),
    "IMU's axes ignored": imu(lambda i: {"rotation": np.eye(3)}),
    "gyroscope in deg/s": imu(lambda i: {"gyroscope": np.degrees(i.gyroscope)}),
    "accelerometer in g": imu(lambda i: {"accelerometer": i.accelerometer / GRAVITY}),
    "accelerometer off by 0.2 m/s²": imu(
        lambda i: {"accelerometer": i.accelerometer + np.array([OFF, 0.0, 0.0])}
    ),
}


def defects(weight: float) -> dict[str, tuple[Change, bool]]:
    """Return what is wrong: the change that does it, and whether forces alone have it."""
    bias = np.array([0.0, 0.0, BIAS * weight])
    # Recorded at 1 kHz.
    return {
        **{name: (change, False) for name, change in PLACES.items()},
        "torques 2 ms late": (effort(lambda e: late(e, 2)), False),
        "IMU 2 ms late": (
            imu(lambda i: {k: late(getattr(i, k), 2) for k in ("gyroscope", "accelerometer")}),
            False,
        ),
        "flags and forces 10 ms late": (
            feet(lambda c: {"down": late(c.down, 10), "forces": late(c.forces, 10)}),
            False,
        ),
        "flags above 10 % of the weight": (
            feet(lambda c: {"down": c.forces[..., 2] > THRESHOLD * weight}),
            False,
        ),
        "one foot always down": (feet(one_foot_always_down), False),
        "left and right feet swapped": (exchanged((1, 0, 3, 2)), False),
        "diagonal feet swapped": (exchanged((3, 2, 1, 0)), False),
        "forces 10 % low": (feet(lambda c: {"forces": 0.9 * c.forces}), True),
        "one foot's forces 10 % low": (
            feet(lambda c: {"forces": c.forces * np.array([0.9, 1.0, 1.0, 1.0])[:, None]}),
            True,
        ),
        "one foot's forces of zeros": (
            feet(lambda c: {"forces": c.forces * np.array([0.0, 1.0, 1.0, 1.0])[:, None]}),
            True,
        ),
        "forces of zeros": (feet(lambda c: {"forces": 0.0 * c.forces}), True),
        "forces off by 5 % of the weight": (feet(lambda c: {"forces": c.forces + bias}), True),
        "forces on the ground": (feet(lambda c: {"forces": -c.forces}), True),
        "forces in the base's axes": (in_base_axes, True),
        "forces of left and right feet swapped": (
            feet(lambda c: {"forces": c.forces[:, [1, 0, 3, 2]]}),
            True,
        ),
        "quaternion w x y z": (
            base(lambda b: {"orientation": np.roll(b.orientation, 1, axis=1)}),
            False,
        ),
        "gyroscope of zeros": (imu(lambda i: {"gyroscope": 0.0 * i.gyroscope}), False),
        "torques in N·mm": (effort(lambda e: 1e3 * e), False),
        "torques 5 % high": (effort(lambda e: 1.05 * e), False),
    }


def without_forces(log: Log) -> Log:
    """Return a log of a robot that has no force sensors."""
    assert log.contacts is not None
    return replace(log, contacts=replace(log.contacts, forces=None, wrenches=None))


def cell(quadruped: Sensed, defect: str, fused: bool) -> list[object]:
    """Return errors of joints and of the mass, in %, and findings: kinds, and those refused."""
    wrenches = quadruped.runs["trot"].motion.wrenches
    # What the noise of the force sensors is.
    std = SENSORS.force_noise * float(np.sqrt(np.mean(wrenches**2)))
    options: dict[str, Any] = {"processing": {"contact_force_std": std}} if fused else {}
    change = defects(quadruped.weight)[defect][0]
    logs = [change(quadruped.runs[motion].recording) for motion in THREE]
    if not fused:
        logs = [without_forces(log) for log in logs]
    try:
        result = quadruped.identify(logs, accept=REFUSED, **options)
    except sdpid.errors.SdpidError as error:
        print(defect, error, flush=True)
        return ["refused", "refused", [], []]
    joints, _, mass = quadruped.judged(result.estimate)
    found = [each for each in result.findings if each.severity != "note"]
    return [
        joints,
        mass,
        sorted({each.kind for each in found}),
        sorted({each.kind for each in found if each.severity == "refuse"}),
    ]


def main() -> None:
    """Write the table: what is found of a mistake, but for what is found of the right logs."""
    study = Study(
        __doc__,
        quick={"robots": ["solo12"], "seconds": 2.0, "most": 2},
        seconds=3.0,
        robots=["solo12", "go1"],
        most=(len(defects(1.0)), "number of mistakes"),
    )
    names = [*defects(1.0)][: study.most]
    quadruped = cache(lambda name: Sensed(name, 0, study.seconds))

    def cells(case: tuple[str, str, bool]) -> Iterator[tuple[object, ...]]:
        name, defect, fused = case
        yield (*case, *cell(quadruped(name), defect, fused))

    cases = [
        (robot, name, fused)
        for robot, name, fused in itertools.product(study.robots, names, (False, True))
        if fused or not defects(1.0)[name][1]
    ]
    usual: dict[tuple[str, bool], list[str]] = {}
    lines: dict[tuple[str, str], list[object]] = {}
    for found in study.rows("cells.csv", CELL, cases, cells):
        robot, name, fused, error, mass, kinds, refused = found.values()
        right = usual.setdefault((robot, fused), [] if name != names[0] else kinds)
        said = [f"{kind} (refused)" if kind in refused else kind for kind in kinds]
        if name != names[0]:
            said = [word for kind, word in zip(kinds, said, strict=True) if kind not in right]
        line = lines.setdefault((robot, name), [None] * 3 if fused else [])
        line += [error, mass, ", ".join(said) or "nothing"]
    study.write("legged_defects.csv", COLUMNS, ((*key, *line) for key, line in lines.items()))


if __name__ == "__main__":
    main()
