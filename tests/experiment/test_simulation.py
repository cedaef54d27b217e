"""Simulated motion: arms, closed loops, controllers and sensitivities."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from scipy.integrate import cumulative_trapezoid, solve_ivp

import sdpid
from sdpid import friction as terms
from sdpid._common.arrays import Array
from sdpid.controllers import PD, PID, ComputedTorque, Controller, P, fit_controller
from sdpid.errors import DataError, ModelError
from sdpid.experiment.plant.drives import load_drives
from sdpid.experiment.simulation import arm as arm_module
from sdpid.experiment.simulation import closed_loop
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.experiment.simulation.closed_loop import simulate_closed_loop
from sdpid.experiment.simulation.kernels import linked, loops
from sdpid.experiment.simulation.open_loop import Track, simulate_stretches, tip_positions
from sdpid.experiment.simulation.sensitivities import sensitivities
from sdpid.friction import Coulomb
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.model.base_parameters import structural_base
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.geometry import link_placements
from tests.helpers.arm_files import ARM_URDF
from tests.helpers.data import random_links, random_theta
from tests.helpers.random_trees import random_tree
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, TREE_MIMIC, planar_arm, small_arm

SLIDER = """<robot name="slider"><link name="base"/>
<link name="mass"><inertial><mass value="2"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="slide" type="prismatic"><parent link="base"/><child link="mass"/><axis xyz="1 0 0"/>
<limit lower="-9" upper="9" effort="100" velocity="9"/></joint></robot>"""


def model_of(
    robot: sdpid.RobotModel,
    terms: Sequence[str | FrictionTerm] = (),
    values: ArrayLike = (),
    bodies: Array | None = None,
) -> RobotDynamics:
    """Return a robot with these bodies, by default its own, and friction parameters."""
    friction = FrictionModel.from_terms(terms, robot.joint_names)
    own = robot.prior if bodies is None else bodies
    return RobotDynamics(
        robot=robot,
        terms=friction,
        theta=np.concatenate([np.ravel(own), np.asarray(values, dtype=np.float64)]),
    )


def slider(friction: Sequence[str | FrictionTerm], values: ArrayLike) -> RobotDynamics:
    """Return a mass of 2 kg on a horizontal rail."""
    return model_of(sdpid.load_robot(SLIDER), friction, values)


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
    found = SimulatedArm.of(model).dynamics(q, v, effort)[2]
    np.testing.assert_allclose(found, expected, atol=5e-3 * np.abs(expected).max())


@settings(max_examples=8)
@given(seed=st.integers(0, 10**6))
def test_masses_and_biases_are_those_of_pinocchio(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for text in (random_tree(rng, 6)[0], TREE, TREE_MIMIC):
        robot = sdpid.load_robot(text)
        model = model_of(robot, ("rotor_inertia", "offset"), rng.uniform(0.0, 1.0, 2 * robot.n))
        q, v = rng.normal(size=(2, 3, robot.n))
        M, h, _ = SimulatedArm.of(model).dynamics(q, v, 0.0 * q)
        expected = model.inverse_dynamics(q, v, np.zeros_like(q))
        np.testing.assert_allclose(M, model.mass_matrix(q), rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(h, expected, rtol=1e-12, atol=1e-11)


def test_accelerations_are_those_of_the_model_with_every_friction() -> None:
    rng = np.random.default_rng(1)
    for seed in range(3):
        model = rubbing(seed)
        q, v, effort = rng.normal(size=(3, 20, 3))
        expected = model.forward_dynamics(q, v, effort)
        found = SimulatedArm.of(model).dynamics(q, v, effort)[2]
        np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-7 * np.abs(expected).max())


def test_the_loops_do_the_same_without_a_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = SimulatedArm.of(rubbing(5))
    q, v, effort = np.random.default_rng(0).normal(size=(3, 2, 3))
    found = []
    for entries in (linked.entries, lambda: loops):
        monkeypatch.setattr(arm_module, "entries", entries)
        efforts = np.repeat(effort[:, None], 20, axis=1)
        found.append(
            (*arm.dynamics(q, v, effort), *arm.run(np.stack([q, v])[:, :, None], efforts, 2e-3))
        )
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-7, atol=1e-9)


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
        q, v = arm.run(start.reshape(2, 1, 1, 2), push, 0.4 / count)
        errors.append(np.abs(np.concatenate([q[0, -1], v[0, -1]]) - true).max())
    assert errors[0] < 1e-3
    assert 3.5 < errors[0] / errors[1] < 4.5
    assert 3.5 < errors[1] / errors[2] < 4.5


@pytest.mark.parametrize("term", ["coulomb", Own(np.sign)])
def test_a_sliding_mass_stops_where_it_must_and_sticks(term: Any) -> None:
    arm = SimulatedArm.of(slider((term,), [3.0]))
    # Braked by 1.5 m/s² from 0.5 m/s; then pushed by less and by more than friction holds.
    push = np.concatenate([np.zeros(100), np.full(50, 2.99), np.full(50, 4.0)])[None, :, None]
    q, v = arm.run([[[[0.0]]], [[[0.5]]]], push, 5e-3)
    assert np.isfinite(v).all()
    assert q[0, 100, 0] == pytest.approx(0.5**2 / (2.0 * 1.5), abs=2e-5)
    assert np.ptp(q[0, 100:151]) == 0.0
    assert (v[0, 70:151] == 0.0).all()
    assert v[0, -1, 0] == pytest.approx(50 * 5e-3 * 0.5, rel=1e-9)
    stays = arm.dynamics(np.zeros((3, 1)), np.zeros((3, 1)), np.array([[2.9], [-2.9], [5.0]]))[2]
    np.testing.assert_allclose(stays, [[0.0], [0.0], [1.0]], atol=1e-12)


def test_sign_friction_is_the_limit_of_narrow_smooth_signs() -> None:
    time = np.arange(200) * 5e-3
    push = (8.0 * np.sin(9.0 * time))[None, :, None]
    ends = []
    for kind in (terms.Coulomb(), terms.Coulomb(width=1e-4), terms.Coulomb(dead_zone=1e-6)):
        arm = SimulatedArm.of(slider((kind, "viscous"), [3.0, 1.0]))
        ends.append(arm.run(np.zeros((2, 1, 1, 1)), push, 5e-3)[0, 0, :, 0])
    assert np.ptp(ends[0]) > 0.05
    np.testing.assert_allclose(ends[1], ends[0], atol=5e-4)
    np.testing.assert_allclose(ends[2], ends[0], atol=1e-4)


def test_a_motor_of_two_joints_sticks_as_one() -> None:
    robot = planar_arm().with_gravity([0.0, 0.0, 0.0])
    names = robot.joint_names
    bodies = random_links(np.random.default_rng(0), 2)
    model = model_of(robot, (terms.Coupling(*names),), [0.0, 0.0, 5.0], bodies)
    arm = SimulatedArm.of(model)
    push = np.tile([0.5, -0.5], (1, 100, 1))
    _, v = arm.run(np.zeros((2, 1, 1, 2)), push, 5e-3)
    assert abs(v[0, -1, 0]) > 0.1
    np.testing.assert_allclose(v[0].sum(axis=1), 0.0, atol=1e-8)


def test_one_free_joint_moves_as_if_the_others_were_simulated() -> None:
    model = rubbing(3)
    arm, rng = SimulatedArm.of(model), np.random.default_rng(1)
    start = rng.normal(size=(2, 1, 1, 3))
    effort = np.tile(rng.normal(size=3), (1, 100, 1))
    all_free = arm.run(start, effort, 2e-3)
    one = arm.run(all_free, effort, 2e-3, free=[False, True, False])
    np.testing.assert_allclose(one[0], all_free[0], atol=3e-4)


def test_a_motion_that_diverges_says_when() -> None:
    bodies = -random_links(np.random.default_rng(4), 2)
    model = model_of(planar_arm(), ("viscous",), [1.0, 1.0], bodies)
    start = np.array([np.ones((2, 1, 2)), [[[0.0, 0.0]], [[np.pi, 2e3]]]])
    q, v = SimulatedArm.of(model).run(start, np.ones((2, 400, 2)), 5e-3)
    count = np.isfinite(q).all(axis=2).sum(axis=1)
    assert count[1] == 0
    assert 0 < count[0] < 401
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


# Closed loops move as SciPy and MuJoCo say.


KP, KD, KI = np.array([90.0, 60.0]), np.array([9.0, 6.0]), np.array([50.0, 40.0])
RATE, SECONDS = 500.0, 0.6
TIMES = np.arange(0.0, SECONDS + 1e-9, 1.0 / RATE)
SPEEDS = np.array([3.0, 5.0])


def reference(time: Array) -> tuple[Array, Array, Array]:
    """Return position, velocity and acceleration of a motion."""
    angle = np.atleast_1d(time)[:, None] * SPEEDS
    return 0.5 * np.sin(angle), 0.5 * SPEEDS * np.cos(angle), -0.5 * SPEEDS**2 * np.sin(angle)


def model(scale: float = 1.0) -> RobotDynamics:
    """Return an arm with smooth friction."""
    bodies = scale * random_links(np.random.default_rng(0), 2)
    return model_of(planar_arm(), (Coulomb(width=0.3), "viscous"), [0.5, 0.3, 0.4, 0.2], bodies)


@pytest.mark.parametrize(
    "law",
    [
        P(KP / KD, KD, feedforward=True),
        PD(KP, KD, effort_limit=np.array([6.0, 3.0])),
        PID(KP, KI, KD),
        ComputedTorque(model(1.3), np.full(2, 100.0), np.full(2, 20.0)),
    ],
    ids=lambda law: type(law).__name__,
)
def test_the_motion_is_that_of_scipy(law: Controller) -> None:
    arm = model()

    def slope(time: float, x: Array) -> Array:
        q, v, integral = x[:2], x[2:4], x[4:]
        told = reference(np.array([time]))
        effort = law.effort(q[None], v[None], *told, integral[None])[0]
        return np.concatenate([v, arm.forward_dynamics(q, v, effort), told[0][0] - q])

    start = np.concatenate([np.zeros(2), reference(np.zeros(1))[1][0], np.zeros(2)])
    true = solve_ivp(slope, (0.0, SECONDS), start, rtol=1e-8, atol=1e-9, t_eval=TIMES).y.T
    told = reference(TIMES)
    motion = simulate_closed_loop(arm, told, law, rate_hz=RATE)
    tracking = np.abs(true[:, :2] - told[0]).max()
    assert motion.diverged is None
    assert np.abs(motion.position - true[:, :2]).max() < 5e-3 * tracking
    effort = law.effort(true[:, :2], true[:, 2:4], *told, true[:, 4:])
    assert np.abs(motion.effort - effort).max() < 1e-2 * np.abs(effort).max()
    residual = arm.inverse_dynamics(motion.position, motion.velocity, motion.acceleration)
    np.testing.assert_allclose(residual, motion.effort, atol=1e-9)


@pytest.mark.parametrize("options", [{}, {"control_hz": 500.0, "position_noise": 1e-5}])
def test_closed_loops_do_the_same_without_a_compiler(
    options: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    told = tuple(each[:20] for each in reference(TIMES))
    inverse = ComputedTorque(model(1.3), np.full(2, 100.0), np.full(2, 20.0))
    for law in (inverse, PID(KP, KI, KD, effort_limit=np.array([2.0, 1.0]))):
        found = []
        for entries in (linked.entries, lambda: loops):
            monkeypatch.setattr(closed_loop, "entries", entries)
            found.append(simulate_closed_loop(model(), told, law, rate_hz=RATE, **options))
        np.testing.assert_allclose(found[1].position, found[0].position, rtol=1e-7, atol=1e-10)
        np.testing.assert_allclose(found[1].effort, found[0].effort, rtol=1e-5, atol=1e-7)


class OwnController(Controller):
    """A law that is not compiled."""

    def __init__(self, law: PD) -> None:
        self.law = law

    @property
    def n(self) -> int:
        return self.law.n

    def effort(self, *states: ArrayLike | None) -> Array:
        return self.law.effort(*states)

    def slopes(self, *states: ArrayLike | None) -> tuple[Array, Array]:
        return self.law.slopes(*states)


def test_a_controller_in_python_moves_the_arm_as_a_compiled_one() -> None:
    law, told = PD(KP, KD), reference(TIMES[:60])
    options = {"rate_hz": RATE, "control_hz": 1000.0, "position_noise": 1e-5, "seed": 3}
    one, other = (
        simulate_closed_loop(model(), told, each, **options) for each in (law, OwnController(law))
    )
    np.testing.assert_allclose(other.position, one.position, atol=1e-6)
    np.testing.assert_allclose(other.effort, one.effort, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(other.measured - other.position, one.measured - one.position)


def test_held_efforts_become_continuous_ones_and_noise_is_seeded() -> None:
    law, told = PD(KP, KD), reference(TIMES)
    smooth = simulate_closed_loop(model(), told, law, rate_hz=RATE).position
    held = [
        np.abs(
            simulate_closed_loop(model(), told, law, rate_hz=RATE, control_hz=hz).position - smooth
        )
        for hz in (1000.0, 4000.0)
    ]
    assert 3.0 < held[0].max() / held[1].max() < 5.0
    noisy = [
        simulate_closed_loop(
            model(), told, law, rate_hz=RATE, control_hz=5000.0, position_noise=1e-5, seed=seed
        )
        for seed in (1, 1, 2)
    ]
    np.testing.assert_array_equal(noisy[0].effort, noisy[1].effort)
    assert np.abs(noisy[0].effort - noisy[2].effort).max() > 1e-2
    spread = noisy[0].measured - noisy[0].position
    assert spread.std() == pytest.approx(1e-5, rel=0.2)


def test_samples_between_steps_lie_on_the_motion() -> None:
    told, law = reference(TIMES), PD(KP, KD)
    fine = simulate_closed_loop(model(), told, law, rate_hz=RATE, control_hz=5000.0)
    time, part = TIMES[::7] * 1.0, told[0][::7]
    log = sdpid.Recording(time=time, position=part, effort=0.0 * part, reference=part)
    coarse = simulate_closed_loop(model(), log, law, control_hz=4321.0)
    np.testing.assert_array_equal(coarse.time, log.time)
    np.testing.assert_allclose(coarse.position, fine.position[::7], atol=2e-3)


def test_an_unstable_loop_ends_where_it_diverges() -> None:
    law, told, start = PD([1e6], [0.0]), np.ones((500, 1)), ([0.0], [0.0])
    options = {"rate_hz": 100.0, "control_hz": 100.0, "start": start}
    motion = simulate_closed_loop(slider((), ()), told, law, **options)
    assert motion.diverged is not None
    assert len(motion.time) < 500
    assert np.isfinite(motion.position).all()
    assert "diverged=0." in repr(motion)


def test_what_does_not_fit_is_told_before_the_simulation() -> None:
    law, told = PD(KP, KD), reference(TIMES)
    for arguments, options, message in (
        ((told, law), {}, "rate_hz: missing"),
        ((told, PD([1.0], [1.0])), {"rate_hz": RATE}, "gains of 1 joints"),
        ((told, 3.0), {"rate_hz": RATE}, "controller: float is none"),
        ((told[0][:, :1], law), {"rate_hz": RATE}, "reference: 1 joints, the robot has 2"),
        ((told[:2], law), {"rate_hz": RATE}, "reference: 2 arrays"),
        ((told, law), {"rate_hz": RATE, "position_noise": 1e-4}, "set control_hz"),
        ((told, law), {"rate_hz": RATE, "differenced": True}, "set control_hz"),
        ((told, law), {"rate_hz": RATE, "step": -1.0}, "step is -1.0"),
        ((told, law), {"rate_hz": RATE, "start": ([0.0], [0.0])}, "start: shapes"),
    ):
        refuses(DataError, message, simulate_closed_loop, model(), *arguments, **options)
    silent = sdpid.Recording(time=TIMES, position=told[0], effort=told[0])
    refuses(DataError, "no commanded positions", simulate_closed_loop, model(), silent, law)


# Controllers give what their formulas say, with slopes, and refuse what is none.


P_GAIN, D_GAIN, I_GAIN = np.array([30.0, 20.0]), np.array([3.0, 2.0]), np.array([5.0, 4.0])


def laws() -> tuple[Controller, ...]:
    """Return one of each kind."""
    model = model_of(
        planar_arm(),
        ("viscous", "coulomb", "rotor_inertia"),
        [0.5, 0.4, 0.3, 0.2, 0.1, 0.2],
        random_links(np.random.default_rng(0), 2),
    )
    return (
        P(P_GAIN, D_GAIN),
        PD(P_GAIN, D_GAIN),
        PID(P_GAIN, I_GAIN, D_GAIN, feedforward=False),
        ComputedTorque(model, P_GAIN, D_GAIN),
        PD(P_GAIN, D_GAIN, effort_limit=np.array([5.0, 1e3])),
    )


@pytest.mark.parametrize("law", laws(), ids=repr)
def test_slopes_are_those_of_the_effort(law: Controller) -> None:
    rng = np.random.default_rng(1)
    q, v, qd, vd, ad, integral = rng.normal(size=(6, 5, 2))
    by_position, by_velocity = law.slopes(q, v, qd, vd, ad, integral)
    for j, h in enumerate(1e-6 * np.eye(2)):
        dq = law.effort(q + h, v, qd, vd, ad, integral) - law.effort(q - h, v, qd, vd, ad, integral)
        dv = law.effort(q, v + h, qd, vd, ad, integral) - law.effort(q, v - h, qd, vd, ad, integral)
        np.testing.assert_allclose(by_position[:, :, j], dq / 2e-6, rtol=1e-6, atol=1e-5)
        np.testing.assert_allclose(by_velocity[:, :, j], dv / 2e-6, rtol=1e-6, atol=1e-5)


def test_the_formulas() -> None:
    q, v, qd, vd, integral = np.random.default_rng(2).normal(size=(5, 3, 2))
    p, pd, pid = (law.effort(q, v, qd, vd, None, integral) for law in laws()[:3])
    np.testing.assert_allclose(p, D_GAIN * (P_GAIN * (qd - q) - v))
    np.testing.assert_allclose(pd, P_GAIN * (qd - q) + D_GAIN * (vd - v))
    np.testing.assert_allclose(pid, P_GAIN * (qd - q) - D_GAIN * v + I_GAIN * integral)
    limited = laws()[4].effort(q, v, qd, vd)
    np.testing.assert_allclose(limited[:, 0], np.clip(pd[:, 0], -5.0, 5.0))
    law = laws()[3]
    assert isinstance(law, ComputedTorque)
    expected = law.model.inverse_dynamics(q, v, qd)
    np.testing.assert_allclose(law.effort(q, v, q, v, qd), expected)


def test_bad_gains_and_samples_are_told() -> None:
    refuses(DataError, r"kp is .* give positive numbers", PD, [0.0, 1.0], [1.0, 1.0])
    refuses(DataError, "lengths differ", PD, [1.0, 1.0], [1.0])
    zero, few = np.zeros((3, 2)), np.zeros((2, 2))
    refuses(DataError, "integral is missing", PID(P_GAIN, I_GAIN, D_GAIN).effort, *[zero] * 4)
    words = r"velocity: shape \(2, 2\), expected \(3, 2\)"
    refuses(DataError, words, PD(P_GAIN, D_GAIN).effort, zero, few, zero, zero)
    other = laws()[3].model
    refuses(DataError, "of 3 joints, the model", ComputedTorque, other, np.ones(3), np.ones(3))
    assert repr(sdpid.controllers.PD(P_GAIN, D_GAIN)) == "PD(2 joints, kp 20 to 30, kd 2 to 3)"


# Gains of controllers from logs of loops whose gains are known.


LOG_RATE = 500.0
T = np.arange(0.0, 12.0, 1.0 / LOG_RATE)
TRUE_KP, TRUE_KD = np.array([900.0, 300.0]), np.array([60.0, 12.0])
LAWS = {
    "p": P(np.array([6.0, 9.0]), TRUE_KD),
    "pd": PD(TRUE_KP, TRUE_KD),
    "pd damped": PD(TRUE_KP, TRUE_KD, feedforward=False),
    "pid": PID(TRUE_KP, 3.0 * TRUE_KP, TRUE_KD),
}


@pytest.fixture(scope="module")
def arm_model() -> RobotDynamics:
    robot = sdpid.RobotModel.from_mdh(
        [{"r": 0.3, "alpha": 0.4}, {"alpha": -np.pi / 2, "d": 0.4}], name="arm"
    )
    links = []
    for mass, center in ((12.0, [0.1, 0.02, 0.0]), (5.0, [0.05, 0.0, 0.15])):
        c = np.array(center)
        spread = 0.04 * mass * np.eye(3) + mass * (c @ c * np.eye(3) - np.outer(c, c))
        xx, xy, xz, yy, yz, zz = spread[np.triu_indices(3)]
        links += [mass, *(mass * c), xx, xy, yy, xz, yz, zz]
    return model_of(robot, ("coulomb", "viscous"), [4.0, 2.0, 3.0, 1.5], np.array(links))


def logged(
    model: RobotDynamics, law: Any, *, noise: float = 1e-5, seed: int = 0
) -> sdpid.Recording:
    """Return a log with noise on positions, which the controller did not see, and on efforts."""
    rng = np.random.default_rng(seed)
    omega = 2.0 * np.pi * np.array([[0.21, 0.43], [0.64, 0.33]])
    told = 0.5 * sum(np.sin(np.outer(T, w) + k) for k, w in enumerate(omega))
    moved = sdpid.simulate_closed_loop(model, told, law, rate_hz=LOG_RATE)
    white = rng.standard_normal((2, *told.shape))
    return sdpid.Recording(
        time=moved.time,
        position=moved.position + noise * white[0],
        effort=moved.effort + 0.01 * moved.effort.std(axis=0) * white[1],
        reference=told,
        joint_names=model.robot.joint_names,
    )


@pytest.mark.parametrize("name", LAWS)
def test_gains_are_found_within_their_deviations(arm_model: RobotDynamics, name: str):
    law, kind = LAWS[name], name.split()[0]
    fitted = fit_controller(logged(arm_model, law), kind)
    assert fitted.usable, fitted.reasons
    assert type(fitted.require()) is type(law)
    assert fitted.feedforward == law.feedforward
    for gain, found in fitted.gains.items():
        off = np.abs(found / getattr(law, gain) - 1.0)
        # The integral of the simulated loop is a step of 1 ms ahead.
        assert np.all(off < 4.0 * fitted.deviations[gain] + (4e-3 if name == "pid" else 1e-3))
        assert np.all(off < 0.03)


def test_deviations_are_those_of_many_logs(arm_model: RobotDynamics):
    law = LAWS["pd"]
    log = logged(arm_model, law, noise=0.0)
    rng = np.random.default_rng(4)
    scores = []
    for _ in range(30):
        noisy = log.position + 1e-3 * rng.standard_normal(log.position.shape)
        efforts = log.effort + 0.02 * log.effort.std(axis=0) * rng.standard_normal(noisy.shape)
        fitted = fit_controller(replace(log, position=noisy, effort=efforts), "pd")
        for gain, found in fitted.gains.items():
            scores.append((found / getattr(law, gain) - 1.0) / fitted.deviations[gain])
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.6


def test_much_noise_is_told_and_refused(arm_model: RobotDynamics):
    fitted = fit_controller(logged(arm_model, LAWS["pd"], noise=0.1), "pd")
    assert not fitted.usable
    refuses(DataError, r"not known well enough: .*(deviation of|explains)", fitted.require)


def test_efforts_of_zero_show_no_controller(arm_model: RobotDynamics):
    log = logged(arm_model, LAWS["pd"])
    fitted = fit_controller(replace(log, effort=0.0 * log.effort))
    assert not fitted.usable
    assert fitted.controller is None


@pytest.mark.parametrize(("name", "kind"), [("pid", "pd"), ("pid", "p")])
def test_other_kinds_are_refused(arm_model: RobotDynamics, name: str, kind: str):
    fitted = fit_controller(logged(arm_model, LAWS[name]), kind)
    assert not fitted.usable
    assert "fit kind='pid'" in fitted.reasons[-1]


def test_the_loop_of_the_simulated_robot_is_found():
    robot, drives = sdpid.load_robot("denso_vp6242"), load_drives("denso_vp6242")
    motion = sdpid.paper_excitation("denso_vp6242", seed=0, periods=1, period=10.0)
    fitted = fit_controller(sdpid.simulate(robot, motion, seed=1), "p")
    assert fitted.usable
    # Joint 6 is the noisiest: its deviations are some percent.
    for gain, rtol in (("proportional_gain", 2e-3), ("velocity_gain", 5e-3)):
        found = fitted.gains[gain]
        np.testing.assert_allclose(found[:5], getattr(drives, gain)[:5], rtol=rtol)
        assert abs(found[5] / getattr(drives, gain)[5] - 1.0) < 4.0 * fitted.deviations[gain][5]
    assert fitted.to_dict()["usable"] is True
    assert "usable" in fitted.describe()
    assert len(repr(fitted)) < 160
    assert "<table" in fitted._repr_html_()


def test_what_cannot_be_fitted_is_told_before(arm_model: RobotDynamics):
    log = logged(arm_model, LAWS["pd"])
    wrong: list[tuple[Any, str]] = [
        (lambda: fit_controller(log, "lqr"), "'lqr' is not known; known are p, pd"),
        (lambda: fit_controller(replace(log, reference=None)), "no commanded positions"),
        (lambda: fit_controller(replace(log, currents=True)), "efforts are currents in A"),
        (lambda: fit_controller(log, cutoff_hz=400.0), "expected at most 50 Hz"),
        (lambda: fit_controller(log, cutoff_hz="3"), "cutoff_hz: is '3', expected"),
        (lambda: fit_controller("run.csv"), "recording: is 'run.csv'; give a Recording"),
        (
            lambda: fit_controller(
                sdpid.Recording(**{k: getattr(log, k)[:400] for k in (
                    "time", "position", "effort", "reference")})
            ),
            "at least 200 are needed",
        ),
    ]  # fmt: skip
    for call, words in wrong:
        refuses(DataError, words, call)


# Stretches of a recording move as SciPy integrates them.


TERMS = (Coulomb(width=0.05), "viscous", "offset")
EFFORT = np.array([1.3, -0.7])


def test_stretches_agree_with_scipy() -> None:
    robot = small_arm(2)
    theta = random_theta(robot, np.random.default_rng(3), TERMS)
    model = model_of(robot, TERMS, theta[20:], theta[:20])

    def effort(t: np.ndarray | float) -> np.ndarray:
        return EFFORT * np.sin(2.0 * np.asarray(t)[..., None] + [0.0, 1.0])

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        return np.concatenate([x[2:], model.forward_dynamics(x[:2], x[2:], effort(t))])

    start = np.array([0.3, -0.5, 0.2, 0.4])
    time = np.arange(0.0, 1.001, 0.02)
    exact = solve_ivp(rate, (0.0, 1.0), start, t_eval=time, rtol=1e-9, atol=1e-10).y.T
    samples = sdpid.Samples(
        position=exact[:, :2],
        velocity=exact[:, 2:],
        acceleration=np.zeros((len(time), 2)),
        effort=effort(time),
        time=time,
    )
    errors = []
    for step in (0.005, 0.0025):
        track = Track.of(samples, step=step)
        assert track.step == pytest.approx(step)
        every = np.array([0, round(0.3 / step)])
        free = np.array([[True, True], [True, True]])
        after = [track.steps(0.1), track.steps(0.5)]
        found = simulate_stretches(SimulatedArm.of(model), track, every, free, after)
        measured = track.position[every[:, None] + after]
        errors.append(np.abs(found - measured).max())
        assert np.isfinite(found).all()
    assert errors[0] < 2e-3
    assert errors[1] < 0.6 * errors[0] + 1e-5
    # A joint that is not free is on the record.
    free[:, 0] = False
    found = simulate_stretches(SimulatedArm.of(model), track, every, free, after)
    assert np.array_equal(found[:, :, 0], measured[:, :, 0])
    assert np.abs(found - measured).max() < 2e-3


def test_starts_stay_within_pieces() -> None:
    time = np.concatenate([np.arange(50), 80 + np.arange(30)]) / 50.0
    zero = np.zeros((80, 1))
    samples = sdpid.Samples(
        position=time[:, None],
        velocity=zero + 1.0,
        acceleration=zero,
        effort=zero,
        time=time,
        starts=(0, 50),
    )
    track = Track.of(samples)
    first = track.starts(0.5, 0.1)
    ends = first + track.steps(0.5)
    assert np.array_equal(track.piece[first], track.piece[ends])
    assert set(track.piece[first]) == {0, 1}
    assert track.time[ends] - track.time[first] == pytest.approx(0.5)
    assert track.position[:, 0] == pytest.approx(track.time)


def test_the_tip_is_where_the_last_link_ends() -> None:
    robot = sdpid.load_robot(TREE)
    q = np.random.default_rng(0).uniform(-0.5, 0.5, (4, robot.n))
    q[2, 0] = np.nan
    found = tip_positions(robot, q)
    assert np.isnan(found[2]).all()
    last = robot.link_names.index("left_slide")
    for k in (0, 1, 3):
        assert found[k] == pytest.approx(link_placements(robot, q[k])[last][:3, 3], abs=1e-12)


# Sensitivities of a controlled motion against differences of simulations.


FINE_RATE = 2000.0
TIME = np.arange(0.0, 2.0, 1.0 / FINE_RATE)
TOLD = np.stack([0.8 * np.sin(2.1 * TIME) ** 2, 0.6 * (1.0 - np.cos(3.3 * TIME))], axis=1)
PD_LAW = sdpid.controllers.PD(np.array([60.0, 30.0]), np.array([6.0, 3.0]))
PID_LAW = sdpid.controllers.PID(
    np.array([60.0, 30.0]), np.array([90.0, 40.0]), np.array([6.0, 3.0])
)
SMOOTH = ("viscous", "rotor_inertia", "offset")


def simulated(model: RobotDynamics, law: Any) -> Any:
    return sdpid.simulate_closed_loop(model, TOLD, law, rate_hz=FINE_RATE)


@pytest.mark.parametrize(
    ("terms", "law", "limit"),
    [
        pytest.param(SMOOTH, PD_LAW, 2e-4, id="smooth"),
        pytest.param(SMOOTH, PID_LAW, 2e-3, id="integral"),
        # Reversals fall between instants: right to a share of a step of the loop.
        pytest.param(("coulomb", "viscous"), PD_LAW, 2e-2, id="sticking"),
        pytest.param((sdpid.friction.Coulomb(width=0.2),), PD_LAW, 2e-4, id="smooth sign"),
    ],
)
def test_they_are_the_differences_of_simulated_motions(terms: Any, law: Any, limit: float) -> None:
    robot = sdpid.load_robot(ARM_URDF)
    count = len(FrictionModel.from_terms(terms, robot.joint_names).parameters)
    model = model_of(robot, terms, np.full(count, 0.4))
    base, theta = structural_base(robot, model.terms), model.theta
    moved = simulated(model, law)
    told = np.gradient(TOLD, TIME, axis=0)
    integral = cumulative_trapezoid(TOLD - moved.position, TIME, axis=0, initial=0.0)
    states = (moved.position, moved.velocity, TOLD, told, 0.0 * TOLD, integral)
    found = sensitivities(model, base, law, TIME, states)
    np.testing.assert_array_equal(
        sensitivities(model, base, law, TIME, states, every=3), found[::3]
    )
    for k, place in enumerate(base.kept):
        step = np.zeros_like(theta)
        step[place] = 1e-4
        ahead, behind = (
            simulated(replace(model, theta=theta + s * step), law) for s in (1.0, -1.0)
        )
        difference = (ahead.position - behind.position) / 2e-4
        off = np.linalg.norm(found[:, :, k] - difference) / np.linalg.norm(difference)
        assert off < limit, base.names[k]
