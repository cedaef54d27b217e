"""Lower bounds on the cost of all feasible parameters, from multipliers.

For any y, any Z ⪰ 0 and any multipliers of the rows the cost obeys, at every feasible theta,

    f(theta) ≥ floor − ‖y‖² − 2·y·h − Σ⟨Z_i, F_0i⟩ + Σ_j λ_j·limit_j + c·theta,
    c = 2·G^T·y − Σ L_i*(Z_i) − Σ_j λ_j·row_j,   f(theta) = ‖G·theta − h‖² + floor

since ‖r‖² ≥ 2·y·r − ‖y‖² and ⟨Z_i, F_i(theta)⟩ ≥ 0, the limit of a row being the lower one where
its multiplier is positive and the upper one where it is negative. (G = A·B and h = rhs, with the
prior's rows below where there is a prior.) A log-det prior adds a convex function, which lies above
its tangents: for any W ≻ 0 that is another linear function of theta. Every theta lies in the box
of the declared bounds, so c·theta is at least its smallest value there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sdpid._arrays import Array
from sdpid.errors import DataError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem

# The gap is relative to the cost, or to this share of the weighted squared efforts where the data
# are exact and the cost is rounding: residuals of a thousandth of the effort.
TINY_COST = 1e-6

# A cost whose proven lower bound is further below it than this is not that of an optimum.
PROVEN = 1e-6

# A gap this small is not worth polishing the multipliers, or another round of it.
ENOUGH = 3e-7


@dataclass(frozen=True, eq=False)
class Dual:
    """Multipliers that prove a bound.

    Attributes
    ----------
    y : ndarray, shape (rows of `Problem.squared`,)
        Multiplier of the residual of `Problem.squared`.
    Z : ndarray, shape (N, s, s)
        Multipliers of the matrix inequalities, positive semidefinite.
    rows : ndarray, shape (r,)
        Multipliers of the linear rows: positive at the lower limit, negative at the upper one.
    W : ndarray, shape (L, 4, 4)
        Multiplier of `Problem.log_det`, the inverses of pseudo-inertias; L may be zero.
    """

    y: Array
    Z: Array
    rows: Array
    W: Array


@dataclass(frozen=True, eq=False)
class Bound:
    """A lower bound and the multipliers that prove it.

    Attributes
    ----------
    value : float
        No feasible parameters cost less (in floating point).
    dual : Dual
        The proof.
    """

    value: float
    dual: Dual


def evaluate(problem: Problem, dual: Dual) -> float:
    """Return the bound that multipliers prove, Z positive semidefinite and W definite."""
    feasible = problem.feasible
    constant, linear = problem.squared.support(dual.y)
    tangent = problem.log_det.support(dual.W)
    constant, linear = constant + tangent[0], linear + tangent[1]
    linear = linear - feasible.adjoint(dual.Z)
    constant -= float(np.einsum("nij,nij->", dual.Z, feasible.block_constants))
    limits = np.where(dual.rows > 0.0, feasible.row_lower, feasible.row_upper)
    used = np.where(np.isfinite(limits), dual.rows, 0.0)
    linear = linear - used @ feasible.rows
    constant += float(used @ np.where(np.isfinite(limits), limits, 0.0))
    ends = np.where(linear > 0.0, feasible.lower, feasible.upper)
    return float(constant + linear @ ends)


def clip_psd(Z: Array) -> Array:
    """Return the nearest positive semidefinite matrices."""
    if not Z.size:
        return Z
    values, vectors = np.linalg.eigh(Z)
    clipped = np.maximum(values, 0.0)
    return np.asarray((vectors * clipped[..., None, :]) @ np.swapaxes(vectors, -1, -2))


def lower_bound(
    estimate: Estimate,
    *,
    enough: float = 0.0,
    patient: bool = False,
    residual: Array | None = None,
) -> Bound:
    """Turn an estimate's multipliers into a lower bound.

    Parameters
    ----------
    estimate : Estimate
        With multipliers, from `solve_sdp`; without them Z = 0, which is the bound that ignores
        the physics.
    enough : float, optional
        A relative gap that needs no polishing.
    patient : bool, optional
        Polish as long as it takes.
    residual : ndarray, optional
        The solver's own multiplier of the residual. It goes with its other multipliers, where the
        residual of the point, which was moved inside, does so to first order only.

    Returns
    -------
    Bound
        The best of a few choices of the multipliers: as found, or polished (see
        `sdpid.estimation.polish`).
    """
    problem, found = estimate.problem, estimate.multipliers
    own, residual = residual, _residual(estimate)
    # Whatever the constraints, nothing costs less than the floor: no multipliers prove that much,
    # and where the constraints cost nothing it is all there is to prove.
    nothing = np.zeros_like(problem.feasible.block_constants), np.zeros(len(problem.feasible.rows))
    W = _touching(estimate)
    best = best_of(
        [
            # At the believed bodies themselves a log-det prior's tangent is zero.
            bounded(problem, Dual(0.0 * residual, *nothing, problem.log_det.inverses)),
            bounded(problem, Dual(residual, *nothing, W)),
        ]
    )
    if found is None or estimate.theta is None:
        return best
    y = residual if found.y is None else found.y
    # What was stored with its y is a proof already: clipping again would only add roundings.
    Z = clip_psd(found.Z) if found.y is None else found.Z
    given = Dual(y, Z, found.rows, W if found.W is None else found.W)
    best = best_of([best, bounded(problem, given)])
    if own is not None:
        best = best_of([best, bounded(problem, replace(given, y=own))])
    if relative_gap(problem, estimate.cost, best.value) <= enough:
        return best
    from sdpid.estimation.polish import polished

    return polished(estimate, residual, given, best, patient=patient)


def bounded(problem: Problem, dual: Dual) -> Bound:
    """Return a bound with its value."""
    try:
        return Bound(evaluate(problem, dual), dual)
    except DataError:
        # A W that is not definite, by rounding or clipping, touches nowhere and proves nothing.
        return Bound(-np.inf, dual)


def best_of(bounds: list[Bound]) -> Bound:
    """Return the highest of several bounds."""
    return max(bounds, key=lambda bound: bound.value)


def _residual(estimate: Estimate) -> Array:
    """Return the residual of `Problem.squared`, zero in a prior's rows where theta is None."""
    problem = estimate.problem
    if estimate.theta is not None:
        return problem.squared.residual(estimate.theta)
    y = problem.A @ estimate.base - problem.rhs
    return np.concatenate([y, np.zeros(len(problem.squared.rhs) - len(y))])


def _touching(estimate: Estimate) -> Array:
    """Return the W at which a log-det prior's tangents touch it at the estimate."""
    log_det = estimate.problem.log_det
    return log_det.inverses if estimate.theta is None else log_det.multiplier(estimate.theta)


def cost_scale(problem: Problem) -> float:
    """Return the smallest cost that gaps are relative to."""
    h = problem.squared.rhs
    return TINY_COST * (float(h @ h) + problem.floor)


def relative_gap(problem: Problem, cost: float, bound: float) -> float:
    """Return (cost − bound) relative to the cost, or to a tiny share of the squared efforts."""
    return (cost - bound) / max(cost, cost_scale(problem))
