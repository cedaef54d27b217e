"""The paper's variables: mass, center of mass and inertia about it, link by link.

The map from these to the standard parameters is a bijection where masses are positive
(docs/theory). Six of the first link's variables have no influence on the effort when its
joint is revolute on a fixed base: they are left out, and filled in so that the link is
consistent, unless a prior or a further condition looks at them. For the Denso that makes the
paper's 66.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
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


@dataclass(frozen=True, eq=False)
class PhysicalVariables:
    """The free variables of a problem and how they become standard parameters.

    Attributes
    ----------
    problem : Problem
        The problem.
    free : ndarray of int
        Which of the 10·links + friction variables are free.
    scale : ndarray
        Size of each free variable.
    axis : int or None
        Axis of the first link's joint whose other variables are left out; None: all are free.
    """

    problem: Problem
    free: np.ndarray
    scale: Array
    axis: int | None

    @classmethod
    def of(cls, problem: Problem) -> PhysicalVariables:
        """Find the free variables of a problem."""
        scaling = Scaling.of(problem)
        links = problem.robot.n_links
        size = scaling.length
        each = np.array([scaling.mass * size**2] * 6 + [size] * 3 + [scaling.mass])
        scale = np.concatenate([np.tile(each, links), scaling.theta[10 * links :]])
        axis = _reducible_axis(problem)
        free = np.ones(len(scale), dtype=bool)
        if axis is not None:
            free[:6] = [pair == (axis, axis) for pair in TENSOR_INDEX]
            free[6 + axis] = False
        index = np.flatnonzero(free)
        return cls(problem, index, scale[index], axis)

    @property
    def count(self) -> int:
        """Number of free variables."""
        return len(self.free)

    def expand(self, x: Array) -> Array:
        """Return all variables of scaled free ones, the left-out ones filled in.

        The first link's inertia becomes diagonal: with the axis entry zz, the others are zz for
        the 6×6 and half of it for the 4×4 inequality, where each second moment across the axis
        must be at least the margin and their sum is zz.
        """
        links = self.problem.robot.n_links
        full = np.zeros(10 * links + len(self.problem.friction.parameters))
        full[self.free] = x * self.scale
        if self.axis is not None:
            about = full[TENSOR_INDEX.index((self.axis, self.axis))]
            for k, (i, j) in enumerate(TENSOR_INDEX):
                if i == j != self.axis:
                    # Second moments zz/2, zz/2 across and zz/2 along the axis: a sphere's.
                    full[k] = about
        return full

    def theta(self, x: Array) -> Array:
        """Return the standard parameters of scaled free variables."""
        links = self.problem.robot.n_links
        full = self.expand(x)
        each = full[: 10 * links].reshape(links, 10)
        inertia = np.einsum("lk,kij->lij", each[:, :6], _TENSOR_BASIS)
        bodies = theta_from_physical(each[:, 9], each[:, 6:9], inertia)
        return np.concatenate([bodies.ravel(), full[10 * links :]])

    def from_theta(self, theta: Array) -> Array:
        """Return the scaled free variables of standard parameters with positive masses."""
        bodies = self.problem.feasible.bodies(theta)
        mass, com, inertia = physical_parameters(bodies)
        each = np.concatenate([tensor_entries(inertia), com, mass[:, None]], axis=1)
        full = np.concatenate([each.ravel(), theta[bodies.size :]])
        return np.asarray(full[self.free] / self.scale)

    def jacobian(self, x: Array) -> Array:
        """Return the derivative of theta in the scaled free variables, shape (p, count)."""
        return self.pulled(x, np.eye(self.problem.n_theta))

    def pulled(self, x: Array, slopes: Array) -> Array:
        """Return derivatives in theta (k, p) as ones in the scaled free variables (k, count)."""
        links = self.problem.robot.n_links
        each = self.expand(x)[: 10 * links].reshape(links, 10)
        blocks = _link_jacobians(each[:, 9], each[:, 6:9])
        out = slopes.copy()
        parts = slopes[:, : 10 * links].reshape(-1, links, 10).swapaxes(0, 1)
        out[:, : 10 * links] = (parts @ blocks).swapaxes(0, 1).reshape(len(slopes), -1)
        return self.reduced(out)

    def reduced(self, slopes: Array) -> Array:
        """Return derivatives in all variables (k, all) as ones in the scaled free variables."""
        out = slopes.copy()
        if self.axis is not None:
            about = TENSOR_INDEX.index((self.axis, self.axis))
            for k, (i, j) in enumerate(TENSOR_INDEX):
                if i == j != self.axis:
                    out[:, about] += out[:, k]
        return np.asarray(out[:, self.free] * self.scale)

    def inside(self, theta: Array) -> Array:
        """Return theta with eigenvalues below the margin raised to it, masses positive."""
        bodies = raise_second_moments(
            self.problem.feasible.bodies(theta),
            self.problem.constraints.margin,
            consistency=self.problem.consistency,
        )
        return np.concatenate([bodies.ravel(), theta[bodies.size :]])

    def inertias(self, x: Array) -> tuple[Array, Array]:
        """Return what must exceed the margin, (links, 3, 3), and its derivative by entry.

        That is the inertia about the center of mass, or for the 4×4 inequality the second
        moments about it, with the derivative in the six tensor entries, (6, 3, 3).
        """
        links = self.problem.robot.n_links
        each = self.expand(x)[: 10 * links].reshape(links, 10)
        tensors = np.einsum("lk,kij->lij", each[:, :6], _TENSOR_BASIS)
        if self.problem.consistency == "pseudo_inertia":
            return second_moment_from_inertia(tensors), second_moment_from_inertia(_TENSOR_BASIS)
        return tensors, _TENSOR_BASIS


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
    """Return the axis of the first link when only its moment about that axis matters.

    Then no parameter of the link but the inertia about the axis and the first moments across it
    has a column in B, whatever the direction of gravity. A prior looks at all of them; rows and
    cones may look at those that stay.
    """
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
