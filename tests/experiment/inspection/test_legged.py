"""Recordings of robots on legs: what is wrong is found and named, what is right is left alone."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sdpid
from sdpid import Recording
from sdpid._common.arrays import Array
from sdpid.experiment.inspection import base_checks, delays, feet_checks
from sdpid.experiment.inspection.explain import ExplainedLog, floating_log
from sdpid.experiment.inspection.inspect import inspect_recordings
from sdpid.experiment.inspection.kinds import Finding
from sdpid.experiment.inspection.subject import Check, Subject
from sdpid.experiment.plant.legged import model
from sdpid.experiment.plant.legged.simulate import LeggedRun, Sensors
from sdpid.experiment.plant.legged.truth import DryFriction, changed_parameters
from sdpid.experiment.preparation import prepare as preparing
from sdpid.experiment.preparation.prepare import prepare
from sdpid.robot.model.jacobians import frame_axes
from sdpid.workflow import formulate
from tests.helpers.refusals import refuses

pytest.importorskip("mujoco")


@cache
def robot(name: str = "solo12") -> sdpid.RobotModel:
    return sdpid.load_robot(name, root="free_flyer")


@cache
def simulated(motion: str, name: str = "solo12", seed: int = 1, duration: float = 2.0) -> LeggedRun:
    """Let a robot move whose links are 15 % off the description."""
    options = {"seed": seed, "duration": duration, "sensors": Sensors(forces=True)}
    return sdpid.simulate_legged(robot(name), motion, **options)


def log(motion: str = "walk", *which: Any) -> Recording:
    return simulated(motion, *which).recording


GO1 = ("go1", 4, 3.0)


@cache
def walk() -> Recording:
    """Return a walk, turned by 90° about the vertical: the world's axes are not the base's."""
    turn, base = Rotation.from_euler("z", 90.0, degrees=True), log().base
    turned = (turn * Rotation.from_quat(base.orientation)).as_quat()
    felt = turn.apply(np.array(log().contacts.forces).reshape(-1, 3)).reshape(-1, 4, 3)
    position = turn.apply(np.array(base.position))
    return changed(log(), {"orientation": turned, "position": position}, feet={"forces": felt})


def changed(
    log: Recording,
    base: dict[str, Any] | None = None,
    imu: dict[str, Any] | None = None,
    feet: dict[str, Any] | None = None,
) -> Recording:
    """Return a recording with other fields of its base, its IMU, or its contacts."""
    moved = replace(log.base, **(base or {}))
    moved = moved if moved.imu is None else replace(moved, imu=replace(moved.imu, **(imu or {})))
    return replace(log, base=moved, contacts=replace(log.contacts, **(feet or {})))


def sensed(
    channel: str, change: Callable[[Array], Array], log: Recording | None = None
) -> Recording:
    log = log or walk()
    return changed(log, imu={channel: change(np.array(getattr(log.base.imu, channel)))})


gyro, force = partial(sensed, "gyroscope"), partial(sensed, "accelerometer")


def turned(change: Callable[[Array], Array]) -> Recording:
    return changed(walk(), {"orientation": change(np.array(walk().base.orientation))})


def without_imu() -> Recording:
    """Return a recording whose quaternions are in another order, which only feet show."""
    rolled = np.roll(log().base.orientation, 1, axis=1)
    return changed(log(), {"orientation": rolled, "imu": None})


def flagged(down: Array) -> Recording:
    return changed(walk(), feet={"forces": None, "down": down})


def flags() -> Array:
    return np.array(walk().contacts.down)


def speeds(frame: str) -> Recording:
    """Return a recording with velocities in the world's axes, that are said to be in others."""
    # As from a filter: differences over single steps are mostly noise of the pose.
    smooth, place = np.ones(25) / 25.0, np.array(walk().base.position)
    padded = np.pad(place, ((12, 12), (0, 0)), mode="edge")
    rows = [np.convolve(column, smooth, "valid") for column in padded.T]
    rate = np.gradient(np.array(rows).T, walk().time, axis=0)
    turning = Rotation.from_quat(walk().base.orientation).apply(walk().base.sensed("gyroscope"))
    moves = {"linear_velocity": rate, "angular_velocity": turning, "velocity_frame": frame}
    return changed(walk(), moves)


def efforts(
    scale: float, joint: int | slice = slice(None), log: Recording | None = None
) -> Recording:
    """Return a recording with one joint's effort, or all, in another unit or sign."""
    factors, log = np.ones(12), log or walk()
    factors[joint] = scale
    return replace(log, effort=np.array(log.effort) * factors)


def ordered(order: Sequence[int], *names: str) -> Recording:
    return replace(walk(), **{name: np.array(getattr(walk(), name))[:, order] for name in names})


def felt(motion: str, change: Callable[[Array], Array], **feet: Any) -> Recording:
    """Return a recording with other forces."""
    forces = change(np.array(log(motion).contacts.forces))
    return changed(log(motion), feet={"forces": forces, **feet})


def of_foot(factor: float, foot: int = 1) -> Array:
    return np.where(np.arange(4) == foot, factor, 1.0)[:, None]


def in_axes(motion: str, axes: str) -> Recording:
    """Return forces in other axes than the world's."""
    base = log(motion).base
    q = np.hstack([base.position, base.orientation, log(motion).position])
    turns = frame_axes(robot(), q, log(motion).contacts.frames)
    if axes == "base":
        turns = np.broadcast_to(base.rotations[:, None], turns.shape)
    return felt(motion, lambda f: np.einsum("kcji,kcj->kci", turns, f))


def off(axis: int) -> Array:
    """Return 5 % of the weight along an axis of one foot."""
    return 0.05 * 9.81 * robot().prior[:, 0].sum() * np.eye(4)[:, [1]] * np.eye(3)[axis]


def of_nothing(forces: Array) -> Array:
    drawn = np.random.default_rng(0).normal(size=(4, 3)) * 6.0
    return drawn * np.sin(7e-3 * np.arange(len(forces))[:, None, None] + np.arange(4)[:, None])


def late(motion: str) -> Recording:
    rows = np.maximum(np.arange(log(motion).n_samples) - 20, 0)
    return replace(log(motion), contacts=log(motion).contacts.rows(rows))


def swapped(order: Sequence[int], *, beside: bool = False) -> Recording:
    """Return flags of other feet, with forces of these as well or without."""
    down = np.array(log().contacts.down)[:, order]
    return felt("walk", lambda f: f[:, order] if beside else f, down=down)


def opened(log: Recording, least: float, **feet: Any) -> Recording:
    """Return a recording with flags that have a high threshold."""
    return changed(log, feet={"down": log.contacts.forces[..., 2] > least, **feet})


LEFT_RIGHT, DIAGONAL, FRONT = (1, 0, 3, 2), (3, 2, 1, 0), (1, 0, 2, 3)
PAIRS = (3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8)
BY_PAIRS = "in the order FR_HAA, FR_HFE, FR_KFE, FL_HAA"
ZEROS = "never changes: it is (0, 0, 0)"
LEAVE, TIMES = "% of what the torques of its leg need", "times (standard error"
UNLIKE = "forces_unlike_motion"
# What is wrong by kind, words of the first, and the recording.
WRONG: list[tuple[str, str, Callable[[], Recording]]] = [
    ("base_orientation", "in the order w x y z", lambda: turned(lambda q: np.roll(q, 1, axis=1))),
    ("base_orientation", "read as the inverse", lambda: turned(lambda q: q * [-1, -1, -1, 1])),
    ("base_orientation", "feet that are down are above the base", without_imu),
    ("imu_gyroscope", "it is in deg/s", lambda: gyro(np.degrees)),
    ("imu_gyroscope", "are -y, x, z", lambda: gyro(lambda w: w[:, [1, 0, 2]] * [1, -1, 1])),
    # About the vertical a trot turns little: less than half is unexplained.
    ("imu_gyroscope", "are x, y, -z", lambda: gyro(lambda w: w * [1, 1, -1], log("trot"))),
    ("imu_gyroscope", ZEROS, lambda: gyro(np.zeros_like)),
    ("imu_accelerometer", "it is in g", lambda: force(lambda f: f / 9.80665)),
    ("imu_accelerometer", "0.8 times gravity", lambda: force(lambda f: 0.8 * f)),
    ("imu_accelerometer", "the opposite sign", lambda: force(np.negative)),
    ("imu_accelerometer", "upright where x, y, z are", lambda: force(lambda f: f[:, [2, 0, 1]])),
    ("imu_accelerometer", "gravity is taken off", lambda: force(lambda f: f - f.mean(axis=0))),
    ("imu_accelerometer", ZEROS, lambda: force(np.zeros_like)),
    ("base_velocity", "where they are the world's", lambda: speeds("base")),
    ("feet_exchanged", "FR_FOOT are of FL_FOOT", lambda: flagged(flags()[:, FRONT])),
    ("effort_sign", "effort of FR_KFE has the wrong sign", lambda: efforts(-1.0, 5)),
    ("joint_order", BY_PAIRS, lambda: ordered(PAIRS, "position", "effort")),
    ("effort_order", BY_PAIRS, lambda: ordered(PAIRS, "effort")),
    ("effort_scale", "N·mm or mN·m", lambda: efforts(1000.0)),
    ("effort_scale", "effort of FR_HFE is", lambda: efforts(1000.0, 4)),
    # Forces, too, disagree with torques of another scale.
    (f"total_mass {UNLIKE}", "another scale of all torques", lambda: efforts(1.4)),
    (UNLIKE, "they are 0.952", lambda: efforts(1.05, log=log("trot"))),
    ("flags_unlike_forces", "said to be up", lambda: opened(log(), 4.0)),
    ("foot_moves", "FL_FOOT moves by", lambda: flagged(np.ones_like(flags()))),
    (UNLIKE, f"they are 0.9504 {TIMES}", lambda: felt("trot", lambda f: 0.95 * f)),
    (UNLIKE, f"of HR_FOOT are 0.9534 {TIMES}", lambda: felt("stand", lambda f: 0.95 * f)),
    (UNLIKE, f"of FR_FOOT are 0.9532 {TIMES}", lambda: felt("walk", lambda f: f * of_foot(0.95))),
    (UNLIKE, LEAVE, lambda: felt("walk", lambda f: f + off(0))),
    (UNLIKE, LEAVE, lambda: felt("walk", lambda f: f + off(2))),
    (UNLIKE, LEAVE, lambda: felt("stand", lambda f: f[:, LEFT_RIGHT])),
    (UNLIKE, LEAVE, lambda: felt("trot", lambda f: f[:, DIAGONAL])),
    (UNLIKE, "those of FR_FOOT leave 9", lambda: felt("walk", lambda f: f[:, FRONT])),
    (UNLIKE, LEAVE, lambda: in_axes("stand", "base")),
    (UNLIKE, LEAVE, lambda: in_axes("walk", "foot")),
    (UNLIKE, f"they are -1 {TIMES}", lambda: felt("trot", np.negative)),
    (UNLIKE, f"of FR_FOOT are -1.001 {TIMES}", lambda: felt("trot", lambda f: f * of_foot(-1.0))),
    (UNLIKE, LEAVE, lambda: felt("stand", of_nothing)),
    ("forces_missing", "HL_FOOT never", lambda: felt("trot", lambda f: f * of_foot(0.0, 2))),
    ("forces_missing", "they are (0, 0, 0) N", lambda: felt("trot", np.zeros_like)),
    ("forces_missing", "FL_FOOT in x, y", lambda: felt("trot", lambda f: f * [0.0, 0.0, 1.0])),
    # Forces of soft ground and torques are a millisecond apart in a stand that is on time.
    ("contacts_late", "contacts are late by 18.5 ms", lambda: late("stand")),
    ("contacts_late", "contacts are late by 19.6 ms", lambda: late("trot")),
    # Where flags alone are wrong, forces are not blamed.
    ("feet_exchanged", "of FR_FOOT are of FL_FOOT", lambda: swapped(LEFT_RIGHT)),
    ("feet_exchanged", "of HR_FOOT are of FL_FOOT", lambda: swapped(DIAGONAL)),
    (f"feet_exchanged {UNLIKE}", "", lambda: swapped(LEFT_RIGHT, beside=True)),
    (f"feet_exchanged {UNLIKE}", "", lambda: swapped(DIAGONAL, beside=True)),
    # Equations in which a foot's force is missing look like efforts in another order.
    ("flags_unlike_motion", "", lambda: opened(log("stand", "go1"), 13.0)),
    ("flags_unlike_motion", "", lambda: opened(log("stand", "go1"), 13.0, forces=None)),
]


def serious(findings: Sequence[Finding]) -> list[Finding]:
    return [finding for finding in findings if finding.severity != "note"]


def found(recording: Recording, **known: Any) -> list[Finding]:
    """Return what is more than a note, of the robot that has these joints."""
    names = {"FL_HAA": "solo12", "FL_hip": "go1", "leg_left_1": "talos_reduced"}
    own = next(name for start, name in names.items() if recording.joint_names[0].startswith(start))
    return serious(sdpid.inspect_recording(recording, robot(own), **known).findings)


def told_by(check: Check, recording: Recording, name: str, **known: Any) -> list[Finding]:
    return list(check(replace(Subject.of(recording, robot(name)), **known)))


@pytest.fixture
def few_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Look for delays in a third of the rows, which shows the same kinds of findings."""
    monkeypatch.setattr(delays, "_ROWS", 200)


@pytest.mark.usefixtures("few_rows")
@pytest.mark.parametrize(("kinds", "words", "make"), WRONG)
def test_what_is_wrong_is_named(kinds: str, words: str, make: Callable[[], Recording]) -> None:
    told = found(make())
    # With too many feet down little is left to compare.
    also = {"effort_unlike_description"} if kinds == "foot_moves" else set()
    assert {finding.kind for finding in told} - also == set(kinds.split())
    assert any(words in finding.message for finding in told if finding.kind in kinds), told


RIGHT = [walk, lambda: speeds("world")]
RIGHT += [partial(log, motion, *of) for motion in ("stand", "trot", "hang") for of in ((), GO1)]


@pytest.mark.usefixtures("few_rows")
@pytest.mark.parametrize("make", RIGHT)
def test_what_is_right_is_left_alone(make: Callable[[], Recording]) -> None:
    assert not found(make())


def test_a_foot_that_is_down_in_the_air_is_named() -> None:
    position = np.array(walk().position)
    # The left fore leg is stretched backward and up at the hip, as where its zero is another.
    position[:, 1] += 1.2
    wrong = replace(walk(), position=position)
    told = {finding.kind: finding.message for finding in told_by(feet_checks.feet, wrong, "solo12")}
    assert "FL_FOOT is" in told.get("foot_high", ""), told
    # Efforts tell the joint, and then its foot is no other defect.
    kinds = {finding.kind: finding.joint for finding in found(wrong)}
    assert kinds["position_zero"] == "FL_HFE"
    assert "foot_high" not in kinds


@pytest.mark.parametrize("sensors", ["imu", "velocity", "position"])
@pytest.mark.parametrize("recorded", [True, False])
def test_robot_that_nothing_bears_must_fall(sensors: str, recorded: bool) -> None:
    base = walk().base if sensors == "imu" else replace(walk().base, imu=None)
    if sensors == "velocity":
        velocity = np.gradient(np.array(base.position), walk().step, axis=0)
        base = replace(base, linear_velocity=velocity, velocity_frame="world")
    contacts = flagged(np.zeros_like(flags())).contacts if recorded else None
    told = found(replace(walk(), base=base, contacts=contacts))
    assert [f.kind for f in told if f.severity == "refuse"] == ["contacts_missing"]
    # In the air there is nothing to be told.
    time = (walk().time - walk().time[0])[:, None]
    falling = np.array(base.position) - 0.5 * 9.81 * time**2 * [0.0, 0.0, 1.0]
    free = sdpid.BaseMotion(orientation=base.orientation, position=falling)
    air = replace(walk(), base=free, contacts=contacts)
    assert not told_by(base_checks.contacts_missing, air, "solo12")


def kinds_of_no_robot(step: float, base: sdpid.BaseMotion) -> dict[str, str]:
    """Return what is told of a base whose two joints move as sines."""
    time = step * np.arange(base.n_samples)
    moved = np.sin(np.outer(time, [1.0, 2.0]))
    log = Recording(time=time, position=moved, effort=moved, base=base)
    return {each.kind: each.message for each in sdpid.inspect_recording(log).findings}


def test_base_that_never_moves() -> None:
    level = np.tile([0.0, 0.0, 0.0, 1.0], (3000, 1))
    imu = sdpid.Imu(gyroscope=np.zeros((3000, 3)))
    base = sdpid.BaseMotion(orientation=level, position=np.zeros((3000, 3)), imu=imu)
    assert ZEROS in kinds_of_no_robot(0.01, base)["imu_gyroscope"]


def test_imu_that_turns_about_one_axis_is_compared_without_a_warning() -> None:
    time = 0.02 * np.arange(400)
    up = np.outer(np.ones(400), [0.0, 0.0, 1.0])
    half = 0.1 * np.sin(time)[:, None]
    orientation = np.hstack([np.sin(half) * up, np.cos(half)])
    imu = sdpid.Imu(gyroscope=0.2 * np.cos(time)[:, None] * up, accelerometer=9.81 * up)
    base = sdpid.BaseMotion(orientation=orientation, imu=imu)
    assert kinds_of_no_robot(0.02, base).keys() == {"contacts_missing", "imu_accelerometer"}


def test_wrong_force_does_not_lift_all_feet() -> None:
    contacts = replace(walk().contacts, down=None)
    spike = np.array(contacts.forces)
    spike[100, 0] = 5000.0
    assert contacts.closed.mean() > 0.5
    assert (contacts.closed != replace(contacts, forces=spike).closed).mean() < 1e-3


# Measured contact forces, and masses.


def test_legs_without_effort_are_not_compared() -> None:
    scaled = felt("trot", lambda f: f * of_foot(0.9, 0))
    assert told_by(feet_checks.forces, scaled, "solo12")
    without = frozenset({"FL_KFE"})
    assert not told_by(feet_checks.forces, scaled, "solo12", without=without)


def test_noise_of_feet_in_the_air_is_no_force() -> None:
    hang, feet = log("hang"), log("stand").contacts
    held, n = hang.contacts, hang.contacts.n_samples
    measured = np.concatenate([np.zeros((n, feet.n, 6)), held.wrenches], axis=1)
    measured[:, : feet.n, :3] = 0.1 * np.random.default_rng(0).normal(size=(n, feet.n, 3))
    contacts = sdpid.Contacts(
        frames=(*feet.frames, *held.frames),
        kind=(*feet.kind, *held.kind),
        down=np.hstack([np.zeros((n, feet.n), dtype=bool), held.closed]),
        wrenches=measured,
    )
    assert not found(replace(hang, contacts=contacts))


@pytest.mark.parametrize("mass", [0, -1.0, float("nan"), float("inf"), "2.5", True])
def test_total_mass_must_be_positive(mass: Any) -> None:
    words = r"total_mass: is .* a positive number"
    refuses(sdpid.errors.DataError, words, found, log("stand"), total_mass=mass)


def test_hanging_robot_does_not_show_its_mass() -> None:
    # Torques of another scale are other masses of the legs; the base's is held.
    assert "total_mass" not in {f.kind for f in found(efforts(1.4, log=log("hang")))}


def test_joints_that_bear_little_are_compared_with_their_own_efforts() -> None:
    def compared(recording: Recording) -> ExplainedLog:
        samples = Subject.of(recording, robot("talos_reduced")).samples
        return floating_log(robot("talos_reduced"), samples)

    hang = log("hang", "talos_reduced")
    rows = compared(hang)
    ankle = rows.joint_names.index("leg_left_6_joint")
    # Friction is most of what an ankle in the air needs, and explains it.
    assert rows.shares[ankle] > 0.5
    assert rows.left[rows.usable].max() < 0.1
    effort = np.array(hang.effort)
    effort[:, ankle] = 3.0 * np.roll(effort[:, ankle], 700) * np.sin(9.0 * hang.time)
    assert compared(replace(hang, effort=effort)).left[ankle] > 0.6


def test_mass_that_is_known_tells_torques_of_another_scale() -> None:
    mass = float(simulated("trot").theta[: 10 * robot().n_links : 10].sum())
    without = changed(log("trot"), feet={"forces": None})
    scaled = efforts(1.07, log=without)
    (told,) = found(scaled, total_mass=mass)
    assert told.kind == "total_mass"
    assert f"times the {mass:.4g} kg that it weighs" in told.message
    # Neither of right torques, nor where nobody weighed the robot.
    assert not found(without, total_mass=mass)
    assert not found(scaled)


@pytest.mark.parametrize(
    ("mass", "given", "named"),
    [
        (2.5, 2.5, {"tolerance": 0.01}),
        (None, 2.5, {"tolerance": 0.5}),
        (None, 0.4, {"links": ("FL_KFE", "FR_KFE")}),
    ],
)
def test_mass_of_a_condition_is_compared(
    mass: float | None, given: float, named: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def inspect(*_: object, total_mass: float | None = None, **__: object) -> None:
        asked.append(total_mass)
        raise sdpid.errors.DataError("asked")

    monkeypatch.setattr(preparing, "inspect_recordings", inspect)
    others = (sdpid.constraints.TotalMass(given, **named),)
    known = {"constraints": sdpid.Constraints(others=others)}
    for run in (sdpid.identify, formulate.formulate):
        refuses(sdpid.errors.DataError, "asked", run, robot(), log("stand"), **known)
    assert asked == [mass, mass]


@pytest.mark.parametrize("motion", ["stand", "step"])
@pytest.mark.parametrize("wrong", ["nothing", "moments", "sign", "feet", "scale"])
def test_wrong_wrenches_are_told(motion: str, wrong: str) -> None:
    right = log(motion, "talos_reduced")
    wrenches = np.array(right.contacts.wrenches)
    if wrong == "feet":
        wrenches = wrenches[:, [1, 0]]
    elif wrong == "moments":
        wrenches[..., 3:] *= -1.0
    else:
        wrenches *= {"nothing": 1.0, "sign": -1.0, "scale": 0.85}[wrong]
    given = changed(right, feet={"wrenches": wrenches})
    told = told_by(feet_checks.forces, given, "talos_reduced")
    assert [finding.kind for finding in told] == [UNLIKE] * (wrong != "nothing")


# Place, axes, biases and scales of an IMU.


def imu_found(recording: Recording) -> list[Finding]:
    return told_by(base_checks.imu, recording, "go1")


@pytest.mark.parametrize("motion", ["stand", "trot"])
@pytest.mark.parametrize("without", [(), ("gyroscope",)])
def test_place_and_axes_are_found_together(motion: str, without: tuple[str, ...]) -> None:
    changes = {**dict.fromkeys(without), "translation": np.zeros(3)}
    imu = log(motion, *GO1).base.imu
    (moved,) = imu_found(changed(log(motion, *GO1), imu=changes))
    assert moved.kind == "imu_place"
    distance = np.linalg.norm(imu.translation)
    assert abs(moved.numbers["distance"] - distance) < 5.0 * moved.numbers["error"]
    # A large turn about the vertical, which gravity does not show.
    told = imu_found(changed(log(motion, *GO1), imu={**changes, "rotation": np.eye(3)}))
    kinds = {finding.kind: finding for finding in told}
    assert kinds.keys() == {"imu_axes", "imu_place"}
    given = np.array(eval(kinds["imu_axes"].remedy.split("=")[1]))
    assert np.linalg.norm(Rotation.from_matrix(given.T @ imu.rotation).as_rotvec()) < 0.03


@pytest.mark.parametrize(
    ("motion", "channel", "factor", "bias", "words"),
    [
        ("stand", "accelerometer", 1.0, [0.3, 0.0, 0.0], ""),
        ("stand", "accelerometer", 0.96, 0.0, ""),
        ("stand", "gyroscope", 1.0, [0.0, 0.1, 0.0], ""),
        ("stand", "gyroscope", 1.05, 0.0, ""),
        ("hang", "accelerometer", 1.0, [0.3, 0.0, 0.0], "; axes that are tilted would show the"),
    ],
)
def test_biases_and_scales_are_named(
    motion: str, channel: str, factor: float, bias: Any, words: str
) -> None:
    (told,) = imu_found(sensed(channel, lambda given: factor * given + bias, log(motion, *GO1)))
    name, true = ("bias", np.linalg.norm(bias)) if np.any(bias) else ("scale", factor)
    assert told.kind == f"imu_{name}"
    assert f"the {channel} shows" in told.message
    assert words in told.message
    assert abs(told.numbers[name] - true) < 5.0 * told.numbers["error"] + 0.01 * true


def test_delays_are_not_told_of_an_imu_that_sits_elsewhere() -> None:
    """Accelerations of a wrong place are those of another time, for all channels."""
    run = sdpid.simulate_legged(
        robot("go1"),
        "stand",
        theta=changed_parameters(robot("go1"), seed=1),
        seed=10,
        duration=2.5,
        friction=DryFriction(width=0.042, peak=0.15, peak_speed=0.13),
    )
    (place,) = found(changed(run.recording, imu={"translation": (0, 0, 0)}))
    assert place.kind == "imu_place"
    assert place.message.endswith("delays are told once this is mended")


# Contacts at another frame or point than where feet touch the ground.


def points_found(motion: str, **changes: object) -> list[Finding]:
    return told_by(feet_checks.feet, changed(log(motion, *GO1), feet=changes), "go1")


@pytest.mark.parametrize("motion", ["stand", "trot"])
def test_point_that_rests_is_named(motion: str) -> None:
    true = np.array(log(motion, *GO1).contacts.offset)
    for stated in ([0.0, 0.0, 0.0], [0.03, 0.0, -0.02]):
        (finding,) = points_found(motion, offset=stated)
        assert (finding.severity, finding.kind) == ("warning", "contact_point")
        named = np.array(eval(finding.remedy.split("=")[1]))
        assert np.linalg.norm(named - true[0]) < 0.004
    if motion == "stand":
        true[0] += [0.0, 0.0, 0.05]
        assert {f.message.split()[0] for f in points_found(motion, offset=true)} == {"FL_foot"}


@pytest.mark.parametrize("part", ["calf", "thigh"])
def test_frame_that_moves_is_refused(part: str) -> None:
    frames = tuple(f"{leg}_{part}" for leg in ("FL", "FR", "RL", "RR"))
    (finding,) = points_found("trot", frames=frames)
    assert (finding.severity, finding.kind) == ("refuse", "contact_frame")
    assert finding.remedy.endswith("FL_foot, FR_foot, RL_foot, RR_foot")
    told = {each.kind for each in found(changed(log("trot", *GO1), feet={"frames": frames}))}
    assert "contact_frame" in told
    assert not told & {"contact_point", "foot_moves", "base_late"}


def test_a_foot_that_slips_has_no_other_point(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model, "_GRIP", 0.05)
    slips = sdpid.simulate_legged(robot(), "trot", seed=2, duration=10.0).recording
    told = told_by(feet_checks.feet, slips, "solo12")
    assert {each.kind for each in told} == {"foot_moves"}
    assert told[0].message.endswith(": it slips")


def test_a_foot_that_is_in_the_air_shows_no_point() -> None:
    down = np.array(log("trot", *GO1).contacts.down)
    down[:, 0] = True
    (finding,) = points_found("trot", down=down)
    assert finding.kind == "foot_moves"
    assert finding.message.startswith("FL_foot moves by")


# Channels that are late are found to 1 ms.


LATE = {"effort": 0.002, "imu": 0.004, "contacts": 0.006}


@cache
def recorded(late: bool, motion: str = "trot", **sensors: Any) -> Recording:
    """Return a motion, with or without late channels."""
    given = Sensors(delays=LATE if late else {}, **sensors)
    return sdpid.simulate_legged(robot(), motion, duration=4.0, seed=3, sensors=given).recording


def delays_found(log: Recording, unused: Sequence[str] = ()) -> dict[str, float]:
    found = delays.channel_delays(robot(), log, unused)
    return {name: delay.value for name, delay in found.items()}


@pytest.mark.parametrize("names", [(), ("FL_KFE",), ("FL_KFE", "HR_HFE")])
def test_each_channel_is_found_to_a_millisecond(names: tuple[str, ...]) -> None:
    log, own = recorded(late=True), robot().joint_names[robot().n_base :]
    effort = np.array(log.effort)
    noise = np.random.default_rng(0).standard_normal(len(effort))
    for name in names:  # It hides no delay.
        effort[:, own.index(name)] = 5.0 * noise
    log = replace(log, effort=effort)
    assert delays_found(log, names) == pytest.approx({**LATE, "base": 0.0}, abs=1e-3)
    processing = prepare(robot(), log, without_effort=names).processing
    assert processing.imu_delay_s == pytest.approx(LATE["imu"], abs=5e-4)
    told = {each.kind for each in inspect_recordings([log], robot(), without_effort=names)}
    assert {"imu_late", "contacts_late"} <= told


# 20 % of the weight.
@pytest.mark.parametrize(("motion", "sensors"), [("trot", {}), ("walk", {"flag_threshold": 5.0})])
def test_good_recordings_have_no_delay(motion: str, sensors: dict[str, float]) -> None:
    log = recorded(late=False, motion=motion, **sensors)
    assert not [each for each in found(log) if each.kind.endswith("_late")]
    processing = prepare(robot(), log).processing
    assert (processing.effort_delay_s, processing.imu_delay_s) == (0.0, 0.0)


def test_findings_tell_what_processing_takes_off() -> None:
    late = {each.kind: each for each in found(recorded(late=True))}
    assert late.keys() == {"effort_late", "imu_late", "contacts_late"}
    assert late["effort_late"].numbers["delay"] == pytest.approx(0.002, abs=1e-3)
    assert "are late by" in late["effort_late"].message
    prepared = prepare(robot(), recorded(late=True), {"imu_delay_s": 0.0})
    assert prepared.processing.effort_delay_s == pytest.approx(0.002, abs=1e-3)
    # What is given stands as it is.
    assert prepared.processing.imu_delay_s == 0.0
    assert any("effort_delay_s" in note for note in prepared.samples.notes)


def test_without_an_imu_the_pose_is_compared_with_legs_that_stand() -> None:
    log = recorded(late=True)
    pose = {name: np.roll(table, 3, axis=0) for name, table in log.base.channels.items()}
    found = delays_found(changed(log, {"imu": None, **pose}).rows(slice(3, None)))
    assert found["base"] == pytest.approx(0.003, abs=1e-3)
    assert found["effort"] == pytest.approx(0.002, abs=1e-3)


def test_a_gyroscope_alone_is_compared_with_the_pose() -> None:
    found = delays_found(changed(recorded(late=True), imu={"accelerometer": None}))
    assert found["imu"] == pytest.approx(0.004, abs=1e-3)


def test_forces_are_compared_with_efforts() -> None:
    found = delays_found(recorded(late=True, forces=True))
    assert found["contacts"] == pytest.approx(0.006, abs=1e-3)


def test_without_a_robot_the_imu_is_compared_with_the_pose() -> None:
    told = {each.kind: each for each in sdpid.inspect_recording(recorded(late=True)).findings}
    assert told["imu_late"].numbers["delay"] == pytest.approx(0.004, abs=5e-4)
