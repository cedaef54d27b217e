"""Functions of the parameters with intervals: links as bodies, and friction over speed.

A function g of the standard parameters theta has the variance ``∇g·C·∇g^T`` with the errors C of
theta from data and prior (see `sdpid.estimation.posterior`), to first order: the delta method.
Active inequalities are not counted, which errs on the wide side; intervals of masses and inertias
end at zero all the same. A principal inertia is an eigenvalue λ with the axis v, and moves by
``v^T·dI·v`` with the inertia I about the center of mass. Friction is a curve over speed: beside a
term of the same shape, such as a sigmoid, a coefficient of Coulomb friction says little, however
well the data determine the curve of both.
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
from sdpid.robot.friction.model import JointCurve, joint_number
from sdpid.robot.friction.position import AtJoints
from sdpid.robot.friction.term import SampledMotion
from sdpid.robot.inertia import complement, physical_parameters, pseudo_inertia

# What is given of each link, in this order, and its units.
QUANTITIES = ("mass", "x", "y", "z", "inertia 1", "inertia 2", "inertia 3")
UNITS = ("kg", "m", "m", "m", "kg·m²", "kg·m²", "kg·m²")

# Masses and inertias.
_POSITIVE = [0, 4, 5, 6]


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkProperties:
    """Mass, center of mass and principal inertias of links, each with its interval.

    Attributes
    ----------
    names : tuple of str, length links
        The links.
    value : ndarray, shape (links, 7)
        `QUANTITIES`: mass, kg; center of mass in the joint's frame, m; principal inertias about
        it, the smallest first, kg·m².
    lower, upper : ndarray, shape (links, 7)
        The interval of each; without end where neither data nor prior tell it.
    prior_share : ndarray, shape (links, 7)
        Share of the prior in the variance.
    level : float
        Stated probability.
    """

    names: tuple[str, ...]
    value: Array
    lower: Array
    upper: Array
    prior_share: Array
    level: float


def half_widths(
    posterior: Posterior, functions: Array, level: float, moved: Array | None = None
) -> tuple[Array, Array]:
    """Return half the widths (...) of intervals of functions (..., p), and the prior's shares.

    How they move with the fit's errors may be more than through theta (see `Posterior.spread`).
    """
    from scipy.special import stdtrit

    shape, flat = functions.shape[:-1], functions.reshape(-1, functions.shape[-1])
    variance, share, freedom = posterior.spread(flat)
    if moved is not None:
        variance, _, _ = posterior.spread(flat, moved.reshape(len(flat), -1))
    half = stdtrit(freedom, 0.5 * (1.0 + level)) * np.sqrt(variance)
    return half.reshape(shape), share.reshape(shape)


def _theta_of(estimate: Estimate, what: str) -> Array:
    """Return the standard parameters, or raise."""
    if estimate.theta is None:
        raise DataError(
            f"{what}: method '{estimate.method}' gives no standard parameters; use an estimate of "
            "a constrained solver."
        )
    return np.array(estimate.theta)


def link_properties(estimate: Estimate, *, level: float = 0.95) -> LinkProperties:
    """Return mass, center of mass and principal inertias of every link, with intervals.

    Parameters
    ----------
    estimate : Estimate
        With standard parameters, whose problem has kept its rows.
    level : float, optional
        Probability with which each interval should hold the truth.

    Raises
    ------
    DataError
        When the estimate has no standard parameters, or its problem no rows.
    """
    theta, problem = _theta_of(estimate, "link properties"), estimate.problem
    robot = problem.robot
    bodies = theta[: 10 * robot.n_links].reshape(-1, 10)
    functions = np.zeros((len(bodies), len(QUANTITIES), problem.n_theta))
    value = properties(bodies)
    for i in np.flatnonzero(np.isfinite(value).all(axis=1)):
        functions[i, :, 10 * i : 10 * i + 10] = slopes(bodies[i])
    half, prior_share = half_widths(Posterior.of(estimate), functions, level)
    lower, upper = value - half, value + half
    lower[:, _POSITIVE] = np.fmax(lower[:, _POSITIVE], 0.0)
    return LinkProperties(
        names=tuple(robot.link_names),
        value=frozen(value),
        lower=frozen(lower),
        upper=frozen(upper),
        prior_share=frozen(prior_share),
        level=level,
    )


def properties(bodies: Array) -> Array:
    """Return `QUANTITIES` (links, 7) of bodies (links, 10); not finite where there is no mass."""
    mass, com, inertia = physical_parameters(bodies)
    known = np.isfinite(inertia).all(axis=(1, 2))
    principal = np.full((len(bodies), 3), np.nan)
    principal[known] = np.linalg.eigvalsh(inertia[known])
    return np.column_stack([mass, com, principal])


def slopes(body: Array) -> Array:
    """Return the derivatives (7, 10) of `QUANTITIES` of one body by its parameters.

    Those of an inertia that two axes share are of the axes as they are found.
    """
    mass, com, inertia = physical_parameters(body)
    axes, units = np.linalg.eigh(inertia)[1], np.eye(10)
    about_com = (units[:, 1:4] - units[:, :1] * com) / mass
    # Of the second moments S = Σ − h·h^T/m, parameter by parameter.
    each = pseudo_inertia(units)
    outer = each[:, :3, 3, None] * com
    moved = each[:, :3, :3] - outer - np.swapaxes(outer, 1, 2)
    moved += units[:, 0, None, None] * np.outer(com, com)
    of_axes = np.einsum("ia,kij,ja->ak", axes, complement(moved), axes)
    return np.vstack([units[0], about_com.T, of_axes])


def friction_curve(
    estimate: Estimate, speed: ArrayLike, *, level: float = 0.95
) -> tuple[Array, Array]:
    """Return friction at some speeds and half the widths of its intervals, (s, joints), N·m or N.

    It is half of what reversing the motion changes: offsets and asymmetry cancel. Terms that depend
    on the position or the load are left out.

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
    curves, speeds = _Curves(estimate), np.atleast_1d(np.asarray(speed, dtype=np.float64))
    v = np.repeat(speeds[:, None], len(estimate.problem.friction.joint_names), axis=1)
    ahead, back = curves.at(v), curves.at(-v)
    functions, slopes = (0.5 * (a - b) for a, b in zip(ahead, back, strict=True))
    return functions @ curves.theta, curves.half_widths(functions, slopes, level)


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
    curves, model = _Curves(estimate), estimate.model()
    places = np.arange(len(estimate.problem.friction.joint_names))
    found = []
    if velocities is None:
        velocities = dict.fromkeys(places.tolist())
    for joint, velocity in velocities.items():
        curve = model.friction_curve(joint, velocity)
        functions, slopes = curves.at(np.outer(curve.velocity, places == joint))
        half = curves.half_widths(functions[:, joint], slopes[:, joint], level)
        ends = frozen(curve.effort - half), frozen(curve.effort + half)
        found.append(replace(curve, lower=ends[0], upper=ends[1], level=level))
    return tuple(found)


class _Curves:
    """Friction of all joints as functions of theta, and how it moves with errors of the fit."""

    def __init__(self, estimate: Estimate) -> None:
        self.theta, self.problem = _theta_of(estimate, "friction curve"), estimate.problem
        spectrum = spectrum_of(estimate)
        self._posterior = Posterior(estimate, FitErrors.of(estimate, spectrum))
        self._shapes = spectrum.whole_root[spectrum.base_count :]
        friction, profiled = self.problem.friction, self.problem.origin.profiled
        tail = self.theta[self.problem.n_theta - len(friction.parameters) :]
        self._bending = Bending.of(friction, profiled, tail)

    def at(self, v: Array) -> tuple[Array, Array]:
        """Return functions (s, joints, p) of theta at velocities (s, joints), and slopes (…, d).

        These are by the shape parameters that were fitted with the rest.
        """
        friction, names = self.problem.friction, self.problem.friction.joint_names
        motion = SampledMotion(
            position=v, velocity=v, acceleration=np.zeros_like(v), robot=self.problem.robot
        )
        functions = np.zeros((*v.shape, self.problem.n_theta))
        tail = functions[:, :, self.problem.n_theta - len(friction.parameters) :]
        for term, place in friction.placed:
            if not term.posed or isinstance(term, AtJoints):
                tail[:, :, place] = term.columns_in(motion, names)
        return functions, self._bending.columns(motion)[:, friction.first :]

    def half_widths(self, functions: Array, slopes: Array, level: float) -> Array:
        """Return half the widths (...) of intervals of functions (..., p) with slopes (..., d)."""
        moved = functions @ self._posterior.from_errors
        moved[..., : self._shapes.shape[1]] += slopes @ self._shapes
        return half_widths(self._posterior, functions, level, moved)[0]
