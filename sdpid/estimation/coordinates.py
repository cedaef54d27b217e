"""Scaled coordinates of theta along the equations among the constraints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.estimation.conic.solve import Matrix
from sdpid.estimation.constraints.feasible_set import FeasibleSet
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling

# Equations that are this close to dependent are dependent; what they then contradict each other
# by, in units of the rows, must be rounding.
_DEPENDENT = 1e-10
CONTRADICTION = 1e-9

# What moves less than this in scaled units is fixed, but for rounding, which a solver would scale
# up: such limits are left to the check of what is found.
FIXED = 1e-12


def contradiction(problem: Problem, scaling: Scaling, chosen: Indices) -> float:
    """Return by how much equations contradict each other, in units of the rows.

    Parameters
    ----------
    problem : Problem
        The problem.
    scaling : Scaling
        Units.
    chosen : ndarray of int
        Rows of the feasible set that are equations.
    """
    feasible = problem.feasible
    rows = feasible.rows[chosen] @ scaling.basis()
    _, U, singular, _, target = _decomposed(rows, feasible.row_lower[chosen])
    return _contradiction(U[:, len(singular) :], target)


def _decomposed(rows: Array, target: Array) -> tuple[Indices, Array, Array, Array, Array]:
    """Return the columns that scaled rows touch, their decomposition there, and the target.

    Rows are taken to unit length; of the singular values those above rounding are returned.
    """
    sizes = np.linalg.norm(rows, axis=1)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    rows = rows / sizes[:, None]
    touched = np.flatnonzero(np.any(rows != 0.0, axis=0))
    U, singular, V = np.linalg.svd(rows[:, touched])
    rank = int(np.count_nonzero(singular > _DEPENDENT * singular.max(initial=0.0)))
    return touched, U, singular[:rank], V, target / sizes


def _contradiction(left: Array, target: Array) -> float:
    """Return the part of a target that rows cannot reach, along the left null directions."""
    worst = float(np.abs(left.T @ target).max(initial=0.0))
    return worst / max(1.0, float(np.abs(target).max(initial=0.0)))


@dataclass(frozen=True, eq=False)
class Coordinates:
    """``theta = origin + directions @ x``: scaled, and along the equations among the rows.

    Attributes
    ----------
    origin : ndarray, shape (p,)
    directions : ndarray, shape (p, n)
    """

    origin: Array
    directions: Array

    @classmethod
    def of(cls, problem: Problem, basis: Array, reference: Array) -> Coordinates | None:
        """Build about a reference; None where the equations contradict each other."""
        feasible = problem.feasible
        equations = feasible.rows[feasible.equations]
        if not len(equations):
            return cls(reference, basis)
        target = feasible.row_lower[feasible.equations] - equations @ reference
        touched, U, singular, V, target = _decomposed(equations @ basis, target)
        rank = len(singular)
        if _contradiction(U[:, rank:], target) > CONTRADICTION:
            return None
        along = (U[:, :rank].T @ target) / singular
        step = V[:rank].T @ along
        rest = np.setdiff1d(np.arange(basis.shape[1]), touched)
        free = len(touched) - rank
        directions = np.zeros((len(basis), free + len(rest)))
        directions[:, :free] = basis[:, touched] @ V[rank:].T
        directions[:, free:] = basis[:, rest]
        size = np.linalg.norm(basis, axis=1, keepdims=True)
        directions[np.abs(directions) < FIXED * size] = 0.0
        return cls(reference + basis[:, touched] @ step, directions)

    def theta(self, x: Array) -> Array:
        """Return the standard parameters at x."""
        return np.asarray(self.origin + self.directions @ x)

    def limited(self, problem: Problem, scaling: Scaling) -> Indices:
        """Return the rows that are not equations and that x can change."""
        feasible = problem.feasible
        moved = np.abs(feasible.rows @ self.directions).max(axis=1, initial=0.0)
        moves = moved > FIXED * scaling.row_sizes(feasible)
        return np.flatnonzero(~feasible.equations & moves)

    def inequalities(
        self, feasible: FeasibleSet, inverses: Array, *, slack: float = 0.0
    ) -> list[Matrix]:
        """Return a set's matrix inequalities, each scaled by its inverse, as functions of x."""
        transposed = np.swapaxes(inverses, 1, 2)
        return self.matrices(
            inverses @ feasible.block_constants @ transposed + slack * np.eye(feasible.size),
            inverses[:, None] @ feasible.block_basis @ transposed[:, None],
            feasible.block_links,
        )

    def matrices(self, constants: Array, basis: Array, links: Indices) -> list[Matrix]:
        """Return matrices of links, ``constant + Σ body_k·basis_k``, as functions of x."""
        out = []
        for constant, units, link in zip(constants, basis, links, strict=True):
            own = self.directions[10 * link : 10 * link + 10]
            index = np.flatnonzero(np.any(own != 0.0, axis=0))
            linear = np.einsum("ka,kij->aij", own[:, index], units)
            here = self.origin[10 * link : 10 * link + 10]
            out.append(Matrix(index, linear, constant + np.einsum("k,kij->ij", here, units)))
        return out
