"""The density that robots are drawn from: data and prior, inside of the constraints.

In coordinates x along the equations, ``theta = origin + directions·x``, it is proportional to

    exp(−½·(x − mean)^T·precision·(x − mean) − slope·x) · Π det(P_i)^strength

where every matrix inequality and every limit holds strictly, and zero elsewhere. The Gaussian is
the errors of the data as the residuals show them and of the prior's rows as stated, as in
`sdpid.estimation.posterior`; where no inequality is near its standard deviations are those of
Gauss-Markov intervals. The determinants and the slope are an entropic prior's own density, not
its curvature. Directions that neither sees are flat: the constraints alone bound them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError, InfeasibleError, SolverError
from sdpid.estimation.conic.solve import ConicProgram, Matrix, solve_conic
from sdpid.estimation.constraints.equalities import Fixed
from sdpid.estimation.coordinates import Coordinates, LinearLimits
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.posterior import FitErrors, Groups, fit_errors, rows_covariance
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling

# Draws stay inside of every matrix inequality by this much, in units of the link's own size:
# rounding and the digits of a file cannot take them out, and loaders take them for bodies.
_INSIDE = 1e-9

# The same for limits of single parameters and rows, some hundred roundings.
_ROUNDING = 1e-13

# What moves less than this in scaled units does not move.
_FIXED = 1e-12

# Directions that data and prior together see this little are open, but for rounding.
_OPEN = 1e-12


class Matrices(NamedTuple):
    """Symmetric matrices ``constants + Σ x_k·linear_k``.

    Attributes
    ----------
    constants : ndarray, shape (N, s, s)
    linear : ndarray, shape (n, N, s, s)
    """

    constants: Array
    linear: Array

    @classmethod
    def of(cls, found: list[Matrix], n: int, size: int) -> Matrices:
        """Gather matrices of n coordinates; those that do not move are left out."""
        moving = [each for each in found if np.abs(each.linear).max(initial=0.0) > _FIXED]
        linear = np.zeros((n, len(moving), size, size))
        for i, each in enumerate(moving):
            linear[each.index, i] = each.linear
        constants = [each.constant for each in moving]
        return cls(np.reshape(constants, (len(moving), size, size)), linear)

    def along(self, v: Array) -> Array:
        """Return how the matrices change along directions (C, n), shape (C, N, s, s)."""
        return np.tensordot(v, self.linear, 1)

    def at(self, x: Array) -> Array:
        """Return the matrices at points (C, n), shape (C, N, s, s)."""
        return np.asarray(self.constants + self.along(x))


@dataclass(frozen=True, eq=False)
class Density:
    """The density, in the coordinates of one scaling.

    Attributes
    ----------
    problem : Problem
        The problem.
    coordinates : Coordinates
        From x to theta.
    mean, slope : ndarray, shape (n,)
    precision : ndarray, shape (n, n)
        Of the Gaussian.
    walls : Matrices
        What must be positive definite.
    limits, room_at_zero : ndarray, shapes (r, n) and (r,)
        What must be positive: ``room_at_zero + limits @ x``.
    bodies : Matrices
        Pseudo-inertias of the links that an entropic prior is about.
    strength : float
        Power of their determinants.
    unseen : int
        Number of directions that neither data nor prior see.
    """

    problem: Problem
    coordinates: Coordinates
    mean: Array
    slope: Array
    precision: Array
    walls: Matrices
    limits: Array
    room_at_zero: Array
    bodies: Matrices
    strength: float
    unseen: int

    @classmethod
    def of(cls, estimate: Estimate, groups: Groups = "frequencies") -> Density:
        """Build from an estimate with standard parameters.

        Raises
        ------
        DataError
            When there is nothing to draw, or it is bounded by nothing but theta_max.
        SolverError
            When the equations among the constraints contradict each other.
        """
        if estimate.theta is None:
            raise DataError(
                f"draw: method {estimate.method!r} has no standard parameters, so there are no "
                "constraints to draw under; use an estimate of sdpid.solve_sdp."
            )
        theta = np.array(estimate.theta)
        problem = _with_fixed_parameters(estimate.problem)
        scaling = Scaling.of(problem).around(theta)
        coordinates = Coordinates.of(problem, scaling.basis(), theta)
        if coordinates is None:
            raise SolverError(
                "draw: the equations among the constraints contradict each other.", problem=problem
            )
        if not coordinates.directions.shape[1]:
            raise DataError("draw: the constraints fix every parameter: there is nothing to draw.")
        n, unseen = coordinates.directions.shape[1], _unseen(problem, scaling, coordinates)
        if problem.consistency == "none" and unseen:
            raise DataError(
                f"draw: neither data nor prior see {unseen} of {n} directions, and with "
                "consistency 'none' nothing but theta_max bounds them; use a consistency or a "
                "prior."
            )
        errors = fit_errors(estimate, groups)
        coordinates, mean, precision = _gaussian(problem, coordinates, errors)
        feasible, log_det = problem.feasible, problem.log_det
        walls = coordinates.inequalities(feasible, scaling, slack=-_INSIDE)
        bodies = coordinates.pseudo_inertias(scaling, log_det.links)
        limits, room = _limits(problem, scaling, coordinates)
        return cls(
            problem=problem,
            coordinates=coordinates,
            mean=mean,
            # Costs are twice nats.
            slope=0.5 * (log_det.trace_slope() @ coordinates.directions),
            precision=precision,
            walls=Matrices.of(walls, n, feasible.size),
            limits=limits,
            room_at_zero=room,
            bodies=Matrices.of(bodies, n, 4),
            strength=log_det.strength if len(log_det.links) else 0.0,
            unseen=unseen,
        )

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.mean)

    def theta(self, x: Array) -> Array:
        """Return the standard parameters (C, p) at points (C, n)."""
        moved = x @ self.coordinates.directions.T
        return np.asarray(self.coordinates.origin + moved)

    def center(self) -> Array:
        """Return the point (n,) where the density, weakened by a barrier on every wall, is largest.

        Raises
        ------
        InfeasibleError
            When the constraints leave no room to move in.
        """
        values, vectors = np.linalg.eigh(self.precision)
        kept = values > _OPEN * values[-1]
        M = np.sqrt(0.5 * values[kept])[:, None] * vectors[:, kept].T
        # A limit is a matrix of one entry.
        numbers = Matrices(self.room_at_zero[:, None, None], self.limits.T[:, :, None, None])
        matrices = [
            Matrix(np.arange(self.n), linear, constant)
            for each in (self.walls, self.bodies, numbers)
            for linear, constant in zip(each.linear.swapaxes(0, 1), each.constants, strict=True)
        ]
        program = ConicProgram(
            M=M,
            m=-M @ self.mean,
            cost=self.slope,
            C=np.zeros((0, self.n)),
            lower=np.zeros(0),
            upper=np.zeros(0),
            log_dets=tuple(matrices),
            weight=1.0,
        )
        solution = solve_conic(program)
        if solution.x is None or not self.inside(solution.x):
            raise InfeasibleError(
                f"draw: found no robot strictly inside of the constraints (the solver ended "
                f"'{solution.status}'): they leave no room to move in, beside data as precise. "
                "Widen limits that nearly meet, or state them as equations; of exact data the "
                "estimate is all there is.",
                problem=self.problem,
            )
        return solution.x

    def room(self, x: Array) -> Array:
        """Return how far points (C, n) are from the limits, (C, r)."""
        return np.asarray(self.room_at_zero + x @ self.limits.T)

    def inside(self, x: Array) -> bool:
        """Return whether a point (n,) is strictly inside."""
        values = [np.linalg.eigvalsh(each.at(x[None])) for each in (self.walls, self.bodies)]
        return all(bool(each.min(initial=1.0) > 0.0) for each in (*values, self.room(x[None])))

    def covariance_at(self, x: Array) -> Array:
        """Return the inverse curvature (n, n) of the density weakened by the barrier at a point.

        The ellipsoid of radius one about a point inside is inside of every wall.
        """
        slopes = [(self.limits / self.room(x[None]).T).T]
        for each in (self.walls, self.bodies):
            root = np.linalg.inv(np.linalg.cholesky(each.at(x[None])[0]))
            slopes.append((root @ each.linear @ np.swapaxes(root, 1, 2)).reshape(self.n, -1))
        flat = np.hstack(slopes)
        return np.asarray(np.linalg.inv(self.precision + flat @ flat.T))


def _with_fixed_parameters(problem: Problem) -> Problem:
    """Return a problem whose parameters with one possible value have equations that say so."""
    feasible, limits = problem.feasible, problem.constraints
    fixed = np.flatnonzero(feasible.lower == feasible.upper)
    if not len(fixed):
        return problem
    known = Fixed({feasible.theta_names[k]: float(feasible.lower[k]) for k in fixed})
    return problem.constrained(constraints=limits.replace(others=(*limits.others, known)))


def _gaussian(
    problem: Problem, coordinates: Coordinates, errors: FitErrors
) -> tuple[Coordinates, Array, Array]:
    """Return mean (n,) and precision (n, n) of the Gaussian of data and prior.

    In coordinates of their own, in which the precision is at most one: data may be many times as
    precise as links are large.
    """
    squared, X = problem.squared, coordinates.directions
    M = squared.matrix @ X
    U, singular, V = np.linalg.svd(M, full_matrices=False)
    rank = int(np.count_nonzero(singular > _OPEN * singular.max(initial=0.0)))
    U, singular, V = U[:, :rank], singular[:rank], V[:rank]
    count = len(problem.A)
    # The errors of the data's rows are those that the residuals show, of the prior's as stated.
    W = np.eye(len(M))
    W[:count, :count] = rows_covariance(problem, errors)
    try:
        root = np.linalg.inv(np.linalg.cholesky(U.T @ W @ U)) @ (singular[:, None] * V)
    except np.linalg.LinAlgError:
        raise DataError(
            "draw: the residuals show no errors in some directions: the data are exact, and the "
            "estimate is all there is."
        ) from None
    own, turned = np.linalg.svd(root)[1:]
    size = np.zeros(X.shape[1])
    size[:rank] = own
    shrunk = np.hypot(size, 1.0)
    mean = shrunk * (turned @ V.T @ ((U.T @ -squared.residual(coordinates.origin)) / singular))
    return (
        Coordinates(coordinates.origin, X @ turned.T / shrunk),
        mean,
        np.diag((size / shrunk) ** 2),
    )


def _unseen(problem: Problem, scaling: Scaling, coordinates: Coordinates) -> int:
    """Return how many directions neither data nor prior see."""
    term = problem.log_det
    entries = (10 * term.links[:, None] + np.arange(10)).ravel()
    bodies = coordinates.directions[entries] / scaling.theta[entries, None]
    squares = problem.squared.matrix @ coordinates.directions
    squares /= max(float(np.linalg.norm(squares, 2)), np.finfo(float).tiny)
    singular = np.linalg.svd(np.vstack([squares, bodies]), compute_uv=False)
    seen = int(np.count_nonzero(singular > _OPEN * singular[0]))
    return int(coordinates.directions.shape[1]) - seen


def _limits(problem: Problem, scaling: Scaling, coordinates: Coordinates) -> tuple[Array, Array]:
    """Return how far parameters and rows are from their limits, a rounding less (see `Density`)."""
    X = coordinates.directions
    bounded = np.abs(X).max(axis=1) > _FIXED * scaling.theta
    limits = LinearLimits(problem, scaling, coordinates, bounded)
    rows = np.vstack([np.eye(len(X)), problem.feasible.rows])[limits.chosen]
    # A value is the sum of its parts, which rounding is relative to.
    room = _ROUNDING * (1.0 + np.abs(rows) @ np.abs(coordinates.origin) / limits.sizes)
    constants = np.concatenate([-limits.lower - room, limits.upper - room])
    real = np.isfinite(constants)
    return np.vstack([limits.C, -limits.C])[real], constants[real]
