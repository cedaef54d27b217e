"""Let go of a simulated arm: no motor helps, gravity and friction act."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import sdpid

# A joint this fast, rad/s, is no robot's: 160 turns a second. Without stops the wrist of a falling
# arm does whip round at tens of rad/s, as the last link of a multiple pendulum does.
DIVERGED = 1000.0

# Relative and absolute tolerance of the integration; a tenth of both changes no time at which one
# of the five arms diverges by more than 0.1 %.
TOLERANCES = 1e-4, 1e-6

# Seconds between the postures that are kept.
GRID = 2e-3

# Of times, s.
ROUNDING = 1e-12


@dataclass(frozen=True)
class Fall:
    """Motion of a released arm.

    Attributes
    ----------
    time : ndarray, shape (K,)
        Seconds, up to where the arm diverges.
    position : ndarray, shape (K, n)
        Joint positions, rad.
    speed : ndarray, shape (K,)
        The fastest joint's speed, rad/s.
    diverged : float or None
        When a joint is faster than `DIVERGED`, or no acceleration is left; None where none is.
    """

    time: np.ndarray
    position: np.ndarray
    speed: np.ndarray
    diverged: float | None


def release(model: Any, q: np.ndarray, duration: float) -> Fall:
    """Simulate an arm that is let go of at rest in posture q (n,), rad, for some seconds.

    The effort is the identified offset, the zero error of the torque sensors, so that the motors
    do no work. Nothing else than the estimate's own equations acts: no stops, no contact.
    """
    from scipy.integrate import Radau

    n = len(q)
    effort = model.friction(np.zeros(n))

    def rates(_: float, state: np.ndarray) -> np.ndarray:
        rows = np.atleast_2d(state.T)
        position, velocity = rows[:, :n], rows[:, n:]
        tau = np.broadcast_to(effort, velocity.shape)
        rate = np.hstack([velocity, model.forward_dynamics(position, velocity, tau)])
        return np.asarray(rate.T.reshape(state.shape))

    relative, absolute = TOLERANCES
    start = np.concatenate([q, np.zeros(n)])
    # Implicit, for friction at rest is stiff.
    solver = Radau(rates, 0.0, start, duration, rtol=relative, atol=absolute, vectorized=True)
    states, diverged = [start], None
    while solver.status == "running" and diverged is None:
        try:
            solver.step()
        except (sdpid.errors.ModelError, ValueError):
            # No acceleration follows from the effort, or none that is finite.
            diverged = float(solver.t)
            break
        state = solver.dense_output()
        while len(states) * GRID <= solver.t + ROUNDING:
            states.append(state(len(states) * GRID))
        if solver.status == "failed" or not np.abs(solver.y[n:]).max() < DIVERGED:
            diverged = float(solver.t)
    found = np.array(states)
    speed = np.abs(found[:, n:]).max(axis=1)
    return Fall(GRID * np.arange(len(found)), found[:, :n], speed, diverged)


def skeleton(robot: sdpid.RobotModel, positions: np.ndarray) -> np.ndarray:
    """Return where the joints and the tool are, (K, points, 3), m, at positions (K, n)."""
    import pinocchio as pin

    model = robot.pin_model
    data = model.createData()
    shapes = []
    for q in positions:
        pin.framesForwardKinematics(model, data, q)
        joints = [data.oMi[i].translation for i in range(model.njoints)]
        shapes.append(np.array([*joints, data.oMf[model.nframes - 1].translation]))
    return np.array(shapes)
