"""Friction as a curve over speed, with its interval.

Beside a term of the same shape, such as a sigmoid, a coefficient of Coulomb friction says little,
however well the data determine the curve of both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen, require_probability
from sdpid.errors import DataError
from sdpid.estimation.effects.bending import Bending
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.posterior import FitErrors, Posterior, spectrum_of
from sdpid.estimation.problem import Problem
from sdpid.robot.friction.curve import JointCurve, joint_number
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
    require_probability(level, "friction curve: level")
    bands = _Bands(estimate)
    speeds = frozen(np.atleast_1d(np.asarray(speed, dtype=np.float64)))
    shape = (len(speeds), len(bands.problem.friction.joint_names))
    values, halves = np.zeros(shape), np.zeros(shape)
    for k, own in enumerate(speeds):
        ahead, back = (_at(bands.problem, bands.bending, sign * own) for sign in (1.0, -1.0))
        columns, slopes = (0.5 * (a - b) for a, b in zip(ahead, back, strict=True))
        values[k], halves[k] = bands.about(columns, slopes, level)
    return FrictionCurve(
        speed=speeds, friction=frozen(values), half_width=frozen(halves), level=level
    )


def joint_curve(
    estimate: Estimate,
    joint: str | int,
    velocity: ArrayLike | None = None,
    *,
    level: float = 0.95,
) -> JointCurve:
    """Return the friction of one joint over its velocity, offsets included, with intervals.

    Parameters
    ----------
    estimate : Estimate
        With standard parameters, whose problem has kept its rows.
    joint, velocity
        As for `sdpid.robot.model.dynamics.RobotDynamics.friction_curve`.
    level : float, optional
        Probability with which each interval should hold the truth.

    Raises
    ------
    DataError
        When the estimate has no standard parameters, its problem no rows, or joint velocity
        or level are none.
    """
    number = joint_number(estimate.problem.friction.joint_names, joint)
    return joint_curves(estimate, {number: velocity}, level=level)[0]


def joint_curves(
    estimate: Estimate,
    velocities: Mapping[int, ArrayLike | None] | None = None,
    *,
    level: float = 0.95,
) -> tuple[JointCurve, ...]:
    """Return the friction of several joints over their velocities, each alone, with intervals.

    Parameters
    ----------
    estimate : Estimate
        With standard parameters, whose problem has kept its rows.
    velocities : mapping of int to array_like, optional
        Velocities (s,) by the joint's place among those with friction, None for the default; by
        default of all joints.
    level : float, optional
        Probability with which each interval should hold the truth.

    Raises
    ------
    DataError
        As `joint_curve`.
    """
    require_probability(level, "friction curve: level")
    bands, model = _Bands(estimate), estimate.model()
    if velocities is None:
        velocities = dict.fromkeys(range(len(bands.problem.friction.joint_names)))
    curves = []
    for joint, velocity in velocities.items():
        curve = model.friction_curve(joint, velocity)
        columns, slopes = _alone(bands.problem, bands.bending, np.array(curve.velocity), joint)
        halves = bands.about(columns, slopes, level)[1]
        ends = frozen(curve.effort - halves), frozen(curve.effort + halves)
        curves.append(replace(curve, lower=ends[0], upper=ends[1], level=level))
    return tuple(curves)


class _Bands:
    """Values and half widths of what is linear in the friction parameters."""

    def __init__(self, estimate: Estimate) -> None:
        if estimate.theta is None:
            raise DataError(
                f"friction curve: method '{estimate.method}' gives no standard parameters; use an "
                "estimate of a constrained solver."
            )
        self.problem, self.theta = estimate.problem, np.array(estimate.theta)
        self._spectrum = spectrum_of(estimate)
        self._posterior = Posterior.about(estimate, FitErrors.of(estimate, self._spectrum))
        friction = self.problem.friction
        self._links = self.problem.n_theta - len(friction.parameters)
        self.bending = Bending.of(friction, self.problem.origin.profiled, self.theta[self._links :])

    def about(self, columns: Array, slopes: Array, level: float) -> tuple[Array, Array]:
        """Return values and half widths (joints,) of columns (joints, f) with slopes (joints, d).

        The slopes are those by the shape parameters that were fitted with the rest.
        """
        from scipy.special import stdtrit

        functions = np.hstack([np.zeros((len(columns), self._links)), columns])
        moved = functions @ self._posterior.from_errors
        of_slopes = self._spectrum.whole_root[self._spectrum.base_count :]
        moved[:, : of_slopes.shape[1]] += slopes @ of_slopes
        variance, _, _ = self._posterior.spread(functions, moved)
        _, _, freedom = self._posterior.spread(functions)
        half = stdtrit(freedom, 0.5 * (1.0 + level)) * np.sqrt(variance)
        return functions @ self.theta, np.asarray(half)


def _at(problem: Problem, bending: Bending, velocity: float) -> tuple[Array, Array]:
    """Return the friction columns (joints, f) at a velocity, and their derivatives (joints, d)."""
    v = np.full((1, len(problem.friction.joint_names)), velocity)
    columns, slopes = _of_motion(problem, bending, v)
    return columns[0], slopes[0]


def _alone(problem: Problem, bending: Bending, velocity: Array, joint: int) -> tuple[Array, Array]:
    """Return a joint's columns (s, f), and derivatives (s, d), at velocities (s,) of it alone."""
    v = np.zeros((len(velocity), len(problem.friction.joint_names)))
    v[:, joint] = velocity
    columns, slopes = _of_motion(problem, bending, v)
    return columns[:, joint], slopes[:, joint]


def _of_motion(problem: Problem, bending: Bending, v: Array) -> tuple[Array, Array]:
    """Return columns (s, joints, f) and derivatives (s, joints, d) at velocities (s, joints)."""
    friction, names = problem.friction, problem.friction.joint_names
    motion = Motion(position=v, velocity=v, acceleration=np.zeros_like(v), robot=problem.robot)
    # The first is of no term: a robot without friction has a curve, too.
    blocks = [np.zeros((*v.shape, 0))]
    blocks += [
        np.zeros((*v.shape, len(term.parameters(names))))
        if term.posed
        else term.columns_in(motion, names)
        for term in friction.terms
    ]
    return np.concatenate(blocks, axis=2), bending.columns(motion)[:, friction.first :]
