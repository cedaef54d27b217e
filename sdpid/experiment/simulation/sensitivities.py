"""How the motion of a controlled arm changes with its base parameters.

Along a motion the equations of motion are linear in small changes. With the inverse dynamics
``tau(q, v, a, base)`` and the controller ``u(q, v)`` the change S = dq/dbase obeys::

    M·S'' + (dtau/dv − du/dv)·S' + (dtau/dq − du/dq)·S + ki·∫S = −Y,

where Y is the regressor of the motion. So all base parameters share one linear recursion over the
motion's time stamps: the trapezoidal rule, which damps nothing and is stable for stiff controllers.
A joint that passes through zero velocity while dry friction changes sides changes speed by another
amount than its neighbor motion, which passes a little earlier or later: the rates jump there by the
saltation matrix [leine2004]_. A joint that friction holds does not change at all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.experiment.simulation.controllers import inverse_dynamics_slopes
from sdpid.robot.friction.term import SampledMotion as FrictionMotion
from sdpid.robot.model.base_parameters import BaseParameters
from sdpid.robot.model.dynamics import RobotDynamics

# Velocity (rad/s or m/s) below which a joint is at rest: what sticks is set to zero exactly.
_RESTS = 1e-9

# Step of velocity (rad/s or m/s) for the slopes of friction, away from its jump at zero: small
# beside any width of a smooth sign, large beside rounding.
_NUDGE = 1e-6

# Instants handled at a time, whose transition matrices are held together.
_CHUNK = 1024


@dataclass(frozen=True, kw_only=True, eq=False)
class ControlledMotion:
    """What acts along a motion: its states, and how the controller answers them.

    Attributes
    ----------
    time : ndarray, shape (N,)
        Instants in s, close enough together to follow the controlled arm.
    position, velocity, effort : ndarray, shape (N, n)
        The motion, and the controller's effort.
    stiffness, damping : ndarray, shape (N, n, n)
        Derivatives of the controller's effort by position and velocity.
    integral : ndarray, shape (n,)
        Minus the effort per integrated position, in N·m/(rad·s): the gain ki of a PID controller.
    """

    time: Array
    position: Array
    velocity: Array
    effort: Array
    stiffness: Array
    damping: Array
    integral: Array


def sensitivities(
    model: RobotDynamics, base: BaseParameters, loop: ControlledMotion, *, at: Indices | None = None
) -> Array:
    """Return the derivative of the positions by the base parameters, (N, n, b).

    The motion starts from the same state whatever the parameters are.

    Parameters
    ----------
    model : RobotDynamics
        The robot that moved.
    base : BaseParameters
        Its base parameters, b.
    loop : ControlledMotion
        Its motion, and its controller.
    at : ndarray of int, optional
        Rising numbers of the instants to return; by default all.
    """
    arm = SimulatedArm.of(model)
    count, n = loop.position.shape
    wanted = np.arange(count) if at is None else at
    out = np.empty((len(wanted), n, base.count))
    state = np.zeros((4 * n, base.count))
    jumps = _jumps(model)
    M, _, _, Y, v, a = _linearized(arm, base, loop, slice(0, 1), jumps)
    # At rest the arm changes first in its accelerations.
    held = (v[0] == 0.0) & (a[0] == 0.0)
    M[0, held], Y[0, held] = 0.0, 0.0
    M[0, held, held] = 1.0
    state[2 * n : 3 * n] = -np.linalg.solve(M[0], Y[0])
    row = 0
    if len(wanted) and wanted[0] == 0:
        out[0] = 0.0
        row = 1
    for start in range(0, count - 1, _CHUNK):
        part = slice(start, min(start + _CHUNK, count - 1) + 1)
        linear = _linearized(arm, base, loop, part, jumps)
        steps = np.diff(loop.time[part])
        transition, forced = _transitions(linear, steps, loop.integral, jumps)
        for k in range(len(steps)):
            state = transition[k] @ state + forced[k]
            if row < len(wanted) and wanted[row] == start + k + 1:
                out[row] = state[:n]
                row += 1
    return out


def _linearized(
    arm: SimulatedArm, base: BaseParameters, loop: ControlledMotion, part: slice, jumps: Array
) -> tuple[Array, ...]:
    """Return M, C, K, Y of M·S'' + C·S' + K·S + ki·∫S = −Y at instants, velocity, acceleration."""
    q, v, effort = loop.position[part], loop.velocity[part], loop.effort[part]
    model = arm.model
    # A joint that sticks keeps a velocity of rounding.
    v = np.where((np.abs(v) <= _RESTS) & (jumps > 0.0), 0.0, v)
    a = arm.acceleration(q, v, effort)
    M, _ = arm.mass_and_bias(q, v)
    by_position, by_velocity = inverse_dynamics_slopes(model, q, v, a)
    C = by_velocity + _friction_slopes(model, v) - loop.damping[part]
    return M, C, by_position - loop.stiffness[part], base_regressor(model, base, q, v, a), v, a


def _transitions(
    linear: tuple[Array, ...], steps: Array, integral: Array, jumps: Array
) -> tuple[Array, Array]:
    """Return T (k, 4n, 4n) and G (k, 4n, b): the next (S, S', S'', ∫S) is ``T @ now + G``."""
    masses, v, a = linear[0], linear[4], linear[5]
    count, n = len(steps), v.shape[1]
    rests = v == 0.0
    turns = (v[:-1] * v[1:] < 0.0) & (jumps > 0.0)
    held = rests[1:] & (jumps > 0.0)
    enters, leaves = held & ~rests[:-1], rests[:-1] & ~held & (jumps > 0.0)
    # Accelerations of before count for nothing where friction has jumped.
    new = (turns | enters | leaves).any(axis=1)
    P = _saltations(masses, v, a, jumps, turns, enters)
    h = steps[:, None, None]
    gamma = np.where(new, 1.0, 0.5)[:, None, None]
    beta = np.where(new, 0.5, 0.25)[:, None, None]
    M, C, K, Y = (each[1:].copy() for each in linear[:4])
    ki = np.tile(np.diag(integral), (count, 1, 1))
    for matrix in (M, C, K, Y, ki):
        matrix[held] = 0.0
    M[held, np.nonzero(held)[1]] = 1.0
    K = K + 0.5 * h * ki
    inverse = np.linalg.inv(M + gamma * h * C + beta * h**2 * K)
    E, none = np.broadcast_to(np.eye(n), (count, n, n)), np.zeros((count, n, n))
    # What S and S' come to without the new acceleration, by blocks of the state.
    S = np.concatenate([E, h * P, (0.5 - beta) * h**2 * E, none], axis=2)
    V = np.concatenate([none, P, (1.0 - gamma) * h * E, none], axis=2)
    sums = np.concatenate([0.5 * h * E, none, none, E], axis=2)
    A, GA = -inverse @ (C @ V + K @ S + ki @ sums), -inverse @ Y
    S, GS = S + beta * h**2 * A, beta * h**2 * GA
    T = np.concatenate([S, V + gamma * h * A, A, sums + 0.5 * h * S], axis=1)
    return T, np.concatenate([GS, gamma * h * GA, GA, 0.5 * h * GS], axis=1)


def _saltations(M: Array, v: Array, a: Array, jumps: Array, turns: Mask, enters: Mask) -> Array:
    """Return what the rates S' are multiplied by before each step, (k, n, n)."""
    count, n = turns.shape
    P = np.tile(np.eye(n), (count, 1, 1))
    for k, j in zip(*np.nonzero(turns | enters), strict=True):
        before = a[k, j]
        if before == 0.0:
            continue
        mobility = np.linalg.inv(M[k])[:, j]
        # Friction opposes the new direction with as much as it opposed the old one.
        change = np.sign(v[k, j]) * jumps[j] * mobility
        if enters[k, j] or before * (before + change[j]) <= 0.0:
            change = -before / mobility[j] * mobility
        salted = np.eye(n)
        salted[:, j] += change / before
        P[k] = salted @ P[k]
        if enters[k, j]:
            P[k, j] = 0.0
    return P


def base_regressor(
    model: RobotDynamics, base: BaseParameters, q: Array, v: Array, a: Array
) -> Array:
    """Return the base regressor at an instant, (N, n, b), friction at these velocities."""
    robot, terms = model.robot, model.terms
    places = np.full(len(base.theta_names), -1, dtype=np.intp)
    places[base.kept] = np.arange(base.count)
    links = 10 * robot.n_links
    out = np.zeros((len(q), robot.n, base.count))
    robot.regressor_columns(q, v, a, places=places[:links], out=out)
    first = terms.first
    motion = FrictionMotion(
        position=q, velocity=v[:, first:], acceleration=a[:, first:], robot=robot
    )
    columns = terms.columns_in(motion)
    own = places[links:]
    out[:, :, own[own >= 0]] = columns[:, :, own >= 0]
    return out


def _friction_slopes(model: RobotDynamics, v: Array) -> Array:
    """Return the derivative (N, n, n) of friction by velocity, without its jumps at zero."""
    slopes = np.empty((*v.shape, v.shape[1]))
    for j in range(v.shape[1]):
        # Away from zero, where friction may jump.
        nudge = np.where(v[:, j] < 0.0, -_NUDGE, _NUDGE)
        start = v.copy()
        start[:, j] = np.where(v[:, j] == 0.0, nudge, v[:, j])
        moved = start.copy()
        moved[:, j] += nudge
        slopes[:, :, j] = (model.friction(moved) - model.friction(start)) / nudge[:, None]
    return slopes


def _jumps(model: RobotDynamics) -> Array:
    """Return by how much each joint's friction jumps at zero velocity, (n,), N·m."""
    n, found = model.robot.n, []
    for nudge in (_NUDGE**2, 2.0 * _NUDGE**2):
        moved = nudge * np.eye(n)
        found.append(np.diagonal(model.friction(moved) - model.friction(-moved)))
    # What grows with the velocity, however steeply, is none.
    jumps = 2.0 * found[0] - found[1]
    return np.asarray(np.where(jumps > 0.5 * found[0], np.maximum(jumps, 0.0), 0.0))
