"""The simulated arm moves as Pinocchio and SciPy say, sticks, and never raises."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import sdpid
from sdpid import friction as terms
from sdpid._common.arrays import Array
from sdpid.errors import ModelError
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.experiment.simulation.kernels import loops
from sdpid.experiment.simulation.kernels.layout import memory_for
from sdpid.robot.model.dynamics import RobotDynamics
from tests.experiment.simulation.models import model_of, slider
from tests.helpers.data import random_links
from tests.helpers.random_trees import random_tree
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, TREE_MIMIC, planar_arm, small_arm


def rubbing(seed: int) -> RobotDynamics:
    """Return an arm of three joints with every kind of friction."""
    rng, robot = np.random.default_rng(seed), small_arm(3)
    bodies = random_links(rng, 3)
    other = tuple(map(tuple, random_links(rng, 3).tolist()))
    first, second, _ = robot.joint_names
    kinds = (
        "viscous",
        "offset",
        "rotor_inertia",
        "asymmetric_coulomb",
        "square_root",
        terms.Coulomb(width=0.2, dead_zone=0.05),
        terms.Stribeck(velocity=0.3, exponent=1.0),
        terms.SigmoidFriction(velocity=0.4),
        terms.Coupling(first, second),
        terms.Tilt(other),
        terms.LoadFriction(other, share=(0.3, 0.0, 1.0), velocity=(0.2, 1.0, 0.5)),
    )
    counts = [len(model_of(robot, (kind,), ()).terms.parameters) for kind in kinds]
    scale = [0.02 if isinstance(k, (terms.Tilt, terms.LoadFriction)) else 0.5 for k in kinds]
    values = rng.uniform(0.2, 1.0, sum(counts)) * np.repeat(scale, counts)
    return model_of(robot, kinds, values, bodies)


@dataclass(frozen=True)
class Own(terms.JointwiseTerm):
    """A term of somebody's own, any function of the velocity."""

    function: Callable[[Array], Array]
    symbol: ClassVar[str] = "Fd"
    unit: ClassVar[str] = "N.m"
    nonnegative: ClassVar[bool] = True

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        """Return the function's values."""
        return np.asarray(self.function(velocity))


@pytest.mark.parametrize("function", [lambda v: v * np.abs(v), lambda v: np.sign(v) + v, np.cos])
def test_terms_of_ones_own_are_simulated(function: Callable[[Array], Array]) -> None:
    links = random_links(np.random.default_rng(4), 3)
    model = model_of(small_arm(3), ("viscous", Own(function)), np.linspace(0.2, 1.0, 6), links)
    q, v, effort = np.random.default_rng(4).normal(size=(3, 20, 3))
    expected = model.forward_dynamics(q, v, effort)
    found = SimulatedArm.of(model).acceleration(q, v, effort)
    np.testing.assert_allclose(found, expected, atol=5e-3 * np.abs(expected).max())


@settings(max_examples=8)
@given(seed=st.integers(0, 10**6))
def test_masses_and_biases_are_those_of_pinocchio(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for text in (random_tree(rng, 6)[0], TREE, TREE_MIMIC):
        robot = sdpid.load_robot(text)
        model = model_of(robot, ("rotor_inertia", "offset"), rng.uniform(0.0, 1.0, 2 * robot.n))
        q, v = rng.normal(size=(2, 3, robot.n))
        M, h = SimulatedArm.of(model).mass_and_bias(q, v)
        expected = model.inverse_dynamics(q, v, np.zeros_like(q))
        np.testing.assert_allclose(M, model.mass_matrix(q), rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(h, expected, rtol=1e-12, atol=1e-11)


def test_accelerations_are_those_of_the_model_with_every_friction() -> None:
    rng = np.random.default_rng(1)
    for seed in range(3):
        model = rubbing(seed)
        q, v, effort = rng.normal(size=(3, 20, 3))
        expected = model.forward_dynamics(q, v, effort)
        found = SimulatedArm.of(model).acceleration(q, v, effort)
        np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-7 * np.abs(expected).max())


def test_the_loops_do_the_same_without_a_compiler() -> None:
    arm = SimulatedArm.of(rubbing(5))
    rng = np.random.default_rng(0)
    q, v, effort = rng.normal(size=(3, 2, 3))
    M, h = np.empty((2, 3, 3)), np.empty((2, 3))
    memory = memory_for(arm.arrays)
    loops.many_dynamics(arm.arrays, memory, q, v, M, h)
    for found, expected in zip((M, h), arm.mass_and_bias(q, v), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
    efforts = np.repeat(effort[:, None], 20, axis=1)
    out, count = np.zeros((2, 2, 21, 3)), np.zeros(2, dtype=np.int64)
    free, record = np.zeros((2, 3), dtype=np.bool_), np.zeros((2, 0, 0, 3))
    loops.open_loop(arm.arrays, memory, q, v, efforts, 2e-3, free, record, out, count)
    position, velocity, steps = arm.run(q, v, efforts, 2e-3)
    assert (steps == count).all()
    np.testing.assert_allclose(out, np.stack([position, velocity]), rtol=1e-7, atol=1e-9)


def test_smooth_friction_converges_to_scipy_with_second_order() -> None:
    robot = planar_arm()
    rng = np.random.default_rng(2)
    kinds = (terms.Coulomb(width=0.3), "viscous", terms.SigmoidFriction(velocity=0.5))
    model = model_of(robot, kinds, rng.uniform(0.2, 0.8, 6), random_links(rng, 2))
    effort, start = np.array([3.0, -1.0]), np.array([0.3, -0.4, 0.5, 1.0])

    def slope(_: float, x: Array) -> Array:
        return np.concatenate([x[2:], model.forward_dynamics(x[:2], x[2:], effort)])

    true = solve_ivp(slope, (0.0, 0.4), start, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    arm, errors = SimulatedArm.of(model), []
    for count in (100, 200, 400):
        push = np.tile(effort, (1, count, 1))
        q, v, _ = arm.run(start[None, :2], start[None, 2:], push, 0.4 / count)
        errors.append(np.abs(np.concatenate([q[0, -1], v[0, -1]]) - true).max())
    assert errors[0] < 1e-3
    assert 3.5 < errors[0] / errors[1] < 4.5
    assert 3.5 < errors[1] / errors[2] < 4.5


@pytest.mark.parametrize("term", ["coulomb", Own(np.sign)])
def test_a_sliding_mass_stops_where_it_must_and_sticks(term: Any) -> None:
    arm = SimulatedArm.of(slider((term,), [3.0]))
    # Braked by 1.5 m/s² from 0.5 m/s; then pushed by less and by more than friction holds.
    push = np.concatenate([np.zeros(100), np.full(50, 2.99), np.full(50, 4.0)])[None, :, None]
    q, v, count = arm.run(np.zeros((1, 1)), np.full((1, 1), 0.5), push, 5e-3)
    assert count[0] == 201
    assert q[0, 100, 0] == pytest.approx(0.5**2 / (2.0 * 1.5), abs=2e-5)
    assert np.ptp(q[0, 100:151]) == 0.0
    assert (v[0, 70:151] == 0.0).all()
    assert v[0, -1, 0] == pytest.approx(50 * 5e-3 * 0.5, rel=1e-9)
    stays = arm.acceleration(np.zeros((3, 1)), np.zeros((3, 1)), np.array([[2.9], [-2.9], [5.0]]))
    np.testing.assert_allclose(stays, [[0.0], [0.0], [1.0]], atol=1e-12)


def test_sign_friction_is_the_limit_of_narrow_smooth_signs() -> None:
    time = np.arange(200) * 5e-3
    push = (8.0 * np.sin(9.0 * time))[None, :, None]
    ends = []
    for kind in (terms.Coulomb(), terms.Coulomb(width=1e-4), terms.Coulomb(dead_zone=1e-6)):
        arm = SimulatedArm.of(slider((kind, "viscous"), [3.0, 1.0]))
        ends.append(arm.run(np.zeros((1, 1)), np.zeros((1, 1)), push, 5e-3)[0][0, :, 0])
    assert np.ptp(ends[0]) > 0.05
    np.testing.assert_allclose(ends[1], ends[0], atol=5e-4)
    np.testing.assert_allclose(ends[2], ends[0], atol=1e-4)


def test_stiff_friction_is_right_at_five_milliseconds() -> None:
    # Friction slows the mass within 10 us: an explicit step of 5 ms would explode.
    arm = SimulatedArm.of(slider(("viscous",), [2e5]))
    q, v, _ = arm.run(np.zeros((1, 1)), np.ones((1, 1)), np.full((1, 100, 1), 2e5), 5e-3)
    assert v[0, -1, 0] == pytest.approx(1.0, rel=1e-9)
    assert q[0, -1, 0] == pytest.approx(0.5, rel=1e-3)


def test_a_motor_of_two_joints_sticks_as_one() -> None:
    robot = planar_arm().with_gravity([0.0, 0.0, 0.0])
    names = robot.joint_names
    bodies = random_links(np.random.default_rng(0), 2)
    model = model_of(robot, (terms.Coupling(*names),), [0.0, 0.0, 5.0], bodies)
    arm = SimulatedArm.of(model)
    push = np.tile([0.5, -0.5], (1, 100, 1))
    _, v, _ = arm.run(np.zeros((1, 2)), np.zeros((1, 2)), push, 5e-3)
    assert abs(v[0, -1, 0]) > 0.1
    np.testing.assert_allclose(v[0].sum(axis=1), 0.0, atol=1e-8)


def test_energy_stays_without_friction() -> None:
    robot = planar_arm()
    model = model_of(robot, (), (), random_links(np.random.default_rng(4), 2))
    q, v, _ = SimulatedArm.of(model).run(
        np.ones((1, 2)), np.zeros((1, 2)), np.zeros((1, 5000, 2)), 1e-3
    )
    q, v = q[0, ::50], v[0, ::50]
    power = np.einsum("ki,ki->k", model.gravity(q), v)
    kinetic = 0.5 * np.einsum("ki,kij,kj->k", v, model.mass_matrix(q), v)
    import pinocchio as pin

    pin_model = model.to_pinocchio()
    data, configurations = pin_model.createData(), robot.configuration(q)
    potential = np.array([pin.computePotentialEnergy(pin_model, data, x) for x in configurations])
    total = kinetic + potential
    assert np.abs(power).max() > 1.0
    assert np.ptp(total) < 2e-3 * np.ptp(potential)


def test_one_free_joint_moves_as_if_the_others_were_simulated() -> None:
    model = rubbing(3)
    arm, rng = SimulatedArm.of(model), np.random.default_rng(1)
    q, v = rng.normal(size=(2, 1, 3))
    effort = np.tile(rng.normal(size=3), (1, 100, 1))
    all_free = arm.run(q, v, effort, 2e-3)
    one = arm.run(q, v, effort, 2e-3, free=[False, True, False], record=all_free[:2])
    np.testing.assert_allclose(one[0], all_free[0], atol=3e-4)


def test_a_motion_that_diverges_says_when() -> None:
    bodies = -random_links(np.random.default_rng(4), 2)
    model = model_of(planar_arm(), ("viscous",), [1.0, 1.0], bodies)
    q, v, count = SimulatedArm.of(model).run(
        np.ones((2, 2)), np.array([[0.0, 0.0], [np.pi, 2e3]]), np.ones((2, 400, 2)), 5e-3
    )
    assert count[1] == 0
    assert 0 < count[0] < 401
    assert np.isfinite(q[0, : count[0]]).all()
    assert np.isnan(v[0, count[0] :]).all()


def test_what_cannot_be_simulated_is_refused_by_name() -> None:
    class Drag(terms.JointwiseTerm):
        symbol, unit, nonnegative = "Fd", "N.m.s2/rad2", True

        def shape(self, velocity: Array, acceleration: Array) -> Array:
            return velocity * np.abs(acceleration)

    with pytest.raises(ModelError, match="effort of Drag depends on the acceleration"):
        SimulatedArm.of(slider((Drag(),), [1.0]))
    robot = sdpid.load_robot(TREE, root="free_flyer")
    refuses(ModelError, "floating base", SimulatedArm.of, model_of(robot))
