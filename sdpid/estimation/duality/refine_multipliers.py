"""Lower bounds from a solver's multipliers, refined as little as needed to prove what it found.

A solver leaves errors in the linear term c of the bound (see `sdpid.estimation.duality.bound`),
which the wide box of theta makes expensive. At the optimum c is the multiplier of the bounds, which
the solver gives too, and zero in every parameter without one. That is a linear system in changes of
all multipliers; the matrices among them change as ``S·(E + D)·S``, S being the square root of Z
smoothed so that its null space can take part. As long as D is above −E the result is positive
semidefinite; where it is not, it is clipped, and another round takes the rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.estimation.conic.standard_form import symmetric_basis
from sdpid.estimation.duality.bound import (
    PROVEN,
    TARGET_GAP,
    Bound,
    bound_of,
    clip_psd,
    relative_gap,
)
from sdpid.estimation.duality.correct_multipliers import corrected_multipliers
from sdpid.estimation.duality.multipliers import Multipliers
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.robot.inertia import pseudo_inertia

# How far the null space of a multiplier may take part in refining it, relative to its largest
# eigenvalue: tried in turn, halved in each of `_ROUNDS` rounds, until the gap is small enough.
_SMOOTHING = (1e-6, 1e-8, 1e-10, 1e-12, 1e-14, 1e-5, 1e-4)
_ROUNDS = 8

# Equations of a round that are this close to dependent are dependent.
_CUT = 1e-14

# Corrections by a program of their own are tried where the gap is no larger: beyond, parameters are
# rather no optimum. Multipliers of examples/studies/birdy begin at up to 1e-3.
_CORRECTED = 1e-3

# A round must close this share of the gap to be worth another.
_PROGRESS = 0.05


def lower_bound(
    problem: Problem,
    theta: Array | None,
    multipliers: Multipliers,
    cost: float,
    *,
    exhaustive: bool = False,
) -> Bound:
    """Turn multipliers into a lower bound on the cost of all feasible parameters.

    Parameters
    ----------
    problem : Problem
        The problem.
    theta : ndarray, shape (p,), or None
        Parameters near an optimum.
    multipliers : Multipliers
        Those that were found with them. Without any of constraints the bound ignores the physics.
    cost : float
        What the parameters cost: the bound is compared with it.
    exhaustive : bool, optional
        Refine as long as it takes.

    Returns
    -------
    Bound
        The best of a few choices of the multipliers: as found, with the residual at theta, or
        refined (see `refine_multipliers`).
    """
    # Whatever the constraints, nothing costs less than the floor: no multipliers prove that much,
    # and where the constraints cost nothing it is all there is to prove. At the believed bodies
    # themselves a log-det prior's tangent is zero.
    free = replace(multipliers, Z=0.0 * multipliers.Z, rows=0.0 * multipliers.rows)
    trials = [replace(free, y=0.0 * free.y, W=problem.log_det.inverses), multipliers]
    if theta is not None:
        # The solver's own y goes with its other multipliers, where the residual of the point,
        # which was moved inside, does so to first order only; but it is the better start.
        residual = problem.squared.residual(theta)
        at_residual = replace(multipliers, y=residual)
        trials += [replace(free, y=residual), at_residual]
    best = max((bound_of(problem, trial) for trial in trials), key=_value)
    # Without constraints y follows from theta, and with a log-det prior its multiplier W.
    if theta is None or not (multipliers.constrained or len(problem.log_det.links)):
        return best
    if relative_gap(problem, cost, best.value) <= TARGET_GAP:
        return best
    best = max(best, refine_multipliers(problem, theta, at_residual, cost), key=_value)
    gap = relative_gap(problem, cost, best.value)
    if PROVEN < gap <= _CORRECTED:
        corrected = bound_of(problem, corrected_multipliers(problem, theta, multipliers))
        best = max(best, corrected, key=_value)
        gap = relative_gap(problem, cost, best.value)
    if exhaustive and gap > PROVEN:
        refined = refine_multipliers(problem, theta, at_residual, cost, exhaustive=True)
        best = max(best, refined, key=_value)
    return best


def refine_multipliers(
    problem: Problem,
    theta: Array,
    multipliers: Multipliers,
    cost: float,
    *,
    exhaustive: bool = False,
) -> Bound:
    """Return the best bound of several rounds of refining the multipliers.

    Parameters
    ----------
    problem : Problem
        The problem.
    theta : ndarray, shape (p,)
        Parameters near an optimum.
    multipliers : Multipliers
        What to start from.
    cost : float
        What the parameters cost; rounds end when the gap is small enough.
    exhaustive : bool, optional
        Go through all rounds, even where they do not seem to help.
    """
    best = bound_of(problem, multipliers)
    system = _System.of(problem, Scaling.of(problem).around(np.array(theta)))
    for first in _SMOOTHING:
        trial, smoothing = multipliers, first
        last = -np.inf
        for _ in range(_ROUNDS):
            trial = system.refined(trial, smoothing)
            bound = bound_of(problem, trial)
            if not np.isfinite(bound.value):
                break
            best = max(best, bound, key=_value)
            if relative_gap(problem, cost, best.value) <= TARGET_GAP:
                return best
            if not exhaustive and bound.value < last + _PROGRESS * (cost - last):
                break
            last, smoothing = bound.value, 0.5 * smoothing
    return best


def _value(bound: Bound) -> float:
    return bound.value


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

    def refined(self, multipliers: Multipliers, smoothing: float) -> Multipliers:
        """Return the multipliers after one round."""
        from scipy.linalg import lstsq

        problem, scaling, feasible = self.problem, self.scaling, self.problem.feasible
        unit = float(np.sqrt(scaling.cost))
        Z = _Smoothed.of(multipliers.Z, self.inverses, scaling.cost, smoothing)
        columns = [
            _columns(Z.S, self.inverses, feasible.block_basis, feasible.block_links, problem)
        ]
        missing = feasible.adjoint(Z.full())
        parts = [Z]
        log_det = problem.log_det
        W = _Smoothed.of(multipliers.W, self.tangent_inverses, 1.0, 0.0)
        basis = np.broadcast_to(pseudo_inertia(np.eye(10)), (len(W.S), 10, 4, 4))
        moved = _columns(W.S, self.tangent_inverses, basis, log_det.links, problem)
        columns.append(2.0 * log_det.strength / scaling.cost * moved)
        missing = missing - log_det.support(multipliers.W)[1]
        parts.append(W)
        bounded = np.flatnonzero(multipliers.bounds_included)
        mu = multipliers.bounds
        missing = (missing + mu + multipliers.rows @ feasible.rows) / scaling.cost
        missing = missing - 2.0 * problem.squared.transposed(multipliers.y) / scaling.cost
        scale_y = max(float(np.linalg.norm(multipliers.y)) / unit, 1e-3)
        relax = np.eye(problem.n_theta)[:, bounded]
        relax = relax * (np.abs(mu[bounded]) / scaling.cost + smoothing / scaling.theta[bounded])
        # A limit without a multiplier takes no part: its side is not known.
        size = (
            np.abs(multipliers.rows) / scaling.cost
            + smoothing * feasible.equations / self.row_scale
        )
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
        at = len(multipliers.y)
        results = []
        for part, block in zip(parts, columns, strict=True):
            results.append(part.moved(step[at : at + block.shape[1]]))
            at += block.shape[1]
        return replace(
            multipliers,
            y=multipliers.y + scale_y * unit * step[: len(multipliers.y)],
            Z=clip_psd(results[0]),
            rows=multipliers.rows + scaling.cost * size * step[at + len(bounded) :],
            W=results[1],
        )


@dataclass(frozen=True, eq=False)
class _Smoothed:
    """Positive semidefinite matrices in scaled units, and the roots that changes go through."""

    S: Array
    inverses: Array
    cost: float

    @classmethod
    def of(cls, Z: Array, inverses: Array, cost: float, smoothing: float) -> _Smoothed:
        D = np.linalg.inv(inverses)
        scaled = np.swapaxes(D, 1, 2) @ Z @ D / cost
        values, vectors = np.linalg.eigh(scaled)
        values = np.maximum(values, 0.0)
        values = values + smoothing * max(float(values.max(initial=0.0)), np.finfo(float).tiny)
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
