"""Recordings of robots on legs: what is wrong is found and named, what is right is left alone."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sdpid
from sdpid import Recording
from sdpid._common.arrays import Array
from sdpid.experiment.inspection import base_checks, feet_checks
from sdpid.experiment.inspection.delays import (
    channel_delays,
    first_scale,
    free_of_contacts,
    lag,
)
from sdpid.experiment.inspection.explain import ExplainedLog, floating_log
from sdpid.experiment.inspection.inspect import inspect_recordings, require_accepted
from sdpid.experiment.inspection.kinds import Finding
from sdpid.experiment.inspection.subject import Subject
from sdpid.experiment.plant.legged import model
from sdpid.experiment.plant.legged.sensors import Sensors
from sdpid.experiment.plant.legged.simulate import LeggedRun
from sdpid.experiment.plant.legged.truth import DryFriction, changed_parameters
from sdpid.experiment.preparation import prepare as preparing
from sdpid.experiment.preparation.prepare import prepare
from sdpid.experiment.processing.contact_samples import ContactSamples
from sdpid.experiment.recording.recording import rows_of
from sdpid.robot.model.jacobians import contact_jacobians, frame_axes
from sdpid.workflow import formulate
from tests.helpers.refusals import refuses

pytest.importorskip("mujoco")


@cache
def robot(name: str = "solo12") -> sdpid.RobotModel:
    return sdpid.load_robot(name, root="free_flyer")


def with_base(log: Recording, **changes: Any) -> Recording:
    return replace(log, base=replace(log.base, **changes))


def with_imu(log: Recording, **changes: Any) -> Recording:
    return with_base(log, imu=replace(log.base.imu, **changes))


def with_feet(log: Recording, **changes: Any) -> Recording:
    return replace(log, contacts=replace(log.contacts, **changes))


# Poses, sensors of the base, flags and efforts of a walk.


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


def turned(change: Callable[[Array], Array]) -> Recording:
    return with_base(walk(), orientation=change(np.array(walk().base.orientation)))


def with_gyro(change: Callable[[Array], Array]) -> Recording:
    return with_imu(walk(), gyroscope=change(np.array(walk().base.imu.gyroscope)))


def with_force(change: Callable[[Array], Array]) -> Recording:
    return with_imu(walk(), accelerometer=change(np.array(walk().base.imu.accelerometer)))


def flags() -> np.ndarray:
    return np.array(walk().contacts.down)


def with_flags(down: np.ndarray) -> Recording:
    return with_feet(walk(), forces=None, down=down)


def speeds(frame: str) -> Recording:
    """Return a recording with velocities in the world's axes, that are said to be in others."""
    base = walk().base
    # As from a filter: differences over single steps are mostly noise of the pose.
    smooth = np.ones(25) / 25.0
    padded = np.pad(np.array(base.position), ((12, 12), (0, 0)), mode="edge")
    rows = [np.convolve(column, smooth, "valid") for column in padded.T]
    rate = np.gradient(np.array(rows).T, walk().time, axis=0)
    return with_base(walk(), linear_velocity=rate, velocity_frame=frame)


ORDER = (1, 0, 2, 3)
PAIRS = (3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8)


def efforts(joint: int | None = None, scale: float = -1.0) -> Recording:
    """Return a recording with one joint's effort, or all, in another unit or sign."""
    factors = np.ones(12)
    factors[slice(None) if joint is None else joint] = scale
    return replace(walk(), effort=np.array(walk().effort) * factors)


def ordered(order: Sequence[int], *, all_columns: bool) -> Recording:
    position, effort = (np.array(each)[:, order] for each in (walk().position, walk().effort))
    return replace(walk(), effort=effort, position=position if all_columns else walk().position)


FROM_LEFT_TO_RIGHT = "in the order FR_HAA, FR_HFE, FR_KFE, FL_HAA"
ZEROS = "never changes: it is (0, 0, 0)"
WRONG: list[tuple[str, str, Callable[[], Recording]]] = [
    ("base_orientation", "in the order w x y z", lambda: turned(lambda q: np.roll(q, 1, axis=1))),
    ("base_orientation", "read as the inverse", lambda: turned(lambda q: q * [-1, -1, -1, 1])),
    ("imu_gyroscope", "it is in deg/s", lambda: with_gyro(np.degrees)),
    (
        "imu_gyroscope",
        "x, y, z are -y, x, z measured",
        lambda: with_gyro(lambda w: w[:, [1, 0, 2]] * [1, -1, 1]),
    ),
    ("imu_gyroscope", ZEROS, lambda: with_gyro(np.zeros_like)),
    ("imu_accelerometer", "it is in g", lambda: with_force(lambda f: f / 9.80665)),
    ("imu_accelerometer", "the opposite sign", lambda: with_force(np.negative)),
    (
        "imu_accelerometer",
        "upright where x, y, z are",
        lambda: with_force(lambda f: f[:, [2, 0, 1]]),
    ),
    ("imu_accelerometer", "gravity is taken off", lambda: with_force(lambda f: f - f.mean(axis=0))),
    ("imu_accelerometer", ZEROS, lambda: with_force(np.zeros_like)),
    ("base_velocity", "where they are the world's", lambda: speeds("base")),
    ("feet_exchanged", "those of FR_FOOT are of FL_FOOT", lambda: with_flags(flags()[:, ORDER])),
    ("effort_sign", "effort of FR_KFE has the wrong sign", lambda: efforts(5)),
    ("joint_order", FROM_LEFT_TO_RIGHT, lambda: ordered(PAIRS, all_columns=True)),
    ("effort_order", FROM_LEFT_TO_RIGHT, lambda: ordered(PAIRS, all_columns=False)),
    ("effort_scale", "N·mm or mN·m", lambda: efforts(scale=1000.0)),
    ("effort_scale", "effort of FR_HFE is", lambda: efforts(4, 1000.0)),
    ("total_mass", "another scale of all torques", lambda: efforts(scale=1.4)),
    (
        "flags_unlike_forces",
        "said to be up",
        lambda: with_feet(walk(), down=np.array(walk().contacts.forces)[:, :, 2] > 4.0),
    ),
    ("foot_moves", "FL_FOOT moves by", lambda: with_flags(np.ones_like(flags()))),
]


@pytest.mark.parametrize(("kind", "words", "make"), WRONG)
def test_what_is_wrong_is_named(kind: str, words: str, make: Callable[[], Recording]) -> None:
    found = sdpid.inspect_recording(make(), robot()).findings
    told = {finding.kind: finding.message for finding in reversed(found)}
    assert words in told.get(kind, "nothing"), told
    also = {
        # With too many feet down little is left to compare.
        "foot_moves": {"effort_unlike_description"},
        # Forces, too, disagree with torques of another scale.
        "total_mass": {"forces_unlike_motion"},
    }.get(kind, set())
    serious = {finding.kind for finding in found if finding.severity != "note"}
    assert not serious - {kind} - also, told


@pytest.mark.parametrize("make", [walk, lambda: speeds("world")])
def test_good_walks_are_left_alone(make: Callable[[], Recording]) -> None:
    assert sdpid.inspect_recording(make(), robot()).ok


def test_a_foot_that_is_down_in_the_air_is_named() -> None:
    position = np.array(walk().position)
    # The left fore leg is stretched backward and up at the hip, as where its zero is another.
    position[:, 1] += 1.2
    wrong = replace(walk(), position=position)
    subject = Subject.of(wrong, robot())
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
    air = Subject.of(replace(log, base=free, contacts=contacts), robot())
    assert not [*base_checks.contacts_missing(air)]


def test_wrong_force_does_not_lift_all_feet() -> None:
    contacts = replace(walk().contacts, down=None, forces=np.array(walk().contacts.forces))
    spike = np.array(walk().contacts.forces)
    spike[100, 0] = 5000.0
    apart = contacts.closed != replace(contacts, forces=spike).closed
    assert contacts.closed.mean() > 0.5
    assert apart.mean() < 1e-3


# Measured contact forces.


LEFT_RIGHT, DIAGONAL = (1, 0, 3, 2), (3, 2, 1, 0)


@cache
def simulated(motion: str, name: str = "solo12") -> LeggedRun:
    """Let a robot move whose links are 15 % off the description."""
    sensors = Sensors(forces=True)
    return sdpid.simulate_legged(robot(name), motion, seed=1, duration=2.0, sensors=sensors)


def log(motion: str, name: str = "solo12") -> Recording:
    return simulated(motion, name).recording


def found(recording: Recording, name: str = "solo12") -> list[Finding]:
    findings = sdpid.inspect_recording(recording, robot(name)).findings
    return [finding for finding in findings if finding.severity != "note"]


def forces(motion: str) -> Array:
    return np.array(log(motion).contacts.forces)


def weight() -> float:
    return 9.81 * float(robot().prior[:, 0].sum())


def in_axes(motion: str, axes: str) -> Array:
    """Return forces in other axes than the world's."""
    base = log(motion).base
    q = np.hstack([base.position, base.orientation, log(motion).position])
    turns = frame_axes(robot(), q, log(motion).contacts.frames)
    if axes == "base":
        turns = np.broadcast_to(base.rotations[:, None], turns.shape)
    return np.einsum("kcji,kcj->kci", turns, forces(motion))


@pytest.mark.parametrize("motion", ["stand", "trot", "walk"])
def test_right_forces_are_left_alone(motion: str) -> None:
    assert not found(log(motion))


LEAVE, SCALED = "% of what the torques of its leg need", "times (standard error"


def off(axis: int) -> Array:
    """Return forces that are 5 % of the weight off at one foot."""
    changed = forces("walk")
    changed[:, 1, axis] += 0.05 * weight()
    return changed


def of_nothing() -> Array:
    drawn = np.random.default_rng(0).normal(size=(4, 3)) * weight() / 4.0
    time = np.array(log("stand").time)[:, None, None]
    return drawn * np.sin(7.0 * time + np.arange(4)[:, None])


UNLIKE: list[tuple[str, str, Callable[[], Array]]] = [
    ("trot", f"they are 0.9504 {SCALED}", lambda: 0.95 * forces("trot")),
    ("stand", f"those of HR_FOOT are 0.9534 {SCALED}", lambda: 0.95 * forces("stand")),
    ("walk", f"those of FR_FOOT are 0.9532 {SCALED}", lambda: forces("walk") * one_foot(0.95)),
    ("walk", LEAVE, lambda: off(0)),
    ("walk", LEAVE, lambda: off(2)),
    ("stand", LEAVE, lambda: forces("stand")[:, LEFT_RIGHT]),
    ("trot", LEAVE, lambda: forces("trot")[:, DIAGONAL]),
    ("walk", "those of FR_FOOT leave 9", lambda: forces("walk")[:, (1, 0, 2, 3)]),
    ("stand", LEAVE, lambda: in_axes("stand", "base")),
    ("walk", LEAVE, lambda: in_axes("walk", "foot")),
    ("trot", f"they are -1 {SCALED}", lambda: -forces("trot")),
    ("trot", f"those of FR_FOOT are -1.001 {SCALED}", lambda: forces("trot") * one_foot(-1.0)),
    ("stand", LEAVE, of_nothing),
]


def one_foot(factor: float) -> Array:
    return np.array([1.0, factor, 1.0, 1.0])[:, None]


@pytest.mark.parametrize(("motion", "words", "make"), UNLIKE)
def test_forces_that_torques_do_not_show(motion: str, words: str, make: Callable[[], Array]):
    (finding,) = found(with_feet(log(motion), forces=make()))
    assert finding.kind == "forces_unlike_motion"
    assert words in finding.message


def test_torques_of_another_scale_are_not_those_of_forces() -> None:
    (finding,) = found(replace(log("trot"), effort=1.05 * np.array(log("trot").effort)))
    assert finding.kind == "forces_unlike_motion"
    assert abs(finding.numbers["ratio"] - 1.0 / 1.05) < 5.0 * finding.numbers["error"]


def test_legs_without_effort_are_not_compared() -> None:
    scaled = with_feet(log("trot"), forces=forces("trot") * np.array([0.9, 1.0, 1.0, 1.0])[:, None])
    subject = replace(Subject.of(scaled, robot()), without=frozenset({"FL_KFE"}))
    assert not [*feet_checks.forces(subject)]


@pytest.mark.parametrize("order", [LEFT_RIGHT, DIAGONAL])
def test_flags_of_other_feet_are_told_beside_their_forces(order: tuple[int, ...]) -> None:
    down = np.array(log("walk").contacts.down)[:, order]
    told = found(with_feet(log("walk"), forces=forces("walk")[:, order], down=down))
    assert {each.kind for each in told} == {"feet_exchanged", "forces_unlike_motion"}
    # Where flags alone are wrong, forces are not blamed.
    (finding,) = found(with_feet(log("walk"), down=down))
    assert finding.kind == "feet_exchanged"


def noise(recording: Recording, feet: int) -> Array:
    return 0.1 * np.random.default_rng(0).normal(size=(recording.contacts.n_samples, feet, 3))


def test_noise_of_feet_in_the_air_is_no_force() -> None:
    hang, feet = log("hang"), log("stand").contacts
    held, n = hang.contacts, hang.contacts.n_samples
    measured = np.concatenate([np.zeros((n, feet.n, 6)), held.wrenches], axis=1)
    measured[:, : feet.n, :3] = noise(hang, feet.n)
    contacts = sdpid.Contacts(
        frames=(*feet.frames, *held.frames),
        kind=(*feet.kind, *held.kind),
        down=np.hstack([np.zeros((n, feet.n), dtype=bool), held.closed]),
        wrenches=measured,
    )
    assert not found(replace(hang, contacts=contacts))


@pytest.mark.parametrize("feet", [[2], [0, 1, 2, 3]])
def test_forces_of_zeros_are_refused(feet: list[int]) -> None:
    changed = forces("trot")
    changed[:, feet] = 0.0
    told = sdpid.inspect_recording(with_feet(log("trot"), forces=changed), robot()).findings
    assert [(f.severity, f.kind) for f in told if f.severity != "note"] == [
        ("refuse", "forces_missing") for _ in feet
    ]
    assert all("never change: they are (0, 0, 0) N" in f.message for f in told[: len(feet)])
    refuses(sdpid.errors.DataError, "forces_missing", require_accepted, told)
    require_accepted(told, "forces_missing")


def test_forces_of_one_axis_are_told() -> None:
    told = found(with_feet(log("trot"), forces=forces("trot") * np.array([0.0, 0.0, 1.0])))
    assert [(each.severity, each.kind) for each in told] == [("warning", "forces_missing")] * 4
    assert "contact forces of FL_FOOT in x, y never change" in told[0].message


@pytest.mark.parametrize("mass", [0, -1.0, float("nan"), float("inf"), "2.5", True])
def test_total_mass_must_be_positive(mass: Any) -> None:
    with pytest.raises(sdpid.errors.DataError, match=r"total_mass: is .* a positive number"):
        sdpid.inspect_recording(log("stand"), robot(), total_mass=mass)


@pytest.mark.parametrize("motion", ["stand", "trot"])
def test_late_forces_are_told_once(motion: str) -> None:
    contacts = log(motion).contacts
    rows = np.maximum(np.arange(contacts.n_samples) - 20, 0)
    late = with_feet(log(motion), forces=contacts.forces[rows], down=contacts.down[rows])
    told = found(late)
    assert [finding.kind for finding in told] == ["contacts_late"]
    # Forces of soft ground and torques are a millisecond apart in a stand that is on time.
    assert told[0].numbers["delay"] == pytest.approx(0.02, abs=2e-3)


def test_hanging_robot_does_not_show_its_mass() -> None:
    hang = log("hang")
    assert not found(hang)
    # Torques of another scale are other masses of the legs; the base's is held.
    assert "total_mass" not in {f.kind for f in found(replace(hang, effort=1.4 * hang.effort))}


def test_joints_that_bear_little_are_compared_with_their_own_efforts() -> None:
    hang = log("hang", "talos_reduced")
    rows = compared(hang)
    ankle = rows.joint_names.index("leg_left_6_joint")
    # Friction is most of what an ankle in the air needs, and explains it.
    assert rows.shares[ankle] > 0.5
    assert rows.left[rows.usable].max() < 0.1
    effort = np.array(hang.effort)
    effort[:, ankle] = 3.0 * np.roll(effort[:, ankle], 700) * np.sin(9.0 * hang.time)
    assert compared(replace(hang, effort=effort)).left[ankle] > 0.6


def compared(recording: Recording) -> ExplainedLog:
    model = robot("talos_reduced")
    samples = Subject.of(recording, model).samples
    assert samples is not None
    rows = floating_log(model, samples)
    assert rows is not None
    return rows


def test_mass_that_is_known_tells_torques_of_another_scale() -> None:
    run = simulated("trot")
    mass = float(run.theta[: 10 * robot().n_links : 10].sum())
    without = with_feet(run.recording, forces=None)
    scaled = replace(without, effort=1.07 * np.array(without.effort))
    told = sdpid.inspect_recording(scaled, robot(), total_mass=mass).findings
    assert [f.kind for f in told if f.severity != "note"] == ["total_mass"]
    assert f"times the {mass:.4g} kg that it weighs" in told[0].message
    # Neither of right torques, nor where nobody weighed the robot.
    assert sdpid.inspect_recording(without, robot(), total_mass=mass).ok
    assert sdpid.inspect_recording(scaled, robot()).ok


@pytest.mark.parametrize(
    ("condition", "mass"),
    [
        (sdpid.constraints.TotalMass(2.5, tolerance=0.01), 2.5),
        (sdpid.constraints.TotalMass(2.5, tolerance=0.5), None),
        (sdpid.constraints.TotalMass(0.4, links=("FL_KFE", "FR_KFE")), None),
    ],
)
def test_mass_of_a_condition_is_compared(
    condition: sdpid.constraints.TotalMass, mass: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def inspect(*_: object, total_mass: float | None = None, **__: object) -> None:
        asked.append(total_mass)
        raise sdpid.errors.DataError("asked")

    monkeypatch.setattr(preparing, "inspect_recordings", inspect)
    constraints = sdpid.Constraints(others=(condition,))
    for run in (sdpid.identify, formulate.formulate):
        with pytest.raises(sdpid.errors.DataError, match="asked"):
            run(robot(), log("stand"), constraints=constraints)
    assert asked == [mass, mass]


@pytest.mark.parametrize("measured", [True, False])
def test_flags_that_open_feet_are_not_taken_for_other_joints(measured: bool) -> None:
    """Equations in which a foot's force is missing look like efforts in another order."""
    stand = log("stand", "go1")
    least = 0.1 * 9.81 * float(robot("go1").prior[:, 0].sum())
    felt = stand.contacts.forces[..., 2] > least
    measure = stand.contacts.forces if measured else None
    told = found(with_feet(stand, down=felt, forces=measure), "go1")
    assert [(each.severity, each.kind) for each in told] == [("warning", "flags_unlike_motion")]


# Measured wrenches of soles.


@cache
def talos(motion: str) -> Recording:
    sensors = Sensors(forces=True)
    model = robot("talos_reduced")
    return sdpid.simulate_legged(model, motion, seed=1, duration=2.0, sensors=sensors).recording


def wrenches(motion: str) -> Array:
    return np.array(talos(motion).contacts.wrenches)


def wrenches_found(motion: str, changed: Array) -> list[Finding]:
    recording = with_feet(talos(motion), wrenches=changed)
    subject = Subject.of(recording, robot("talos_reduced"))
    return list(feet_checks.forces(subject))


@pytest.mark.parametrize("motion", ["stand", "step"])
def test_right_wrenches_are_left_alone(motion: str) -> None:
    assert not wrenches_found(motion, wrenches(motion))


def test_hand_that_never_lands_is_not_compared() -> None:
    stand = talos("stand").contacts
    n = stand.n_samples
    noisy = np.zeros((n, 1, 6))
    noisy[..., :3] = np.random.default_rng(0).normal(size=(n, 1, 3))
    contacts = sdpid.Contacts(
        frames=(*stand.frames, "gripper_left_joint"),
        kind=(*stand.kind, "point"),
        down=np.hstack([stand.closed, np.zeros((n, 1), dtype=bool)]),
        wrenches=np.concatenate([stand.wrenches, noisy], axis=1),
    )
    told = sdpid.inspect_recording(
        replace(talos("stand"), contacts=contacts), robot("talos_reduced")
    ).findings
    assert not [each for each in told if each.severity != "note"]


@pytest.mark.parametrize("motion", ["stand", "step"])
@pytest.mark.parametrize("wrong", ["moments", "sign", "feet", "scale"])
def test_wrong_wrenches_are_told(motion: str, wrong: str) -> None:
    changed = wrenches(motion)
    if wrong == "feet":
        changed = changed[:, [1, 0]]
    elif wrong == "moments":
        changed[..., 3:] *= -1.0
    else:
        changed *= -1.0 if wrong == "sign" else 0.85
    (finding,) = wrenches_found(motion, changed)
    assert finding.kind == "forces_unlike_motion"


# Place, axes, biases and scales of an IMU.


@cache
def go1(motion: str, seed: int = 3, duration: float = 2.0) -> Recording:
    return sdpid.simulate_legged(robot("go1"), motion, seed=seed, duration=duration).recording


def imu_found(recording: Recording) -> list[Finding]:
    return list(base_checks.imu(Subject.of(recording, robot("go1"))))


@pytest.mark.parametrize("motion", ["stand", "trot", "hang"])
def test_right_imus_are_left_alone(motion: str) -> None:
    assert not imu_found(go1(motion))
    late = np.maximum(np.arange(2000) - 10, 0)
    imu = go1(motion).base.imu
    channels = {name: getattr(imu, name)[late] for name in ("gyroscope", "accelerometer")}
    assert not imu_found(with_imu(go1(motion), **channels))


@pytest.mark.parametrize("motion", ["stand", "trot"])
@pytest.mark.parametrize("gyroscope", [True, False])
def test_place_and_axes_are_found_together(motion: str, gyroscope: bool) -> None:
    changes = {} if gyroscope else {"gyroscope": None}
    imu = go1(motion).base.imu
    moved = imu_found(with_imu(go1(motion), translation=np.zeros(3), **changes))
    assert [finding.kind for finding in moved] == ["imu_place"]
    distance = np.linalg.norm(imu.translation)
    assert abs(moved[0].numbers["distance"] - distance) < 5.0 * moved[0].numbers["error"]
    # A large turn about the vertical, which gravity does not show.
    changes |= {"rotation": np.eye(3), "translation": np.zeros(3)}
    turned = imu_found(with_imu(go1(motion), **changes))
    assert {finding.kind for finding in turned} == {"imu_axes", "imu_place"}
    axes = next(finding for finding in turned if finding.kind == "imu_axes")
    given = np.array(eval(axes.remedy.split("=")[1]))
    assert np.linalg.norm(Rotation.from_matrix(given.T @ imu.rotation).as_rotvec()) < 0.03


@pytest.mark.parametrize(
    ("channel", "factor", "bias", "kind"),
    [
        ("accelerometer", 1.0, [0.3, 0.0, 0.0], "imu_bias"),
        ("accelerometer", 0.96, [0.0, 0.0, 0.0], "imu_scale"),
        ("gyroscope", 1.0, [0.0, 0.1, 0.0], "imu_bias"),
        ("gyroscope", 1.05, [0.0, 0.0, 0.0], "imu_scale"),
    ],
)
def test_biases_and_scales_are_named(channel: str, factor: float, bias: list[float], kind: str):
    values = factor * np.array(getattr(go1("stand").base.imu, channel)) + bias
    (finding,) = imu_found(with_imu(go1("stand"), **{channel: values}))
    assert finding.kind == kind
    assert f"the {channel} shows" in finding.message
    true = factor if kind == "imu_scale" else np.linalg.norm(bias)
    told = finding.numbers[kind.removeprefix("imu_")]
    assert abs(told - true) < 5.0 * finding.numbers["error"] + 0.01 * true


def test_bias_of_a_base_at_rest_may_be_a_tilt() -> None:
    force = np.array([0.3, 0.0, 0.0]) + go1("hang").base.imu.accelerometer
    (finding,) = imu_found(with_imu(go1("hang"), accelerometer=force))
    assert finding.kind == "imu_bias"
    assert "axes that are tilted would show the same" in finding.message


def test_mirrored_gyroscope_is_named() -> None:
    trot = log("trot")
    mirrored = np.array(trot.base.imu.gyroscope) * [1.0, 1.0, -1.0]
    # About the vertical a trot turns little: less than half is unexplained.
    (finding,) = found(with_imu(trot, gyroscope=mirrored))
    assert finding.kind == "imu_gyroscope"
    assert "limit 2 %" in finding.message
    assert "where x, y, z are x, y, -z measured" in finding.message


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
    moved = with_imu(run.recording, translation=(0, 0, 0))
    told = sdpid.inspect_recording(moved, robot("go1")).findings
    (place,) = [finding for finding in told if finding.severity != "note"]
    assert place.kind == "imu_place"
    assert place.message.endswith("delays are told once this is mended")


# Contacts at another frame or point than where feet touch the ground.


def points_found(motion: str, **changes: object) -> list[Finding]:
    recording = with_feet(go1(motion, 4, 3.0), **changes)
    return list(feet_checks.feet(Subject.of(recording, robot("go1"))))


@pytest.mark.parametrize("motion", ["stand", "trot", "hang"])
def test_right_contacts_are_left_alone(motion: str) -> None:
    assert not points_found(motion)


@pytest.mark.parametrize("motion", ["stand", "trot"])
def test_point_that_rests_is_named(motion: str) -> None:
    true = np.array(go1(motion, 4, 3.0).contacts.offset)
    for stated in ([0.0, 0.0, 0.0], [0.03, 0.0, -0.02]):
        (finding,) = points_found(motion, offset=stated)
        assert (finding.severity, finding.kind) == ("warning", "contact_point")
        named = np.array(eval(finding.remedy.split("=")[1]))
        assert np.linalg.norm(named - true[0]) < 0.004
    # One foot alone.
    offset = true + np.array([[0.0, 0.0, 0.05], *3 * [[0.0, 0.0, 0.0]]])
    if motion == "stand":
        assert {f.message.split()[0] for f in points_found(motion, offset=offset)} == {"FL_foot"}


@pytest.mark.parametrize("part", ["calf", "thigh"])
def test_frame_that_moves_is_refused(part: str) -> None:
    frames = tuple(f"{leg}_{part}" for leg in ("FL", "FR", "RL", "RR"))
    (finding,) = points_found("trot", frames=frames)
    assert (finding.severity, finding.kind) == ("refuse", "contact_frame")
    assert finding.remedy.endswith("FL_foot, FR_foot, RL_foot, RR_foot")
    refuses(sdpid.errors.DataError, "accept=\\['contact_frame'\\]", require_accepted, [finding])
    require_accepted([finding], "contact_frame")
    wrong = with_feet(go1("trot", 4, 3.0), frames=frames)
    told = {each.kind for each in sdpid.inspect_recording(wrong, robot("go1")).findings}
    assert "contact_frame" in told
    assert not told & {"contact_point", "foot_moves", "base_late"}


def test_a_foot_that_slips_has_no_other_point(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model, "_GRIP", 0.05)
    slips = sdpid.simulate_legged(robot(), "trot", seed=2, duration=10.0).recording
    told = list(feet_checks.feet(Subject.of(slips, robot())))
    assert {each.kind for each in told} == {"foot_moves"}
    assert told[0].message.endswith(": it slips")


def test_a_foot_that_is_in_the_air_shows_no_point() -> None:
    down = np.array(go1("trot", 4, 3.0).contacts.down)
    down[:, 0] = True
    (finding,) = points_found("trot", down=down)
    assert finding.kind == "foot_moves"
    assert finding.message.startswith("FL_foot moves by")


# Channels that are late are found to 1 ms.


# 20 % of the weight.
THRESHOLD = Sensors(flag_threshold=5.0)
LATE = {"effort": 0.002, "imu": 0.004, "contacts": 0.006}


@cache
def recorded(late: bool, *, forces: bool = False) -> Recording:
    """Return a trot, with or without late channels."""
    delays = LATE if late else {}
    sensors = Sensors(delays=delays, forces=forces)
    return sdpid.simulate_legged(robot(), "trot", duration=4.0, seed=3, sensors=sensors).recording


def delays_found(log: Recording) -> dict[str, float]:
    return {name: delay.value for name, delay in channel_delays(robot(), log).items()}


def test_each_channel_is_found_to_a_millisecond() -> None:
    assert delays_found(recorded(late=True)) == pytest.approx({**LATE, "base": 0.0}, abs=1e-3)


@pytest.mark.parametrize("names", [("FL_KFE",), ("FL_KFE", "HR_HFE")])
def test_joints_without_effort_hide_no_delay(names: tuple[str, ...]) -> None:
    log, own = recorded(late=True), robot().joint_names[robot().n_base :]
    effort = np.array(log.effort)
    noise = np.random.default_rng(0).standard_normal(len(effort))
    for name in names:
        effort[:, own.index(name)] = 5.0 * noise
    log = replace(log, effort=effort)
    delays = {name: each.value for name, each in channel_delays(robot(), log, names).items()}
    assert delays == pytest.approx({**LATE, "base": 0.0}, abs=1e-3)
    processing = prepare(robot(), log, without_effort=names).processing
    assert processing.imu_delay_s == pytest.approx(LATE["imu"], abs=5e-4)
    told = {each.kind for each in inspect_recordings([log], robot(), without_effort=names)}
    assert {"imu_late", "contacts_late"} <= told


def test_good_recordings_have_no_delay() -> None:
    kinds = {each.kind for each in sdpid.inspect_recording(recorded(late=False), robot()).findings}
    assert not {kind for kind in kinds if kind.endswith("_late")}
    processing = prepare(robot(), recorded(late=False)).processing
    assert (processing.effort_delay_s, processing.imu_delay_s) == (0.0, 0.0)


def test_flags_with_a_threshold_make_no_delays() -> None:
    log = sdpid.simulate_legged(robot(), "walk", duration=3.0, seed=3, sensors=THRESHOLD).recording
    kinds = {each.kind for each in sdpid.inspect_recording(log, robot()).findings}
    assert not {kind for kind in kinds if kind.endswith("_late")}


def test_findings_tell_what_processing_takes_off() -> None:
    log = recorded(late=True)
    findings = {each.kind: each for each in sdpid.inspect_recording(log, robot()).findings}
    assert findings["effort_late"].numbers["delay"] == pytest.approx(0.002, abs=1e-3)
    assert "are late by" in findings["effort_late"].message
    prepared = prepare(robot(), log, {"imu_delay_s": 0.0})
    assert prepared.processing.effort_delay_s == pytest.approx(0.002, abs=1e-3)
    # What is given stands as it is.
    assert prepared.processing.imu_delay_s == 0.0
    assert any("effort_delay_s" in note for note in prepared.samples.notes)


def test_without_an_imu_the_pose_is_compared_with_legs_that_stand() -> None:
    log = recorded(late=True)
    base = replace(
        log.base,
        imu=None,
        position=np.roll(log.base.position, 3, axis=0),
        orientation=np.roll(log.base.orientation, 3, axis=0),
    )
    log = replace(log, base=base)
    delays = delays_found(rows_of(log, slice(3, None)))
    assert delays["base"] == pytest.approx(0.003, abs=1e-3)
    assert delays["effort"] == pytest.approx(0.002, abs=1e-3)


def test_forces_are_compared_with_efforts() -> None:
    delays = delays_found(recorded(late=True, forces=True))
    assert delays["contacts"] == pytest.approx(0.006, abs=1e-3)


def test_without_a_robot_the_imu_is_compared_with_the_pose() -> None:
    findings = {each.kind: each for each in sdpid.inspect_recording(recorded(late=True)).findings}
    assert findings["imu_late"].numbers["delay"] == pytest.approx(0.004, abs=5e-4)


def test_projected_efforts_hold_no_contact_force() -> None:
    samples = prepare(robot(), recorded(late=False)).samples
    rows = np.arange(0, samples.n_samples, 40)
    q, contacts = samples.position[rows], samples.contacts.picked(rows)
    scale = first_scale(robot(), samples.effort)
    free = free_of_contacts(robot(), q, contacts, scale)
    J = contact_jacobians(robot(), q, contacts.frames, contacts.offset)
    force = np.random.default_rng(0).normal(size=(len(rows), contacts.n, 3))
    force *= contacts.down[:, :, None]
    pushed = np.einsum("kcin,kci->kn", J[:, :, :3], force) / scale
    assert np.abs(np.einsum("kij,kj->ki", free, pushed)).max() < 1e-9 * np.abs(pushed).max()
    left = robot().n - 3 * contacts.down.sum(axis=1)
    np.testing.assert_allclose(np.einsum("kii->k", free), left)


def test_projected_efforts_hold_no_moment_across_a_line() -> None:
    rng = np.random.default_rng(1)
    turned = rng.normal(size=(5, 4))
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    position = np.hstack([np.zeros((5, 3)), turned, rng.normal(size=(5, 12))])
    edge = ContactSamples(frames=["FL_FOOT"], kind="line", down=np.ones((5, 1), dtype=bool))
    free = free_of_contacts(robot(), position, edge, np.ones(18))
    moments = contact_jacobians(robot(), position, edge.frames)[:, 0, 3:]
    across = frame_axes(robot(), position, edge.frames)[:, 0][:, :, [0, 2]]
    twisted = np.einsum("kin,kij->kjn", moments, across)
    assert np.abs(twisted @ free).max() < 1e-9 * np.abs(twisted).max()


@pytest.mark.parametrize("delay", [-0.013, 0.0004, 0.02])
def test_lag_of_two_signals(delay: float) -> None:
    time = 0.01 * np.arange(800)
    phases = np.array([0.0, 1.0])
    wave = np.sin(4.0 * time[:, None] + phases) + np.sin(7.3 * time[:, None])
    late = np.sin(4.0 * (time - delay)[:, None] + phases) + np.sin(7.3 * (time - delay)[:, None])
    found = lag(late, 1.3 * wave + 2.0, 0.01, gain=True)
    assert found.value == pytest.approx(delay, abs=1e-4)
