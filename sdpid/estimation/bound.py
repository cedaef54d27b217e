"""Lower bounds on the cost of all feasible parameters, from multipliers.

For any y and any Z ⪰ 0 the cost obeys, at every feasible theta,

    f(theta) ≥ floor − ‖y‖² − 2·y·h − Σ⟨Z_i, F_0⟩ + c·theta,
    c = 2·G^T·y − Σ L_i*(Z_i),   f(theta) = ‖G·theta − h‖² + floor

since ‖r‖² ≥ 2·y·r − ‖y‖² and ⟨Z_i, F_i(theta)⟩ ≥ 0. (G = A·B and h = rhs, with the prior's rows
below where there is a prior.) Every theta lies in the box of the declared bounds, so c·theta is
at least its smallest value there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._arrays import Array
from sdpid.estimation.estimate import Estimate, Multipliers
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.robot.inertia import symmetric_basis

# The gap is relative to the cost, or to this share of the weighted squared efforts where the data
# are exact and the cost is rounding: residuals of a thousandth of the effort.
TINY_COST = 1e-6


# How far the null space of a multiplier may take part in polishing it, relative to its largest
# eigenvalue: tried in turn, halved in each of so many rounds, until the gap is small enough.
_SOFT = (1e-6, 1e-8, 1e-10, 1e-12, 1e-14, 1e-5, 1e-4)
_ROUNDS = 8

# Equations of the polishing that are this close to dependent are dependent.
_CUT = 1e-14

# A gap this small is not worth another round.
_ENOUGH = 1e-7


@dataclass(frozen=True, eq=False)
class Bound:
    """A lower bound and the multipliers that prove it.

    Attributes
    ----------
    value : float
        No feasible parameters cost less (in floating point).
    y : ndarray, shape (rows,)
        Multiplier of the residual of `Problem.design`.
    Z : ndarray, shape (links, s, s)
        Multipliers of the matrix inequalities, positive semidefinite.
    """

    value: float
    y: Array
    Z: Array


def adjoint(Z: Array, basis: Array, n_theta: int) -> Array:
    """Return Σ L_i*(Z_i) as a vector over theta: entry k is ⟨Z_i, F_k⟩."""
    out = np.zeros(n_theta)
    values = np.einsum("lij,kij->lk", Z, basis)
    out[: values.size] = values.ravel()
    return out


def gradient(problem: Problem, y: Array) -> Array:
    """Return G^T·y, through the base matrix so that invisible directions vanish exactly."""
    count = problem.base.count
    out = problem.base.matrix.T @ (problem.A.T @ y[:count])
    if problem.prior is not None:
        out = out + problem.prior.matrix.T @ y[count:]
    return np.asarray(out)


def evaluate(problem: Problem, y: Array, Z: Array) -> float:
    """Return the bound that y and positive semidefinite Z prove."""
    feasible = problem.feasible
    h = problem.design[1]
    linear = 2.0 * gradient(problem, y)
    constant = problem.floor - y @ y - 2.0 * (y @ h)
    if Z.size:
        linear = linear - adjoint(Z, feasible.basis(), problem.n_theta)
        constant -= float(np.einsum("lij,ij->", Z, feasible.constant()))
    ends = np.where(linear > 0.0, feasible.lower, feasible.upper)
    return float(constant + linear @ ends)


def clip_psd(Z: Array) -> Array:
    """Return the nearest positive semidefinite matrices."""
    if not Z.size:
        return Z
    values, vectors = np.linalg.eigh(Z)
    clipped = np.maximum(values, 0.0)
    return np.asarray((vectors * clipped[..., None, :]) @ np.swapaxes(vectors, -1, -2))


def lower_bound(estimate: Estimate) -> Bound:
    """Turn an estimate's multipliers into a lower bound.

    Parameters
    ----------
    estimate : Estimate
        With multipliers, from `solve_sdp`; without them Z = 0, which is the bound that ignores
        the physics.

    Returns
    -------
    Bound
        The best of a few choices of y and Z: as found, or polished.
    """
    problem = estimate.problem
    s = problem.feasible.size
    found = estimate.multipliers
    if estimate.theta is not None:
        y = problem.residual_of(estimate.theta)
    else:
        y = problem.A @ estimate.base - problem.rhs
        y = np.concatenate([y, np.zeros(len(problem.design[1]) - len(y))])
    # Whatever the constraints, nothing costs less than the floor: no multipliers prove that much,
    # and where the constraints cost nothing it is all there is to prove.
    none = np.zeros((0, s, s))
    best = Bound(evaluate(problem, 0.0 * y, none), 0.0 * y, none)
    if found is None or estimate.theta is None or not found.Z.size:
        own = Bound(evaluate(problem, y, none), y, none)
        return max(best, own, key=lambda bound: bound.value)
    Z = clip_psd(found.Z)
    start = y if found.y is None else found.y
    given = Bound(evaluate(problem, start, Z), start, Z)
    best = max(best, given, key=lambda bound: bound.value)
    if relative_gap(problem, estimate.cost, best.value) <= _ENOUGH:
        return best
    scaling = Scaling.of(problem).around(estimate.theta)
    for first in _SOFT:
        trial, soft = Multipliers(Z, found.bounds), first
        residual = y
        for _ in range(_ROUNDS):
            residual, improved = _polished(problem, scaling, residual, trial, soft)
            value = evaluate(problem, residual, improved)
            if value > best.value:
                best = Bound(value, residual, improved)
            if relative_gap(problem, estimate.cost, best.value) <= _ENOUGH:
                return best
            trial, soft = Multipliers(improved, found.bounds), 0.5 * soft
    return best


def _polished(
    problem: Problem, scaling: Scaling, y: Array, found: Multipliers, soft: float
) -> tuple[Array, Array]:
    """Return y and Z changed as little as needed for the linear term to be what it should.

    A solver leaves errors in the linear term c, which the wide box of theta makes expensive. At
    the optimum c is the multiplier of the bounds, which the solver gives too, and zero in every
    parameter without one. That is a linear system in a change of y, in the bounds' multipliers
    and in D of ``S·(E + D)·S``, S being the square root of Z softened so that its null space can
    take part. Of many solutions the smallest is taken. As long as D is above −E the result is
    positive semidefinite; where it is not, it is clipped, and another round takes the rest.
    """
    from scipy.linalg import lstsq

    feasible = problem.feasible
    links, size = feasible.n_links, feasible.size
    basis, D = scaling.basis(), scaling.roots(size)
    unit = float(np.sqrt(scaling.cost))
    inverse = np.linalg.inv(D)
    Z = np.swapaxes(D, 1, 2) @ found.Z @ D / scaling.cost
    values, vectors = np.linalg.eigh(Z)
    values = np.maximum(values, 0.0)
    values = values + soft * max(float(values.max()), np.finfo(float).tiny)
    S = (vectors * np.sqrt(values)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    Z = S @ S
    full = scaling.cost * np.swapaxes(inverse, 1, 2) @ Z @ inverse
    symmetric = symmetric_basis(size)
    changes = np.zeros((problem.n_theta, links, len(symmetric)))
    for link in range(links):
        F = inverse[link] @ feasible.basis() @ inverse[link].T
        own = slice(10 * link, 10 * link + 10)
        changes[own, link] = np.einsum("aij,kij->ka", S[link] @ symmetric @ S[link], F)
    bounded = np.flatnonzero(np.isfinite(found.bounds))
    mu = np.nan_to_num(found.bounds)
    GT = 2.0 * problem.design[0].T / unit
    missing = (adjoint(full, feasible.basis(), problem.n_theta) + mu) / scaling.cost
    missing = missing - 2.0 * gradient(problem, y) / scaling.cost
    scale_y = max(float(np.linalg.norm(y)) / unit, 1e-3)
    relax = np.eye(problem.n_theta)[:, bounded]
    relax = relax * (np.abs(mu[bounded]) / scaling.cost + soft / scaling.theta[bounded])
    system = np.hstack([GT * scale_y, -changes.reshape(problem.n_theta, -1), -relax])
    # Smallest solution by pivoted QR: ten times faster than by singular values.
    step = lstsq(
        basis.T @ system, basis.T @ missing, cond=_CUT, lapack_driver="gelsy", check_finite=False
    )[0]
    part = step[len(y) : len(y) + links * len(symmetric)].reshape(links, -1)
    polished = clip_psd(Z + S @ np.einsum("la,aij->lij", part, symmetric) @ S)
    polished = scaling.cost * np.swapaxes(inverse, 1, 2) @ polished @ inverse
    return y + scale_y * unit * step[: len(y)], clip_psd(polished)


def cost_scale(problem: Problem) -> float:
    """Return the smallest cost that gaps are relative to."""
    h = problem.design[1]
    return TINY_COST * (float(h @ h) + problem.floor)


def relative_gap(problem: Problem, cost: float, bound: float) -> float:
    """Return (cost − bound) relative to the cost, or to a tiny share of the squared efforts."""
    return (cost - bound) / max(cost, cost_scale(problem))
