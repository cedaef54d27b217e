"""Units in which a problem's numbers are of order one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.conic.solve import symmetric_basis
from sdpid.estimation.constraints.feasible_set import FeasibleSet
from sdpid.estimation.problem import Problem
from sdpid.robot.consistent import raise_second_moments
from sdpid.robot.inertia import (
    from_pseudo_inertia,
    physical_parameters,
    pseudo_inertia,
    spatial_inertia,
    theta_from_physical,
)
from sdpid.robot.model.base_parameters import characteristic_length

# The cost is counted in units of its floor; when the data are exact the floor is rounding, and
# this share of the squared efforts takes its place.
_COST_FLOOR = 1e-7

# Radius of gyration, as a share of the robot's length, of a body nothing is known of.
_GYRATION = 0.5

# Second moments of a scale are at least those of this share of the robot's length: bodies of
# descriptions are sometimes points, and solutions lie on the boundary.
_THINNEST = 0.1

# And at most these: sizes beyond a few lengths of the robot, or below a gram, are no sizes.
_FARTHEST = 5.0
_LIGHTEST = 1e-3


@dataclass(frozen=True, eq=False)
class Scaling:
    """Scales of one problem.

    Attributes
    ----------
    length : float
        A length of the robot's size, m.
    mass : float
        A mass that gives efforts of the measured size, kg.
    bodies : ndarray, shape (links, 10)
        A consistent body of each link's size: its prior where there is one.
    friction : ndarray
        Size of each friction parameter.
    cost : float
        Size of the cost.
    """

    length: float
    mass: float
    bodies: Array
    friction: Array
    cost: float

    @classmethod
    def of(cls, problem: Problem) -> Scaling:
        """Choose scales from the robot's lengths, its prior and the measured efforts."""
        length = characteristic_length(problem.robot)
        h = problem.squared.rhs
        total = float(h @ h) + problem.floor
        links = problem.robot.n_links
        G = problem.A @ problem.base.matrix
        inertial = np.linalg.norm(G[:, : 10 * links] * np.tile(_units(length), links), axis=0)
        seen = inertial[inertial > 1e-9 * inertial.max(initial=1.0)]
        reach = float(np.sqrt(np.mean(seen**2))) if seen.size else 1.0
        mass = np.sqrt(total) / (reach * np.sqrt(10.0 * links))
        mass = float(np.clip(mass, problem.constraints.mass_min, problem.constraints.mass_max))
        friction = np.linalg.norm(G[:, 10 * links :], axis=0)
        size, moves = np.sqrt(total / max(problem.robot.n, 1)), friction > 0.0
        rest = np.where(moves, size / np.where(moves, friction, 1.0), 1.0)
        sphere = from_pseudo_inertia(mass * np.diag([(_GYRATION * length) ** 2] * 3 + [1.0]))
        known = problem.robot.prior[:, :1] > 0.0
        bodies = thickened(np.where(known, problem.robot.prior, sphere), length)
        cost = max(problem.floor, _COST_FLOOR * total, float(np.finfo(float).tiny))
        return cls(length, mass, bodies, rest, cost)

    @property
    def theta(self) -> Array:
        """Size of each standard parameter, shape (p,)."""
        return np.append(self.bodies[:, :1] * _units(self.length), self.friction)

    def around(self, theta: Array) -> Scaling:
        """Return the same scales with bodies of the sizes of theta's links."""
        bodies = theta[: self.bodies.size].reshape(self.bodies.shape)
        return replace(self, bodies=thickened(bodies, self.length))

    def basis(self) -> Array:
        """Return the map from scaled coordinates to theta, shape (p, p).

        A link's coordinates are the entries, in an orthonormal basis, of U in P = L·U·L^T, with
        L·L^T the pseudo-inertia of its body of that size: U = E is that body.
        """
        count = self.bodies.size
        out = np.diag(np.concatenate([np.zeros(count), self.friction]))
        symmetric = symmetric_basis(4)
        for link, P in enumerate(pseudo_inertia(self.bodies)):
            L = np.linalg.cholesky(P)
            columns = from_pseudo_inertia(L @ symmetric @ L.T).T
            out[10 * link : 10 * link + 10, 10 * link : 10 * link + 10] = columns
        return out

    def roots(self, size: int) -> Array:
        """Return D of each link with F = D·F_scaled·D^T for its 4×4 or 6×6 matrix F."""
        matrices = pseudo_inertia(self.bodies) if size == 4 else spatial_inertia(self.bodies)
        return np.asarray(np.linalg.cholesky(matrices))

    def block_roots(self, feasible: FeasibleSet) -> Array:
        """Return D of each of the set's matrix inequalities, shape (N, s, s)."""
        size = feasible.size
        own = self.roots(size)[: feasible.n_own]
        cones = feasible.block_basis[feasible.n_own :, :, -1, -1]
        bodies = np.abs(self.bodies[feasible.block_links[feasible.n_own :]])
        # The size of a cone is that of its axis; of the terms, should they cancel.
        scale = np.einsum("nk,nk->n", np.abs(cones), bodies)
        scale = np.where(scale > 0.0, scale, 1.0)
        rest = np.sqrt(scale)[:, None, None] * np.eye(size)
        return np.concatenate([own, rest])

    def inverses(self, feasible: FeasibleSet) -> Array:
        """Return the inverses of `block_roots`: from the set's matrices to scaled ones."""
        return np.asarray(np.linalg.inv(self.block_roots(feasible)))

    def row_sizes(self, feasible: FeasibleSet) -> Array:
        """Return the size of each of the set's linear rows, shape (r,)."""
        size = np.linalg.norm(feasible.rows * self.theta, axis=1)
        return np.asarray(np.maximum(size, np.finfo(float).tiny))


def _units(length: float) -> Array:
    """Return the size of each of a body's parameters (10,), for a mass of one."""
    return np.array([1.0, *(length,) * 3, *(length**2,) * 6])


def congruent(T: Array, matrices: Array) -> Array:
    """Return ``T @ matrix @ T^T`` of stacks of matrices."""
    return np.asarray(T @ matrices @ np.swapaxes(T, -1, -2))


def thickened(bodies: Array, length: float) -> Array:
    """Return bodies made consistent and not too thin, for use as sizes only.

    Centers of mass are kept within a few lengths of the robot, and eigenvalues of the second
    moments about them between those of a tenth and of a few lengths.
    """
    bodies = np.array(bodies)
    bodies[:, 0] = np.maximum(bodies[:, 0], _LIGHTEST)
    mass, com, about = physical_parameters(bodies)
    distance = np.linalg.norm(com, axis=1, keepdims=True)
    com = com * np.minimum(1.0, _FARTHEST * length / np.maximum(distance, 1e-300))
    least, most = (mass * (share * length) ** 2 for share in (_THINNEST, _FARTHEST))
    return raise_second_moments(theta_from_physical(mass, com, about), least, most=most)
