"""What a problem demands of the physical variables: smooth functions that are ≥ 0, or zero."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.estimation.local.physical_variables import PhysicalVariables
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling

# Scaled equations whose part beyond those before is smaller are taken for repetitions.
_REPEATED = 1e-9

# Bounds closer than this (scaled) are an equation.
_FIXED = 1e-12


@dataclass(frozen=True, eq=False)
class PhysicalConstraints:
    """Constraints in scaled physical variables, each in units of its own size.

    In order: the eigenvalues of what must exceed the margin, the room of the moments of inertia
    below theta_max, the bounds, the linear rows, and the cones ``axis·body − ‖V·body‖``. The
    eigenvalues are smooth but where they meet, the cones but at their apex.

    Attributes
    ----------
    problem : Problem
    variables : PhysicalVariables
    moment : float
        Size of a moment of inertia, kg·m².
    lower, upper : ndarray, shape (count,)
        Bounds on the scaled variables.
    rows : ndarray, shape (r, p)
        Rows ``rows @ theta ≥ limits`` that are inequalities.
    limits : ndarray, shape (r,)
    equations : ndarray, shape (e, p)
        Rows that are equations, repetitions left out.
    values : ndarray, shape (e,)
    cone_sizes : ndarray, shape (c,)
        Sizes of the cones.
    """

    problem: Problem
    variables: PhysicalVariables
    moment: float
    lower: Array
    upper: Array
    rows: Array
    limits: Array
    equations: Array
    values: Array
    cone_sizes: Array

    @classmethod
    def of(cls, problem: Problem, variables: PhysicalVariables) -> PhysicalConstraints:
        """Build the constraints of a problem in its variables."""
        scaling = Scaling.of(problem)
        feasible = problem.feasible
        index, inertial = variables.free, variables.free < 10 * feasible.n_links
        lower = np.full(variables.count, -np.inf)
        upper = np.full(variables.count, np.inf)
        mass = inertial & (index % 10 == 9)
        lower[mass], upper[mass] = problem.constraints.mass_min, problem.constraints.mass_max
        # Friction variables keep their place: the tail of theta.
        lower[~inertial] = feasible.lower[index[~inertial]]
        upper[~inertial] = feasible.upper[index[~inertial]]
        sizes = scaling.row_sizes(feasible)
        rows = feasible.rows / sizes[:, None]
        low, high = feasible.row_lower / sizes, feasible.row_upper / sizes
        equal = feasible.equations
        above, below = ~equal & np.isfinite(low), ~equal & np.isfinite(high)
        kept = _independent(rows[equal] * scaling.theta)
        cones = scaling.block_roots(feasible)[feasible.n_own :, 0, 0] ** 2
        return cls(
            problem,
            variables,
            scaling.mass * scaling.length**2,
            frozen(lower / variables.scale),
            frozen(upper / variables.scale),
            frozen(np.vstack([rows[above], -rows[below]])),
            frozen(np.concatenate([low[above], -high[below]])),
            frozen(rows[equal][kept]),
            frozen(low[equal][kept]),
            frozen(cones),
        )

    @property
    def fixed(self) -> np.ndarray:
        """Which variables have a single value."""
        return np.asarray(self.upper - self.lower < _FIXED)

    def at_least(self, x: Array) -> Array:
        """Return what must not be negative.

        In a consistent link no entry of theta exceeds the largest diagonal of its inertia by
        more than the mass allows, so bounding the diagonals bounds everything.
        """
        matrices, _ = self.variables.inertias(x)
        theta = self.variables.theta(x)
        eigenvalues = np.linalg.eigvalsh(matrices).ravel() - self.problem.constraints.margin
        bodies = self.problem.feasible.bodies(theta)
        room = 1.0 - bodies[:, [4, 6, 9]].ravel() / self.problem.constraints.theta_max
        low, high = self._bounded()
        return np.concatenate(
            [
                eigenvalues / self.moment,
                room,
                (x - self.lower)[low],
                (self.upper - x)[high],
                self.rows @ theta - self.limits,
                self._cones(theta)[0],
            ]
        )

    def at_least_jacobian(self, x: Array) -> Array:
        """Return the derivative of `at_least`."""
        matrices, _ = self.variables.inertias(x)
        _, vectors = np.linalg.eigh(matrices)
        J = self.variables.jacobian(x)
        links = self.problem.robot.n_links
        moments = J[: 10 * links].reshape(links, 10, -1)[:, [4, 6, 9]].reshape(3 * links, -1)
        low, high = self._bounded()
        identity = np.eye(len(x))
        return np.vstack(
            [
                self.normals(x, vectors),
                -moments / self.problem.constraints.theta_max,
                identity[low],
                -identity[high],
                self.rows @ J,
                self._cones(self.variables.theta(x))[1] @ J,
            ]
        )

    def zero(self, x: Array) -> Array:
        """Return what must vanish."""
        fixed = self.fixed
        equations = self.equations @ self.variables.theta(x) - self.values
        return np.concatenate([equations, (x - self.lower)[fixed]])

    def zero_jacobian(self, x: Array) -> Array:
        """Return the derivative of `zero`."""
        equations = self.equations @ self.variables.jacobian(x)
        return np.vstack([equations, np.eye(len(x))[self.fixed]])

    def along(self, x: Array, vectors: Array) -> Array:
        """Return ``u^T·(N − margin·E)·u`` of unit vectors (links, 3, k), scaled, (links·k,)."""
        matrices, _ = self.variables.inertias(x)
        values = np.einsum("lia,lij,lja->la", vectors, matrices, vectors)
        return np.asarray((values - self.problem.constraints.margin).ravel() / self.moment)

    def normals(self, x: Array, vectors: Array) -> Array:
        """Return the derivative of `along`, which is constant in x, (links·k, count)."""
        _, basis = self.variables.inertias(x)
        slopes = np.einsum("lia,kij,lja->lak", vectors, basis, vectors)
        links, count = slopes.shape[:2]
        each = np.zeros((links, count, links, 10))
        each[range(links), :, range(links), :6] = slopes
        full = np.zeros((links * count, self.problem.n_theta))
        full[:, : 10 * links] = each.reshape(links * count, -1)
        return self.variables.reduced(full) / self.moment

    def _bounded(self) -> tuple[np.ndarray, np.ndarray]:
        return np.isfinite(self.lower) & ~self.fixed, np.isfinite(self.upper) & ~self.fixed

    def _cones(self, theta: Array) -> tuple[Array, Array]:
        """Return the cones' rooms and their derivatives in theta, in units of the cones."""
        feasible = self.problem.feasible
        F = feasible.block_basis[feasible.n_own :]
        links = feasible.block_links[feasible.n_own :]
        bodies = feasible.bodies(theta)[links]
        axis, vectors = F[:, :, -1, -1], F[:, :, -1, :3]
        v = np.einsum("nki,nk->ni", vectors, bodies)
        length = np.linalg.norm(v, axis=1)
        # At the apex of ‖v‖ zero is one of its slopes.
        unit = v / np.where(length > 0.0, length, 1.0)[:, None]
        values = np.einsum("nk,nk->n", axis, bodies) - length
        slopes = np.zeros((len(links), len(theta)))
        own = axis - np.einsum("nki,ni->nk", vectors, unit)
        for row, (link, slope) in enumerate(zip(links, own, strict=True)):
            slopes[row, 10 * link : 10 * link + 10] = slope
        return values / self.cone_sizes, slopes / self.cone_sizes[:, None]


def _independent(rows: Array) -> np.ndarray:
    """Return which rows, in order, are independent of those before them."""
    from scipy.linalg import qr

    if not len(rows):
        return np.zeros(0, dtype=np.intp)
    unit = rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), np.finfo(float).tiny)
    R, order = qr(unit.T, mode="r", pivoting=True)
    diagonal = np.abs(np.diagonal(R))
    return np.sort(order[: int((diagonal > _REPEATED * diagonal[0]).sum())])
