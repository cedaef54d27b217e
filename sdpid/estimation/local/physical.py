"""The paper's variables: mass, center of mass and inertia about it, and what they must satisfy.

The map from these to the standard parameters is a bijection where masses are positive
(docs/theory). Six of the first link's variables have no influence on the effort when its
joint is revolute on a fixed base: they are left out, and filled in so that the link is
consistent, unless a prior or a further condition looks at them. For the Denso that makes the
paper's 66.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Indices, frozen
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.robot.consistent import raise_second_moments
from sdpid.robot.inertia import (
    TENSOR_INDEX,
    complement,
    inertia_tensor,
    physical_parameters,
    second_moment_from_inertia,
    tensor_entries,
    theta_from_physical,
)

# Order of a link's variables: inertia about the center of mass (6, as in theta), center of mass
# (3), mass (1).
_TENSOR_BASIS = inertia_tensor(np.eye(10)[4:])

# Forms (6, 3, 3): the inertia that a unit mass at r adds about the origin has entries r^T·F_k·r.
_FORMS = tensor_entries(complement(np.eye(9).reshape(3, 3, 3, 3)))
_PARALLEL_AXIS = np.moveaxis(0.5 * (_FORMS + _FORMS.swapaxes(0, 1)), -1, 0)

# A column of the regressor this small beside the largest is zero.
_INVISIBLE = 1e-12

# Scaled equations whose part beyond those before is smaller are taken for repetitions.
_REPEATED = 1e-9

# Bounds closer than this (scaled) are an equation.
_FIXED = 1e-12


@dataclass(frozen=True, eq=False)
class PhysicalVariables:
    """The free variables of a problem and how they become standard parameters.

    Attributes
    ----------
    problem : Problem
        The problem.
    sizes : ndarray, shape (p,)
        Size of each of the 10·links + friction variables.
    free : ndarray of int, shape (count,)
        Which of them are free.
    spread : ndarray, shape (p, count)
        All variables of the scaled free ones. Where the others are left out, the first link's
        inertia becomes diagonal: with the axis entry zz, the others are zz for the 6×6 and half of
        it for the 4×4 inequality, where each second moment across the axis must be at least the
        margin and their sum is zz: a sphere's second moments zz/2 in all directions.
    """

    problem: Problem
    sizes: Array
    free: Indices
    spread: Array

    @classmethod
    def of(cls, problem: Problem) -> PhysicalVariables:
        """Find the free variables of a problem."""
        scaling = Scaling.of(problem)
        links, size = problem.robot.n_links, scaling.length
        each = np.array([scaling.mass * size**2] * 6 + [size] * 3 + [scaling.mass])
        sizes = np.concatenate([np.tile(each, links), scaling.friction])
        spread, free = np.diag(sizes), np.arange(len(sizes))
        axis = _reducible_axis(problem)
        if axis is not None:
            about = TENSOR_INDEX.index((axis, axis))
            alike = [k for k, (i, j) in enumerate(TENSOR_INDEX) if i == j]
            spread[alike, about] = sizes[about]
            free = np.delete(free, [k for k in (*range(6), 6 + axis) if k != about])
        return cls(problem, sizes, free, frozen(spread[:, free]))

    def _links(self, x: Array) -> tuple[Array, Array, Array]:
        """Return masses (links,), centers of mass (links, 3) and inertias about them."""
        links = self.problem.robot.n_links
        each = (self.spread @ x)[: 10 * links].reshape(links, 10)
        return each[:, 9], each[:, 6:9], np.einsum("lk,kij->lij", each[:, :6], _TENSOR_BASIS)

    def theta(self, x: Array) -> Array:
        """Return the standard parameters of scaled free variables."""
        bodies = theta_from_physical(*self._links(x))
        return np.concatenate([bodies.ravel(), (self.spread @ x)[bodies.size :]])

    def from_theta(self, theta: Array) -> Array:
        """Return the scaled free variables of standard parameters with positive masses."""
        bodies = self.problem.feasible.bodies(theta)
        mass, com, inertia = physical_parameters(bodies)
        each = np.concatenate([tensor_entries(inertia), com, mass[:, None]], axis=1)
        full = np.concatenate([each.ravel(), theta[bodies.size :]])
        return np.asarray((full / self.sizes)[self.free])

    def jacobian(self, x: Array) -> Array:
        """Return the derivative of theta in the scaled free variables, shape (p, count)."""
        return self.pulled(x, np.eye(self.problem.n_theta))

    def pulled(self, x: Array, slopes: Array) -> Array:
        """Return derivatives in theta (k, p) as ones in the scaled free variables (k, count)."""
        mass, com, _ = self._links(x)
        links = len(mass)
        parts = slopes[:, : 10 * links].reshape(-1, links, 10).swapaxes(0, 1)
        pulled = (parts @ _link_jacobians(mass, com)).swapaxes(0, 1).reshape(-1, 10 * links)
        return np.asarray(np.hstack([pulled, slopes[:, 10 * links :]]) @ self.spread)

    def within(self, x: Array) -> Array:
        """Return scaled free variables with masses and friction within their bounds."""
        feasible, links = self.problem.feasible, 10 * self.problem.robot.n_links
        full, low, high = self.spread @ x, feasible.lower, feasible.upper
        full[9:links:10] = np.clip(full[9:links:10], low[:links:10], high[:links:10])
        full[links:] = np.clip(full[links:], low[links:], high[links:])
        return np.asarray((full / self.sizes)[self.free])

    def inside(self, theta: Array) -> Array:
        """Return theta with eigenvalues below the margin raised to it, masses positive."""
        bodies = raise_second_moments(
            self.problem.feasible.bodies(theta),
            self.problem.constraints.margin,
            consistency=self.problem.consistency,
        )
        return np.concatenate([bodies.ravel(), theta[bodies.size :]])

    def above_margin(self, x: Array) -> Array:
        """Return what must exceed the margin, (links, 3, 3).

        That is the inertia about the center of mass, or for the 4×4 inequality the second moments.
        """
        return self.bounded_by_margin(self._links(x)[2])

    def bounded_by_margin(self, inertias: Array) -> Array:
        """Return inertias about centers of mass (…, 3, 3) as what must exceed the margin."""
        of_moments = self.problem.consistency == "pseudo_inertia"
        return second_moment_from_inertia(inertias) if of_moments else inertias


def _link_jacobians(mass: Array, com: Array) -> Array:
    """Return the derivatives (links, 10, 10) of the links' parameters in (I_g, r, m)."""
    J = np.zeros((len(mass), 10, 10))
    J[:, 4:, :6] = np.eye(6)
    J[:, 0, 9] = 1.0
    J[:, 1:4, 6:9] = mass[:, None, None] * np.eye(3)
    J[:, 1:4, 9] = com
    slopes = np.einsum("kij,lj->lki", _PARALLEL_AXIS, com)
    J[:, 4:, 9] = np.einsum("lki,li->lk", slopes, com)
    J[:, 4:, 6:9] = 2.0 * mass[:, None, None] * slopes
    return J


def _reducible_axis(problem: Problem) -> int | None:
    """Return the axis of the first link when only its moment about that axis matters."""
    # Then no parameter of the link but the inertia about the axis and the first moments across it
    # has a column in B, whatever the direction of gravity. A prior looks at all of them; rows and
    # cones may look at those that stay.
    if problem.prior is not None:
        return None
    feasible = problem.feasible
    cones = feasible.block_basis[feasible.n_own :][feasible.block_links[feasible.n_own :] == 0]
    conditioned = np.any(feasible.rows[:, :10] != 0.0, axis=0) | np.any(
        cones != 0.0, axis=(0, 2, 3)
    )
    B = problem.base.matrix[:, :10]
    seen = np.abs(B).max(axis=0) > _INVISIBLE * max(float(np.abs(problem.base.matrix).max()), 1.0)
    for axis in range(3):
        tensor = [pair == (axis, axis) for pair in TENSOR_INDEX]
        allowed = np.array([False, *(k != axis for k in range(3)), *tensor])
        kept = allowed | (np.arange(10) == 0)
        if not np.any((seen & ~allowed) | (conditioned & ~kept)) and seen[4:][tensor].all():
            return axis
    return None


@dataclass(frozen=True, eq=False)
class PhysicalConstraints:
    """Constraints in scaled physical variables, each in units of its own size.

    In order: the eigenvalues of what must exceed the margin; rows of theta, which are the room of
    the moments of inertia below theta_max, bounds, and linear conditions; and the cones
    ``axis·body − ‖V·body‖``. The eigenvalues are smooth but where they meet, the cones but at their
    apex. In a consistent link no entry of theta exceeds the largest diagonal of its inertia by more
    than the mass allows, so bounding the diagonals bounds everything.

    Attributes
    ----------
    variables : PhysicalVariables
        The variables.
    moment : float
        Size of a moment of inertia, kg·m².
    margin : float
        The margin, so scaled.
    rows : ndarray, shape (r, p)
        Rows ``rows @ theta ≥ limits`` that are inequalities.
    limits : ndarray, shape (r,)
    equations : ndarray, shape (e, p)
        Rows that are equations, repetitions left out.
    values : ndarray, shape (e,)
    cone_sizes : ndarray, shape (c,)
        Sizes of the cones.
    """

    variables: PhysicalVariables
    moment: float
    margin: float
    rows: Array
    limits: Array
    equations: Array
    values: Array
    cone_sizes: Array

    @classmethod
    def of(cls, variables: PhysicalVariables) -> PhysicalConstraints:
        """Build the constraints of a problem in its variables."""
        problem = variables.problem
        feasible, scaling = problem.feasible, Scaling.of(problem)
        links, unit = 10 * feasible.n_links, np.eye(problem.n_theta)
        moments = [10 * link + k for link in range(feasible.n_links) for k in (4, 6, 9)]
        # Bounds are those of masses and of friction.
        own = np.concatenate([np.arange(0, links, 10), np.arange(links, problem.n_theta)])
        bound = np.concatenate([variables.sizes[9:links:10], variables.sizes[links:]])
        sizes = np.concatenate([bound, scaling.row_sizes(feasible)])
        rows = np.vstack([unit[own], feasible.rows]) / sizes[:, None]
        low = np.concatenate([feasible.lower[own], feasible.row_lower]) / sizes
        high = np.concatenate([feasible.upper[own], feasible.row_upper]) / sizes
        bounding = np.arange(len(rows)) < len(own)
        equal = np.where(bounding, high - low < _FIXED, low == high)
        above, below = ~equal & np.isfinite(low), ~equal & np.isfinite(high)
        kept = np.flatnonzero(equal)[_independent(rows[equal] * scaling.theta)]
        most, moment = problem.constraints.theta_max, scaling.mass * scaling.length**2
        return cls(
            variables,
            moment,
            problem.constraints.margin / moment,
            frozen(np.vstack([-unit[moments] / most, rows[above], -rows[below]])),
            frozen(np.concatenate([-np.ones(len(moments)), low[above], -high[below]])),
            frozen(rows[kept]),
            frozen(low[kept]),
            frozen(scaling.block_roots(feasible)[feasible.n_own :, 0, 0] ** 2),
        )

    def at_least(self, x: Array) -> Array:
        """Return what must not be negative."""
        theta = self.variables.theta(x)
        eigenvalues = np.linalg.eigvalsh(self.variables.above_margin(x)).ravel() / self.moment
        rows = self.rows @ theta - self.limits
        return np.concatenate([eigenvalues - self.margin, rows, self._cones(theta)[0]])

    def at_least_jacobian(self, x: Array) -> Array:
        """Return the derivative of `at_least`."""
        variables = self.variables
        _, vectors = np.linalg.eigh(variables.above_margin(x))
        slopes = np.vstack([self.rows, self._cones(variables.theta(x))[1]])
        return np.vstack([self.normals(vectors), variables.pulled(x, slopes)])

    def zero(self, x: Array) -> Array:
        """Return what must vanish."""
        return self.equations @ self.variables.theta(x) - self.values

    def zero_jacobian(self, x: Array) -> Array:
        """Return the derivative of `zero`."""
        return self.variables.pulled(x, self.equations)

    def normals(self, vectors: Array) -> Array:
        """Return rows (links·k, count) with ``u^T·N·u = rows @ x`` of unit vectors (links, 3, k).

        N is what must exceed the margin; scaled.
        """
        basis = self.variables.bounded_by_margin(_TENSOR_BASIS)
        slopes = np.einsum("lia,kij,lja->lak", vectors, basis, vectors)
        links, count = slopes.shape[:2]
        each = np.zeros((links, count, links, 10))
        each[range(links), :, range(links), :6] = slopes
        flat = each.reshape(links * count, 10 * links)
        return np.asarray(flat @ self.variables.spread[: 10 * links] / self.moment)

    def _cones(self, theta: Array) -> tuple[Array, Array]:
        """Return the cones' rooms and their derivatives in theta, in units of the cones."""
        feasible = self.variables.problem.feasible
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
