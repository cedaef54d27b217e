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

from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.estimation.conic.solve import ConicProgram, ConicSolution, Matrix, solve_conic
from sdpid.estimation.conic.standard_form import symmetric_basis
from sdpid.estimation.duality.bound import clip_psd
from sdpid.estimation.duality.multipliers import Multipliers
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling

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
    program = _Program.of(problem, theta, multipliers)
    solution = solve_conic(program.conic(), tolerance=_TOLERANCE)
    return multipliers if solution.x is None else program.corrected(solution)


@dataclass(frozen=True, eq=False)
class _Program:
    """The program in scaled coordinates, for a unit cost.

    Its variables are dy, dZ, dλ of rows that have multipliers, and ρ⁻, in this order.

    Attributes
    ----------
    problem : Problem
        The problem.
    scaling : Scaling
        Units about the parameters.
    theta : ndarray, shape (p,)
        The parameters.
    multipliers : Multipliers
        To be corrected.
    unit : float
        ε.
    rest : ndarray, shape (p,)
        ρ of the multipliers.
    inverses : ndarray, shape (N, s, s)
        From the matrices of the inequalities to scaled ones.
    Z : ndarray, shape (N, s, s)
        Multipliers of the scaled matrices.
    rows : ndarray of int
        The rows that have multipliers, and equations.
    """

    problem: Problem
    scaling: Scaling
    theta: Array
    multipliers: Multipliers
    unit: float
    rest: Array
    inverses: Array
    Z: Array
    rows: Indices

    @classmethod
    def of(cls, problem: Problem, theta: Array, multipliers: Multipliers) -> _Program:
        feasible = problem.feasible
        scaling = Scaling.of(problem).around(theta)
        rest = problem.squared.support(multipliers.y)[1]
        rest = rest + problem.log_det.support(multipliers.W)[1]
        rest = rest - feasible.adjoint(multipliers.Z) - multipliers.rows @ feasible.rows
        rest = rest * scaling.theta / scaling.cost
        # Of parameters with bounds of their own ρ is the multiplier, and no error.
        unit = float(np.abs(rest[~feasible.bounded]).max(initial=_LEAST))
        roots = scaling.block_roots(feasible)
        return cls(
            problem=problem,
            scaling=scaling,
            theta=theta,
            multipliers=multipliers,
            unit=unit,
            rest=rest,
            inverses=np.asarray(np.linalg.inv(roots)),
            Z=np.asarray(np.swapaxes(roots, 1, 2) @ multipliers.Z @ roots / scaling.cost),
            rows=np.flatnonzero((multipliers.rows != 0.0) | feasible.equations),
        )

    def _split(self) -> tuple[slice, slice, slice, slice]:
        """Return where dy, dZ, dλ and ρ⁻ are among the variables."""
        count, size = self.Z.shape[0], self.Z.shape[-1]
        lengths = (
            len(self.multipliers.y),
            count * (size * (size + 1) // 2),
            len(self.rows),
            self.problem.n_theta,
        )
        ends = np.cumsum((0, *lengths))
        y, Z, rows, left = (slice(ends[i], ends[i + 1]) for i in range(4))
        return y, Z, rows, left

    def conic(self) -> ConicProgram:
        """Return the program of the corrections."""
        problem, feasible, scaling = self.problem, self.problem.feasible, self.scaling
        y, Z, rows, left = self._split()
        symmetric = symmetric_basis(feasible.size)
        J = self._derivative()
        above = np.maximum((self.theta - feasible.lower) / scaling.theta, 0.0)
        below = np.maximum((feasible.upper - self.theta) / scaling.theta, 0.0)
        F = self.inverses @ feasible.matrices(self.theta) @ np.swapaxes(self.inverses, 1, 2)
        # ρ⁺ = ρ + ρ⁻.
        cost = above @ J
        cost[Z] += np.einsum("nij,aij->na", F, symmetric).ravel()
        cost[rows] += self._slacks()
        cost[left] += above + below
        squares = np.zeros((len(self.multipliers.y), J.shape[1]))
        squares[:, y] = np.sqrt(self.unit) * np.eye(len(squares))
        short = problem.squared.residual(self.theta) - self.multipliers.y
        short = short / np.sqrt(scaling.cost * self.unit)
        # ρ⁻ and ρ⁺ are positive, and so is λ in its direction.
        directions = np.sign(self.multipliers.rows[self.rows])
        directed = np.flatnonzero(~feasible.equations[self.rows])
        signs = np.zeros((len(directed), J.shape[1]))
        signs[np.arange(len(directed)), rows.start + directed] = directions[directed]
        positive = np.zeros_like(J)
        positive[:, left] = np.eye(len(J))
        sizes = np.abs(self.multipliers.rows) * scaling.row_sizes(feasible) / scaling.cost
        lower = [np.zeros(len(J)), -self.rest, -sizes[self.rows[directed]]]
        limits = np.concatenate(lower) / self.unit
        return ConicProgram(
            M=squares,
            m=-short,
            cost=cost,
            C=np.vstack([positive, J + positive, signs]),
            lower=limits,
            upper=np.full(len(limits), np.inf),
            blocks=self._blocks(Z.start, symmetric),
        )

    def _derivative(self) -> Array:
        """Return how ρ, in units of ε, changes with dy, dZ and dλ; ρ⁻ changes nothing."""
        problem, feasible, scaling = self.problem, self.problem.feasible, self.scaling
        y, Z, rows, left = self._split()
        symmetric = symmetric_basis(feasible.size)
        J = np.zeros((problem.n_theta, left.stop))
        J[:, y] = 2.0 * problem.squared.matrix.T / np.sqrt(scaling.cost)
        scaled = self.inverses[:, None] @ feasible.block_basis
        scaled = scaled @ np.swapaxes(self.inverses, 1, 2)[:, None]
        moved = np.einsum("aij,nkij->nka", symmetric, scaled)
        for n, link in enumerate(feasible.block_links):
            first = Z.start + n * len(symmetric)
            J[10 * link : 10 * link + 10, first : first + len(symmetric)] = -moved[n]
        J[:, rows] = -(feasible.rows[self.rows] / self._row_sizes()[:, None]).T
        return J * scaling.theta[:, None]

    def _row_sizes(self) -> Array:
        return self.scaling.row_sizes(self.problem.feasible)[self.rows]

    def _slacks(self) -> Array:
        """Return by how much the rows with multipliers are above the limits that these hold."""
        feasible, chosen = self.problem.feasible, self.rows
        at_lower = self.multipliers.rows[chosen] > 0.0
        limits = np.where(at_lower, feasible.row_lower[chosen], feasible.row_upper[chosen])
        return np.asarray((feasible.rows[chosen] @ self.theta - limits) / self._row_sizes())

    def _blocks(self, first: int, symmetric: Array) -> tuple[Matrix, ...]:
        """Return Z + ε·dZ, each taken by its own eigenvectors to order one."""
        out = []
        for n, Z in enumerate(self.Z):
            values, vectors = np.linalg.eigh(Z)
            K = (vectors / np.sqrt(np.maximum(values, self.unit))).T
            index = first + n * len(symmetric) + np.arange(len(symmetric))
            out.append(Matrix(index, self.unit * (K @ symmetric @ K.T), K @ Z @ K.T))
        return tuple(out)

    def corrected(self, solution: ConicSolution) -> Multipliers:
        """Return the multipliers with the corrections of a solution that has a point."""
        multipliers, cost = self.multipliers, self.scaling.cost
        step = self.unit * np.asarray(solution.x)
        y, Z, rows, _ = self._split()
        symmetric = symmetric_basis(self.Z.shape[-1])
        moved = np.einsum("na,aij->nij", step[Z].reshape(len(self.Z), len(symmetric)), symmetric)
        corrected = np.swapaxes(self.inverses, 1, 2) @ (self.Z + moved) @ self.inverses
        found = np.array(multipliers.rows)
        found[self.rows] += cost * step[rows] / self._row_sizes()
        return replace(
            multipliers,
            y=multipliers.y + np.sqrt(cost) * step[y],
            Z=clip_psd(cost * corrected),
            rows=found,
        )
