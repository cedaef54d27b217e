"""Closed loops move as SciPy and MuJoCo say."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp

import sdpid
from sdpid._common.arrays import Array
from sdpid.controllers import PD, PID, ComputedTorque, Controller, P
from sdpid.errors import DataError
from sdpid.experiment.plant.drives import load_drives
from sdpid.experiment.plant.simulate import true_parameters
from sdpid.experiment.simulation.closed_loop import simulate_closed_loop
from sdpid.friction import Coulomb
from sdpid.robot.model.dynamics import RobotDynamics
from tests.experiment.simulation.models import model_of, slider
from tests.helpers.data import random_links
from tests.helpers.refusals import refuses
from tests.helpers.robots import planar_arm

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


def test_the_motion_is_that_of_the_plant_on_mujoco() -> None:
    pytest.importorskip("mujoco")
    robot = sdpid.load_robot("denso_vp6242")
    theta = true_parameters("denso_vp6242")
    theta[60:66] = 0.0  # MuJoCo's dry friction creeps
    drives = load_drives("denso_vp6242")
    trajectory = sdpid.paper_excitation("denso_vp6242", seed=0, periods=2, period=10.0)
    log = sdpid.simulate(robot, trajectory, theta=theta, noise=False)
    law = P(drives.proportional_gain, drives.velocity_gain)
    arm = model_of(robot, ("coulomb", "viscous"), theta[60:], theta[:60])
    motion = simulate_closed_loop(arm, trajectory, law)
    last = slice(trajectory.lead_samples + 10_000, trajectory.lead_samples + 20_000)
    # MuJoCo's integrated command leads by half of a sample.
    off = np.abs(motion.position[last] - log.position[last]).max()
    assert off < 2e-3 * np.ptp(log.position[last])


class Own(Controller):
    """A law that is not compiled."""

    def __init__(self, law: PD) -> None:
        self.law = law

    @property
    def n(self) -> int:
        return self.law.n

    def effort(self, *states: ArrayLike | None) -> Array:  # type: ignore[override]
        return self.law.effort(*states)  # type: ignore[arg-type]

    def slopes(self, *states: ArrayLike | None) -> tuple[Array, Array]:  # type: ignore[override]
        return self.law.slopes(*states)  # type: ignore[arg-type]


def test_the_integral_of_a_sample_ends_at_the_sample() -> None:
    law = PID(KP, KI, KD)
    moved = simulate_closed_loop(model(), reference(TIMES), law, rate_hz=RATE)
    told = reference(moved.time)
    error = told[0] - moved.position
    sums = np.cumsum(0.5 / RATE * (error[1:] + error[:-1]), axis=0)
    integral = np.concatenate([np.zeros((1, 2)), sums])
    expected = law.effort(moved.position, moved.velocity, *told, integral)
    ahead = (KI * error).max() * 1e-3
    np.testing.assert_allclose(moved.effort, expected, atol=0.1 * ahead)


def test_a_controller_in_python_moves_the_arm_as_a_compiled_one() -> None:
    law, told = PD(KP, KD), reference(TIMES[:60])
    options = {"rate_hz": RATE, "control_hz": 1000.0, "position_noise": 1e-5, "seed": 3}
    one, other = (simulate_closed_loop(model(), told, each, **options) for each in (law, Own(law)))
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
    log = sdpid.Recording(
        time=TIMES[::7] * 1.0, position=told[0][::7], effort=np.zeros_like(told[0][::7])
    )
    log = replace(log, reference=told[0][::7])
    coarse = simulate_closed_loop(model(), log, law, control_hz=4321.0)
    np.testing.assert_array_equal(coarse.time, log.time)
    np.testing.assert_allclose(coarse.position, fine.position[::7], atol=2e-3)


def test_an_unstable_loop_ends_where_it_diverges() -> None:
    law = PD([1e6], [0.0])
    motion = simulate_closed_loop(
        slider((), ()),
        np.ones((500, 1)),
        law,
        rate_hz=100.0,
        control_hz=100.0,
        start=([0.0], [0.0]),
    )
    assert motion.diverged is not None
    assert len(motion.time) < 500
    assert np.isfinite(motion.position).all()
    assert "diverged at" in repr(motion)


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
        with pytest.raises(DataError, match=message):
            simulate_closed_loop(model(), *arguments, **options)  # type: ignore[arg-type]
    silent = sdpid.Recording(time=TIMES, position=told[0], effort=told[0])
    refuses(DataError, "no commanded positions", simulate_closed_loop, model(), silent, law)
