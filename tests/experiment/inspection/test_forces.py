"""Measured contact forces that are wrong are named, and right ones are left alone."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid import Recording
from sdpid._common.arrays import Array
from sdpid.experiment.inspection.accept import require_accepted
from sdpid.experiment.inspection.finding import Finding, Subject, floating_log
from sdpid.experiment.inspection.floating.floating_log import FloatingLog
from sdpid.experiment.inspection.forces import force_checks
from sdpid.experiment.plant.legged.sensors import Sensors
from sdpid.experiment.plant.legged.simulate import LeggedRun
from sdpid.experiment.preparation import several
from sdpid.robot.model.contacts.jacobians import frame_axes
from sdpid.workflow import formulate
from tests.helpers.refusals import refuses

pytest.importorskip("mujoco")

LEFT_RIGHT, DIAGONAL = (1, 0, 3, 2), (3, 2, 1, 0)


@cache
def robot(name: str = "solo12") -> sdpid.RobotModel:
    return sdpid.load_robot(name, root="free_flyer")


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


def with_feet(motion: str, **changes: Any) -> Recording:
    recording = log(motion)
    return replace(recording, contacts=replace(recording.contacts, **changes))


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


@pytest.mark.parametrize("motion", ["stand", "trot"])
@pytest.mark.parametrize(
    ("forced", "driven", "likely"), [(1.0, 1.05, "torques"), (0.95, 1.0, "forces")]
)
def test_scale_of_forces_against_torques(motion: str, forced: float, driven: float, likely: str):
    recording = with_feet(motion, forces=forced * forces(motion))
    (finding,) = found(replace(recording, effort=driven * np.array(recording.effort)))
    assert finding.kind == "forces_scale"
    right = forced / driven
    assert abs(finding.numbers["ratio"] - right) < 5.0 * finding.numbers["error"]
    assert f"{likely} are likelier wrong" in finding.message


def test_some_feet_alone_tell_no_mass() -> None:
    scaled = with_feet("trot", forces=0.95 * forces("trot"))
    subject = Subject(log=scaled, robot=None, floating=robot(), without=frozenset({"FL_KFE"}))
    (finding,) = force_checks.forces(subject)
    assert finding.kind == "forces_scale"
    assert "kg" not in finding.message
    assert "likelier" not in finding.message


def test_scale_of_one_foot() -> None:
    scaled = forces("walk") * np.array([1.0, 0.95, 1.0, 1.0])[:, None]
    (finding,) = found(with_feet("walk", forces=scaled))
    assert finding.kind == "forces_scale"
    assert "contact forces of FR_FOOT are 0.9" in finding.message


@pytest.mark.parametrize("motion", ["stand", "trot", "walk"])
@pytest.mark.parametrize("axis", [0, 2])
def test_offset_of_one_foot(motion: str, axis: int) -> None:
    offset = np.zeros(3)
    offset[axis] = 0.05 * weight()
    changed = forces(motion)
    changed[:, 1] += offset
    (finding,) = found(with_feet(motion, forces=changed))
    assert finding.kind == "forces_offset"
    assert "contact forces of FR_FOOT are off by" in finding.message
    told = np.array([finding.numbers[f"offset_{key}"] for key in "xyz"])
    assert np.abs(told - offset).max() < 0.01 * weight()
    # A foot that is never up cannot tell its sensor from its leg's torques.
    assert ("it is never up" in finding.message) == (motion == "stand")


def test_offset_of_torques_is_none_of_forces() -> None:
    effort = np.array(log("trot").effort)
    # What the force of an offset would be carried by.
    effort[:, :3] += 0.05 * weight() * np.array([0.02, 0.05, 0.1])
    assert "forces_offset" not in {each.kind for each in found(replace(log("trot"), effort=effort))}


@pytest.mark.parametrize("motion", ["stand", "trot", "walk"])
@pytest.mark.parametrize("order", [LEFT_RIGHT, DIAGONAL, (1, 0, 2, 3)])
def test_forces_of_other_feet(motion: str, order: tuple[int, ...]) -> None:
    columns = list(order)
    (finding,) = found(with_feet(motion, forces=forces(motion)[:, columns]))
    assert finding.kind == "forces_exchanged"
    names = log(motion).contacts.frames
    assert f"are of other feet: those of {names[order[0]]} are of {names[0]}" in finding.message
    assert not finding.numbers["flags"]


@pytest.mark.parametrize("order", [LEFT_RIGHT, DIAGONAL])
def test_forces_and_flags_of_other_feet_are_one_mistake(order: tuple[int, ...]) -> None:
    columns = list(order)
    down = np.array(log("walk").contacts.down)[:, columns]
    (finding,) = found(with_feet("walk", forces=forces("walk")[:, columns], down=down))
    assert finding.kind == "forces_exchanged"
    assert "contact forces, and flags with them, are of other feet" in finding.message
    # Where flags alone are wrong, forces are not blamed.
    (finding,) = found(with_feet("walk", down=down))
    assert finding.kind == "feet_exchanged"


@pytest.mark.parametrize("motion", ["stand", "walk"])
@pytest.mark.parametrize(("axes", "words"), [("base", "the base"), ("foot", "each foot's frame")])
def test_forces_in_other_axes(motion: str, axes: str, words: str) -> None:
    (finding,) = found(with_feet(motion, forces=in_axes(motion, axes)))
    assert finding.kind == "forces_axes"
    assert f"in the axes of {words}" in finding.message


def test_forces_of_the_wrong_sign() -> None:
    (finding,) = found(with_feet("trot", forces=-forces("trot")))
    assert finding.kind == "forces_axes"
    assert "contact forces have the wrong sign" in finding.message
    (finding,) = found(
        with_feet("trot", forces=forces("trot") * np.array([1.0, 1.0, -1.0, 1.0])[:, None])
    )
    assert "contact forces of HL_FOOT have the wrong sign" in finding.message


def test_several_mistakes_are_told_apart() -> None:
    changed = -0.9 * in_axes("walk", "base")[:, list(LEFT_RIGHT)]
    told = [finding.kind for finding in found(with_feet("walk", forces=changed))]
    assert told == ["forces_exchanged", "forces_axes", "forces_axes", "forces_scale"]


def test_forces_of_nothing_are_told_as_such() -> None:
    drawn = np.random.default_rng(0).normal(size=(4, 3)) * weight() / 4.0
    time = np.array(log("stand").time)[:, None, None]
    other = drawn * np.sin(7.0 * time + np.arange(4)[:, None])
    told = {finding.kind: finding.message for finding in found(with_feet("stand", forces=other))}
    assert set(told) == {"forces_unlike_motion"}, told


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
    told = sdpid.inspect_recording(with_feet("trot", forces=changed), robot()).findings
    assert [(f.severity, f.kind) for f in told if f.severity != "note"] == [
        ("refuse", "forces_missing") for _ in feet
    ]
    assert all("never change: they are (0, 0, 0) N" in f.message for f in told[: len(feet)])
    refuses(sdpid.errors.DataError, "forces_missing", require_accepted, told)
    require_accepted(told, "forces_missing")


def test_forces_of_one_axis_are_told() -> None:
    told = found(with_feet("trot", forces=forces("trot") * np.array([0.0, 0.0, 1.0])))
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
    late = with_feet(motion, forces=contacts.forces[rows], down=contacts.down[rows])
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
    assert rows.left[rows.rows.usable].max() < 0.1
    effort = np.array(hang.effort)
    effort[:, ankle] = 3.0 * np.roll(effort[:, ankle], 700) * np.sin(9.0 * hang.time)
    assert compared(replace(hang, effort=effort)).left[ankle] > 0.6


def compared(recording: Recording) -> FloatingLog:
    model = robot("talos_reduced")
    samples = Subject(log=recording, robot=None, floating=model).samples
    assert samples is not None
    rows = floating_log(model, samples)
    assert rows is not None
    return rows


def test_mass_that_is_known_tells_torques_of_another_scale() -> None:
    run = simulated("trot")
    mass = float(run.theta[: 10 * robot().n_links : 10].sum())
    without = replace(run.recording, contacts=replace(run.recording.contacts, forces=None))
    scaled = replace(without, effort=1.07 * np.array(without.effort))
    told = sdpid.inspect_recording(scaled, robot(), total_mass=mass).findings
    assert [f.kind for f in told if f.severity != "note"] == ["total_mass"]
    assert f"times the {mass:.4g} kg that it weighs" in told[0].message
    # Neither of right torques, nor where nobody weighed the robot.
    assert sdpid.inspect_recording(without, robot(), total_mass=mass).ok
    assert sdpid.inspect_recording(scaled, robot()).ok


def test_mass_that_is_known_tells_whether_forces_are_wrong() -> None:
    mass = 1.05 * float(simulated("trot").theta[: 10 * robot().n_links : 10].sum())
    forced = with_feet("trot", forces=0.95 * forces("trot"))
    told = sdpid.inspect_recording(forced, robot(), total_mass=mass).findings
    assert "forces are likelier wrong" in {f.kind: f.message for f in told}["forces_scale"]
    raised = with_feet("trot", forces=1.05 * forces("trot"))
    told = sdpid.inspect_recording(raised, robot(), total_mass=mass).findings
    assert "torques are likelier wrong" in {f.kind: f.message for f in told}["forces_scale"]


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

    monkeypatch.setattr(several, "inspect_recordings", inspect)
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
    contacts = replace(
        stand.contacts, down=felt, forces=stand.contacts.forces if measured else None
    )
    told = found(replace(stand, contacts=contacts), "go1")
    assert [(each.severity, each.kind) for each in told] == [("warning", "flags_unlike_motion")]
