"""Simulated motion: arms, closed loops, controllers and sensitivities."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
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
from sdpid.experiment.plant.simulate import load_drives
from sdpid.experiment.simulation import arm as arm_module
from sdpid.experiment.simulation import closed_loop
from sdpid.experiment.simulation.arm import SimulatedArm, Track, simulate_stretches, tip_positions
from sdpid.experiment.simulation.closed_loop import simulate_closed_loop
from sdpid.experiment.simulation.kernels import linked, loops
from sdpid.experiment.simulation.sensitivities import sensitivities
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.model.base_parameters import structural_base
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.geometry import link_placements
from tests.helpers.data import random_links
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
    friction: Sequence[str | FrictionTerm] = (),
    values: ArrayLike = (),
    bodies: Array | None = None,
) -> RobotDynamics:
    """Return a robot with these bodies, by default its own, and friction parameters."""
    links = robot.prior if bodies is None else bodies
    theta = np.concatenate([np.ravel(links), np.asarray(values, dtype=np.float64)])
    placed = FrictionModel.from_terms(friction, robot.joint_names)
    return RobotDynamics(robot=robot, terms=placed, theta=theta)


def slider(friction: Sequence[str | FrictionTerm] = (), values: ArrayLike = ()) -> RobotDynamics:
    """Return a mass of 2 kg on a horizontal rail."""
    return model_of(sdpid.load_robot(SLIDER), friction, values)


def planar(
    friction: Sequence[str | FrictionTerm] = (terms.Coulomb(width=0.3), "viscous"),
    values: ArrayLike = (0.5, 0.3, 0.4, 0.2),
    scale: float = 1.0,
) -> RobotDynamics:
    """Return an arm of two joints, by default with smooth friction."""
    bodies = scale * random_links(np.random.default_rng(0), 2)
    return model_of(planar_arm(), friction, values, bodies)


def rubbing(seed: int) -> RobotDynamics:
    """Return an arm of three joints with every kind of friction."""
    rng, robot = np.random.default_rng(seed), small_arm(3)
    bodies = random_links(rng, 3)
    other = tuple(map(tuple, random_links(rng, 3).tolist()))
    kinds = (
        "viscous",
        "offset",
        "rotor_inertia",
        "asymmetric_coulomb",
        "square_root",
        terms.Coulomb(width=0.2, dead_zone=0.05),
        terms.Stribeck(velocity=0.3, exponent=1.0),
        terms.SigmoidFriction(velocity=0.4),
        terms.Coupling(*robot.joint_names[:2]),
        terms.Tilt(other),
        terms.LoadFriction(other, share=(0.3, 0.0, 1.0), velocity=(0.2, 1.0, 0.5)),
    )
    if seed == 1:
        width = (0.3, 0.0, 0.1)
        kinds = (*kinds[:-1], terms.PositionFriction((-0.5,) * 3, (0.5, 1.0, 0.3), width))
    counts = [len(model_of(robot, (kind,)).terms.parameters) for kind in kinds]
    scale = [0.02 if isinstance(k, (terms.Tilt, terms.LoadFriction)) else 0.5 for k in kinds]
    values = rng.uniform(0.2, 1.0, sum(counts)) * np.repeat(scale, counts)
    return model_of(robot, kinds, values, bodies)


@dataclass(frozen=True)
class Own(terms.JointwiseTerm):
    """A term of somebody's own, any function of velocity and acceleration."""

    function: Callable[..., Array]
    symbol: ClassVar[str] = "Fd"
    unit: ClassVar[str] = "N.m"
    nonnegative: ClassVar[bool] = True

    def shape(self, velocity: Array, acceleration: Array) -> Array:
        """Return the function's values."""
        return np.asarray(self.function(velocity, acceleration))


def test_friction_over_position_is_in_motions_and_laws() -> None:
    """A held joint creeps where friction over position can no longer hold it."""
    drag = terms.PositionFriction((0.0,), (1.0,))
    model = slider((drag,), (0.0, 0.5, 1.0))
    arm = SimulatedArm.of(model)
    at = np.array([[0.0], [0.5], [2.0]])
    push = arm.dynamics(at, np.zeros((3, 1)), np.full((3, 1), 0.4))[2]
    assert push[0, 0] > 0.0
    np.testing.assert_array_equal(push[1:], 0.0)
    law = ComputedTorque(model, np.full(1, 100.0), np.full(1, 20.0))
    time = np.arange(0.0, 2.0, 0.01)[:, None]
    told = (0.5 + 0.3 * np.sin(3.0 * time), 0.9 * np.cos(3.0 * time), -2.7 * np.sin(3.0 * time))
    moved = simulate_closed_loop(model, told, law, rate_hz=100.0)
    assert np.abs(moved.position - told[0]).max() < 2e-3
    both = (drag, terms.LoadFriction())
    with pytest.raises(ModelError, match="of the load and over position together"):
        SimulatedArm.of(slider(both, (0.0, 0.5, 1.0, 0.1)))


OWN = (lambda v, a: v * np.abs(v), lambda v, a: np.sign(v) + v, lambda v, a: np.cos(v))


@pytest.mark.parametrize("case", [0, 1, 2, *OWN])
def test_accelerations_are_those_of_the_model_with_every_friction(case: Any) -> None:
    rng, close = np.random.default_rng(4), 1e-7
    if callable(case):
        links, close = random_links(rng, 3), 5e-3
        model = model_of(small_arm(3), ("viscous", Own(case)), np.linspace(0.2, 1.0, 6), links)
    else:
        model = rubbing(case)
    q, v, effort = rng.normal(size=(3, 20, 3))
    expected = model.forward_dynamics(q, v, effort)
    found = SimulatedArm.of(model).dynamics(q, v, effort)[2]
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=close * np.abs(expected).max())


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


@pytest.mark.parametrize("term", ["coulomb", Own(lambda v, a: np.sign(v))])
def test_a_sliding_mass_stops_where_it_must_and_sticks(term: Any) -> None:
    arm = SimulatedArm.of(slider((term,), [3.0]))
    # Braked by 1.5 m/s² from 0.5 m/s; then pushed by less and by more than friction holds.
    push = np.concatenate([np.zeros(100), np.full(50, 2.99), np.full(50, 4.0)])[None, :, None]
    q, v = arm.run([[[[0.0]]], [[[0.5]]]], push, 5e-3)
    assert q[0, 100, 0] == pytest.approx(0.5**2 / (2.0 * 1.5), abs=2e-5)
    assert np.ptp(q[0, 100:151]) == 0.0
    assert (v[0, 70:151] == 0.0).all()
    assert v[0, -1, 0] == pytest.approx(50 * 5e-3 * 0.5, rel=1e-9)
    still = np.zeros((3, 1))
    stays = arm.dynamics(still, still, np.array([[2.9], [-2.9], [5.0]]))[2]
    np.testing.assert_allclose(stays, [[0.0], [0.0], [1.0]], atol=1e-12)


def test_sign_friction_is_the_limit_of_narrow_smooth_signs() -> None:
    push, start = (8.0 * np.sin(9.0 * np.arange(200) * 5e-3))[None, :, None], np.zeros((2, 1, 1, 1))
    kinds = (terms.Coulomb(), terms.Coulomb(width=1e-4), terms.Coulomb(dead_zone=1e-6))
    arms = (SimulatedArm.of(slider((kind, "viscous"), [3.0, 1.0])) for kind in kinds)
    exact, narrow, dead = (arm.run(start, push, 5e-3)[0] for arm in arms)
    assert np.ptp(exact) > 0.05
    np.testing.assert_allclose(narrow, exact, atol=5e-4)
    np.testing.assert_allclose(dead, exact, atol=1e-4)


def test_a_motor_of_two_joints_sticks_as_one() -> None:
    model = planar((terms.Coupling(*planar_arm().joint_names),), [0.0, 0.0, 5.0])
    arm = SimulatedArm.of(replace(model, robot=model.robot.with_gravity([0.0, 0.0, 0.0])))
    _, v = arm.run(np.zeros((2, 1, 1, 2)), np.tile([0.5, -0.5], (1, 100, 1)), 5e-3)
    assert abs(v[0, -1, 0]) > 0.1
    np.testing.assert_allclose(v[0].sum(axis=1), 0.0, atol=1e-8)


def test_one_free_joint_moves_as_if_the_others_were_simulated() -> None:
    arm, rng = SimulatedArm.of(rubbing(3)), np.random.default_rng(1)
    effort = np.tile(rng.normal(size=3), (1, 100, 1))
    all_free = arm.run(rng.normal(size=(2, 1, 1, 3)), effort, 2e-3)
    one = arm.run(all_free, effort, 2e-3, free=[False, True, False])
    np.testing.assert_allclose(one[0], all_free[0], atol=3e-4)


def test_a_motion_that_diverges_says_when() -> None:
    start = np.array([np.ones((2, 1, 2)), [[[0.0, 0.0]], [[np.pi, 2e3]]]])
    arm = SimulatedArm.of(planar(("viscous",), [1.0, 1.0], -1.0))
    q, v = arm.run(start, np.ones((2, 400, 2)), 5e-3)
    count = np.isfinite(q).all(axis=2).sum(axis=1)
    assert count[1] == 0
    assert 0 < count[0] < 401
    assert np.isnan(v[0, count[0] :]).all()


def test_what_cannot_be_simulated_is_refused_by_name() -> None:
    drag = slider((Own(lambda v, a: v * np.abs(a)),), [1.0])
    refuses(ModelError, "effort of Own depends on the acceleration", SimulatedArm.of, drag)
    robot = sdpid.load_robot(TREE, root="free_flyer")
    refuses(ModelError, "floating base", SimulatedArm.of, model_of(robot))
    arm, two = SimulatedArm.of(slider()), np.zeros((1, 2))
    refuses(DataError, r"position: shape \(1, 2\), expected \(1, 1\)", arm.dynamics, two, two, two)


# Closed loops move as SciPy says, and controllers give what their formulas say.


KP, KD, KI = np.array([90.0, 60.0]), np.array([9.0, 6.0]), np.array([50.0, 40.0])
RATE, SECONDS = 500.0, 0.6
TIMES = np.arange(0.0, SECONDS + 1e-9, 1.0 / RATE)
SPEEDS = np.array([3.0, 5.0])
LIMITED = PD(KP, KD, effort_limit=np.array([6.0, 3.0]))


def reference(time: Array) -> tuple[Array, Array, Array]:
    """Return position, velocity and acceleration of a motion."""
    angle = np.atleast_1d(time)[:, None] * SPEEDS
    return 0.5 * np.sin(angle), 0.5 * SPEEDS * np.cos(angle), -0.5 * SPEEDS**2 * np.sin(angle)


def inverse() -> ComputedTorque:
    """Return computed torque of another arm, with friction that jumps."""
    other = planar(("viscous", "coulomb", "rotor_inertia"), [0.5, 0.4, 0.3, 0.2, 0.1, 0.2], 1.3)
    return ComputedTorque(other, np.full(2, 100.0), np.full(2, 20.0))


LAWS = (
    P(KP / KD, KD, feedforward=True),
    LIMITED,
    PID(KP, KI, KD),
    ComputedTorque(planar(scale=1.3), np.full(2, 100.0), np.full(2, 20.0)),
)


def moved(law: Any, told: Any = None, **options: Any) -> closed_loop.Motion:
    """Return the motion of the arm along the reference."""
    told = reference(TIMES) if told is None else told
    return simulate_closed_loop(planar(), told, law, **({"rate_hz": RATE} | options))


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_the_motion_is_that_of_scipy(law: Controller) -> None:
    arm = planar()

    def slope(time: float, x: Array) -> Array:
        q, v, integral = x[:2], x[2:4], x[4:]
        told = reference(np.array([time]))
        effort = law.effort(q[None], v[None], *told, integral[None])[0]
        return np.concatenate([v, arm.forward_dynamics(q, v, effort), told[0][0] - q])

    start = np.concatenate([np.zeros(2), reference(np.zeros(1))[1][0], np.zeros(2)])
    true = solve_ivp(slope, (0.0, SECONDS), start, rtol=1e-8, atol=1e-9, t_eval=TIMES).y.T
    told, motion = reference(TIMES), moved(law)
    tracking = np.abs(true[:, :2] - told[0]).max()
    assert motion.diverged is None
    assert np.abs(motion.position - true[:, :2]).max() < 5e-3 * tracking
    effort = law.effort(true[:, :2], true[:, 2:4], *told, true[:, 4:])
    assert np.abs(motion.effort - effort).max() < 1e-2 * np.abs(effort).max()
    residual = arm.inverse_dynamics(motion.position, motion.velocity, motion.acceleration)
    np.testing.assert_allclose(residual, motion.effort, atol=1e-9)


def test_the_loops_do_the_same_without_a_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    arm, told = SimulatedArm.of(rubbing(5)), tuple(each[:20] for each in reference(TIMES))
    q, v, effort = np.random.default_rng(0).normal(size=(3, 2, 3))
    found: list[list[Array]] = []
    for entries in (linked.entries, lambda: loops):
        for module in (arm_module, closed_loop):
            monkeypatch.setattr(module, "entries", entries)
        efforts = np.repeat(effort[:, None], 20, axis=1)
        open_ones = arm.run(np.stack([q, v])[:, :, None], efforts, 2e-3)
        found.append([*arm.dynamics(q, v, effort), open_ones])
        for law in (inverse(), PID(KP, KI, KD, effort_limit=np.array([2.0, 1.0]))):
            for options in ({}, {"control_hz": 500.0, "position_noise": 1e-5}):
                motion = moved(law, told, **options)
                found[-1] += [motion.position, motion.effort]
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-5, atol=1e-7)


class OwnController(Controller):
    """A law that is not compiled."""

    n = 2

    def effort(self, *states: ArrayLike | None) -> Array:
        return PD(KP, KD).effort(*states)

    def slopes(self, *states: ArrayLike | None) -> tuple[Array, Array]:
        return PD(KP, KD).slopes(*states)


def test_a_controller_in_python_moves_the_arm_as_a_compiled_one() -> None:
    told = reference(TIMES[:60])
    options = {"control_hz": 1000.0, "position_noise": 1e-5, "seed": 3}
    one, other = (moved(law, told, **options) for law in (PD(KP, KD), OwnController()))
    np.testing.assert_allclose(other.position, one.position, atol=1e-6)
    np.testing.assert_allclose(other.effort, one.effort, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(other.measured - other.position, one.measured - one.position)
    away = ([1e300, 0.0], [0.0, 0.0])
    with np.errstate(all="ignore"):
        assert moved(OwnController(), told, start=away).diverged == 0.0


def test_held_efforts_become_continuous_ones_and_noise_is_seeded() -> None:
    law = PD(KP, KD)
    smooth, slow, fast = (moved(law, control_hz=hz).position for hz in (None, 1000.0, 4000.0))
    assert 3.0 < np.abs(slow - smooth).max() / np.abs(fast - smooth).max() < 5.0
    one, same, other = (
        moved(law, control_hz=5000.0, position_noise=1e-5, seed=seed) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one.effort, same.effort)
    assert np.abs(one.effort - other.effort).max() > 1e-2
    assert (one.measured - one.position).std() == pytest.approx(1e-5, rel=0.2)
    # Samples between steps lie on the motion.
    part = reference(TIMES)[0][::7]
    log = sdpid.Recording(time=TIMES[::7], position=part, effort=0.0 * part, reference=part)
    coarse = moved(law, log, control_hz=4321.0)
    np.testing.assert_array_equal(coarse.time, log.time)
    np.testing.assert_allclose(coarse.position, fast[::7], atol=2e-3)


def test_an_unstable_loop_ends_where_it_diverges() -> None:
    told, options = np.ones((500, 1)), {"rate_hz": 100.0, "control_hz": 100.0}
    law, start = PD([1e6], [0.0]), ([0.0], [0.0])
    motion = simulate_closed_loop(slider(), told, law, start=start, **options)
    assert motion.diverged is not None
    assert len(motion.time) < 500
    assert np.isfinite(motion.position).all()
    assert "diverged=0." in repr(motion)


def test_what_does_not_fit_is_told_before_the_simulation() -> None:
    law, told = PD(KP, KD), reference(TIMES)
    silent = sdpid.Recording(time=TIMES, position=told[0], effort=told[0])
    for arguments, options, message in (
        ((law, told), {"rate_hz": None}, "rate_hz: missing"),
        ((PD([1.0], [1.0]),), {}, "gains of 1 joints"),
        ((3.0,), {}, "controller: float is none"),
        ((law, told[0][:, :1]), {}, "reference: 1 joints, the robot has 2"),
        ((law, told[:2]), {}, "reference: 2 arrays"),
        ((law, silent), {}, "no commanded positions"),
        ((law,), {"position_noise": 1e-4}, "set control_hz"),
        ((law,), {"position_noise": [-1.0, 0.0], "control_hz": 1e3}, "not negative"),
        ((law,), {"differenced": True}, "set control_hz"),
        ((law,), {"step": -1.0}, "step is -1.0"),
        ((law,), {"step": "long"}, "step is 'long'"),
        ((law,), {"start": ([0.0], [0.0])}, "start: has shape"),
    ):
        refuses(DataError, message, moved, *arguments, **options)


@pytest.mark.parametrize("law", [*LAWS, inverse(), PID(KP, KI, KD, feedforward=False)], ids=repr)
def test_slopes_are_those_of_the_effort(law: Controller) -> None:
    states = np.random.default_rng(1).normal(size=(6, 5, 2))
    for which, slope in enumerate(law.slopes(*states)):
        for j, h in enumerate(1e-6 * np.eye(2)):
            step = np.zeros((6, 1, 2))
            step[which] = h
            off = law.effort(*(states + step)) - law.effort(*(states - step))
            np.testing.assert_allclose(slope[:, :, j], off / 2e-6, rtol=1e-6, atol=1e-5)


def test_the_formulas() -> None:
    q, v, qd, vd, integral = np.random.default_rng(2).normal(size=(5, 3, 2))
    p, pd, limited, pid = (
        law.effort(q, v, qd, vd, None, integral)
        for law in (P(KP, KD), PD(KP, KD), LIMITED, PID(KP, KI, KD, feedforward=False))
    )
    np.testing.assert_allclose(p, KD * (KP * (qd - q) - v))
    np.testing.assert_allclose(pd, KP * (qd - q) + KD * (vd - v))
    np.testing.assert_allclose(limited, np.clip(pd, [-6.0, -3.0], [6.0, 3.0]))
    np.testing.assert_allclose(pid, KP * (qd - q) - KD * v + KI * integral)
    law = inverse()
    expected = law.model.inverse_dynamics(q, v, qd)
    np.testing.assert_allclose(law.effort(q, v, q, v, qd), expected)


def test_bad_gains_and_samples_are_told() -> None:
    zero, few = np.zeros((3, 2)), np.zeros((2, 2))
    other, ones = inverse().model, np.ones(3)
    for words, call, given_ in (
        (r"kp is .* give positive numbers", PD, ([0.0, 1.0], [1.0, 1.0])),
        ("lengths differ", PD, ([1.0, 1.0], [1.0])),
        ("integral is missing", PID(KP, KI, KD).effort, [zero] * 4),
        (r"velocity: shape \(2, 2\), expected \(3, 2\)", LIMITED.effort, (zero, few, zero, zero)),
        ("of 3 joints, the model", ComputedTorque, (other, ones, ones)),
    ):
        refuses(DataError, words, call, *given_)
    assert repr(PD(KP, KD)) == "PD(2 joints, kp 60 to 90, kd 6 to 9)"
    assert "kp" in PD(KP, KD)._repr_html_()


# Gains of controllers from logs of loops whose gains are known.


LOG_RATE = 500.0
TRUE_KP, TRUE_KD = np.array([900.0, 300.0]), np.array([60.0, 12.0])
FITTED = {
    "p": P(np.array([6.0, 9.0]), TRUE_KD),
    "pd": PD(TRUE_KP, TRUE_KD),
    "pd damped": PD(TRUE_KP, TRUE_KD, feedforward=False),
    "pid": PID(TRUE_KP, 3.0 * TRUE_KP, TRUE_KD),
}


@cache
def heavy_log(name: str) -> sdpid.Recording:
    """Return a log of a heavy arm under a law, without noise."""
    robot = sdpid.RobotModel.from_mdh(
        [{"r": 0.3, "alpha": 0.4}, {"alpha": -np.pi / 2, "d": 0.4}], name="arm"
    )
    bodies = 4.0 * random_links(np.random.default_rng(1), 2)
    model = model_of(robot, ("coulomb", "viscous"), [4.0, 2.0, 3.0, 1.5], bodies)
    omega = 2.0 * np.pi * np.array([[0.21, 0.43], [0.64, 0.33]])
    time = np.arange(0.0, 12.0, 1.0 / LOG_RATE)
    told = 0.5 * sum(np.sin(np.outer(time, w) + k) for k, w in enumerate(omega))
    found = sdpid.simulate_closed_loop(model, told, FITTED[name], rate_hz=LOG_RATE)
    columns = {"position": found.position, "effort": found.effort, "reference": told}
    return sdpid.Recording(time=found.time, joint_names=robot.joint_names, **columns)


def logged(name: str, noise: float = 1e-5, of_effort: float = 0.01, seed: int = 0) -> Any:
    """Return the log with noise on positions, which the controller did not see, and on efforts."""
    log, rng = heavy_log(name), np.random.default_rng(seed)
    white = rng.standard_normal((2, *np.shape(log.position)))
    effort = log.effort + of_effort * np.std(log.effort, axis=0) * white[1]
    return replace(log, position=log.position + noise * white[0], effort=effort)


@pytest.mark.parametrize("name", FITTED)
def test_gains_are_found_within_their_deviations(name: str):
    law, kind = FITTED[name], name.split()[0]
    fitted = fit_controller(logged(name), kind)
    assert fitted.usable, fitted.reasons
    assert type(fitted.require()) is type(law)
    assert fitted.feedforward == law.feedforward
    for gain, found in fitted.gains.items():
        off = np.abs(found / getattr(law, gain) - 1.0)
        # The integral of the simulated loop is a step of 1 ms ahead.
        assert np.all(off < 4.0 * fitted.deviations[gain] + (4e-3 if name == "pid" else 1e-3))
        assert np.all(off < 0.03)


def test_deviations_are_those_of_many_logs():
    scores = []
    for seed in range(30):
        fitted = fit_controller(logged("pd", 1e-3, 0.02, seed), "pd")
        for gain, found in fitted.gains.items():
            scores.append((found / getattr(FITTED["pd"], gain) - 1.0) / fitted.deviations[gain])
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.6


def test_a_late_effort_has_a_delay():
    log = logged("pd")
    late = replace(log, effort=np.roll(log.effort, 3, axis=0))
    assert fit_controller(late).delay == pytest.approx(3.0 / LOG_RATE, rel=0.1)


@pytest.mark.parametrize(
    ("name", "kind", "noise", "size", "words"),
    [
        ("pd", "pd", 0.1, 1.0, "not known well enough: .*(deviation of|explains)"),
        ("pid", "pd", 1e-5, 1.0, "fit kind='pid'"),
        ("pid", "p", 1e-5, 1.0, "fit kind='pid'"),
        ("pd", "pd", 1e-5, 0.0, "does not show whether the commanded velocity .* positive"),
    ],
)
def test_what_the_log_does_not_show_is_refused(
    name: str, kind: str, noise: float, size: float, words: str
):
    log = logged(name, noise)
    fitted = fit_controller(replace(log, effort=size * log.effort), kind)
    assert not fitted.usable
    refuses(DataError, words, fitted.require)


def test_the_loop_of_the_simulated_robot_is_found():
    robot, drives = sdpid.load_robot("denso_vp6242"), load_drives("denso_vp6242")
    motion = sdpid.paper_excitation("denso_vp6242", seed=0, periods=1, period=10.0)
    fitted = fit_controller(sdpid.simulate(robot, motion, seed=1), "p")
    assert fitted.usable
    for gain, found in fitted.gains.items():
        # Joint 6 is the noisiest: its deviations are some percent.
        off = np.abs(found / getattr(drives, gain) - 1.0)
        assert np.all(off < np.where(np.arange(6) < 5, 5e-3, 4.0 * fitted.deviations[gain]))
    assert fitted.to_dict()["usable"] is True
    assert "usable" in fitted.describe()
    assert len(repr(fitted)) < 160
    assert "<table" in fitted._repr_html_()


def test_what_cannot_be_fitted_is_told_before():
    log = logged("pd")
    names = ("time", "position", "effort", "reference")
    short = sdpid.Recording(**{name: getattr(log, name)[:400] for name in names})
    for log_, options, words in (
        (log, {"kind": "lqr"}, "lqr is not known; known are p, pd"),
        (replace(log, reference=None), {}, "no commanded positions"),
        (replace(log, currents=True), {}, "efforts are currents in A"),
        (log, {"cutoff_hz": 400.0}, "expected at most 50 Hz"),
        (log, {"cutoff_hz": "3"}, "cutoff_hz: is '3', expected"),
        ("run.csv", {}, "recording: is 'run.csv'; give a Recording"),
        (short, {}, "at least 200 are needed"),
    ):
        refuses(DataError, words, fit_controller, log_, **options)


# Stretches of a recording move as SciPy integrates them.


def test_stretches_converge_to_scipy_with_second_order() -> None:
    kinds = (terms.Coulomb(width=0.3), "viscous", terms.SigmoidFriction(velocity=0.5))
    model = planar(kinds, np.random.default_rng(2).uniform(0.2, 0.8, 6))
    arm, free, errors = SimulatedArm.of(model), np.ones((2, 2), bool), []

    def effort(t: np.ndarray | float) -> np.ndarray:
        return np.array([3.0, -1.0]) * np.sin(2.0 * np.asarray(t)[..., None] + [0.0, 1.0])

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        return np.concatenate([x[2:], model.forward_dynamics(x[:2], x[2:], effort(t))])

    start, time = np.array([0.3, -0.4, 0.5, 1.0]), np.arange(0.0, 1.001, 0.01)
    exact = solve_ivp(rate, (0.0, 1.0), start, t_eval=time, rtol=1e-9, atol=1e-10).y.T
    states = {"position": exact[:, :2], "velocity": exact[:, 2:], "acceleration": exact[:, 2:]}
    samples = sdpid.Samples(effort=effort(time), time=time, **states)
    for step in (0.005, 0.0025):
        track = Track.of(samples, step=step)
        assert track.step == pytest.approx(step)
        first, after = np.array([0, round(0.3 / step)]), [track.steps(0.1), track.steps(0.5)]
        found = simulate_stretches(arm, track, first, free, after)
        measured = track.position[first[:, None] + after]
        errors.append(np.abs(found - measured).max())
    assert errors[0] < 2e-3
    assert 3.5 < errors[0] / errors[1] < 4.5
    # A joint that is not free is on the record.
    free[:, 0] = False
    found = simulate_stretches(arm, track, first, free, after)
    assert np.array_equal(found[:, :, 0], measured[:, :, 0])
    assert np.abs(found - measured).max() < 2e-3


def test_starts_stay_within_pieces() -> None:
    time, zero = np.concatenate([np.arange(50), 80 + np.arange(30)]) / 50.0, np.zeros((80, 1))
    states = {"position": time[:, None], "velocity": zero + 1.0, "acceleration": zero}
    track = Track.of(sdpid.Samples(effort=zero, time=time, starts=(0, 50), **states))
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


TIME = np.arange(0.0, 2.0, 1.0 / 2000.0)
TOLD = np.stack([0.8 * np.sin(2.1 * TIME) ** 2, 0.6 * (1.0 - np.cos(3.3 * TIME))], axis=1)
SMOOTH, SOFT = ("viscous", "rotor_inertia", "offset"), PD([60.0, 30.0], [6.0, 3.0])


@pytest.mark.parametrize(
    ("friction", "law", "limit"),
    [
        pytest.param(SMOOTH, SOFT, 2e-4, id="smooth"),
        pytest.param(SMOOTH, PID([60.0, 30.0], [90.0, 40.0], [6.0, 3.0]), 2e-3, id="integral"),
        # Reversals fall between instants: right to a share of a step of the loop.
        pytest.param(("coulomb", "viscous"), SOFT, 2e-2, id="sticking"),
        pytest.param((terms.Coulomb(width=0.2),), SOFT, 2e-4, id="smooth sign"),
    ],
)
def test_they_are_the_differences_of_motions(friction: Any, law: Any, limit: float) -> None:
    model = planar(friction, np.full(2 * len(friction), 0.4))

    def motion(theta: Array) -> closed_loop.Motion:
        return simulate_closed_loop(replace(model, theta=theta), TOLD, law, rate_hz=2000.0)

    base, own = structural_base(model.robot, model.terms), motion(model.theta)
    told = np.gradient(TOLD, TIME, axis=0)
    integral = cumulative_trapezoid(TOLD - own.position, TIME, axis=0, initial=0.0)
    states = (own.position, own.velocity, TOLD, told, 0.0 * TOLD, integral)
    found = sensitivities(model, base, law, TIME, states)
    few = sensitivities(model, base, law, TIME, states, every=3)
    np.testing.assert_array_equal(few, found[::3])
    for k, place in enumerate(base.kept):
        step = np.zeros_like(model.theta)
        step[place] = 1e-4
        ahead, behind = (motion(model.theta + s * step).position for s in (1.0, -1.0))
        difference = (ahead - behind) / 2e-4
        off = np.linalg.norm(found[:, :, k] - difference) / np.linalg.norm(difference)
        assert off < limit, base.names[k]
