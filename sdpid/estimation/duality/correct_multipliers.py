"""Multipliers corrected by a semidefinite program of their corrections, in units of their errors.

A solver's multipliers leave a rest ρ in the linear term of the bound (see
`sdpid.estimation.duality.bound`) that the wide box of theta multiplies by thousands. With ε the
size of ρ the corrections (dy, dZ, dλ) to y + ε·dy, Z + ε·dZ and λ + ε·dλ are of order one, and the
best of them minimize what the bound is short of the cost of the parameters at hand,

    ‖r − y‖² + Σ⟨Z_i, F_i⟩ + Σ_j λ_j·(row_j·theta − limit_j) + Σ_k ρ⁺_k·(theta_k − lower_k)
      + Σ_k ρ⁻_k·(upper_k − theta_k),

in units of ε, with all Z_i ⪰ 0: a semidefinite program again, whose solution is off by the solver's
accuracy times ε. Iterative refinement of linear programs does the same [gleixner2016].

It finds what linear equations cannot (`sdpid.estimation.duality.refine_multipliers`): where no
multipliers have a definite Z, as of a first link that may hold any mass on its axis, ρ is rather
left to the bounds of theta than taken by matrices that would have to be indefinite.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.estimation.conic.solve import ConicProgram, Matrix, solve_conic
from sdpid.estimation.conic.standard_form import symmetric_basis
from sdpid.estimation.duality.bound import Multipliers, clip_psd, support
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling, congruent

# Where nothing is left of ρ this is the unit of corrections: some rounding.
_LEAST = 1e-12

# The program is solved to this, which is times ε of the multipliers. On 65 problems of
# examples/studies/birdy 1e-11 proves no more and takes half as long again.
_TOLERANCE = 1e-7


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
        -slopes(problem, inverses, feasible.block_basis, feasible.block_links),
        -(rows / row_sizes[:, None]).T,
        np.zeros((len(size), len(size))),
    )
    J = np.hstack(parts) * size[:, None]
    starts = np.cumsum([part.shape[1] for part in parts])
    # What each variable costs; ρ⁺ = ρ + ρ⁻.
    symmetric = symmetric_basis(feasible.size)
    above, below = ((theta - feasible.lower) / size, (feasible.upper - theta) / size)
    above, below = np.maximum(above, 0.0), np.maximum(below, 0.0)
    F = congruent(inverses, feasible.matrices(theta))
    directions = np.sign(multipliers.rows[held])
    limits = np.where(directions > 0.0, feasible.row_lower[held], feasible.row_upper[held])
    linear = above @ J
    linear[starts[0] : starts[1]] += np.einsum("nij,aij->na", F, symmetric).ravel()
    linear[starts[1] : starts[2]] += (rows @ theta - limits) / row_sizes
    linear[starts[2] :] += above + below
    squares = np.sqrt(unit) * np.eye(len(multipliers.y), J.shape[1])
    short = (problem.squared.residual(theta) - multipliers.y) / np.sqrt(cost * unit)
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
            M=squares,
            m=-short,
            cost=linear,
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
    Z = Z + np.einsum("na,aij->nij", dZ.reshape(len(Z), len(symmetric)), symmetric)
    found = np.array(multipliers.rows)
    found[held] += cost * dl / row_sizes
    return replace(
        multipliers,
        y=multipliers.y + np.sqrt(cost) * dy,
        Z=clip_psd(cost * congruent(np.swapaxes(inverses, 1, 2), Z)),
        rows=found,
    )


def slopes(problem: Problem, T: Array, basis: Array, links: Indices) -> Array:
    """Return how c falls with ``T^T·D·T`` in place of each Z, (p, N·s·(s+1)/2), by D's entries."""
    symmetric = symmetric_basis(basis.shape[-1])
    out = np.zeros((len(T), len(symmetric), problem.n_theta))
    values = np.einsum("aij,nkij->nak", symmetric, congruent(T[:, None], basis))
    for n, link in enumerate(links):
        out[n, :, 10 * link : 10 * link + 10] = values[n]
    return out.reshape(-1, problem.n_theta).T
