"""Multipliers of the constraints and the residual, and the lower bounds that they prove.

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

from sdpid._common.arrays import Array, Mask
from sdpid.errors import DataError
from sdpid.estimation.problem import Problem

# The gap is relative to the cost, or to this share of the weighted squared efforts where the data
# are exact and the cost is rounding: residuals of a thousandth of the effort.
TINY_COST = 1e-6

# A cost whose proven lower bound is further below it than this is not that of an optimum.
PROVEN = 1e-6

# A gap this small is not worth refining the multipliers, or another round of it.
TARGET_GAP = 3e-7


@dataclass(frozen=True, kw_only=True, eq=False)
class Multipliers:
    """Multipliers of one problem, in units of the cost.

    Attributes
    ----------
    y : ndarray, shape (rows of `Problem.squared`,)
        Multiplier of `Problem.squared`; at an optimum its residual.
    Z : ndarray, shape (N, s, s)
        Multipliers of the matrix inequalities of `FeasibleSet`, positive semidefinite.
    rows : ndarray, shape (r,)
        Multipliers of the linear rows: positive at the lower limit, negative at the upper one.
    W : ndarray, shape (L, 4, 4)
        Multiplier of `Problem.log_det`, the inverses of pseudo-inertias; L may be zero.
    bounds : ndarray, shape (p,)
        Multipliers of the bounds on theta, signed likewise; zero where they are not included.
    bounds_included : ndarray of bool, shape (p,)
        Whose bounds the solver was given.
    """

    y: Array
    Z: Array
    rows: Array
    W: Array
    bounds: Array
    bounds_included: Mask

    def __repr__(self) -> str:
        bounds = int(np.count_nonzero(self.bounds_included))
        return (
            f"Multipliers({len(self.y)} of the cost, {len(self.Z)} matrices, {len(self.rows)} "
            f"rows, {bounds} of {len(self.bounds)} bounds, {len(self.W)} log-det)"
        )

    @classmethod
    def of_cost(cls, problem: Problem, y: Array, W: Array | None = None) -> Multipliers:
        """Return multipliers of the cost's terms alone; those of the constraints are zero.

        Without W the log-det term's are those of the believed bodies.
        """
        feasible = problem.feasible
        return cls(
            y=y,
            Z=np.zeros_like(feasible.block_constants),
            rows=np.zeros(len(feasible.rows)),
            bounds=np.zeros(problem.n_theta),
            bounds_included=np.zeros(problem.n_theta, dtype=bool),
            W=problem.log_det.inverses if W is None else W,
        )

    @classmethod
    def at(cls, problem: Problem, theta: Array) -> Multipliers:
        """Return the multipliers of the cost's terms at theta, where it is finite."""
        y, W = problem.squared.residual(theta), problem.log_det.multiplier(theta)
        return cls.of_cost(problem, y, W)

    @property
    def constrained(self) -> bool:
        """Whether any constraint has a multiplier."""
        return bool(np.any(self.Z) or np.any(self.rows) or np.any(self.bounds))


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


def support(problem: Problem, multipliers: Multipliers) -> tuple[float, Array]:
    """Return constant and slope c (p,) of the bound that multipliers prove, before the box."""
    feasible = problem.feasible
    terms = problem.squared.support(multipliers.y), problem.log_det.support(multipliers.W)
    constant, slope = terms[0][0] + terms[1][0], terms[0][1] + terms[1][1]
    constant -= float(np.einsum("nij,nij->", multipliers.Z, feasible.block_constants))
    limits = np.where(multipliers.rows > 0.0, feasible.row_lower, feasible.row_upper)
    used = np.where(np.isfinite(limits), multipliers.rows, 0.0)
    constant += float(used @ np.where(np.isfinite(limits), limits, 0.0))
    return constant, slope - feasible.adjoint(multipliers.Z) - used @ feasible.rows


def evaluate(problem: Problem, multipliers: Multipliers) -> float:
    """Return the bound that multipliers prove, Z positive semidefinite and W definite."""
    constant, slope = support(problem, multipliers)
    ends = np.where(slope > 0.0, problem.feasible.lower, problem.feasible.upper)
    return float(constant + slope @ ends)


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


def best_of(*bounds: Bound) -> Bound:
    """Return the strongest of several bounds."""
    return max(bounds, key=lambda bound: bound.value)


def cost_scale(problem: Problem) -> float:
    """Return the smallest cost that gaps are relative to."""
    h = problem.squared.rhs
    return TINY_COST * (float(h @ h) + problem.floor)


def relative_gap(problem: Problem, cost: float, bound: float) -> float:
    """Return (cost − bound) relative to the cost, or to a tiny share of the squared efforts."""
    return (cost - bound) / max(cost, cost_scale(problem))
