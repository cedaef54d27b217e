"""Multipliers refined as little as needed to prove what a solver found.

A solver leaves errors in the linear term c of the bound (see `sdpid.estimation.duality.bound`),
which the wide box of theta makes expensive. There are two remedies.

**Linear equations.** At the optimum c is the multiplier of the bounds, which the solver gives too,
and zero in every parameter without one. That is a linear system in changes of all multipliers; the
matrices among them change as ``S·(E + D)·S``, S being the square root of Z smoothed so that its
null space can take part. As long as D is above −E the result is positive semidefinite; where it is
not, it is clipped, and another round takes the rest.

**A program of the corrections**, in units of the errors. With ε the size of c but for multipliers
of bounds, the rest ρ, the corrections (dy, dZ, dλ) to y + ε·dy, Z + ε·dZ and λ + ε·dλ are of order
one, and the best of them minimize what the bound is short of the cost of the parameters at hand,

    ‖r − y‖² + Σ⟨Z_i, F_i⟩ + Σ_j λ_j·(row_j·theta − limit_j) + Σ_k ρ⁺_k·(theta_k − lower_k)
      + Σ_k ρ⁻_k·(upper_k − theta_k),

in units of ε, with all Z_i ⪰ 0: a semidefinite program again, whose solution is off by the solver's
accuracy times ε. Iterative refinement of linear programs does the same [gleixner2016]. It finds
what linear equations cannot: where no multipliers have a definite Z, as of a first link that may
hold any mass on its axis, ρ is rather left to the bounds of theta than taken by matrices that would
have to be indefinite. It cannot take their place: of 24 robots of a catalogue it alone leaves 13
unproven, most with an entropic prior, both together one. On 15 problems of five real arms it alone
proves all.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.estimation.conic.solve import ConicProgram, Matrix, solve_conic, symmetric_basis
from sdpid.estimation.duality.bound import (
    PROVEN,
    TARGET_GAP,
    Bound,
    Multipliers,
    best_of,
    bound_of,
    clip_psd,
    relative_gap,
    support,
)
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling, congruent
from sdpid.robot.inertia import pseudo_inertia

# How far the null space of a multiplier may take part in refining it, relative to its largest
# eigenvalue: tried in turn, halved in each of `_ROUNDS` rounds, until the gap is small enough.
_SMOOTHING = (1e-6, 1e-8, 1e-10, 1e-12, 1e-14, 1e-5, 1e-4)
_ROUNDS = 8

# Equations of a round that are this close to dependent are dependent.
_CUT = 1e-14

# A round must close this share of the gap to be worth another.
_PROGRESS = 0.05

# Corrections by a program are tried where the gap is no larger: beyond, parameters are rather no
# optimum. Multipliers of examples/evidence/birdy begin at up to 1e-3.
_CORRECTED = 1e-3

# Where nothing is left of ρ this is the unit of corrections: some rounding.
_LEAST = 1e-12

# The program is solved to this, which is times ε of the multipliers. On 65 problems of
# examples/evidence/birdy 1e-11 proves no more and takes half as long again.
_TOLERANCE = 1e-7


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
        refined (see `refine_multipliers` and `corrected_multipliers`).
    """
    # Whatever the constraints, nothing costs less than the floor: no multipliers prove that much,
    # and where the constraints cost nothing it is all there is to prove. At the believed bodies
    # themselves a log-det prior's tangent is zero.
    free = replace(multipliers, Z=0.0 * multipliers.Z, rows=0.0 * multipliers.rows)
    trials = [replace(free, y=0.0 * free.y, W=problem.log_det.inverses), multipliers]
    # The solver's own y goes with its other multipliers, where the residual of the point, which
    # was moved inside, does so to first order only; but it is the better start.
    at_residual = multipliers
    if theta is not None:
        at_residual = replace(multipliers, y=problem.squared.residual(theta))
        trials += [replace(free, y=at_residual.y), at_residual]
    best = best_of(*(bound_of(problem, trial) for trial in trials))

    def gap() -> float:
        return relative_gap(problem, cost, best.value)

    # Without constraints y follows from theta, and with a log-det prior its multiplier W.
    if theta is None or not (multipliers.constrained or len(problem.log_det.links)):
        return best
    if gap() > TARGET_GAP:
        best = best_of(best, refine_multipliers(problem, theta, at_residual, cost))
    if PROVEN < gap() <= _CORRECTED:
        corrected = corrected_multipliers(problem, theta, multipliers)
        best = best_of(best, bound_of(problem, corrected))
    if exhaustive and gap() > PROVEN:
        refined = refine_multipliers(problem, theta, at_residual, cost, exhaustive=True)
        best = best_of(best, refined)
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
    scaling = Scaling.of(problem).around(np.array(theta))
    for first in _SMOOTHING:
        trial, smoothing = multipliers, first
        last = -np.inf
        for _ in range(_ROUNDS):
            trial = _refined(problem, scaling, trial, smoothing)
            bound = bound_of(problem, trial)
            if not np.isfinite(bound.value):
                break
            best = best_of(best, bound)
            if relative_gap(problem, cost, best.value) <= TARGET_GAP:
                return best
            if not exhaustive and bound.value < last + _PROGRESS * (cost - last):
                break
            last, smoothing = bound.value, 0.5 * smoothing
    return best


def _refined(
    problem: Problem, scaling: Scaling, multipliers: Multipliers, smoothing: float
) -> Multipliers:
    """Return the multipliers after one round."""
    from scipy.linalg import lstsq

    feasible, log_det, cost = problem.feasible, problem.log_det, scaling.cost
    y, mu = multipliers.y, multipliers.bounds
    size_y = max(float(np.linalg.norm(y)), 1e-3 * float(np.sqrt(cost)))
    inverses = scaling.inverses(feasible)
    believed = np.asarray(np.linalg.inv(scaling.roots(4)[log_det.links]))
    S = _smoothed(multipliers.Z, inverses, cost, smoothing)
    V = _smoothed(multipliers.W, believed, 1.0, 0.0)
    transposed = np.swapaxes(inverses, 1, 2), np.swapaxes(believed, 1, 2)
    full = replace(multipliers, Z=cost * congruent(transposed[0], S @ S))
    missing = (mu - support(problem, full)[1]) / cost
    bounded = np.flatnonzero(multipliers.bounds_included)
    relax = np.eye(problem.n_theta)[:, bounded]
    relax = relax * (np.abs(mu[bounded]) / cost + smoothing / scaling.theta[bounded])
    # A limit without a multiplier takes no part: its side is not known.
    row_sizes = scaling.row_sizes(feasible)
    size = np.abs(multipliers.rows) / cost + smoothing * feasible.equations / row_sizes
    units = pseudo_inertia(np.eye(10))
    parts = (
        problem.squared.matrix.T * (2.0 * size_y / cost),
        -_slopes(problem, S @ inverses, feasible.block_basis, feasible.block_links),
        -2.0 * log_det.strength / cost * _slopes(problem, V @ believed, units, log_det.links),
        -relax,
        -feasible.rows.T * size,
    )
    basis = scaling.basis()
    # Smallest solution by pivoted QR: ten times faster than by singular values.
    step = lstsq(
        basis.T @ np.hstack(parts),
        basis.T @ missing,
        cond=_CUT,
        lapack_driver="gelsy",
        check_finite=False,
    )[0]
    steps = np.split(step, np.cumsum([part.shape[1] for part in parts[:-1]]))
    return replace(
        multipliers,
        y=y + size_y * steps[0],
        Z=clip_psd(cost * congruent(transposed[0], _moved(S, steps[1]))),
        rows=multipliers.rows + cost * size * steps[4],
        W=congruent(transposed[1], _moved(V, steps[2])),
    )


def _smoothed(Z: Array, inverses: Array, cost: float, smoothing: float) -> Array:
    """Return the roots S of matrices in scaled units, which changes go through."""
    roots = np.swapaxes(np.linalg.inv(inverses), 1, 2)
    values, vectors = np.linalg.eigh(congruent(roots, Z) / cost)
    values = np.maximum(values, 0.0)
    values = values + smoothing * max(float(values.max(initial=0.0)), np.finfo(float).tiny)
    return np.asarray((vectors * np.sqrt(values)[:, None, :]) @ np.swapaxes(vectors, 1, 2))


def _moved(S: Array, step: Array) -> Array:
    """Return ``S·(E + D)·S`` for coordinates of D, clipped."""
    return clip_psd(S @ S + S @ _matrices(step, S.shape[-1]) @ S)


def corrected_multipliers(problem: Problem, theta: Array, multipliers: Multipliers) -> Multipliers:
    """Return multipliers whose bound is as near to the cost of parameters as corrections get it.

    Parameters
    ----------
    problem : Problem
        The problem.
    theta : ndarray, shape (p,)
        Feasible parameters near an optimum.
    multipliers : Multipliers
        A solver's, found with them. Those of a log-det prior stay as they are.

    Returns
    -------
    Multipliers
        The same ones where the program has no solution.
    """
    feasible, scaling = problem.feasible, Scaling.of(problem).around(theta)
    size, cost = scaling.theta, scaling.cost
    rest = support(problem, multipliers)[1] * size / cost
    # Of parameters with bounds of their own ρ is the multiplier, and no error.
    unit = float(np.abs(rest[~feasible.bounded]).max(initial=_LEAST))
    inverses, roots = scaling.inverses(feasible), scaling.block_roots(feasible)
    Z = congruent(np.swapaxes(roots, 1, 2), multipliers.Z) / cost
    held = np.flatnonzero((multipliers.rows != 0.0) | feasible.equations)
    rows, row_sizes = feasible.rows[held], scaling.row_sizes(feasible)[held]
    # How ρ, in units of ε, changes with dy, dZ and dλ, which are the variables, and last ρ⁻.
    parts = (
        2.0 * problem.squared.matrix.T / np.sqrt(cost),
        -_slopes(problem, inverses, feasible.block_basis, feasible.block_links),
        -(rows / row_sizes[:, None]).T,
        np.zeros((len(size), len(size))),
    )
    J = np.hstack(parts) * size[:, None]
    starts = np.cumsum([part.shape[1] for part in parts])
    # What each variable costs; ρ⁺ = ρ + ρ⁻.
    symmetric = symmetric_basis(feasible.size)
    above = np.maximum((theta - feasible.lower) / size, 0.0)
    below = np.maximum((feasible.upper - theta) / size, 0.0)
    F = congruent(inverses, feasible.matrices(theta))
    directions = np.sign(multipliers.rows[held])
    limits = np.where(directions > 0.0, feasible.row_lower[held], feasible.row_upper[held])
    short = problem.squared.residual(theta) - multipliers.y
    products = np.einsum("nij,aij->na", F, symmetric).ravel()
    own = (0.0 * short, products, (rows @ theta - limits) / row_sizes, above + below)
    # ρ⁻ and ρ⁺ are positive, and so is λ in its direction.
    variables = np.eye(J.shape[1])
    directed = np.flatnonzero(~feasible.equations[held])
    signs = directions[directed, None] * variables[starts[1] + directed]
    sizes = np.abs(multipliers.rows[held]) * row_sizes / cost
    least = np.concatenate([np.zeros(len(size)), -rest, -sizes[directed]]) / unit
    # Z + ε·dZ, each taken by its own eigenvectors to order one.
    blocks = []
    for n, each in enumerate(Z):
        values, vectors = np.linalg.eigh(each)
        K = (vectors / np.sqrt(np.maximum(values, unit))).T
        index = starts[0] + n * len(symmetric) + np.arange(len(symmetric))
        blocks.append(Matrix(index, unit * (K @ symmetric @ K.T), K @ each @ K.T))
    solution = solve_conic(
        ConicProgram(
            M=np.sqrt(unit) * np.eye(len(short), J.shape[1]),
            m=-short / np.sqrt(cost * unit),
            cost=above @ J + np.concatenate(own),
            C=np.vstack([variables[starts[2] :], J + variables[starts[2] :], signs]),
            lower=least,
            upper=np.full(len(least), np.inf),
            blocks=tuple(blocks),
        ),
        tolerance=_TOLERANCE,
    )
    if solution.x is None:
        return multipliers
    dy, dZ, dl, _ = np.split(unit * solution.x, starts[:-1])
    found = np.array(multipliers.rows)
    found[held] += cost * dl / row_sizes
    Z = cost * congruent(np.swapaxes(inverses, 1, 2), Z + _matrices(dZ, feasible.size))
    y = multipliers.y + np.sqrt(cost) * dy
    return replace(multipliers, y=y, Z=clip_psd(Z), rows=found)


def _matrices(coordinates: Array, size: int) -> Array:
    """Return symmetric matrices (N, s, s) of coordinates, those of each in turn."""
    basis = symmetric_basis(size)
    return np.asarray(np.einsum("na,aij->nij", coordinates.reshape(-1, len(basis)), basis))


def _slopes(problem: Problem, T: Array, basis: Array, links: Indices) -> Array:
    """Return how c falls with ``T^T·D·T`` in place of each Z, (p, N·s·(s+1)/2), by D's entries."""
    symmetric = symmetric_basis(basis.shape[-1])
    out = np.zeros((len(T), len(symmetric), problem.n_theta))
    values = np.einsum("aij,nkij->nak", symmetric, congruent(T[:, None], basis))
    for n, link in enumerate(links):
        out[n, :, 10 * link : 10 * link + 10] = values[n]
    return out.reshape(-1, problem.n_theta).T
