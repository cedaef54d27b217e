"""Scaled coordinates of theta along the equations among the constraints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.estimation.conic.solve import Matrix
from sdpid.estimation.constraints.feasible_set import FeasibleSet
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling, congruent
from sdpid.robot.inertia import pseudo_inertia

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
    return _solved(rows, feasible.row_lower[chosen])[-1]


def _solved(rows: Array, target: Array) -> tuple[Indices, Array, Array, float]:
    """Return the columns that scaled rows touch, there a solution and the null space; what is left.

    Rows are taken to unit length. What is left of the target is what they contradict each other
    by, along the left null directions.
    """
    sizes = np.linalg.norm(rows, axis=1)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    rows, target = rows / sizes[:, None], target / sizes
    touched = np.flatnonzero(np.any(rows != 0.0, axis=0))
    U, singular, V = np.linalg.svd(rows[:, touched])
    rank = int(np.count_nonzero(singular > _DEPENDENT * singular.max(initial=0.0)))
    solution = V[:rank].T @ ((U[:, :rank].T @ target) / singular[:rank])
    worst = float(np.abs(U[:, rank:].T @ target).max(initial=0.0))
    size = max(1.0, float(np.abs(target).max(initial=0.0)))
    return touched, solution, V[rank:].T, worst / size


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
        touched, step, null, left = _solved(equations @ basis, target)
        if left > CONTRADICTION:
            return None
        rest = np.setdiff1d(np.arange(basis.shape[1]), touched)
        directions = np.hstack([basis[:, touched] @ null, basis[:, rest]])
        size = np.linalg.norm(basis, axis=1, keepdims=True)
        directions[np.abs(directions) < FIXED * size] = 0.0
        return cls(reference + basis[:, touched] @ step, directions)

    def theta(self, x: Array) -> Array:
        """Return the standard parameters at x."""
        return np.asarray(self.origin + self.directions @ x)

    def inequalities(
        self, feasible: FeasibleSet, scaling: Scaling, *, slack: float = 0.0
    ) -> list[Matrix]:
        """Return a set's scaled matrix inequalities, loosened by a slack, as functions of x."""
        inverses = scaling.inverses(feasible)
        return self._matrices(
            congruent(inverses, feasible.block_constants) + slack * np.eye(feasible.size),
            congruent(inverses[:, None], feasible.block_basis),
            feasible.block_links,
        )

    def pseudo_inertias(self, scaling: Scaling, links: Indices) -> list[Matrix]:
        """Return the pseudo-inertias of links, in scaled units, as functions of x."""
        inverses = np.asarray(np.linalg.inv(scaling.roots(4)[links]))
        basis = congruent(inverses[:, None], pseudo_inertia(np.eye(10)))
        return self._matrices(np.zeros_like(inverses), basis, links)

    def _matrices(self, constants: Array, basis: Array, links: Indices) -> list[Matrix]:
        """Return matrices of links, ``constant + Σ body_k·basis_k``, as functions of x."""
        out = []
        for constant, units, link in zip(constants, basis, links, strict=True):
            own = self.directions[10 * link : 10 * link + 10]
            index = np.flatnonzero(np.any(own != 0.0, axis=0))
            linear = np.einsum("ka,kij->aij", own[:, index], units)
            here = self.origin[10 * link : 10 * link + 10]
            out.append(Matrix(index, linear, constant + np.einsum("k,kij->ij", here, units)))
        return out


class LinearLimits:
    """Bounds on parameters and linear rows, in units of their sizes, as functions of x.

    Of some parameters (p,) and then all r rows it holds those that x can change; no equations.

    Attributes
    ----------
    chosen : ndarray of int
        Which of the p + r these are.
    sizes : ndarray
        Their sizes.
    C, lower, upper : ndarray
        ``lower ≤ C·x ≤ upper``.
    """

    def __init__(
        self, problem: Problem, scaling: Scaling, coordinates: Coordinates, bounded: Mask
    ) -> None:
        feasible, X = problem.feasible, coordinates.directions
        sizes = np.append(scaling.theta, scaling.row_sizes(feasible))
        functions = np.vstack([np.eye(len(X)), feasible.rows])
        moved = np.abs(functions @ X).max(axis=1, initial=0.0)
        limited = ~feasible.equations & (moved[len(X) :] > FIXED * sizes[len(X) :])
        self.chosen = np.flatnonzero(np.append(bounded & (moved[: len(X)] > 0.0), limited))
        self.sizes, functions = sizes[self.chosen], functions[self.chosen]
        lower = np.append(feasible.lower, feasible.row_lower)[self.chosen]
        upper = np.append(feasible.upper, feasible.row_upper)[self.chosen]
        self.C, here = functions @ X / self.sizes[:, None], functions @ coordinates.origin
        self.lower, self.upper = (lower - here) / self.sizes, (upper - here) / self.sizes
        self._ends = len(X), len(sizes)

    def split(self, values: Array) -> tuple[Array, Array]:
        """Return values of the chosen as those of all parameters and all rows; others are zero."""
        parameters, count = self._ends
        out = np.zeros(count)
        out[self.chosen] = values
        return out[:parameters], out[parameters:]
