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

from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError, InfeasibleError, SolverError
from sdpid.estimation.conic.solve import ConicProgram, Matrix, solve_conic
from sdpid.estimation.coordinates import Coordinates, Limits
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


@dataclass(frozen=True, eq=False)
class Matrices:
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

    def __len__(self) -> int:
        return len(self.constants)

    @property
    def flat(self) -> Array:
        """Their entries, (n, N·s·s)."""
        return self.linear.reshape(len(self.linear), self.constants.size)

    def along(self, v: Array) -> Array:
        """Return how the matrices change along directions (C, n), shape (C, N, s, s)."""
        return np.asarray((v @ self.flat).reshape(len(v), *self.constants.shape))

    def at(self, x: Array) -> Array:
        """Return the matrices at points (C, n), shape (C, N, s, s)."""
        return self.constants + self.along(x)

    def single(self) -> list[Matrix]:
        """Return them one by one."""
        index = np.arange(len(self.linear))
        return [
            Matrix(index, self.linear[:, i], constant) for i, constant in enumerate(self.constants)
        ]


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
    walls : tuple of Matrices
        What must be positive definite: the matrix inequalities, and every limit as a number.
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
    walls: tuple[Matrices, ...]
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
        limits = _limits(problem, scaling, coordinates)
        return cls(
            problem=problem,
            coordinates=coordinates,
            mean=mean,
            # Costs are twice nats.
            slope=0.5 * (log_det.trace_slope() @ coordinates.directions),
            precision=precision,
            walls=(Matrices.of(walls, n, feasible.size), limits),
            bodies=Matrices.of(bodies, n, 4),
            strength=log_det.strength,
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
        program = ConicProgram(
            M=M,
            m=-M @ self.mean,
            cost=self.slope,
            C=np.zeros((0, self.n)),
            lower=np.zeros(0),
            upper=np.zeros(0),
            log_dets=tuple(each for own in self.matrices for each in own.single()),
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

    @property
    def matrices(self) -> tuple[Matrices, ...]:
        """All that must be positive definite, the bodies last."""
        return (*self.walls, self.bodies)

    def inside(self, x: Array) -> bool:
        """Return whether a point (n,) is strictly inside."""
        every = (np.linalg.eigvalsh(each.at(x[None])) for each in self.matrices)
        return all(bool(values.min(initial=1.0) > 0.0) for values in every)

    def covariance_at(self, x: Array) -> Array:
        """Return the inverse curvature (n, n) of the density weakened by the barrier at a point.

        The ellipsoid of radius one about a point inside is inside of every wall.
        """
        H = self.precision.copy()
        for each in self.matrices:
            root = np.linalg.inv(np.linalg.cholesky(each.at(x[None])[0]))
            whitened = root @ each.linear @ np.swapaxes(root, 1, 2)
            flat = whitened.reshape(each.flat.shape)
            H += flat @ flat.T
        return np.asarray(np.linalg.inv(H))


def _with_fixed_parameters(problem: Problem) -> Problem:
    """Return a problem whose parameters with one possible value have equations that say so."""
    feasible = problem.feasible
    fixed = np.flatnonzero(feasible.lower == feasible.upper)
    if not len(fixed):
        return problem
    limits = feasible.lower[fixed]
    extended = replace(
        feasible,
        row_names=(*feasible.row_names, *(f"{feasible.theta_names[k]} fixed" for k in fixed)),
        rows=np.vstack([feasible.rows, np.eye(problem.n_theta)[fixed]]),
        row_lower=np.concatenate([feasible.row_lower, limits]),
        row_upper=np.concatenate([feasible.row_upper, limits]),
    )
    return replace(problem, feasible=extended)


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


def _limits(problem: Problem, scaling: Scaling, coordinates: Coordinates) -> Matrices:
    """Return how far parameters and rows are from their limits, a rounding less."""
    X = coordinates.directions
    bounded = np.abs(X).max(axis=1) > _FIXED * scaling.theta
    limits = Limits(problem, scaling, coordinates, bounded)
    rows = np.vstack([np.eye(len(X)), problem.feasible.rows])[limits.chosen]
    # A value is the sum of its parts, which rounding is relative to.
    room = _ROUNDING * (1.0 + np.abs(rows) @ np.abs(coordinates.origin) / limits.sizes)
    constants = np.concatenate([-limits.lower - room, limits.upper - room])
    linear, real = np.vstack([limits.C, -limits.C]), np.isfinite(constants)
    return Matrices(constants[real, None, None], linear[real].T[:, :, None, None])
