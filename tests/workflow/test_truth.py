"""The default estimate finds the friction that a clean log was simulated with."""

import numpy as np
import pytest

import sdpid
from tests.helpers.runs import arm

COULOMB, VISCOUS = np.array([3.0, 2.0]), np.array([2.5, 2.0])


def simulated(width: float) -> sdpid.Recording:
    """Return a log whose friction has a sign of this width (rad/s)."""
    rng = np.random.default_rng(1)
    robot = arm()
    time = np.arange(3000) / 100.0
    omega = 2.0 * np.pi * rng.uniform(0.04, 0.5, (6, robot.n))
    waves = np.exp(1j * (time[:, None, None] * omega + rng.uniform(0.0, 6.0, omega.shape)))
    q, v, a = (np.real(0.25 * waves * (1j * omega) ** k).sum(axis=1) for k in range(3))
    sign = np.tanh(v / width) if width else np.sign(v)
    effort = robot.inverse_dynamics(robot.prior, q, v, a) + COULOMB * sign + VISCOUS * v
    noise = 0.02 * rng.standard_normal(q.shape)
    return sdpid.Recording(time=time, position=q, effort=effort + noise)


@pytest.mark.parametrize("width", [0.0, 0.01, 0.05])
def test_friction_curves_are_right_whatever_the_width_of_the_sign(width: float) -> None:
    estimate = sdpid.identify(arm(), simulated(width), intervals=False).estimate
    friction = estimate.problem.friction
    for speed in (0.1, 0.3, 1.0):
        v = np.full((1, 2), speed)
        curve = [friction.columns(s * v, 0.0 * v)[0] for s in (1.0, -1.0)]
        tail = estimate.theta[-len(friction.parameters) :]
        found = 0.5 * (curve[0] - curve[1]) @ tail
        sign = np.tanh(speed / width) if width else 1.0
        np.testing.assert_allclose(found, COULOMB * sign + VISCOUS * speed, rtol=0.005)
