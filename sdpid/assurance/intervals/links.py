"""Mass, center of mass and principal inertias of every link, with intervals.

They are functions g of the standard parameters theta that are not linear: their variance is
``∇g·C·∇g^T`` with the errors C of theta from data and prior (see `sdpid.estimation.posterior`), the
first order of the delta method. Active inequalities are not counted, which errs on the wide side;
intervals of masses and inertias end at zero all the same. A principal inertia is an eigenvalue λ
with the axis v, and moves by ``v^T·dI·v`` with the inertia I about the center of mass.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.errors import DataError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.posterior import Posterior
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
    from scipy.special import stdtrit

    if estimate.theta is None:
        raise DataError(
            f"link properties: method '{estimate.method}' gives no standard parameters; use an "
            "estimate of a constrained solver."
        )
    problem = estimate.problem
    robot = problem.robot
    bodies = np.array(estimate.theta[: 10 * robot.n_links]).reshape(-1, 10)
    functions = np.zeros((len(bodies), len(QUANTITIES), problem.n_theta))
    value = properties(bodies)
    for i in np.flatnonzero(np.isfinite(value).all(axis=1)):
        functions[i, :, 10 * i : 10 * i + 10] = slopes(bodies[i])
    posterior = Posterior.of(estimate)
    flat = functions.reshape(-1, problem.n_theta)
    variance, prior_share, freedom = posterior.spread(flat)
    half = stdtrit(freedom, 0.5 * (1.0 + level)) * np.sqrt(variance)
    half = half.reshape(value.shape)
    lower = value - half
    lower[:, _POSITIVE] = np.fmax(lower[:, _POSITIVE], 0.0)
    return LinkProperties(
        names=tuple(robot.link_names),
        value=frozen(value),
        lower=frozen(lower),
        upper=frozen(value + half),
        prior_share=frozen(prior_share.reshape(value.shape)),
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
    axes = np.linalg.eigh(inertia)[1]
    return np.array(list(_slopes(float(mass), com, axes)))


def _slopes(mass: float, com: Array, axes: Array) -> Iterator[Array]:
    units = np.eye(10)
    yield units[0]
    about_com = (units[:, 1:4] - units[:, :1] * com) / mass
    yield from about_com.T
    # Of the second moments S = Σ − h·h^T/m, parameter by parameter.
    each = pseudo_inertia(units)
    outer = each[:, :3, 3, None] * com
    moved = each[:, :3, :3] - outer - np.swapaxes(outer, 1, 2)
    moved += units[:, 0, None, None] * np.outer(com, com)
    yield from np.einsum("ia,kij,ja->ak", axes, complement(moved), axes)
