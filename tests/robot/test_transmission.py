"""Joints behind transmissions, springs, terms of the position and of its history."""

from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import ModelError
from sdpid.friction import AtJoints, Hysteresis, LoadFriction, Offset, PositionTerm, Spring, Viscous
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.position import play
from sdpid.robot.friction.term import SampledMotion
from sdpid.robot.model.base_parameters import generic_states, structural_base
from sdpid.robot.model.closure import close_loops
from tests.helpers.data import random_links
from tests.helpers.linkages import urdf
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, TREE_MIMIC, described_arm
from tests.helpers.strategies import SEEDS, random_states

NAMES = ("joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6")
# A differential wrist behind motors of its own.
WRIST = [[0.5, 0.5], [0.5, -0.5]]

# A pendulum of two links with springs, and its joints' equalities to motors of their own.
SPRUNG = """
<mujoco><compiler angle="radian"/><option gravity="0 0 -9.81"/>
<worldbody><body name="upper">
<joint name="shoulder" axis="0 1 0" stiffness="30" springref="0.2"/>
<inertial mass="2" pos="0.1 0.02 -0.2" fullinertia="0.04 0.05 0.02 0.001 0.002 0.003"/>
<body name="lower" pos="0 0 -0.4"><joint name="elbow" axis="0 1 0" stiffness="5"/>
<inertial mass="1" pos="0 0.01 -0.15" fullinertia="0.02 0.02 0.01 0 0 0"/></body></body></worldbody>
</mujoco>
"""


def behind(seed: int, n: int = 4) -> sdpid.RobotModel:
    """Return an arm whose joints follow fewer motors by random factors."""
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(6, n)) * (rng.random((6, n)) < 0.6) + 0.1 * rng.normal(size=(6, n))
    return sdpid.load_robot(
        "denso_vp6242", transmission=sdpid.Transmission(matrix, rng.normal(size=6))
    )


@given(seed=SEEDS, compiled=st.booleans())
def test_efforts_of_motors_do_the_work_of_those_of_joints(seed: int, compiled: bool):
    robot, plain = behind(seed), sdpid.load_robot("denso_vp6242")
    m, v, a = random_states(np.random.default_rng(seed), robot.n, 5)
    E = robot.expansion
    joints = plain.regressor(m @ E.T + robot.offset, v @ E.T, a @ E.T)
    found = robot.regressor_columns(m, v, a, compiled=compiled)
    np.testing.assert_allclose(found, np.einsum("jn,kjp->knp", E, joints), atol=1e-9)


# Three motors of a leg's joints, one of two joints of another leg.
LEGS = {
    "FL_HFE": {"left": 0.5, "right": 0.5, "offset": 0.1},
    "FL_KFE": {"left": 0.5, "right": -0.5},
    "HR_KFE": {"screw": 2.0, "offset": -0.2},
    "HR_HFE": {"screw": 1.0},
}


@pytest.mark.parametrize("compiled", [True, False])
def test_a_base_may_float(compiled: bool):
    robot = sdpid.load_robot("solo12", root="free_flyer", transmission={"joints": LEGS})
    q, v, a = generic_states(robot, 5, seed=1)
    assert q.shape[1] == robot.n + 1
    model, E = robot.pin_model, robot.expansion
    states = robot.configuration(q), v @ E.T, a @ E.T
    data = model.createData()
    efforts = [pin.rnea(model, data, *state) for state in zip(*states, strict=True)]
    found = robot.regressor_columns(q, v, a, compiled=compiled) @ robot.prior.ravel()
    np.testing.assert_allclose(found, np.array(efforts) @ E, atol=1e-9)
    spring = columns(Spring("HR_KFE", rest=0.3), robot, (q, v, a))
    way = E[robot.tree_joints.index("HR_KFE"), 6:]
    np.testing.assert_allclose(spring[:, :, 0], (q[:, 7:] @ way - 0.5)[:, None] * way)


def test_loops_close_behind_motors():
    text, motors = urdf("five_bar"), np.array([[4.3, 0.7], [4.4, 0.5]])
    rows = {"left_arm_joint": [0.5, 0.0, 0.1], "right_arm_joint": [0.0, 1.0, 0.2]}
    given = {j: dict(zip(("one", "two", "offset"), row, strict=True)) for j, row in rows.items()}
    robot = sdpid.load_robot(text, transmission={"joints": given})
    assert robot.passive == ("left_rod_joint", "right_rod_joint")
    closed = close_loops(robot, np.insert(motors, [1, 2], 0.0, axis=1), robot.passive)
    joints = closed @ robot.expansion.T + robot.offset
    plain = sdpid.load_robot(text)
    known = np.where(np.isin(plain.joint_names, plain.passive), 0.0, joints)
    np.testing.assert_allclose(joints, close_loops(plain, known, plain.passive), atol=1e-9)


def test_a_joint_that_mimics_another_is_a_transmission():
    mimic, plain = sdpid.load_robot(TREE_MIMIC), sdpid.load_robot(TREE)
    written = sdpid.Transmission(mimic.expansion, mimic.offset, mimic.joint_names)
    same = written.applied(plain)
    assert same.joint_names == mimic.joint_names
    states = random_states(np.random.default_rng(0), mimic.n, 5)
    np.testing.assert_allclose(same.regressor(*states), mimic.regressor(*states), atol=1e-12)


def test_motors_take_the_place_of_their_joints_and_files_say_the_same(tmp_path: Path):
    wrist = sdpid.Transmission(WRIST, [0.1, 0.0], ("left", "right"), NAMES[4:])
    robot = sdpid.load_robot("denso_vp6242", transmission=wrist)
    assert robot.joint_names == (*NAMES[:4], "left", "right")
    assert robot.tree_joints == NAMES
    file = tmp_path / "wrist.toml"
    file.write_text(
        "[joints.joint_5]\nleft = 0.5\nright = 0.5\noffset = 0.1\n"
        "[joints.joint_6]\nleft = 0.5\nright = -0.5\n"
    )
    read = sdpid.load_robot("denso_vp6242", transmission=file)
    np.testing.assert_array_equal(read.expansion, robot.expansion)
    np.testing.assert_array_equal(read.offset, robot.offset)
    assert read.joint_names == robot.joint_names


def of(**given: object) -> object:
    return lambda: sdpid.load_robot("denso_vp6242", transmission=given)


REFUSED = [
    (lambda: sdpid.Transmission([[1.0, 2.0]]), "2 motors move the 1 joints in 1 ways"),
    (lambda: sdpid.Transmission([[1.0, 2.0], [2.0, 4.0]]), "in 1 ways; leave dependent motors"),
    (lambda: sdpid.Transmission(WRIST, [0.0]), "offset has 1 numbers for 2 rows"),
    (lambda: sdpid.Transmission(WRIST, names=("a", "a")), "names are a, a; give 2 names"),
    (lambda: sdpid.Transmission(WRIST, joints=("a",)), "joints are a; give 2 names"),
    (lambda: sdpid.Transmission(WRIST, names=(1, 2)), "names are 1, 2; give 2 names"),
    (of(joints={5: {"a": 1.0}}), "joints are 5; give 1 names"),
    (lambda: sdpid.Transmission([[np.nan]]), "transmission: matrix"),
    (
        lambda: sdpid.load_robot("denso_vp6242", transmission=sdpid.Transmission(WRIST)),
        "2 rows for the 6 joints",
    ),
    (of(joints={"elbow": {"a": 1.0}}), "has no joint elbow; it has joint_1"),
    (of(joints={"joint_6": {"joint_5": 1.0}}), "joint_5 is a motor, and a joint"),
    (of(joints={"joint_6": {"a": "1"}}), "joints.joint_6 is .*; give numbers by motors"),
    (of(rows={}), "give a table 'joints' of tables"),
    (lambda: sdpid.load_robot("denso_vp6242", transmission="no.toml"), "no.toml: .*No such file"),
    (
        lambda: sdpid.Transmission.of({"joints": {"joint_1": {"a": 1.0}}}).applied(behind(0)),
        "has one already; load it without",
    ),
    (lambda: Spring("joint_2", stiffness=-1.0), "stiffness is -1.0, the least is 0"),
    (lambda: Spring("joint_2", rest=np.inf), "rest is inf; give a finite number"),
    (lambda: Spring("joint_2", stiffness="5"), "stiffness is '5'; give a finite number"),  # type: ignore[arg-type]
    (lambda: Hysteresis("joint_2", (0.1, 0.0)), "slips are .*; give positive numbers"),
    (lambda: Hysteresis("joint_2", 0.1), "slips are 0.1; give positive numbers"),  # type: ignore[arg-type]
    (lambda: PositionTerm(((0.0, 0.0), (1.0, 2.0)), "c", joint="joint_2"), "do not rise"),
    (lambda: PositionTerm("sin", "c", joint="joint_2"), "give a function of positions, or two"),
    (lambda: PositionTerm(((), ()), "c", joint="joint_2"), "give a function of positions, or two"),
    (lambda: PositionTerm(np.sin, "", joint="joint_2"), "name is ''; give a text"),
    (lambda: PositionTerm(np.sin, "c", joint="joint_2", count=0), "count is 0; .* from 1 to 26"),
    (lambda: PositionTerm(np.sin, "c", joint="joint_2", count="x"), "count is 'x'; give"),  # type: ignore[arg-type]
    (lambda: PositionTerm(np.sin, "c", joint="joint_2", value=np.nan), "value is nan; give"),
    (
        lambda: PositionTerm(np.sin, "c", joint="joint_2", value=-1.0, nonnegative=True),
        "value is -1.0; give a finite number from 0 on",
    ),
    (lambda: Spring("joint_2", 1.0, 0.0, polynomial="ab"), "Spring: polynomial: not a rectangular"),  # type: ignore[arg-type]
    (lambda: Spring("joint_2", 1.0, 0.0, polynomial=3.0), "Spring: polynomial: has 0 axes"),  # type: ignore[arg-type]
    (lambda: Spring(2).parameters(("a",)), "Spring: joint is 2; give the name of a joint"),  # type: ignore[arg-type]
    (lambda: AtJoints(Spring("joint_2"), ("joint_2",)), "is no term of several joints"),
    (lambda: columns(Spring("elbow")), "has no joint 'elbow'; it has joint_1"),
    (lambda: columns(PositionTerm(lambda q: "x", "c", joint="joint_2")), "returned the shape"),  # type: ignore[arg-type,return-value]
    (
        lambda: columns(PositionTerm(lambda q: q[:1], "c", joint="joint_2")),
        "returned the shape .* for 5 positions; give 1 finite value",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("call", "words"), REFUSED, ids=[words for _, words in REFUSED])
def test_what_is_refused(call: object, words: str):
    refuses(ModelError, words, call)  # type: ignore[arg-type]


def columns(
    term: sdpid.friction.FrictionTerm,
    robot: sdpid.RobotModel | None = None,
    states: tuple[Array, Array, Array] | None = None,
) -> Array:
    robot = sdpid.load_robot("denso_vp6242") if robot is None else robot
    first = robot.n_base
    q, v, a = random_states(np.random.default_rng(1), robot.n, 5) if states is None else states
    motion = SampledMotion(
        position=q, velocity=v[:, first:], acceleration=a[:, first:], robot=robot
    )
    return term.columns_in(motion, robot.joint_names[first:])


@given(seed=SEEDS)
def test_terms_on_joints_do_the_same_work_on_motors(seed: int):
    robot = behind(seed)
    q, v, _ = random_states(np.random.default_rng(1), robot.n, 5)
    E = robot.expansion
    found = columns(AtJoints(Viscous(), NAMES), robot)
    np.testing.assert_allclose(found, np.einsum("jn,kj->knj", E, v @ E.T), atol=1e-12)
    power = np.einsum("kn,knj->kj", v, found)
    np.testing.assert_allclose(power, (v @ E.T) ** 2, atol=1e-9)
    spring = columns(Spring("joint_5"), robot)
    expected = (q @ E[4] + robot.offset[4])[:, None] * E[4]
    np.testing.assert_allclose(spring[:, :, 0], expected, atol=1e-12)
    np.testing.assert_allclose(spring[:, :, 1], np.tile(-E[4], (5, 1)), atol=1e-12)


def test_terms_are_called_by_joints_and_stand_alone_without_a_transmission():
    robot = sdpid.load_robot("denso_vp6242")
    names = [p.name for p in AtJoints(Offset(), ("joint_2", "joint_3")).parameters(NAMES)]
    assert names == ["Fo_joint_2", "Fo_joint_3"]
    assert [p.name for p in Spring("joint_2").parameters(NAMES)] == ["K2", "Kr2"]
    assert [p.name for p in Spring("rod").parameters(NAMES)] == ["K_rod", "Kr_rod"]
    table = PositionTerm(((-1.0, 1.0), (-2.0, 2.0)), "t", joint="joint_3")
    line = PositionTerm(lambda q: 2.0 * np.clip(q, -1.0, 1.0), "t", joint="joint_3")
    np.testing.assert_allclose(columns(table, robot), columns(line, robot), atol=1e-12)
    wide = columns(AtJoints(Viscous(), NAMES), robot)
    np.testing.assert_array_equal(wide, columns(Viscous(), robot))


@given(seed=SEEDS, slip=st.floats(0.01, 1.0))
def test_hysteresis_takes_energy_up_along_every_closed_way(seed: int, slip: float):
    rng = np.random.default_rng(seed)
    way = np.cumsum(rng.normal(size=200)) * 0.1
    round_trip = np.concatenate([way, np.linspace(way[-1], way[0], 50)])
    twice = np.tile(round_trip, 3)
    effort = (twice - play(twice, slip)) / slip
    assert np.abs(effort).max() <= 1.0 + 1e-9
    last = slice(-len(round_trip) - 1, None)
    middle = 0.5 * (effort[last][1:] + effort[last][:-1])
    assert middle @ np.diff(twice[last]) >= -1e-9


def test_springs_of_mujoco_are_found_and_known_ones_held():
    """Efforts are those of MuJoCo's inverse dynamics: two springs, one of them known."""
    model = mujoco.MjModel.from_xml_string(SPRUNG)
    time = np.arange(0.0, 20.0, 0.01)
    waves = np.array([[1.1, 0.7], [2.3, 1.9], [3.1, 4.3]])
    q = np.sum(0.3 * np.sin(waves[:, None] * time[:, None]), axis=0)
    v = np.sum(0.3 * waves[:, None] * np.cos(waves[:, None] * time[:, None]), axis=0)
    a = np.sum(-0.3 * waves[:, None] ** 2 * np.sin(waves[:, None] * time[:, None]), axis=0)
    data, effort = mujoco.MjData(model), np.empty_like(q)
    for k in range(len(time)):
        data.qpos, data.qvel, data.qacc = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        effort[k] = data.qfrc_inverse
    robot = sdpid.load_robot(SPRUNG)
    samples = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=effort)
    terms = (Spring("shoulder"), Spring("elbow", stiffness=5.0, rest=0.0))
    problem = sdpid.build_problem(robot, samples, friction=terms, weighting="residual")
    estimate = sdpid.solve_sdp(problem)
    found = estimate.named_theta()
    assert found is not None
    assert found["K2"] == pytest.approx(5.0, abs=1e-6)
    np.testing.assert_allclose(problem.predict(estimate.base), effort, atol=1e-5)
    free = sdpid.build_problem(robot, samples, friction=(Spring("shoulder", rest=0.2),))
    named = sdpid.solve_wls(
        sdpid.build_problem(
            robot, samples, friction=(Spring("shoulder", rest=0.2), Spring("elbow", rest=0.0))
        )
    ).named()
    assert free.base.count < problem.base.count + 1
    assert named["K1"] == pytest.approx(30.0, rel=1e-6)
    assert named["K2"] == pytest.approx(5.0, rel=1e-6)


def test_load_friction_behind_a_transmission_is_that_of_the_motors():
    robot = behind(3)
    bodies = tuple(tuple(body) for body in robot.prior)
    q, v, a = random_states(np.random.default_rng(1), robot.n, 5)
    found = columns(LoadFriction(bodies=bodies, width=0.1), robot)
    load = np.abs(robot.efforts_of_bodies(robot.prior, q, v, a)) * np.tanh(v / 0.1)
    np.testing.assert_allclose(np.einsum("knn->kn", found), load, atol=1e-9)


@pytest.mark.parametrize("gears", [(30.0, -30.0, 30.0, 30.0), (100.0, 1.0, -160.0, 3000.0)])
def test_gears_leave_the_base_parameters_as_they_are(gears: tuple[float, ...]):
    text = described_arm(random_links(np.random.default_rng(3), 4)).urdf
    plain, motors = sdpid.load_robot(text), tuple(f"motor_{k}" for k in range(4))
    geared = sdpid.load_robot(
        text, transmission=sdpid.Transmission(np.diag(1.0 / np.array(gears)), names=motors)
    )
    bases = []
    for robot in (plain, geared):
        model = FrictionModel.from_terms(("viscous", "offset"), robot.joint_names)
        bases.append(structural_base(robot, model))
    # Friction is listed where its motor's joint is, if that has its name.
    each = [dict(zip(base.names, base.matrix, strict=True)) for base in bases]
    assert each[0].keys() == each[1].keys()
    for name in each[0]:
        links = [base[name][: plain.prior.size] for base in each]
        np.testing.assert_allclose(links[1], links[0], atol=1e-9)


def test_limits_of_joints_are_those_of_their_motors_by_the_gears():
    plain, ratios, shift = sdpid.load_robot("denso_vp6242"), np.array([50.0, -80.0]), [0.1, -0.2]
    gears = sdpid.Transmission(np.diag(1.0 / ratios), shift, ("m1", "m2"), NAMES[:2])
    robot = sdpid.load_robot("denso_vp6242", transmission=gears)
    ends = ratios[:, None] * (plain.position_limits[:2] - np.array(shift)[:, None])
    np.testing.assert_allclose(robot.position_limits[:2], np.sort(ends, axis=1))
    np.testing.assert_allclose(robot.velocity_limits[:2], abs(ratios) * plain.velocity_limits[:2])
    np.testing.assert_allclose(robot.effort_limits[:2], plain.effort_limits[:2] / abs(ratios))
    np.testing.assert_array_equal(robot.position_limits[2:], plain.position_limits[2:])
    # A wrist of two motors has no limits that are those of one.
    wrist = sdpid.Transmission(WRIST, joints=NAMES[4:])
    mixed = sdpid.load_robot("denso_vp6242", transmission=wrist)
    assert np.isinf(mixed.position_limits[4:]).all()


def test_what_is_assumed_of_joints_without_limits_is_so_behind_gears():
    arm = described_arm(random_links(np.random.default_rng(5), 3))
    assert arm.urdf is not None
    gears = np.array([1.0, 50.0, -80.0])
    geared = sdpid.load_robot(
        arm.urdf, transmission=sdpid.Transmission(np.diag(1.0 / gears), names=("a", "b", "c"))
    )
    plain, found = sdpid.Limits().of(arm), sdpid.Limits().of(geared)
    for name in ("upper", "velocity", "acceleration", "jerk"):
        np.testing.assert_allclose(getattr(found, name), abs(gears) * getattr(plain, name))
    assert any("b, c have no position limits" in each for each in found.assumed)
    assert any("times the gear before a joint" in each for each in found.assumed)


class Ripple(sdpid.friction.PositionwiseTerm):
    symbol, unit, nonnegative = "Fp", "N.m", False

    def shape(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        return np.cos(5.0 * position) * np.tanh(velocity / 0.1)


def test_a_term_of_ones_own_depends_on_the_whole_motion():
    arm, rng = described_arm(random_links(np.random.default_rng(5), 3)), np.random.default_rng(1)
    q, v, a = random_states(rng, 3, 400)
    true = np.array([0.3, -0.2, 0.1])
    ripple = Ripple().shape(q, v, a) * true
    samples = sdpid.Samples(
        position=q,
        velocity=v,
        acceleration=a,
        effort=arm.inverse_dynamics(arm.prior, q, v, a) + ripple,
    )
    problem = sdpid.build_problem(arm, samples, friction=("viscous", Ripple()))
    found = sdpid.solve_sdp(problem)
    values = found.named()
    np.testing.assert_allclose([values[f"Fp{j}"] for j in (1, 2, 3)], true, atol=1e-4)
    effort = found.model().inverse_dynamics(q, v, a)
    np.testing.assert_allclose(effort, samples.effort, atol=1e-3)
    with pytest.raises(ModelError, match="simulat"):
        list(Ripple().simulated(true, arm.joint_names))

    class Short(Ripple):
        def shape(self, position: Array, velocity: Array, acceleration: Array) -> Array:
            return position[:, :1]

    with pytest.raises(ModelError, match=r"its shape is .* for .* .samples, joints."):
        sdpid.build_problem(arm, samples, friction=(Short(),))
