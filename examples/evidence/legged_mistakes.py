"""Mistakes in logs of robots on legs: what they cost, and what the inspection says, in two parts.

Logs of quadrupeds in MuJoCo as in `legged.py`, in which one mistake at a time is made.

* ``defects``: stand, trot and hang with an IMU and force sensors in the feet, friction terms known,
  the mistake in all three logs. Contact forces are then either left out, so that those of closed
  contacts are eliminated (*projection*), or measurements (*fusion*). Where the log is refused, the
  error is what one gets who overrules that (`accept`). Errors on a held-out walk, and findings that
  the right logs do not have.
* ``places``: contact points, frames and IMUs that are not where a log says, for other links and
  friction laws of each seed. In how many logs a mistake is named by the checks that look at places,
  axes and units, how far off the number is that is told, and how many logs have findings that are
  not it.

    python examples/evidence/legged_mistakes.py --parts defects --out results
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from legged import GRAVITY, THREE, WITH_FORCES, Walker
from study import Rows, Study

import sdpid
from sdpid._common.arrays import Array
from sdpid.experiment.inspection import base_checks, feet_checks
from sdpid.experiment.inspection.inspect import REFUSED
from sdpid.experiment.inspection.kinds import explained
from sdpid.experiment.inspection.subject import Check, Subject
from sdpid.experiment.recording.floating import BaseMotion, Contacts, Imu

Log = sdpid.Recording
Change = Callable[[Log], Log]
# Of the weight: below it, a foot is said to be up; and what a force sensor shows without a load.
THRESHOLD, BIAS = 0.1, 0.05
# What an accelerometer is off by, m/s², and by how much a gyroscope is too high.
OFF, HIGH = 0.2, 1.05


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


def scaled(*shares: float) -> Change:
    """Give shares of the feet's forces."""
    return feet(lambda c: {"forces": c.forces * np.array(shares)[:, None]})


def in_base_axes(log: Log) -> Log:
    """Give forces in the axes of the base, in place of the world's."""
    assert log.base is not None
    turns = log.base.rotations
    return feet(lambda c: {"forces": np.einsum("kji,kcj->kci", turns, c.forces)})(log)


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


def defects_of(weight: float) -> tuple[dict[str, Change], dict[str, Change]]:
    """Return what is wrong, and what of it forces alone have; recorded at 1 kHz."""
    bias = np.array([0.0, 0.0, BIAS * weight])
    both = {
        **PLACES,
        "torques 2 ms late": effort(lambda e: late(e, 2)),
        "IMU 2 ms late": imu(
            lambda i: {k: late(getattr(i, k), 2) for k in ("gyroscope", "accelerometer")}
        ),
        "flags and forces 10 ms late": feet(
            lambda c: {"down": late(c.down, 10), "forces": late(c.forces, 10)}
        ),
        "flags above 10 % of the weight": feet(
            lambda c: {"down": c.forces[..., 2] > THRESHOLD * weight}
        ),
        "one foot always down": feet(
            lambda c: {"down": c.down | (np.arange(c.down.shape[1]) == 0)}
        ),
        "left and right feet swapped": exchanged((1, 0, 3, 2)),
        "diagonal feet swapped": exchanged((3, 2, 1, 0)),
        "quaternion w x y z": base(lambda b: {"orientation": np.roll(b.orientation, 1, axis=1)}),
        "gyroscope of zeros": imu(lambda i: {"gyroscope": 0.0 * i.gyroscope}),
        "torques in N·mm": effort(lambda e: 1e3 * e),
        "torques 5 % high": effort(lambda e: 1.05 * e),
    }
    return both, {
        "forces 10 % low": scaled(0.9),
        "one foot's forces 10 % low": scaled(0.9, 1.0, 1.0, 1.0),
        "one foot's forces of zeros": scaled(0.0, 1.0, 1.0, 1.0),
        "forces of zeros": scaled(0.0),
        "forces off by 5 % of the weight": feet(lambda c: {"forces": c.forces + bias}),
        "forces on the ground": scaled(-1.0),
        "forces in the base's axes": in_base_axes,
        "forces of left and right feet swapped": feet(
            lambda c: {"forces": c.forces[:, [1, 0, 3, 2]]}
        ),
    }


def without_forces(log: Log) -> Log:
    """Return a log of a robot that has no force sensors."""
    assert log.contacts is not None
    return replace(log, contacts=replace(log.contacts, forces=None, wrenches=None))


def cell(quadruped: Walker, defect: str, fused: bool) -> list[object]:
    """Return errors of joints and of the mass, in %, and findings: kinds, and those refused."""
    # What the noise of the force sensors is.
    rms = float(np.sqrt(np.mean(quadruped.run("trot").motion.wrenches ** 2)))
    std = WITH_FORCES.force_noise * rms
    options: dict[str, Any] = {"processing": {"contact_force_std": std}} if fused else {}
    both, of_forces = defects_of(quadruped.weight)
    change = {**both, **of_forces}[defect]
    logs = [change(log) for log in quadruped.logs(*THREE)]
    if not fused:
        logs = [without_forces(log) for log in logs]
    try:
        result = quadruped.identify(logs, accept=REFUSED, **options)
    except sdpid.errors.SdpidError as error:
        print(defect, error, flush=True)
        return ["refused", "refused", [], []]
    joints, _, mass = quadruped.judged(result.estimate)
    found = [each for each in result.findings if each.severity != "note"]
    refused = {each.kind for each in found if each.severity == "refuse"}
    return [joints, mass, sorted({each.kind for each in found}), sorted(refused)]


def defects(study: Study) -> None:
    """Write what is found of a mistake, but for what is found of the right logs."""
    both, of_forces = defects_of(1.0)
    names = [*both, *of_forces][: study.most]
    quadruped = cache(lambda name: Walker(name, 0, study.seconds or 3.0, WITH_FORCES))

    def cells(name: str, defect: str, fused: bool) -> Rows:
        # Without forces there are no mistakes in them.
        if fused or defect in both:
            yield name, defect, fused, *cell(quadruped(name), defect, fused)

    header = ("robot", "defect", "fused", "joints", "mass", "kinds", "refused")
    robots = [name for name in study.robots if name != "a1"]
    usual: dict[tuple[str, bool], list[str]] = {}
    lines: dict[tuple[str, str], list[object]] = {}
    for found in study.rows("cells.csv", header, cells, robots, names, (False, True)):
        robot, name, fused, error, mass, kinds, refused = found.values()
        right = usual.setdefault((robot, fused), [] if name != names[0] else kinds)
        said = [
            f"{kind} (refused)" if kind in refused else kind
            for kind in kinds
            if name == names[0] or kind not in right
        ]
        line = lines.setdefault((robot, name), [None] * 3 if fused else [])
        line += [error, mass, ", ".join(said) or "nothing"]
    ways = (f"{way}_{what}" for way in ("projection", "fusion") for what in SHOWN)
    header = ("robot", "defect", *ways)
    study.write("legged_defects.csv", header, ((*key, *line) for key, line in lines.items()))


SHOWN = ("joints_percent", "mass_percent", "named")
CHECKS: tuple[Check, ...] = (
    base_checks.orientation,
    base_checks.imu_channels,
    base_checks.imu,
    feet_checks.feet,
)


def imu_of(log: Log) -> Imu:
    """Return where the IMU is."""
    assert log.base is not None
    assert log.base.imu is not None
    return log.base.imu


# What is to be found of mistakes, and the number that is to be told, where there is one. A scale of
# the gyroscope stands beside those of the other part.
SCALED = "gyroscope 5 % high"
CHANGES = {**PLACES, SCALED: imu(lambda i: {"gyroscope": HIGH * i.gyroscope})}
EXPECTED: dict[str, tuple[str, str, Callable[[Log], float]]] = {
    "contact at the ball's center": (
        *("contact_point", "distance"),
        lambda log: 0.0 if log.contacts is None else np.linalg.norm(log.contacts.offset[0]),
    ),
    "shanks for feet": ("contact_frame", "", lambda log: 1.0),
    "IMU's place ignored": (
        *("imu_place", "distance"),
        lambda log: np.linalg.norm(imu_of(log).translation),
    ),
    "IMU's axes ignored": (
        *("imu_axes", "angle"),
        lambda log: np.arccos((np.trace(imu_of(log).rotation) - 1.0) / 2.0),
    ),
    "gyroscope in deg/s": ("imu_gyroscope", "", lambda log: 1.0),
    SCALED: ("imu_scale", "scale", lambda log: HIGH),
    "accelerometer in g": ("imu_accelerometer", "", lambda log: 1.0),
    "accelerometer off by 0.2 m/s²": ("imu_bias", "bias", lambda log: OFF),
    "nothing": ("", "", lambda log: 1.0),
}


def places(study: Study) -> None:
    """Write in how many logs mistakes are named."""
    walkers = [
        Walker(name, seed, study.seconds or 5.0)
        for name in ("go1", "a1", "solo12")
        if name in study.robots
        for seed in range(study.seeds)
    ]

    def row(name: str, motion: str) -> Rows:
        kind, number, truth = EXPECTED[name]
        named, others, numbers = 0, 0, []
        for walker in walkers:
            log = walker.run(motion).recording
            subject = Subject.of(CHANGES[name](log), walker.robot)
            found = [each for look in CHECKS for each in look(subject)]
            found = [each for each in found if not explained(each, found)]
            right = [each for each in found if each.kind == kind]
            named += bool(right)
            # Shanks that move are frames that move: the same mistake.
            others += any(each.kind not in (kind, "foot_moves") for each in found)
            if number:
                numbers += [100.0 * abs(each.numbers[number] / truth(log) - 1.0) for each in right]
        off = (float(np.median(numbers)), max(numbers)) if numbers else (None, None)
        yield len(walkers), named if kind else None, kind, *off, others

    header = ("defect", "motion", "logs", "named", "told", "median_off_percent")
    header = (*header, "worst_off_percent", "others")
    study.rows("legged_places.csv", header, row, CHANGES, study.motions)


def main() -> None:
    """Write the tables that are asked for."""
    parts = {"defects": defects, "places": places}
    study = Study(
        __doc__,
        quick={"seconds": 2.0, "robots": ["solo12"], "most": 2, "seeds": 1, "motions": ["stand"]},
        parts=[*parts],
        seconds=(0.0, "of each motion; 0 for those of the tables"),
        robots=["solo12", "go1", "a1"],
        most=(sum(map(len, defects_of(1.0))), "number of mistakes of defects"),
        seeds=(4, "of each robot of places"),
        motions=["stand", "trot", "walk", "hang"],
    )
    for part in study.parts:
        parts[part](study)


if __name__ == "__main__":
    main()
