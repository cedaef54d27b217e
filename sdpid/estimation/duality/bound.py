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

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.estimation.duality.multipliers import Multipliers
from sdpid.estimation.problem import Problem

# The gap is relative to the cost, or to this share of the weighted squared efforts where the data
# are exact and the cost is rounding: residuals of a thousandth of the effort.
TINY_COST = 1e-6

# A cost whose proven lower bound is further below it than this is not that of an optimum.
PROVEN = 1e-6

# A gap this small is not worth refining the multipliers, or another round of it.
TARGET_GAP = 3e-7


@dataclass(frozen=True, eq=False)
class Bound:
    """A lower bound and the multipliers that prove it.

    Attributes
    ----------
    value : float
        No feasible parameters cost less (in floating point).
    multipliers : Multipliers
        The proof.
    """

    value: float
    multipliers: Multipliers


def evaluate(problem: Problem, multipliers: Multipliers) -> float:
    """Return the bound that multipliers prove, Z positive semidefinite and W definite."""
    feasible = problem.feasible
    constant, linear = problem.squared.support(multipliers.y)
    tangent = problem.log_det.support(multipliers.W)
    constant, linear = constant + tangent[0], linear + tangent[1]
    linear = linear - feasible.adjoint(multipliers.Z)
    constant -= float(np.einsum("nij,nij->", multipliers.Z, feasible.block_constants))
    limits = np.where(multipliers.rows > 0.0, feasible.row_lower, feasible.row_upper)
    used = np.where(np.isfinite(limits), multipliers.rows, 0.0)
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


def bound_of(problem: Problem, multipliers: Multipliers) -> Bound:
    """Return the bound that multipliers prove, minus infinity where they prove none."""
    try:
        return Bound(evaluate(problem, multipliers), multipliers)
    except DataError:
        # A W that is not definite, by rounding or clipping, touches nowhere and proves nothing.
        return Bound(-np.inf, multipliers)


def cost_scale(problem: Problem) -> float:
    """Return the smallest cost that gaps are relative to."""
    h = problem.squared.rhs
    return TINY_COST * (float(h @ h) + problem.floor)


def relative_gap(problem: Problem, cost: float, bound: float) -> float:
    """Return (cost − bound) relative to the cost, or to a tiny share of the squared efforts."""
    return (cost - bound) / max(cost, cost_scale(problem))
