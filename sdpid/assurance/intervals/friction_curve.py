"""Friction as a curve over speed, with its interval.

Beside a term of the same shape, such as a sigmoid, a coefficient of Coulomb friction says little,
however well the data determine the curve of both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen
from sdpid.errors import DataError
from sdpid.estimation.effects.bending import Bending
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.noise_spectrum import NoiseSpectrum
from sdpid.estimation.posterior import Posterior
from sdpid.estimation.problem import Problem
from sdpid.robot.friction.motion import Motion


@dataclass(frozen=True, kw_only=True, eq=False)
class FrictionCurve:
    """Friction of every joint at some speeds.

    Attributes
    ----------
    speed : ndarray, shape (s,)
        Speeds, rad/s or m/s.
    friction : ndarray, shape (s, joints)
        Half of what reversing the motion changes, N·m or N: offsets and asymmetry cancel.
    half_width : ndarray, shape (s, joints)
        Of its interval.
    level : float
        Stated probability.
    """

    speed: Array
    friction: Array
    half_width: Array
    level: float


def friction_curve(estimate: Estimate, speed: ArrayLike, *, level: float = 0.95) -> FrictionCurve:
    """Return friction (s, joints) at speeds (s,), with intervals.

    Terms that depend on the position or the load are left out.

    Parameters
    ----------
    estimate : Estimate
        With standard parameters.
    speed : array_like, shape (s,)
        Speeds, rad/s or m/s.
    level : float, optional
        Probability with which each interval should hold the truth.

    Raises
    ------
    DataError
        When the estimate has no standard parameters, or its problem no rows.
    """
    from scipy.special import stdtrit

    if estimate.theta is None:
        raise DataError(
            f"friction curve: method '{estimate.method}' gives no standard parameters; use an "
            "estimate of a constrained solver."
        )
    problem, theta = estimate.problem, np.array(estimate.theta)
    speeds = frozen(np.atleast_1d(np.asarray(speed, dtype=np.float64)))
    errors = NoiseSpectrum.of(problem, theta)
    posterior = Posterior.about(estimate, errors)
    friction = problem.friction
    links = problem.n_theta - len(friction.parameters)
    bending = Bending.of(friction, problem.profiled, theta[links:])
    count = len(friction.joint_names)
    values, halves = np.zeros((2, len(speeds), count))
    for k, own in enumerate(speeds):
        ahead, back = (_at(problem, bending, sign * own) for sign in (1.0, -1.0))
        columns, slopes = (0.5 * (a - b) for a, b in zip(ahead, back, strict=True))
        functions = np.hstack([np.zeros((count, links)), columns])
        values[k] = functions @ theta
        moves = np.hstack([functions @ posterior.from_fit, slopes])
        variance = np.einsum("ji,il,jl->j", moves, errors.whole_covariance, moves)
        variance += np.sum((functions @ posterior.from_prior) ** 2, axis=1)
        freedom = posterior.spread(functions)[2]
        halves[k] = stdtrit(freedom, 0.5 * (1.0 + level)) * np.sqrt(variance)
    return FrictionCurve(
        speed=speeds, friction=frozen(values), half_width=frozen(halves), level=level
    )


def _at(problem: Problem, bending: Bending, velocity: float) -> tuple[Array, Array]:
    """Return the friction columns (joints, f) at a velocity, and their derivatives (joints, d)."""
    friction, first = problem.friction, problem.friction.first
    v = np.full((1, len(friction.joint_names)), velocity)
    motion = Motion(position=v, velocity=v, acceleration=np.zeros_like(v), robot=problem.robot)
    blocks = [
        np.zeros((v.shape[1], len(term.parameters(friction.joint_names))))
        if term.posed
        else term.columns_in(motion, friction.joint_names)[0]
        for term in friction.terms
    ]
    return np.hstack(blocks), bending.columns(motion)[0, first:]
