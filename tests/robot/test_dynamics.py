"""Dynamics of identified and of random robots, against Pinocchio's own algorithms."""

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid import load_robot
from sdpid._common.arrays import Array
from sdpid.errors import DataError, ModelError
from sdpid.friction import (
    Coulomb,
    Coupling,
    LoadFriction,
    Offset,
    RotorInertia,
    SigmoidFriction,
    Tilt,
    Viscous,
)
from sdpid.robot.friction.posed import horizontal_axes
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.model.closure import close_loops
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.jacobians import contact_jacobians, frame_axes, relative_jacobians
from sdpid.robot.model.model import RobotModel
from tests.helpers.closed_chains import mjcf
from tests.helpers.data import friction_model, full_regressor, random_bodies, random_theta
from tests.helpers.linkages import urdf
from tests.helpers.random_trees import random_tree
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, TREE_MIMIC, TREE_MIMIC_NO_OFFSET, pendulum, small_arm
from tests.helpers.small_robots import MODELS, SMALL
from tests.helpers.strategies import SEEDS, random_states
from tests.helpers.tolerances import assert_same

TERMS: tuple[FrictionTerm, ...] = (
    Coulomb(width=0.1),
    Viscous(),
    Offset(),
    SigmoidFriction(velocity=0.3),
    RotorInertia(),
)
ROBOTS = {
    "pendulum": pendulum(),
    "arm": small_arm(4),
    "tree": sdpid.load_robot(TREE),
    "mimic": sdpid.load_robot(TREE_MIMIC),
    **MODELS,
}


def dynamics(
    robot: sdpid.RobotModel, seed: int, terms: tuple[FrictionTerm, ...] = TERMS
) -> RobotDynamics:
    theta = random_theta(robot, np.random.default_rng(seed), terms)
    return RobotDynamics(robot=robot, terms=friction_model(robot, terms), theta=theta)


@given(SEEDS, st.sampled_from(sorted(ROBOTS)))
def test_the_laws_of_the_equations_of_motion(seed: int, name: str) -> None:
    robot = ROBOTS[name]
    n = robot.n
    terms = (*TERMS, Coupling(robot.joint_names[0], robot.joint_names[1])) if n > 1 else TERMS
    model = dynamics(robot, seed, terms)
    states = q, v, a = random_states(np.random.default_rng(seed), n, 3)
    effort = model.inverse_dynamics(q, v, a)
    assert_same(effort, full_regressor(robot, states, terms) @ model.theta)
    M, C = model.mass_matrix(q), model.coriolis(q, v)
    parts = np.einsum("kij,kj->ki", M, a) + np.einsum("kij,kj->ki", C, v)
    assert_same(parts + model.gravity(q) + model.friction(v), effort)
    # Energy: the power of inertial forces is that of 2·C, whatever the velocity.
    step = 1e-6
    moved = (model.mass_matrix(q + step * v) - model.mass_matrix(q - step * v)) / (2.0 * step)
    skew = moved - 2.0 * C
    np.testing.assert_allclose(skew + skew.swapaxes(1, 2), 0.0, atol=1e-6 * np.abs(M).max())
    # Pinocchio knows no couplings, and joints that mimic others are joints of their own there.
    if name != "mimic":
        plain = dynamics(robot, seed)
        full = plain.to_pinocchio()
        state = (full, full.createData(), robot.configuration(q)[0], v[0], a[0])
        assert_same(plain.inverse_dynamics(q, v, a)[0], pin.rnea(*state) + plain.friction(v)[0])


def test_rotor_inertia_is_pinocchios_armature_and_descriptions_have_no_say() -> None:
    robot = ROBOTS["mimic"]
    described = robot.pin_model.copy()
    described.armature = np.full(described.nv, 7.0)
    described.damping = np.full(described.nv, 7.0)
    other = sdpid.RobotModel.from_pinocchio(described)
    model = dynamics(other, 6, (RotorInertia(), Viscous()))
    n = other.n
    full = model.to_pinocchio()
    np.testing.assert_allclose(full.armature, model.theta[10 * other.n_links :][:n])
    np.testing.assert_array_equal(full.damping, 0.0)
    followers = dynamics(robot, 6, (RotorInertia(),)).to_pinocchio()
    assert np.count_nonzero(followers.armature) == robot.n == followers.nv - 1


def test_what_does_not_fit_is_refused() -> None:
    model = dynamics(ROBOTS["arm"], 0)
    q = np.zeros((3, 4))
    refuses(DataError, "velocity: 3 columns, the robot has 4 joints", model.friction, np.zeros(3))
    refuses(DataError, "velocity: 2 states, the positions have 3", model.coriolis, q, q[:2])
    refuses(DataError, "tau: 1 states, the positions have 3", model.forward_dynamics, q, q, q[0])
    refuses(DataError, "not a rectangular array", model.gravity, [[0.0], [0.0, 1.0]])
    axis = np.eye(10)[0]  # a point mass at the joint, which turns without effort
    bare = RobotDynamics(robot=ROBOTS["pendulum"], terms=friction_model(pendulum(), ()), theta=axis)
    refuses(ModelError, "mass matrix is singular", bare.forward_dynamics, [0.0], [0.0], [1.0])
    floating = dynamics(sdpid.load_robot(TREE, root="free_flyer"), 3)
    q = pin.neutral(floating.robot.pin_model)
    q[3:7] *= 1.01
    refuses(DataError, "state 0 has a quaternion", floating.mass_matrix, q)


GRAVITIES = ((0.0, 0.0, -9.81), (0.0, 0.0, 9.81), (9.81, 0.0, 0.0), (3.0, -5.0, 2.0))


@given(SEEDS, st.sampled_from(GRAVITIES))
def test_tilt_and_friction_of_the_load_are_in_it(seed: int, g: tuple[float, float, float]) -> None:
    robot = sdpid.RobotModel.from_pinocchio(ROBOTS["arm"].pin_model, gravity=g)
    bodies = random_bodies(robot, seed)
    theta = np.concatenate([np.ravel(bodies), [0.03, -0.02], np.full(4, 0.1)])
    terms = friction_model(robot, (Tilt(bodies), LoadFriction(bodies)))
    model = RobotDynamics(robot=robot, terms=terms, theta=theta)
    q, v, a = random_states(np.random.default_rng(seed), robot.n, 3)
    links = robot.inverse_dynamics(theta, q, v, a)
    rest = np.zeros_like(v)
    upright = robot.inverse_dynamics(theta, q, rest, rest)
    tilt = model.gravity(q) - upright
    turn = np.array([0.03, -0.02]) @ horizontal_axes(robot.gravity)
    gravity = robot.gravity + np.cross(turn, robot.gravity)
    tilted = sdpid.RobotModel.from_pinocchio(robot.pin_model, gravity=gravity.tolist())
    assert_same(tilt, tilted.inverse_dynamics(theta, q, v, a) - links)
    np.testing.assert_allclose(model.to_pinocchio().gravity.linear, gravity, atol=1e-12)
    expected = links + tilt + 0.1 * np.abs(links) * np.sign(v)
    effort = model.inverse_dynamics(q, v, a)
    assert_same(effort, expected)
    assert_same(model.inverse_dynamics(q[0], v[0], a[0]), expected[0])
    # Friction follows the acceleration that it slows down.
    again = model.inverse_dynamics(q, v, model.forward_dynamics(q, v, effort))
    assert_same(again, effort)


def loaded(share: float) -> RobotDynamics:
    """Return an arm whose gears lose a share of their load."""
    robot = ROBOTS["arm"]
    bodies = random_bodies(robot, 8)
    theta = np.concatenate([np.ravel(bodies), np.full(4, share)])
    terms = friction_model(robot, (LoadFriction(bodies),))
    return RobotDynamics(robot=robot, terms=terms, theta=theta)


@pytest.mark.parametrize("share", [0.1, 0.7])
def test_a_state_with_friction_of_the_load_does_not_hang_on_the_others(share: float) -> None:
    model = loaded(share)
    q, v, a = random_states(np.random.default_rng(9), 4, 6)
    sizes = np.logspace(-6.0, 3.0, 6)[:, None]
    v, tau = v * np.sqrt(sizes), model.inverse_dynamics(q, v, a) * sizes
    found = model.forward_dynamics(q, v, tau)
    assert_same(model.inverse_dynamics(q, v, found), tau)
    for k in range(6):
        alone = model.forward_dynamics(q[k], v[k], tau[k])
        np.testing.assert_allclose(alone, found[k], rtol=1e-9, atol=1e-9)


def test_gears_that_lose_all_of_their_load_are_told() -> None:
    q, v, a = random_states(np.random.default_rng(10), 4, 3)
    words = r"no acceleration found for [123] of 3 states"
    for share in (1.5, 1e9):
        refuses(ModelError, words, loaded(share).forward_dynamics, q, v, 10.0 * a)


def test_the_curve_of_a_joint_is_its_friction() -> None:
    robot = ROBOTS["tree"]
    terms = (*TERMS, Coupling("slide", "right"))
    model = dynamics(robot, 11, terms)
    for j, name in enumerate(robot.joint_names):
        curve = model.friction_curve(name)
        states = np.zeros((len(curve.velocity), robot.n))
        states[:, j] = curve.velocity
        np.testing.assert_array_equal(curve.effort, model.friction(states)[:, j])
        assert curve.unit == ("N" if name in ("lift", "slide") else "N·m")
        # To the limit of the description; a continuous joint has none.
        top = 1.0 if name == "left" else robot.velocity_limits[j]
        assert curve.velocity[0] == -top == -curve.velocity[-1]
        assert name in repr(curve)
        assert name in curve._repr_html_()
    np.testing.assert_array_equal(model.friction_curve(0, [0.5]).velocity, [0.5])
    pytest.importorskip("matplotlib")
    axes = model.friction_curve("lift").plot()
    assert axes.get_xlabel() == "velocity [m/s]"
    assert model.friction_curve("right").plot(axes=axes) is axes
    floating = dynamics(sdpid.load_robot(TREE, root="free_flyer"), 3)
    assert floating.friction_curve(0).joint == "lift"
    for wrong in ("thumbs", 6, -1, None, True, 1.0):
        refuses(DataError, "is none of the 6 joints", model.friction_curve, wrong)
    words = "velocity: 1 of 2 values are not finite"
    refuses(DataError, words, model.friction_curve, 0, [0.0, np.nan])


def test_a_notebook_shows_links_and_friction() -> None:
    model = ROBOTS["arm"].pin_model.copy()
    model.name = "<b>arm</b>" + 500 * "x"
    robot = dynamics(sdpid.RobotModel.from_pinocchio(model), 12)
    text = robot._repr_html_()
    assert "&lt;b&gt;arm" in text
    assert "<b>arm" not in text
    assert "Fv3" in text
    assert len(repr(robot)) < 200


# The robot in use against MuJoCo, which reads the random URDF itself, and knows bodies and gravity
# here. Friction and the gears of joints that follow others are added from their formulas.


# Two implementations of the same recursions over at most seven links, relative to the largest entry
# of a matrix or effort.
SAME = 1e-9

# Accelerations, times the condition of the mass matrix by which rounding may grow.
SOLVED = 1e-12

SHAPES = ("chain", "tree", "follower", "floating")


def case(seed: int, shape: str) -> tuple[str, RobotDynamics, Array, Array, Array]:
    """Return a random URDF, its robot with friction and rotors, and two random states."""
    rng = np.random.default_rng(seed)
    urdf, _ = random_tree(
        rng, int(rng.integers(1, 7)), chain=shape == "chain", follower=shape == "follower"
    )
    robot = sdpid.load_robot(urdf, root="free_flyer" if shape == "floating" else None)
    terms = (Coulomb(), Viscous(), Offset(), RotorInertia())
    values = rng.uniform(0.1, 2.0, 4 * (robot.n - robot.n_base))
    theta = np.concatenate([robot.prior.ravel(), values])
    model = RobotDynamics(robot=robot, terms=friction_model(robot, terms), theta=theta)
    q, v, a = random_states(rng, robot.n, 2)
    if shape == "floating":
        full = robot.pin_model
        q = np.stack([pin.integrate(full, pin.neutral(full), x) for x in q])
    return urdf, model, q, v, a


@given(SEEDS, st.sampled_from(SHAPES))
def test_it_is_mujoco_with_all_that_the_links_do_not_have(seed: int, shape: str) -> None:
    mujoco = pytest.importorskip("mujoco", reason="the extra sim is not installed")
    urdf, model, positions, velocities, accelerations = case(seed, shape)
    robot, own = model.robot, mujoco_of(mujoco, urdf, shape == "floating")
    data = mujoco.MjData(own)
    tail = np.zeros((4, robot.n))
    tail[:, robot.n_base :] = model.theta[10 * robot.n_links :].reshape(4, -1)
    coulomb, viscous, offset, rotors = tail
    states = (robot.configuration(positions), positions, velocities, accelerations)
    for configuration, q, v, a in zip(*states, strict=True):
        T = placed(mujoco, own, data, robot, configuration)
        J = T @ robot.expansion
        mujoco.mj_forward(own, data)
        links = np.zeros((own.nv, own.nv))
        for column, unit in zip(links, np.eye(own.nv), strict=True):
            mujoco.mj_mulM(own, data, column, unit)
        data.qvel[:] = data.qacc[:] = 0.0
        mujoco.mj_inverse(own, data)
        rest = np.array(data.qfrc_inverse)
        # MuJoCo has the base's linear velocity along the axes of the world: it turns there.
        turning = np.zeros(own.nv)
        if shape == "floating":
            turning[:3] = T[:3, :3] @ np.cross(v[3:6], v[:3])
        data.qvel[:], data.qacc[:] = J @ v, turning
        mujoco.mj_inverse(own, data)
        M, still, moving = J.T @ links @ J + np.diag(rotors), J.T @ rest, J.T @ data.qfrc_inverse
        friction = coulomb * np.sign(v) + viscous * v + offset
        effort = M @ a + moving + friction
        assert_same(model.mass_matrix(q), M, SAME)
        assert_same(model.gravity(q), still, SAME)
        assert_same(model.coriolis(q, v) @ v, moving - still, SAME)
        assert_same(model.friction(v), friction, SAME)
        assert_same(model.inverse_dynamics(q, v, a), effort, SAME)
        limit = (SAME + SOLVED * float(np.linalg.cond(M))) * max(1.0, float(np.abs(a).max()))
        found = model.forward_dynamics(q, v, effort)
        np.testing.assert_allclose(found, a, rtol=0, atol=limit)


def mujoco_of(mujoco: Any, urdf: str, floating: bool) -> Any:
    """Return what MuJoCo's own reader makes of a URDF, with nothing but bodies and gravity."""
    spec = mujoco.MjSpec.from_string(urdf)
    spec.compiler.fusestatic = False
    spec.compiler.balanceinertia = False
    for flag in ("CONTACT", "LIMIT", "EQUALITY", "FRICTIONLOSS", "DAMPER"):
        bit = getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}", None)
        spec.option.disableflags |= 0 if bit is None else bit.value
    if floating:
        spec.body("l0").add_freejoint()
    return spec.compile()


def placed(mujoco: Any, own: Any, data: Any, robot: RobotModel, configuration: Array) -> Array:
    """Put MuJoCo's robot where Pinocchio's is; return its rates (nv, nv) from Pinocchio's."""
    model = robot.pin_model
    T = np.zeros((own.nv, model.nv))
    for i in range(1, model.njoints):
        joint, x = model.joints[i], configuration[model.joints[i].idx_q :]
        if joint.nv == 6:
            data.qpos[:3], data.qpos[3:7] = x[:3], x[[6, 3, 4, 5]]
            R = pin.Quaternion(x[3:7]).toRotationMatrix()
            T[:3, :3], T[3:6, 3:6] = R, np.eye(3)
            continue
        own_joint = own.joint(model.names[i])
        data.qpos[own_joint.qposadr[0]] = np.arctan2(x[1], x[0]) if joint.nq == 2 else x[0]
        T[own_joint.dofadr[0], joint.idx_v] = 1.0
    return T


@given(SEEDS, st.sampled_from(SHAPES))
def test_many_states_are_each_of_them(seed: int, shape: str) -> None:
    _, model, q, v, a = case(seed, shape)
    tau = model.inverse_dynamics(q, v, a)
    for method, states in (
        (model.mass_matrix, (q,)),
        (model.coriolis, (q, v)),
        (model.gravity, (q,)),
        (model.friction, (v,)),
        (model.inverse_dynamics, (q, v, a)),
        (model.forward_dynamics, (q, v, tau)),
    ):
        many = method(*states)
        assert method(*(x[:0] for x in states)).shape == (0, *many.shape[1:])
        for k in range(len(q)):
            assert_same(method(*(x[k] for x in states)), many[k], SAME)


# Positions that close loops, and Jacobians of contacts.


@pytest.mark.parametrize("kind", ["spherical", "revolute"])
def test_positions_are_those_of_the_cosine_rule(kind: str) -> None:
    robot = load_robot(urdf("four_bar", kind=kind))
    crank = np.linspace(1.0, 8.0, 300) + np.sin(np.linspace(0.0, 9.0, 300))
    position = np.zeros((300, 3))
    position[:, 0] = crank
    found = close_loops(robot, position, robot.passive)
    way = 0.1 * np.column_stack([np.cos(crank), np.sin(crank)]) - [0.28, 0.0]
    size = np.linalg.norm(way, axis=1)
    rocker = np.arctan2(way[:, 1], way[:, 0]) - np.arccos(
        (size**2 + 0.25**2 - 0.3**2) / (2.0 * size * 0.25)
    )
    np.testing.assert_allclose(np.cos(found[:, 2] - rocker), 1.0, atol=1e-12)
    np.testing.assert_array_equal(found[:, 0], crank)
    # Followed, and not jumped to: the rocker swings, the crank turns.
    assert np.ptp(found[:, 2]) < 1.0


def test_refuses_what_loops_do_not_tell() -> None:
    text = urdf("four_bar")
    robot = load_robot(text)
    far = load_robot(text.replace('link="rocker" xyz="0.25 0 0"', 'link="rocker" xyz="2 0 0"'))
    # Two arms do not reach each other everywhere.
    five = load_robot(urdf("five_bar").replace("0.22 0 0", "0.15 0 0"))
    apart, zero = np.zeros((50, 4)), np.zeros((5, 3))
    apart[:, 0], apart[:, 2] = np.linspace(2.0, 3.6, 50), np.linspace(1.14, -0.5, 50)
    for words, one, position, found in (
        ("do not determine the positions of crank_joint", robot, zero, robot.joint_names),
        ("cannot be closed: the least gap is", far, zero, far.passive),
        (r"cannot be closed by left_rod_joint, .* at sample", five, apart, five.passive),
    ):
        refuses(DataError, words, close_loops, one, position, found)


# Jacobians of contact points against Pinocchio's, and against differences of places.


FEET = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
CASES = {
    "solo12": ("solo12", FEET),
    "tree": (TREE, ("thumb", "bracket", "left_slide")),
    "mimic": (TREE_MIMIC_NO_OFFSET, ("thumb", "finger")),
    "hinge": (SMALL["hinge"].urdf, ("turn_link",)),
    "slider": (SMALL["slider"].urdf, ("lift_link",)),
    "wheel": (SMALL["wheel"].urdf, ("roll_link",)),
}


@pytest.mark.parametrize("root", [None, "free_flyer"])
@pytest.mark.parametrize("name", CASES)
def test_equals_pinocchio(name: str, root: Any) -> None:
    source, frames = CASES[name]
    robot = load_robot(source, root=root)
    rng = np.random.default_rng(1)
    offset = rng.normal(scale=0.1, size=(len(frames), 3))
    q = rng.uniform(-1.0, 1.0, (4, robot.n if root is None else robot.pin_model.nq))
    if root is not None:
        q = np.array([pin.randomConfiguration(robot.pin_model, *_box(robot)) for _ in range(4)])
    expected = contact_jacobians(robot, q, frames, offset, compiled=False)
    assert expected.shape == (4, len(frames), 6, robot.n)
    compiled = contact_jacobians(robot, q, frames, offset, compiled=True)
    np.testing.assert_allclose(compiled, expected, atol=1e-13)
    data = robot.pin_model.createData()
    axes, numbers = frame_axes(robot, q, frames), [robot.frame_numbers[name] for name in frames]
    for k, configuration in enumerate(robot.configuration(q)):
        pin.framesForwardKinematics(robot.pin_model, data, configuration)
        for i, number in enumerate(numbers):
            np.testing.assert_allclose(axes[k, i], data.oMf[number].rotation, atol=1e-13)


def _box(robot: Any) -> tuple[Any, Any]:
    size = robot.pin_model.nq
    return -np.ones(size), np.ones(size)


def test_points_move_as_the_jacobian_says() -> None:
    robot = load_robot("solo12", root="free_flyer")
    model = robot.pin_model
    q = pin.randomConfiguration(model, *_box(robot))
    offset = np.array([0.03, -0.02, -0.018])
    J = contact_jacobians(robot, q[None], FEET[1:2], offset)[0, 0, :3]
    data, step = model.createData(), 1e-6
    number = model.getFrameId(FEET[1])

    def placement(at: Any) -> Any:
        pin.framesForwardKinematics(model, data, at)
        return pin.SE3(data.oMf[number])

    # The point is fixed to the foot: its place in the foot's axes does not change.
    own = placement(q).rotation.T @ offset
    for j in range(robot.n):
        ends = [
            placement(pin.integrate(model, q, sign * step * np.eye(robot.n)[j])) for sign in (-1, 1)
        ]
        slope = (ends[1].act(own) - ends[0].act(own)) / (2.0 * step)
        np.testing.assert_allclose(J[:, j], slope, atol=1e-8)
    words = r"'FL_FOTO' is no frame .* FL_FOOT"
    refuses(DataError, words, contact_jacobians, robot, q[None], ["FL_FOTO"])
    words = r"offset: has shape \(2, 3\), expected \(3,\) or \(1, 3\)"
    refuses(DataError, words, contact_jacobians, robot, q[None], FEET[:1], np.zeros((2, 3)))


def test_links_that_meet_move_against_each_other_alone() -> None:
    """What carries both moves neither against the other, though a filter left them apart."""
    robot = load_robot(mjcf("ankle", floating=True))
    q = np.zeros((3, robot.pin_model.nq))
    q[:, 6] = 1.0
    q[:, 7:] = 1e-3 * np.arange(24).reshape(3, 8)
    ends = [loop.frame for loop in robot.loops], [loop.against for loop in robot.loops]
    J = relative_jacobians(robot, q, *ends)
    apart = contact_jacobians(robot, q, ends[0]) - contact_jacobians(robot, q, ends[1])
    assert np.abs(apart[..., :6]).max() > 1e-4
    assert not J[..., :6].any()
    # Each rod, its crank and the foot.
    names = np.array(robot.joint_names)
    for i, side in enumerate(("left", "right")):
        moving = {"pitch", "roll", side, f"{side}_a", f"{side}_b"}
        assert set(names[np.any(J[:, i] != 0.0, axis=(0, 1))]) == moving
        np.testing.assert_array_equal(J[:, i][..., 6:], apart[:, i][..., 6:])
