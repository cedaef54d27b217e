"""Robots with springs and transmissions through files: results, URDF and MJCF."""

from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import ExportError, ModelError
from sdpid.estimation.estimate import Estimate
from sdpid.friction import (
    AtJoints,
    Coulomb,
    Hysteresis,
    Offset,
    PositionFriction,
    PositionTerm,
    RotorInertia,
    Spring,
    Viscous,
)
from sdpid.output.robots.friction_files import write_friction
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.terms import term_from_dict, term_to_dict
from sdpid.robot.model.base_parameters import generic_states
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.workflow.result import Identification
from tests.helpers.data import random_links
from tests.helpers.refusals import refuses
from tests.helpers.robots import described_arm

# Motors that move the last two joints together.
WRIST = {
    "joints": {
        "joint_4": {"left": 0.5, "right": 0.5, "offset": 0.1},
        "joint_5": {"left": 0.5, "right": -0.5},
    }
}
# A bar that follows two motors, a rod that follows one.
BARS = {
    "joints": {
        "joint_2": {"shoulder": 2.0},
        "joint_3": {"shoulder": -1.0, "elbow": 1.0, "offset": 0.2},
        "joint_4": {"elbow": 1.0},
        "joint_5": {"shoulder": 0.7, "offset": -0.3},
    }
}
# Motors that move joints of a leg together, and one that moves two joints.
LEGS = {
    "FL_HFE": {"left": 0.5, "right": 0.5, "offset": 0.1},
    "FL_KFE": {"left": 0.5, "right": -0.5},
    "HR_KFE": {"screw": 2.0, "offset": -0.2},
    "HR_HFE": {"screw": 1.0},
}
TERMS = (
    *("viscous", "rotor_inertia", Spring("joint_1", rest=0.2), Spring("joint_5")),
    AtJoints(Viscous(), ("joint_3",)),
    AtJoints(RotorInertia(), ("joint_4",)),
)
VALUES = {"K1": 40.0, "K_joint_5": 25.0, "Kr_joint_5": 4.0, "Fv_joint_3": 2.0}


def described(transmission: Any, seed: int = 3) -> sdpid.RobotModel:
    text = described_arm(random_links(np.random.default_rng(seed), 5)).urdf
    return sdpid.load_robot(text, transmission=transmission)


def motion(n: int, seconds: float = 10.0) -> tuple[Array, Array, Array]:
    rng, time = np.random.default_rng(0), np.arange(0.0, seconds, 0.01)
    rates, phases = rng.uniform(0.5, 5.0, (4, n)), rng.uniform(0.0, 6.0, (4, n))
    angle = rates * time[:, None, None] + phases
    waves = np.sin(angle), rates * np.cos(angle), -(rates**2) * np.sin(angle)
    q, v, a = (0.25 * each.sum(axis=1) for each in waves)
    return q, v, a


def truth(robot: sdpid.RobotModel, terms: tuple[Any, ...]) -> RobotDynamics:
    """Return the described links with terms whose parameters are one, but for `VALUES`."""
    model = FrictionModel.from_terms(terms, robot.joint_names)
    numbers = [VALUES.get(p.name, 1.0) if p.value is None else p.value for p in model.parameters]
    theta = np.concatenate([robot.prior.ravel(), numbers])
    return RobotDynamics(robot=robot, terms=model, theta=theta)


def identified(robot: sdpid.RobotModel, terms: tuple[Any, ...] = TERMS) -> Estimate:
    q, v, a = motion(robot.n)
    effort = truth(robot, terms).inverse_dynamics(q, v, a)
    samples = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=effort)
    return sdpid.solve_sdp(
        sdpid.build_problem(robot, samples, friction=terms, weighting="residual")
    )


def in_mujoco(file: Path, robot: sdpid.RobotModel, *states: Array) -> Array:
    """Return the motors' efforts in MuJoCo; its equalities hold, and do no work."""
    model = mujoco.MjModel.from_xml_path(str(file))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EQUALITY
    data, E = mujoco.MjData(model), robot.expansion
    q, v, a = states[0] @ E.T + robot.offset, states[1] @ E.T, states[2] @ E.T
    out = np.empty_like(q)
    for k in range(len(q)):
        data.qpos, data.qvel, data.qacc = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        out[k] = data.qfrc_inverse
    return out @ E


@pytest.mark.parametrize("transmission", [WRIST, BARS, None], ids=["wrist", "bars", "none"])
def test_mujoco_asks_for_the_same_efforts(tmp_path: Path, transmission: Any):
    robot = described(transmission)
    estimate = identified(robot)
    report = sdpid.write_mjcf(estimate, target=tmp_path / "arm.xml")
    assert not report.left_out
    states = [each[::50] for each in motion(robot.n)]
    expected = estimate.model().inverse_dynamics(*states)
    found = in_mujoco(tmp_path / "arm.xml", robot, *states)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
    if transmission is WRIST:
        own = sdpid.load_robot(tmp_path / "arm.xml", transmission="description")
        np.testing.assert_allclose(own.expansion, robot.expansion, atol=1e-15)
        assert own.joint_names == robot.joint_names
    # What was written is read again: the springs as known ones.
    again = sdpid.load_robot(tmp_path / "arm.xml", transmission=transmission)
    assert [each.joint for each in again.springs] == ["joint_1", "joint_5"]
    second = identified(again, (*TERMS[:2], *again.springs, *TERMS[4:]))
    sdpid.write_mjcf(second, target=tmp_path / "again.xml", source=tmp_path / "arm.xml")
    expected = second.model().inverse_dynamics(*states)
    found = in_mujoco(tmp_path / "again.xml", robot, *states)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_springs_of_a_motor_and_of_its_joint_are_one_in_mujoco(tmp_path: Path):
    robot = described({"joints": {"joint_3": {"belt": -0.5, "offset": 0.2}}})
    bent = Spring("joint_3", 20.0, 0.1, (3.0, 40.0))
    for joint in (bent, Spring("joint_3", 20.0, 0.1)):
        estimate = identified(robot, ("viscous", joint, Spring("belt", 5.0, 0.3)))
        assert not sdpid.write_mjcf(estimate, target=tmp_path / "arm.xml").left_out
        states = [each[::50] for each in motion(robot.n)]
        expected = estimate.model().inverse_dynamics(*states)
        found = in_mujoco(tmp_path / "arm.xml", robot, *states)
        np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
    restless = Spring("joint_3", 20.0, 0.0, (100.0,)), Spring("belt", 5.0, 2.0)
    estimate = identified(robot, ("viscous", *restless))
    target = tmp_path / "none.xml"
    refuses(ExportError, "nowhere at rest", sdpid.write_mjcf, estimate, target=target)


def test_a_floating_base_in_mujoco(tmp_path: Path):
    robot = sdpid.load_robot("solo12", root="free_flyer", transmission={"joints": LEGS})
    q, v, a = generic_states(robot, 200, seed=3)
    # At rest, so that MuJoCo's velocity of the base, in the world's axes, does not matter.
    v[:, :6] = 0.0
    terms = ("viscous", "rotor_inertia", Spring("left"), AtJoints(Viscous(), ("FL_KFE",)))
    model = FrictionModel.from_terms(terms, robot.joint_names, first=6)
    theta = np.concatenate([robot.prior.ravel(), np.full(len(model.parameters), 0.3)])
    effort = RobotDynamics(robot=robot, terms=model, theta=theta).inverse_dynamics(q, v, a)
    samples = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=effort)
    problem = sdpid.build_problem(robot, samples, friction=terms, weighting="residual")
    estimate = sdpid.solve_sdp(problem)
    np.testing.assert_allclose(problem.predict(estimate.base), effort, atol=1e-6)
    sdpid.write_urdf(estimate, target=tmp_path / "a.urdf")
    sdpid.write_mjcf(estimate, target=tmp_path / "a.xml")
    found = mujoco.MjModel.from_xml_path(str(tmp_path / "a.xml"))
    found.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EQUALITY
    data, E = mujoco.MjData(found), robot.expansion
    joints = [found.joint(name) for name in robot.tree_joints[6:]]
    at, to = [j.qposadr[0] for j in joints], [j.dofadr[0] for j in joints]
    out = np.empty((len(q), len(E)))
    for k, (place, rate, change) in enumerate(
        zip(robot.configuration(q), v @ E.T, a @ E.T, strict=True)
    ):
        turn = pin.Quaternion(place[3:7]).matrix()
        data.qpos[:7] = place[[0, 1, 2, 6, 3, 4, 5]]
        data.qpos[at], data.qvel[to], data.qacc[to] = place[7:], rate[6:], change[6:]
        data.qacc[:3], data.qacc[3:6] = turn @ change[:3], change[3:6]
        mujoco.mj_inverse(found, data)
        force = data.qfrc_inverse
        out[k] = np.concatenate([turn.T @ force[:3], force[3:6], force[to]])
    expected = estimate.model().inverse_dynamics(q, v, a)
    np.testing.assert_allclose(out @ E, expected, atol=1e-9 * np.abs(expected).max())
    again = sdpid.load_robot(tmp_path / "a.xml", transmission={"joints": LEGS})
    assert again.joint_names == robot.joint_names


def test_equalities_hold_where_the_motors_take_the_joints(tmp_path: Path):
    robot = described(BARS)
    sdpid.write_mjcf(identified(robot), target=tmp_path / "arm.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    assert model.neq == 2
    data = mujoco.MjData(model)
    for m in motion(robot.n)[0][::200]:
        data.qpos = robot.expansion @ m + robot.offset
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.efc_pos[: model.neq], 0.0, atol=1e-12)


def test_a_urdf_has_the_joints_that_follow_one_other(tmp_path: Path):
    robot = described(BARS)
    # What was found at the shoulder holds the friction of the last joint, which follows it.
    source = '<dynamics damping="3"/></joint>'.join(str(robot.urdf).rsplit("</joint>", 1))
    report = sdpid.write_urdf(identified(robot), source=source, target=tmp_path / "arm.urdf")
    assert "has place for mimic joints alone" in report.describe()
    plain = sdpid.load_robot(tmp_path / "arm.urdf")
    assert plain.joint_names == ("joint_1", "joint_2", "joint_3", "joint_4")
    assert (plain.expansion[4, 1], plain.offset[4]) == pytest.approx((0.35, -0.3))
    assert (source.count("damping"), plain.pin_model.damping[4]) == (1, 0.0)
    again = sdpid.load_robot(tmp_path / "arm.urdf", transmission=BARS)
    np.testing.assert_array_equal(again.expansion, robot.expansion)


@cache
def run(folder: Path) -> tuple[Identification, sdpid.Recording]:
    robot, rng = described(WRIST), np.random.default_rng(1)
    cam = PositionTerm(((-1.0, 0.0, 1.0), (1.0, 0.0, 1.0)), "cam", joint="joint_2")
    terms = (
        *("coulomb", "viscous", Spring("joint_4")),
        *(AtJoints(Viscous(), ("joint_5",)), cam, Hysteresis("joint_3", (0.05, 0.2))),
    )
    q, v, a = motion(robot.n, 20.0)
    effort = truth(robot, terms).inverse_dynamics(q, v, a)
    effort += rng.normal(0.0, 0.02, effort.shape)
    log = sdpid.Recording(
        time=0.01 * np.arange(len(q)), position=q, effort=effort, joint_names=robot.joint_names
    )
    result = sdpid.identify(robot, log, friction=terms, effects="none")
    result.save(folder)
    return result, log


def test_results_are_saved_verified_and_loaded(tmp_path: Path):
    result, log = run(tmp_path / "results")
    found = sdpid.verify(tmp_path / "results", data=log)
    assert found.passed, found.problems
    assert any("identified.urdf" in each for each in found.made_again)
    assert any("is the same" in each and "identified.xml" in each for each in found.made_again)
    states = [each[:20] for each in motion(result.problem.robot.n)]
    loaded = sdpid.load(tmp_path / "results").model()
    np.testing.assert_array_equal(
        loaded.inverse_dynamics(*states), result.model().inverse_dynamics(*states)
    )


@pytest.mark.parametrize(
    ("transmission", "terms", "asked"),
    [
        (WRIST, ("viscous", "offset"), {}),
        (WRIST, ("viscous", "offset"), {"offsets": True}),
        (None, ("viscous", PositionFriction((-1.0,) * 5, (1.0,) * 5)), {"tendons": True}),
    ],
)
def test_files_are_verified_as_they_were_asked_for(
    tmp_path: Path, transmission: Any, terms: tuple[Any, ...], asked: dict[str, bool]
):
    """Drives of several joints are actuators too, as offsets are, and fixed tendons."""
    robot = described(transmission)
    q, v, a = motion(robot.n)
    effort = robot.inverse_dynamics(robot.prior, q, v, a) + v + 0.1
    effort += np.random.default_rng(0).normal(0.0, 0.02, effort.shape)
    time = 0.01 * np.arange(len(q))
    log = sdpid.Recording(time=time, position=q, effort=effort, joint_names=robot.joint_names)
    result = sdpid.identify(robot, log, friction=terms, effects="none", intervals=False)
    result.save(tmp_path / "results", **asked)  # type: ignore[arg-type]
    found = sdpid.verify(tmp_path / "results", data=log)
    assert found.passed, found.problems
    assert any("is the same" in each and "identified.xml" in each for each in found.made_again)


KEPT = [
    Spring("joint_1", stiffness=3.0),
    Spring("joint_1", stiffness=3.0, rest=0.1, polynomial=(1.0, 2.0)),
    PositionTerm(((0.0, 1.0), (2.0, 3.0)), "cam", joint="joint_2", nonnegative=True, value=1.0),
    Hysteresis("joint_2", (0.1, 0.2)),
    AtJoints(Coulomb(width=(0.1, 0.2)), ("joint_2", "joint_3")),
]


@pytest.mark.parametrize("term", KEPT, ids=[type(each).__name__ for each in KEPT])
def test_terms_are_kept_in_files(term: sdpid.friction.FrictionTerm):
    assert term_from_dict(term_to_dict(term)) == term


def test_code_of_ones_own_is_kept_in_no_file():
    term = PositionTerm(np.sin, "cam", joint="joint_2")
    refuses(ModelError, "function of PositionTerm is code of your own", lambda: term_to_dict(term))


BENT = """
<mujoco><compiler angle="radian"/><worldbody><body>
<joint name="a" axis="0 1 0" stiffness="{}" springref="0.2"/>
<inertial mass="2" pos="0.1 0.02 -0.2" fullinertia="0.04 0.05 0.02 0.001 0.002 0.003"/>
</body></worldbody></mujoco>
"""


@pytest.mark.parametrize("stiffness", ["30", "30 5 7"])
def test_springs_of_a_description_are_known(tmp_path: Path, stiffness: str):
    file = tmp_path / "a.xml"
    file.write_text(BENT.format(stiffness))
    robot, (q, v, a) = sdpid.load_robot(file), motion(1, 20.0)
    effort = in_mujoco(file, robot, q, v, a)
    log = sdpid.Recording(time=0.01 * np.arange(len(q)), position=q, effort=effort)
    result = sdpid.identify(robot, log, friction=("viscous",), effects="none", intervals=False)
    assert result.problem.friction.terms[1:] == robot.springs
    assert any("springs of the description" in each for each in result.notes)
    sdpid.write_mjcf(result.estimate, target=tmp_path / "b.xml", source=file)
    assert sdpid.load_robot(tmp_path / "b.xml").springs == robot.springs
    hysteresis = Hysteresis("a", (0.1,))
    beside = sdpid.identify(robot, log, friction=(hysteresis,), effects="none", intervals=False)
    assert beside.problem.friction.terms == (hysteresis, *robot.springs)
    free = Spring("a", rest=0.2, polynomial=robot.springs[0].polynomial)
    anew = sdpid.identify(robot, log, friction=("viscous", free), effects="none", intervals=False)
    assert anew.estimate.named_theta()["K1"] == pytest.approx(30.0, rel=0.02)


GEARED = """
<mujoco><compiler angle="radian"/><worldbody>
<body><joint name="b" axis="0 1 0"/><inertial mass="1" pos="0.1 0 -0.2" diaginertia=".1 .1 .1"/>
<body pos="0 0 -0.4"><joint name="c" axis="1 0 0"/>
<inertial mass="1" pos="0 0.1 -0.2" diaginertia=".1 .1 .1"/></body></body></worldbody>
<tendon><fixed name="sum" stiffness="8" springlength="0.4" damping="3" armature="0.1">
<joint joint="b" coef="1"/><joint joint="c" coef="1"/></fixed>
<fixed name="difference"><joint joint="b" coef="1"/><joint joint="c" coef="-1"/></fixed></tendon>
<actuator><motor name="left" tendon="sum" gear="2"/><motor name="right" tendon="difference"/>
</actuator></mujoco>
"""


def test_tendons_of_a_file_keep_their_gears(tmp_path: Path):
    (tmp_path / "a.xml").write_text(GEARED)
    robot = sdpid.load_robot(tmp_path / "a.xml", transmission="description")
    q, v, a = motion(robot.n)
    effort = in_mujoco(tmp_path / "a.xml", robot, q, v, a)
    samples = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=effort)
    terms = ("viscous", "rotor_inertia", *robot.springs)
    problem = sdpid.build_problem(robot, samples, friction=terms, weighting="residual")
    estimate = sdpid.solve_sdp(problem)
    np.testing.assert_allclose(problem.predict(estimate.base), effort, atol=1e-5)
    report = sdpid.write_mjcf(estimate, target=tmp_path / "b.xml", source=tmp_path / "a.xml")
    states = [each[::50] for each in (q, v, a)]
    expected = estimate.model().inverse_dynamics(*states)
    found = in_mujoco(tmp_path / "b.xml", robot, *states)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
    assert not report.left_out
    again = sdpid.load_robot(tmp_path / "b.xml", transmission="description")
    assert again.springs == robot.springs


def test_offsets_of_joints_have_a_place_where_they_are_asked_for(tmp_path: Path):
    robot, terms = described(BARS), ("viscous", "offset", AtJoints(Offset(), ("joint_3",)))
    estimate = identified(robot, terms)
    report = sdpid.write_mjcf(estimate, target=tmp_path / "a.xml", offsets=True)
    assert not report.left_out
    assert report.training is not None
    assert report.training.file < 1e-6
    text = (tmp_path / "a.xml").read_text()
    assert text.count("<general ") == robot.n + 1
    assert sdpid.write_mjcf(estimate, target=tmp_path / "b.xml").left_out


def test_what_has_no_place_is_told(tmp_path: Path):
    terms = ("viscous", AtJoints(Coulomb(width=0.2), ("joint_5",)), Spring("joint_4"))
    estimate = identified(described(WRIST), terms)
    told = sdpid.write_urdf(estimate, target=tmp_path / "a.urdf").describe()
    assert "no place for friction of motors that move joints together: left, right" in told
    assert "no place in a URDF: Spring K_joint_4, Kr_joint_4" in told
    assert (
        "lacks its smooth sign" in sdpid.write_mjcf(estimate, target=tmp_path / "a.xml").describe()
    )
    slack = identified(described(WRIST), ("viscous", Spring("joint_4", stiffness=0.0, rest=0.1)))
    report = sdpid.write_mjcf(slack, target=tmp_path / "b.xml")
    assert "no place for the spring of joint_4: its stiffness is zero" in report.describe()
    assert "joint_4, joint_5" in described(WRIST)._repr_html_()
    for file in (tmp_path / "a.py", tmp_path / "a.hpp"):
        (told,) = write_friction(estimate, file)
        assert "not in it: AtJoints, Spring; take" in told
        assert "behind a transmission): AtJoints, Spring." in file.read_text()


def test_a_spring_that_the_motion_hides_is_named(tmp_path: Path):
    file = tmp_path / "a.xml"
    file.write_text(BENT.format("30"))
    robot, (q, v, a) = sdpid.load_robot(file), motion(1, 20.0)
    told = []
    for size in (0.05, 3.0):
        effort = in_mujoco(file, robot, size * q, size * v, size * a)
        effort += 0.01 * np.random.default_rng(0).standard_normal(effort.shape)
        log = sdpid.Recording(time=0.01 * np.arange(len(q)), position=size * q, effort=effort)
        terms = ("viscous", Spring("a", rest=0.2))
        found = sdpid.identify(robot, log, friction=terms, effects="none", intervals=False)
        told.append(any("K1 of a is hardly told from" in each for each in found.notes))
    assert told == [True, False]
