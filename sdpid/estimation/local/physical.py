"""The paper's variables: mass, center of mass and inertia about it, and what they must satisfy.

The map from these to the standard parameters is a bijection where masses are positive
(docs/theory). Six of the first link's variables have no influence on the effort when its
joint is revolute on a fixed base: they are left out, and filled in so that the link is
consistent, unless a prior or a further condition looks at them. For the Denso that makes the
paper's 66.
"""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid._common.kept import last_kept
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
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

# A column of the regressor this small beside the largest is zero.
_INVISIBLE = 1e-12

# Scaled equations whose part beyond those before is smaller are taken for repetitions.
_REPEATED = 1e-9

# Limits closer than this (scaled) are an equation.
_FIXED = 1e-12


# Slopes in the six entries as symmetric matrices, where an entry off the diagonal stands for two;
# and those of the moments that a mass away from the origin adds.
_SLOPES = _TENSOR_BASIS * (0.5 + 0.5 * np.eye(3))
_OF_OFFSET = complement(_SLOPES)


def tensor_slopes(slopes: Array) -> Array:
    """Return slopes (…, 6) in the entries of an inertia as a symmetric matrix (…, 3, 3)."""
    return np.asarray(np.tensordot(slopes, _SLOPES, 1))


def physical_slopes(mass: Array, com: Array, slopes: Array) -> tuple[Array, Array]:
    """Return slopes in a body's parameters (…, 10) as ones in its mass and center of mass.

    Those in its inertia are the same. Masses (…,) and centers of mass (…, 3) may be complex.
    """
    h = slopes[..., 1:4]
    turned = (np.tensordot(slopes[..., 4:], _OF_OFFSET, 1) @ com[..., None])[..., 0]
    return slopes[..., 0] + np.sum((h + turned) * com, axis=-1), mass[..., None] * (
        h + 2.0 * turned
    )


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
    bounded, bounded_theta : ndarray of int
        Masses and friction, among all variables and in theta.
    tensors : ndarray, shape (6, 3, 3)
        How what must exceed the margin follows from a link's inertia: that itself, about the center
        of mass, or for the 4×4 inequality the second moments.
    """

    def __init__(self, problem: Problem) -> None:
        scaling, links = Scaling.of(problem), 10 * problem.robot.n_links
        moment = scaling.mass * scaling.length**2
        each = np.array([moment] * 6 + [scaling.length] * 3 + [scaling.mass])
        self.problem, self.tensors = problem, _TENSOR_BASIS
        if problem.consistency == "pseudo_inertia":
            self.tensors = second_moment_from_inertia(_TENSOR_BASIS)
        self.sizes = np.concatenate([np.tile(each, problem.robot.n_links), scaling.friction])
        friction = np.arange(links, problem.n_theta)
        self.bounded = np.concatenate([np.arange(9, links, 10), friction])
        self.bounded_theta = np.concatenate([np.arange(0, links, 10), friction])
        spread, self.free = np.diag(self.sizes), np.arange(problem.n_theta)
        axis = _reducible_axis(problem)
        if axis is not None:
            about = TENSOR_INDEX.index((axis, axis))
            alike = [k for k, (i, j) in enumerate(TENSOR_INDEX) if i == j]
            spread[alike, about] = self.sizes[about]
            self.free = np.delete(self.free, [k for k in (*range(6), 6 + axis) if k != about])
        self.spread = spread[:, self.free]

    @last_kept
    def _links(self, x: Array) -> tuple[Array, Array, Array]:
        """Return masses (links,), centers of mass (links, 3) and inertias about them."""
        each = self.problem.feasible.bodies(self.spread @ x)
        return each[:, 9], each[:, 6:9], np.tensordot(each[:, :6], _TENSOR_BASIS, 1)

    @last_kept
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
        J = self._link_jacobians(x)
        links = 10 * len(J)
        parts = slopes[:, :links].reshape(-1, len(J), 10).swapaxes(0, 1)
        pulled = (parts @ J).swapaxes(0, 1).reshape(-1, links)
        return np.asarray(np.hstack([pulled, slopes[:, links:]]) @ self.spread)

    @last_kept
    def _link_jacobians(self, x: Array) -> Array:
        """Return the derivative of each link's parameters in its variables, (links, 10, 10)."""
        mass, com, _ = self._links(x)
        units, J = np.eye(10), np.empty((len(mass), 10, 10))
        J[:, :, :6] = units[:, 4:]
        J[:, :, 9], J[:, :, 6:9] = physical_slopes(mass[:, None], com[:, None], units)
        return J

    def within(self, x: Array) -> Array:
        """Return scaled free variables with masses and friction within their bounds."""
        feasible, full, own = self.problem.feasible, self.spread @ x, self.bounded_theta
        full[self.bounded] = np.clip(full[self.bounded], feasible.lower[own], feasible.upper[own])
        return np.asarray((full / self.sizes)[self.free])

    def above_margin(self, x: Array) -> Array:
        """Return what must exceed the margin, (links, 3, 3)."""
        bodies = self.problem.feasible.bodies(self.spread @ x)
        return np.tensordot(bodies[:, :6], self.tensors, 1)


def _reducible_axis(problem: Problem) -> int | None:
    """Return the axis of the first link when only its moment about that axis matters."""
    # Then no parameter of the link but the inertia about the axis and the first moments across it
    # has a column in B, whatever the direction of gravity. A prior looks at all of them; rows and
    # cones may look at those that stay, the mass among them.
    if problem.prior is not None:
        return None
    feasible, B = problem.feasible, np.abs(problem.base.matrix)
    cones = feasible.block_basis[feasible.n_own :][feasible.block_links[feasible.n_own :] == 0]
    conditioned = np.any(feasible.rows[:, :10], axis=0) | np.any(cones, axis=(0, 2, 3))
    seen = B[:, :10].max(axis=0) > _INVISIBLE * max(float(B.max()), 1.0)
    for axis in range(3):
        about = 4 + TENSOR_INDEX.index((axis, axis))
        others = np.delete(np.arange(10), [about, *(1 + k for k in range(3) if k != axis)])
        if seen[about] and not seen[others].any() and not conditioned[others[1:]].any():
            return axis
    return None


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
    rows, limits : ndarray, shapes (r, p) and (r,)
        Rows ``rows @ theta ≥ limits`` that are inequalities.
    equations, values : ndarray, shapes (e, p) and (e,)
        Rows that are equations, repetitions left out.
    cone_sizes : ndarray, shape (c,)
        Sizes of the cones.
    """

    def __init__(self, variables: PhysicalVariables) -> None:
        problem, self.variables = variables.problem, variables
        feasible, scaling, own = problem.feasible, Scaling.of(problem), variables.bounded_theta
        unit, most = np.eye(problem.n_theta), problem.constraints.theta_max
        self.moment = scaling.mass * scaling.length**2
        self.margin = problem.constraints.margin / self.moment
        sizes = np.append(variables.sizes[variables.bounded], scaling.row_sizes(feasible))
        rows = np.vstack([unit[own], feasible.rows]) / sizes[:, None]
        low = np.append(feasible.lower[own], feasible.row_lower) / sizes
        high = np.append(feasible.upper[own], feasible.row_upper) / sizes
        equal = high - low < _FIXED
        above, below = ~equal & np.isfinite(low), ~equal & np.isfinite(high)
        kept = np.flatnonzero(equal)[_independent(rows[equal] * scaling.theta)]
        moments = np.arange(10 * feasible.n_links).reshape(-1, 10)[:, [4, 6, 9]].ravel()
        self.rows = np.vstack([-unit[moments] / most, rows[above], -rows[below]])
        self.limits = np.concatenate([-np.ones(len(moments)), low[above], -high[below]])
        self.equations, self.values = rows[kept], low[kept]
        self.cone_sizes = scaling.block_roots(feasible)[feasible.n_own :, 0, 0] ** 2

    def at_least(self, x: Array) -> Array:
        """Return what must not be negative."""
        theta = self.variables.theta(x)
        eigenvalues = np.linalg.eigvalsh(self.variables.above_margin(x)).ravel() / self.moment
        rows = self.rows @ theta - self.limits
        cones = self.variables.problem.feasible.slacks(theta) / self.cone_sizes
        return np.concatenate([eigenvalues - self.margin, rows, cones])

    def at_least_jacobian(self, x: Array) -> Array:
        """Return the derivative of `at_least`."""
        _, vectors = np.linalg.eigh(self.variables.above_margin(x))
        slopes = np.vstack([self.rows, self._cone_slopes(self.variables.theta(x))])
        return np.vstack([self.normals(vectors), self.variables.pulled(x, slopes)])

    def zero(self, x: Array) -> Array:
        """Return what must vanish."""
        return np.asarray(self.equations @ self.variables.theta(x) - self.values)

    def zero_jacobian(self, x: Array) -> Array:
        """Return the derivative of `zero`."""
        return self.variables.pulled(x, self.equations)

    def normals(self, vectors: Array) -> Array:
        """Return rows (links·k, count) with ``u^T·N·u = rows @ x`` of unit vectors (links, 3, k).

        N is what must exceed the margin; scaled.
        """
        slopes = np.einsum("lia,kij,lja->lak", vectors, self.variables.tensors, vectors)
        links = np.repeat(np.arange(len(vectors)), vectors.shape[2])
        full = self._of_links(slopes.reshape(-1, 6), links)
        return np.asarray(full @ self.variables.spread / self.moment)

    def _cone_slopes(self, theta: Array) -> Array:
        """Return the derivatives in theta of the cones' rooms, in units of the cones."""
        feasible = self.variables.problem.feasible
        v = feasible.cones(theta)[:, :-1]
        length = np.linalg.norm(v, axis=1, keepdims=True)
        # At the apex of ‖v‖ zero is one of its slopes.
        last = np.append(-v / np.where(length > 0.0, length, 1.0), np.ones_like(length), axis=1)
        slopes = np.einsum("ni,nki->nk", last, feasible.block_basis[feasible.n_own :, :, -1])
        slopes = slopes / self.cone_sizes[:, None]
        return self._of_links(slopes, feasible.block_links[feasible.n_own :])

    def _of_links(self, slopes: Array, links: Indices) -> Array:
        """Return slopes (k, m) in the first numbers of links (k,) as ones in all, (k, p)."""
        full = np.zeros((len(slopes), self.variables.problem.n_theta))
        columns = 10 * links[:, None] + np.arange(slopes.shape[1])
        full[np.arange(len(full))[:, None], columns] = slopes
        return full


def _independent(rows: Array) -> Indices:
    """Return which rows, in order, are independent of those before them."""
    from scipy.linalg import qr

    if not len(rows):
        return np.zeros(0, dtype=np.intp)
    unit = rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), np.finfo(float).tiny)
    R, order = qr(unit.T, mode="r", pivoting=True)
    diagonal = np.abs(np.diagonal(R))
    return np.sort(order[: int((diagonal > _REPEATED * diagonal[0]).sum())])
