"""Terms that depend on the position: gravity's direction, and friction of the load."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import ModelError
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.motion import Motion
from sdpid.robot.friction.posed import LoadFriction, PosedTerm, Tilt, horizontal_axes
from sdpid.robot.model.base_parameters import structural_base
from tests.helpers.data import random_links
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, TREE_MIMIC, small_arm
from tests.helpers.small_robots import MODELS
from tests.helpers.strategies import random_states

ARM = small_arm(4)
GRAVITIES = ((0.0, 0.0, -9.81), (0.0, 0.0, 9.81), (9.81, 0.0, 0.0), (3.0, -5.0, 2.0))


def bodies_of(robot: sdpid.RobotModel, seed: int) -> tuple[tuple[float, ...], ...]:
    links = random_links(np.random.default_rng(seed), robot.n_links)
    return tuple(tuple(float(x) for x in body) for body in links)


def motion_of(robot: sdpid.RobotModel, seed: int, count: int = 20) -> Motion:
    q, v, a = random_states(np.random.default_rng(seed), robot.n, count)
    return Motion(position=q, velocity=v, acceleration=a, robot=robot)


def efforts(robot: sdpid.RobotModel, motion: Motion, bodies: object) -> Array:
    return robot.inverse_dynamics(
        np.ravel(np.asarray(bodies)), motion.position, motion.velocity, motion.acceleration
    )


@given(st.integers(0, 99), st.sampled_from(GRAVITIES))
def test_a_tilt_is_how_efforts_change_with_gravity(
    seed: int, gravity: tuple[float, float, float]
) -> None:
    robot = sdpid.RobotModel.from_pinocchio(ARM.pin_model, gravity=gravity)
    motion, bodies = motion_of(robot, seed), bodies_of(robot, seed)
    columns = Tilt(bodies).columns_in(motion, robot.joint_names)
    upright = efforts(robot, motion, bodies)
    for k, axis in enumerate(horizontal_axes(robot.gravity)):
        turned = robot.gravity + np.cross(axis, robot.gravity)
        other = sdpid.RobotModel.from_pinocchio(ARM.pin_model, gravity=turned.tolist())
        np.testing.assert_allclose(
            columns[:, :, k], efforts(other, motion, bodies) - upright, atol=1e-10
        )


@given(st.tuples(*(st.floats(-1.0, 1.0) for _ in range(3))))
def test_horizontal_axes_are_across_gravity(gravity: tuple[float, float, float]) -> None:
    g = np.array(gravity)
    if np.linalg.norm(g) < 1e-3:
        return
    axes = horizontal_axes(g)
    np.testing.assert_allclose(axes @ axes.T, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(axes @ g, 0.0, atol=1e-12)


def test_the_axes_of_an_upright_base_are_its_own() -> None:
    np.testing.assert_array_equal(horizontal_axes(np.array([0.0, 0.0, -9.81])), np.eye(3)[:2])
    refuses(ModelError, "no gravity", horizontal_axes, np.zeros(3))


@pytest.mark.parametrize("robot", [ARM, sdpid.load_robot(TREE_MIMIC), *MODELS.values()])
def test_friction_of_the_load_is_a_share_of_the_efforts(robot: sdpid.RobotModel) -> None:
    motion, bodies = motion_of(robot, 1), bodies_of(robot, 1)
    columns = LoadFriction(bodies).columns_in(motion, robot.joint_names)
    share = np.linspace(0.05, 0.2, robot.n)
    expected = share * np.abs(efforts(robot, motion, bodies)) * np.sign(motion.velocity)
    np.testing.assert_allclose(columns @ share, expected, atol=1e-10)


def test_friction_of_the_load_may_share_its_sign_with_a_sigmoid() -> None:
    motion, bodies = motion_of(ARM, 5), bodies_of(ARM, 5)
    share, speeds = (0.0, 0.3, 1.0, 0.5), (0.1, 0.2, 0.5, 1.0)
    term = LoadFriction(bodies, share=share, velocity=speeds)
    found = term.columns_in(motion, ARM.joint_names).sum(axis=1)
    v, c = motion.velocity, np.array(share)
    sign = (1.0 - c) * np.sign(v) + c * np.tanh(v / np.array(speeds))
    np.testing.assert_allclose(found, np.abs(efforts(ARM, motion, bodies)) * sign, atol=1e-10)
    refuses(ModelError, "one a joint of each", LoadFriction, share=(0.5,))


def test_bodies_of_the_description_are_the_default() -> None:
    robot = sdpid.load_robot(TREE)
    motion = motion_of(robot, 2)
    described = tuple(tuple(float(x) for x in body) for body in robot.prior)
    for term in (Tilt, LoadFriction):
        np.testing.assert_array_equal(
            term().columns_in(motion, robot.joint_names),
            term(described).columns_in(motion, robot.joint_names),
        )


@pytest.mark.parametrize("term", [Tilt(), LoadFriction()])
def test_what_cannot_be_evaluated_is_refused(term: PosedTerm) -> None:
    motion = motion_of(ARM, 3)
    with pytest.raises(ModelError, match="depends on the position"):
        term.columns(motion.velocity, motion.acceleration, ARM.joint_names)
    with pytest.raises(ModelError, match="needs"):
        type(term)(((1.0,) * 10,)).columns_in(motion, ARM.joint_names)
    floating = sdpid.load_robot(TREE, root="free_flyer")
    state = Motion(
        position=np.zeros((1, floating.pin_model.nq)),
        velocity=np.zeros((1, floating.n - 6)),
        acceleration=np.zeros((1, floating.n - 6)),
        robot=floating,
    )
    refuses(ModelError, "floats", term.columns_in, state, floating.joint_names[6:])


def test_base_parameters_hold_them() -> None:
    bodies = bodies_of(ARM, 4)
    friction = FrictionModel.from_terms(
        ("coulomb", "viscous", Tilt(bodies), LoadFriction(bodies)), ARM.joint_names
    )
    base = structural_base(ARM, friction)
    assert {"Gx", "Gy", "Fl1", "Fl4"} <= set(base.names)
    units = dict(zip(base.names, base.units, strict=True))
    assert units["Gx"] == "rad"
    assert units["Fl1"] == "1"
    # At an instant without a position they have no columns.
    plain = friction.columns(np.ones((1, 4)), np.zeros((1, 4)))
    assert not plain[:, :, 8:].any()
