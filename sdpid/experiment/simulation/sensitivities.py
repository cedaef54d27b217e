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

from collections.abc import Sequence

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.experiment.simulation.controllers import Controller, inverse_dynamics_slopes
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


def sensitivities(
    model: RobotDynamics,
    base: BaseParameters,
    controller: Controller,
    time: Array,
    states: Sequence[Array],
    *,
    every: int = 1,
) -> Array:
    """Return the derivative of the positions by the base parameters, (N / every, n, b).

    The motion starts from the same state whatever the parameters are.

    Parameters
    ----------
    model : RobotDynamics
        The robot that moved.
    base : BaseParameters
        Its base parameters, b.
    controller : Controller
        What moved it.
    time : ndarray, shape (N,)
        Instants in s, close enough together to follow the controlled arm.
    states : sequence of 6 ndarrays, shape (N, n)
        What the controller's effort depends on, in the order of its arguments.
    every : int, optional
        Of how many instants one is returned, from the first on; by default all.
    """
    arm = SimulatedArm.of(model)
    jumps = _jumps(arm)
    (count, n), gains = states[0].shape, getattr(controller, "gains", None)
    integral = np.zeros(n) if gains is None else gains.integral
    # The effort of these states: a held one is that of the last period.
    acting = (*states[:2], controller.effort(*states), *controller.slopes(*states))
    out = np.zeros((len(time[::every]), n, base.count))
    state = np.zeros((4 * n, base.count))
    M, _, _, Y, v, a = _linearized(arm, base, [each[:1] for each in acting], jumps)
    # At rest the arm changes first in its accelerations.
    held = (v[0] == 0.0) & (a[0] == 0.0)
    M[0, held], Y[0, held] = 0.0, 0.0
    M[0, held, held] = 1.0
    state[2 * n : 3 * n] = -np.linalg.solve(M[0], Y[0])
    for start in range(0, count - 1, _CHUNK):
        part = slice(start, start + _CHUNK + 1)
        linear = _linearized(arm, base, [each[part] for each in acting], jumps)
        steps = np.diff(time[part])
        for k, (T, G) in enumerate(zip(*_transitions(linear, steps, integral, jumps), strict=True)):
            state = T @ state + G
            row, between = divmod(start + k + 1, every)
            if not between:
                out[row] = state[:n]
    return out


def _linearized(
    arm: SimulatedArm, base: BaseParameters, acting: Sequence[Array], jumps: Array
) -> tuple[Array, ...]:
    """Return M, C, K, Y of M·S'' + C·S' + K·S + ki·∫S = −Y at instants, velocity, acceleration."""
    q, v, effort, stiffness, damping = acting
    # A joint that sticks keeps a velocity of rounding.
    v = np.where((np.abs(v) <= _RESTS) & (jumps > 0.0), 0.0, v)
    M, _, a = arm.dynamics(q, v, effort)
    by_position, by_velocity, _ = inverse_dynamics_slopes(arm.model, q, v, a)
    C = by_velocity + _friction_slopes(arm.model, v) - damping
    return M, C, by_position - stiffness, base_regressor(arm.model, base, q, v, a), v, a


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
    robot, terms, first = model.robot, model.terms, model.terms.first
    motion = FrictionMotion(
        position=q, velocity=v[:, first:], acceleration=a[:, first:], robot=robot
    )
    columns = np.concatenate([robot.regressor(q, v, a), terms.columns_in(motion)], axis=2)
    return np.asarray(columns[:, :, base.kept])


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


def _jumps(arm: SimulatedArm) -> Array:
    """Return by how much each joint's friction jumps at zero velocity, (n,), N·m."""
    (joint, other), (speed, low, high) = arm.arrays.contacts.T[:2], arm.arrays.jumps.T[:3]
    here = (other < 0) & (speed == 0.0)
    return np.asarray(np.bincount(joint[here], high[here] - low[here], arm.n), dtype=np.float64)
