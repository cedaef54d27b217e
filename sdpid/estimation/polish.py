"""Multipliers changed as little as needed for them to prove what the solver found.

A solver leaves errors in the linear term c of the bound (see `sdpid.estimation.bound`), which the
wide box of theta makes expensive. At the optimum c is the multiplier of the bounds, which the
solver gives too, and zero in every parameter without one. That is a linear system in changes of
all multipliers; the matrices among them change as ``S·(E + D)·S``, S being the square root of Z
softened so that its null space can take part. As long as D is above −E the result is positive
semidefinite; where it is not, it is clipped, and another round takes the rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sdpid._arrays import Array, Indices
from sdpid.estimation.bound import (
    ENOUGH,
    Bound,
    Dual,
    best_of,
    bounded,
    clip_psd,
    relative_gap,
)
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.robot.inertia import pseudo_inertia, symmetric_basis

# How far the null space of a multiplier may take part in polishing it, relative to its largest
# eigenvalue: tried in turn, halved in each of so many rounds, until the gap is small enough.
_SOFT = (1e-6, 1e-8, 1e-10, 1e-12, 1e-14, 1e-5, 1e-4)
_ROUNDS = 8

# Equations of the polishing that are this close to dependent are dependent.
_CUT = 1e-14

# A round must close this share of the gap to be worth another.
_PROGRESS = 0.05


def polished(
    estimate: Estimate, residual: Array, given: Dual, best: Bound, *, patient: bool = False
) -> Bound:
    """Return the best bound of rounds of polishing, or `best` where none is better.

    Parameters
    ----------
    estimate : Estimate
        With standard parameters and multipliers.
    residual : ndarray
        Its residual of `Problem.squared`, from which y starts.
    given : Dual
        The multipliers as found.
    best : Bound
        The best bound so far.
    patient : bool, optional
        Go through all rounds, even where they do not seem to help.
    """
    problem, found = estimate.problem, estimate.multipliers
    if found is None or estimate.theta is None:
        raise ValueError("only multipliers can be polished")
    if relative_gap(problem, estimate.cost, best.value) <= ENOUGH:
        return best
    system = _System.of(problem, Scaling.of(problem).around(np.array(estimate.theta)))
    for first in _SOFT:
        trial, soft = replace(given, y=residual), first
        last = -np.inf
        for _ in range(_ROUNDS):
            trial = system.polish(trial, found.bounds, soft)
            bound = bounded(problem, trial)
            if not np.isfinite(bound.value):
                break
            best = best_of([best, bound])
            if relative_gap(problem, estimate.cost, best.value) <= ENOUGH:
                return best
            if not patient and bound.value < last + _PROGRESS * (estimate.cost - last):
                break
            last, soft = bound.value, 0.5 * soft
    return best


@dataclass(frozen=True, eq=False)
class _System:
    """What does not change from round to round.

    Attributes
    ----------
    problem : Problem
        The problem.
    scaling : Scaling
        Its units.
    basis : ndarray, shape (p, p)
        From scaled coordinates to theta.
    inverses : ndarray, shape (N, s, s)
        From the matrices of the inequalities to scaled ones.
    tangent_inverses : ndarray, shape (L, 4, 4)
        The same of the pseudo-inertias that a log-det prior sees.
    GT : ndarray, shape (p, rows of `Problem.squared`)
        Derivative of c in y, for a unit cost.
    row_scale : ndarray, shape (r,)
        Sizes of the linear rows.
    """

    problem: Problem
    scaling: Scaling
    basis: Array
    inverses: Array
    tangent_inverses: Array
    GT: Array
    row_scale: Array

    @classmethod
    def of(cls, problem: Problem, scaling: Scaling) -> _System:
        feasible = problem.feasible
        believed = np.asarray(np.linalg.inv(scaling.roots(4)[problem.log_det.links]))
        return cls(
            problem=problem,
            scaling=scaling,
            basis=scaling.basis(),
            inverses=np.asarray(np.linalg.inv(scaling.block_roots(feasible))),
            tangent_inverses=believed,
            GT=2.0 * problem.squared.matrix.T / np.sqrt(scaling.cost),
            row_scale=scaling.row_sizes(feasible),
        )

    def polish(self, dual: Dual, bounds: Array, soft: float) -> Dual:
        """Return the multipliers after one round."""
        from scipy.linalg import lstsq

        problem, scaling, feasible = self.problem, self.scaling, self.problem.feasible
        unit = float(np.sqrt(scaling.cost))
        Z = _Softened.of(dual.Z, self.inverses, scaling.cost, soft)
        columns = [
            _columns(Z.S, self.inverses, feasible.block_basis, feasible.block_links, problem)
        ]
        missing = feasible.adjoint(Z.full())
        parts = [Z]
        log_det = problem.log_det
        W = _Softened.of(dual.W, self.tangent_inverses, 1.0, 0.0)
        basis = np.broadcast_to(pseudo_inertia(np.eye(10)), (len(W.S), 10, 4, 4))
        moved = _columns(W.S, self.tangent_inverses, basis, log_det.links, problem)
        columns.append(2.0 * log_det.strength / scaling.cost * moved)
        missing = missing - log_det.support(dual.W)[1]
        parts.append(W)
        bounded = np.flatnonzero(np.isfinite(bounds))
        mu = np.nan_to_num(bounds)
        missing = (missing + mu + dual.rows @ feasible.rows) / scaling.cost
        missing = missing - 2.0 * problem.squared.transposed(dual.y) / scaling.cost
        scale_y = max(float(np.linalg.norm(dual.y)) / unit, 1e-3)
        relax = np.eye(problem.n_theta)[:, bounded]
        relax = relax * (np.abs(mu[bounded]) / scaling.cost + soft / scaling.theta[bounded])
        # A limit without a multiplier takes no part: its side is not known.
        size = np.abs(dual.rows) / scaling.cost + soft * feasible.equations / self.row_scale
        system = np.hstack(
            [self.GT * scale_y, *(-block for block in columns), -relax, -feasible.rows.T * size]
        )
        # Smallest solution by pivoted QR: ten times faster than by singular values.
        step = lstsq(
            self.basis.T @ system,
            self.basis.T @ missing,
            cond=_CUT,
            lapack_driver="gelsy",
            check_finite=False,
        )[0]
        at = len(dual.y)
        results = []
        for part, block in zip(parts, columns, strict=True):
            results.append(part.moved(step[at : at + block.shape[1]]))
            at += block.shape[1]
        return Dual(
            y=dual.y + scale_y * unit * step[: len(dual.y)],
            Z=clip_psd(results[0]),
            rows=dual.rows + scaling.cost * size * step[at + len(bounded) :],
            W=results[1],
        )


@dataclass(frozen=True, eq=False)
class _Softened:
    """Positive semidefinite matrices in scaled units, and the roots that changes go through."""

    S: Array
    inverses: Array
    cost: float

    @classmethod
    def of(cls, Z: Array, inverses: Array, cost: float, soft: float) -> _Softened:
        D = np.linalg.inv(inverses)
        scaled = np.swapaxes(D, 1, 2) @ Z @ D / cost
        values, vectors = np.linalg.eigh(scaled)
        values = np.maximum(values, 0.0)
        values = values + soft * max(float(values.max(initial=0.0)), np.finfo(float).tiny)
        S = (vectors * np.sqrt(values)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
        return cls(np.asarray(S), inverses, cost)

    def full(self) -> Array:
        """Return the matrices in their own units."""
        return np.asarray(
            self.cost * np.swapaxes(self.inverses, 1, 2) @ self.S @ self.S @ self.inverses
        )

    def moved(self, step: Array) -> Array:
        """Return them changed by coordinates of D in ``S·(E + D)·S``."""
        symmetric = symmetric_basis(self.S.shape[-1])
        D = np.einsum("na,aij->nij", step.reshape(len(self.S), len(symmetric)), symmetric)
        changed = clip_psd(self.S @ self.S + self.S @ D @ self.S)
        return np.asarray(self.cost * np.swapaxes(self.inverses, 1, 2) @ changed @ self.inverses)


def _columns(S: Array, inverses: Array, basis: Array, links: Indices, problem: Problem) -> Array:
    """Return how c changes with the coordinates of D of each matrix, (p, N·s·(s+1)/2)."""
    symmetric = symmetric_basis(S.shape[-1])
    out = np.zeros((len(S), len(symmetric), problem.n_theta))
    scaled = inverses[:, None] @ basis @ np.swapaxes(inverses, 1, 2)[:, None]
    moved = S[:, None] @ symmetric @ S[:, None]
    values = np.einsum("naij,nkij->nak", moved, scaled)
    for n, link in enumerate(links):
        out[n, :, 10 * link : 10 * link + 10] = values[n]
    return out.reshape(-1, problem.n_theta).T
