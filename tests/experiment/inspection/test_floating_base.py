"""Wrong recordings of legged robots are found and named, and good ones are left alone."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sdpid
from sdpid import Recording
from sdpid.experiment.inspection.accept import require_accepted
from sdpid.experiment.inspection.finding import Subject
from sdpid.experiment.inspection.floating import feet_checks, flight_checks
from sdpid.experiment.plant.legged.sensors import Sensors

pytest.importorskip("mujoco")


@cache
def robot() -> sdpid.RobotModel:
    return sdpid.load_robot("solo12", root="free_flyer")


@cache
def walk() -> Recording:
    """Return a walk, turned by 90° about the vertical: the world's axes are not the base's."""
    sensors = Sensors(forces=True)
    log = sdpid.simulate_legged(robot(), "walk", seed=1, duration=3.0, sensors=sensors).recording
    turn = Rotation.from_euler("z", 90.0, degrees=True)
    turned = (turn * Rotation.from_quat(log.base.orientation)).as_quat()
    position = turn.apply(np.array(log.base.position))
    forces = turn.apply(np.array(log.contacts.forces).reshape(-1, 3)).reshape(-1, 4, 3)
    log = replace(log, contacts=replace(log.contacts, forces=forces))
    return replace(log, base=replace(log.base, orientation=turned, position=position))


def with_base(**changes: Any) -> Recording:
    return replace(walk(), base=replace(walk().base, **changes))


def with_imu(**changes: Any) -> Recording:
    return with_base(imu=replace(walk().base.imu, **changes))


def with_feet(**changes: Any) -> Recording:
    return replace(walk(), contacts=replace(walk().contacts, forces=None, **changes))


def with_forces(forces: np.ndarray) -> Recording:
    return replace(walk(), contacts=replace(walk().contacts, forces=forces))


def forces() -> np.ndarray:
    return np.array(walk().contacts.forces)


def gyro() -> np.ndarray:
    return np.array(walk().base.imu.gyroscope)


def force() -> np.ndarray:
    return np.array(walk().base.imu.accelerometer)


def speeds(frame: str) -> Recording:
    """Return a recording with velocities in the world's axes, that are said to be in others."""
    base = walk().base
    # As from a filter: differences over single steps are mostly noise of the pose.
    smooth = np.ones(25) / 25.0
    padded = np.pad(np.array(base.position), ((12, 12), (0, 0)), mode="edge")
    rows = [np.convolve(column, smooth, "valid") for column in padded.T]
    rate = np.gradient(np.array(rows).T, walk().time, axis=0)
    return with_base(linear_velocity=rate, velocity_frame=frame)


ORDER = (1, 0, 2, 3)
LEGS = (3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8)


def efforts(joint: int | None = None, scale: float = -1.0) -> Recording:
    """Return a recording with one joint's effort, or all, in another unit or sign."""
    factors = np.ones(12)
    factors[slice(None) if joint is None else joint] = scale
    return replace(walk(), effort=np.array(walk().effort) * factors)


def ordered(order: Sequence[int], *, all_columns: bool) -> Recording:
    position, effort = (np.array(each)[:, order] for each in (walk().position, walk().effort))
    return replace(walk(), effort=effort, position=position if all_columns else walk().position)


WRONG: dict[str, tuple[Callable[[], Recording], str, str]] = {
    "w first": (
        lambda: with_base(orientation=np.roll(walk().base.orientation, 1, axis=1)),
        "base_orientation",
        "in the order w x y z",
    ),
    "world to base": (
        lambda: with_base(orientation=np.array(walk().base.orientation) * [-1, -1, -1, 1]),
        "base_orientation",
        "read as the inverse",
    ),
    "gyroscope in degrees": (
        lambda: with_imu(gyroscope=np.degrees(gyro())),
        "imu_gyroscope",
        "it is in deg/s",
    ),
    "axes of the gyroscope": (
        lambda: with_imu(gyroscope=gyro()[:, ORDER[:3]] * [1.0, -1.0, 1.0]),
        "imu_gyroscope",
        "x, y, z are -y, x, z measured",
    ),
    "accelerometer in g": (
        lambda: with_imu(accelerometer=force() / 9.80665),
        "imu_accelerometer",
        "it is in g",
    ),
    "sign of the accelerometer": (
        lambda: with_imu(accelerometer=-force()),
        "imu_accelerometer",
        "the opposite sign",
    ),
    "axes of the accelerometer": (
        lambda: with_imu(accelerometer=force()[:, [2, 0, 1]]),
        "imu_accelerometer",
        "upright where x, y, z are",
    ),
    "no gravity": (
        lambda: with_imu(accelerometer=force() - force().mean(axis=0)),
        "imu_accelerometer",
        "gravity is taken off",
    ),
    "axes of velocities": (lambda: speeds("base"), "base_velocity", "where they are the world's"),
    "flags of other feet": (
        lambda: with_feet(down=np.array(walk().contacts.down)[:, ORDER]),
        "feet_exchanged",
        "those of FR_FOOT are of FL_FOOT",
    ),
    "sign of a knee's effort": (
        lambda: efforts(5),
        "effort_sign",
        "effort of FR_KFE has the wrong sign",
    ),
    "legs": (
        lambda: ordered(LEGS, all_columns=True),
        "joint_order",
        "in the order FR_HAA, FR_HFE, FR_KFE, FL_HAA",
    ),
    "efforts of legs": (
        lambda: ordered(LEGS, all_columns=False),
        "effort_order",
        "in the order FR_HAA, FR_HFE, FR_KFE, FL_HAA",
    ),
    "N·mm": (lambda: efforts(scale=1000.0), "effort_scale", "N·mm or mN·m"),
    "one joint in N·mm": (lambda: efforts(4, 1000.0), "effort_scale", "effort of FR_HFE is"),
    "gyroscope of zeros": (
        lambda: with_imu(gyroscope=0.0 * gyro()),
        "imu_gyroscope",
        "never changes: it is (0, 0, 0)",
    ),
    "accelerometer of zeros": (
        lambda: with_imu(accelerometer=0.0 * force()),
        "imu_accelerometer",
        "never changes: it is (0, 0, 0)",
    ),
    "torques 40 % high": (lambda: efforts(scale=1.4), "total_mass", "another scale of all torques"),
    "flags with a threshold": (
        lambda: replace(
            walk(), contacts=replace(walk().contacts, down=forces()[:, :, 2] > 4.0)
        ),
        "flags_unlike_forces",
        "said to be up",
    ),
    "feet always down": (
        lambda: with_feet(down=np.ones_like(walk().contacts.down)),
        "foot_moves",
        "FL_FOOT moves by",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_named(name: str) -> None:
    make, kind, words = WRONG[name]
    found = sdpid.inspect_recording(make(), robot()).findings
    told = {finding.kind: finding.message for finding in reversed(found)}
    assert words in told.get(kind, "nothing"), told
    also = {
        # With too many feet down little is left to compare.
        "feet always down": {"effort_unlike_description"},
        # Forces, too, disagree with torques of another scale.
        "torques 40 % high": {"forces_scale"},
    }.get(name, set())
    serious = {finding.kind for finding in found if finding.severity != "note"}
    assert not serious - {kind} - also, told


@pytest.mark.parametrize("make", [walk, lambda: speeds("world")])
def test_good_recordings_are_left_alone(make: Callable[[], Recording]) -> None:
    assert sdpid.inspect_recording(make(), robot()).ok


def test_a_foot_that_is_down_in_the_air_is_named() -> None:
    position = np.array(walk().position)
    # The left fore leg is stretched backward and up at the hip, as where its zero is another.
    position[:, 1] += 1.2
    wrong = replace(walk(), position=position)
    subject = Subject(log=wrong, robot=None, floating=robot())
    told = {finding.kind: finding.message for finding in feet_checks.feet(subject)}
    assert "FL_FOOT is" in told.get("foot_high", ""), told
    # Efforts tell the joint, and then its foot is no other defect.
    found = sdpid.inspect_recording(wrong, robot()).findings
    assert {f.joint for f in found if f.kind == "position_zero"} == {"FL_HFE"}
    assert not [f for f in found if f.kind == "foot_high"]


def test_without_sensors_feet_tell_what_is_below() -> None:
    base = replace(walk().base, imu=None, orientation=np.roll(walk().base.orientation, 1, axis=1))
    (first, *_) = sdpid.inspect_recording(replace(walk(), base=base), robot()).findings
    assert (first.severity, first.kind) == ("refuse", "base_orientation")
    assert "feet that are down are above the base" in first.message


@pytest.mark.parametrize("sensors", ["imu", "velocity", "position"])
@pytest.mark.parametrize("recorded", [True, False])
def test_robot_that_nothing_bears_must_fall(sensors: str, recorded: bool) -> None:
    log = walk()
    base = log.base if sensors == "imu" else replace(log.base, imu=None)
    if sensors == "velocity":
        velocity = np.gradient(np.array(base.position), log.step, axis=0)
        base = replace(base, linear_velocity=velocity, velocity_frame="world")
    down = np.zeros(np.shape(log.contacts.down), dtype=bool)
    contacts = replace(log.contacts, down=down, forces=None) if recorded else None
    found = sdpid.inspect_recording(replace(log, base=base, contacts=contacts), robot())
    assert [f.kind for f in found.findings if f.severity == "refuse"] == ["contacts_missing"]
    require_accepted(found.findings, "contacts_missing")
    # In the air there is nothing to be told.
    time = log.time - log.time[0]
    falling = np.array(base.position) - 0.5 * 9.81 * time[:, None] ** 2 * [0.0, 0.0, 1.0]
    free = sdpid.BaseMotion(orientation=base.orientation, position=falling)
    air = Subject(log=replace(log, base=free, contacts=contacts), robot=None, floating=robot())
    assert not [*flight_checks.contacts_missing(air)]


def test_wrong_force_does_not_lift_all_feet() -> None:
    contacts = replace(walk().contacts, down=None, forces=forces())
    spike = forces()
    spike[100, 0] = 5000.0
    apart = contacts.closed != replace(contacts, forces=spike).closed
    assert contacts.closed.mean() > 0.5
    assert apart.mean() < 1e-3
