"""What local solvers share: starts, the history of a run, and whether its end is stationary."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from contextlib import suppress

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen, real_array
from sdpid.errors import DataError
from sdpid.estimation.duality.bound import cost_scale
from sdpid.estimation.estimate import Estimate, Status, Step
from sdpid.estimation.local.physical import (
    PhysicalConstraints,
    PhysicalVariables,
    tensor_slopes,
)
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.robot.inertia import complement, theta_from_central_moments

# A local result may lie this far outside a constraint (kg·m², kg, …) and still count as feasible;
# SLSQP works on scaled constraints and stops near 1e-10 of them.
FEASIBLE_LOCAL = 1e-7

# Why a local solver is not needed.
UNCONSTRAINED = "consistency is 'none', nothing constrains; use solve_wls."

# Solvers sometimes report success where they merely stopped making progress. Their word is
# checked: what the best step promises must not exceed this share of the cost.
STATIONARY = 1e-4

# Least curvature, as a share of the largest, of directions that the effort does not show. With
# 1e-6 what is promised of the Denso is up to a thousand times less than what is to be had.
_FLATTEST = 1e-12

# Times that multipliers of the matrix inequalities are looked for in new directions.
_ROUNDS = 4


def random_start(problem: Problem, rng: np.random.Generator) -> Array:
    """Return random standard parameters that satisfy margins, bounds on masses, and signs.

    Each link is a random ellipsoid: masses log-uniform within the bounds around the problem's
    own scale, radii and centers of mass of the size of the robot. Further conditions are left to
    the solver.

    Parameters
    ----------
    problem : Problem
        The problem.
    rng : numpy.random.Generator
        Source of randomness.
    """
    scaling = Scaling.of(problem)
    bounds = problem.constraints
    links = problem.robot.n_links
    low = max(bounds.mass_min * 1.01, 0.05 * scaling.mass)
    high = max(min(bounds.mass_max * 0.99, 3.0 * scaling.mass), low)
    mass = np.exp(rng.uniform(np.log(low), np.log(high), links))
    com = rng.normal(0.0, 0.5 * scaling.length, (links, 3))
    frames = np.linalg.qr(rng.standard_normal((links, 3, 3)))[0]
    moments = mass[:, None] * (scaling.length * rng.uniform(0.1, 0.8, (links, 3))) ** 2
    moments = moments + 1.1 * bounds.margin
    second = np.einsum("lik,lk,ljk->lij", frames, moments, frames)
    friction = scaling.friction * rng.uniform(0.05, 1.0, len(scaling.friction))
    bodies = theta_from_central_moments(mass, com, second, "pseudo_inertia")
    return np.concatenate([bodies.ravel(), friction])


class LocalRun(ABC):
    """A problem in the variables of a local solver, and the steps that it takes.

    Parameters
    ----------
    problem : Problem
        The problem.
    start : array_like, shape (p,), optional
        Standard parameters; by default random ones.
    seed : int or numpy.random.Generator, optional
        Of the random start.

    Raises
    ------
    DataError
        When the start has another size or masses that are not positive.

    Attributes
    ----------
    start : ndarray, shape (p,)
        Where the run begins.
    scale : float
        Factor of residuals, with which the squared efforts sum to one.
    G, rhs : ndarray, shapes (k, p) and (k,)
        The problem's squares, scaled.
    history : list of Step
        The start and one entry a step; the last one is where the run stands.
    """

    def __init__(
        self,
        problem: Problem,
        start: ArrayLike | None = None,
        seed: int | np.random.Generator = 0,
    ) -> None:
        if start is None:
            start = random_start(problem, np.random.default_rng(seed))
        self.problem, self.start = problem, real_array(start, "start", ndim=1)
        if self.start.shape != (problem.n_theta,):
            raise DataError(f"start: shape {self.start.shape}, expected ({problem.n_theta},).")
        masses = problem.feasible.bodies(self.start)[:, 0]
        worst = int(np.argmin(masses))
        if masses[worst] <= 0.0:
            raise DataError(
                f"start: link {worst + 1} has mass {masses[worst]} kg; a local solver needs "
                "positive masses to start from."
            )
        matrix, rhs = problem.squared.matrix, problem.squared.rhs
        self.scale = 1.0 / np.sqrt(float(rhs @ rhs) + problem.floor)
        self.G, self.rhs = self.scale * matrix, self.scale * rhs
        self.history: list[Step] = []
        self._begin = time.perf_counter()

    @abstractmethod
    def theta(self, x: Array) -> Array:
        """Return the standard parameters of the solver's variables."""

    def record(self, x: Array) -> None:
        """Add a step to the history."""
        self.history.append(self._step(self.theta(x)))

    def _step(self, theta: Array) -> Step:
        seconds = time.perf_counter() - self._begin
        violation = self.problem.feasible.violation(theta)
        return Step(seconds, self.problem.cost_of(theta), violation)

    def estimate(self, method: str, theta: Array, *, stopped: Status, message: str) -> Estimate:
        """Return the estimate at the end of the run.

        Parameters
        ----------
        method : str
            Name of the solver.
        theta : ndarray, shape (p,)
            Where the run ended.
        stopped : str
            Status of a feasible point that, recomputed, is not stationary.
        message : str
            The solver's own words.
        """
        # The last step is the point that is handed back.
        self.history[-1] = last = self._step(theta)
        status = stopped
        if last.violation > FEASIBLE_LOCAL:
            status = "infeasible"
        elif stationarity_gap(self.problem, theta) <= STATIONARY:
            status = "optimal"
        return Estimate.of_theta(
            self.problem,
            theta,
            method=method,
            status=status,
            message=message,
            iterations=len(self.history) - 1,
            solve_time=last.seconds,
            history=tuple(self.history),
            start=frozen(self.start),
        )


def stationarity_gap(problem: Problem, theta: Array) -> float:
    """Return the share of the cost that the best step from theta can gain, 0 at an optimum.

    It is measured in the physical variables x; there stationary points are optimal
    (docs/theory, section 5), which they need not be in coordinates that have the boundary at
    infinity. With the gradient g, the Gauss–Newton matrix H and the constraints ``c ≥ 0``, the
    step d that lowers ``g·d + ½·d^T·H·d`` most while ``c + c'·d ≥ 0`` promises, by duality,

        min over λ of  ½·(g − c'^T·λ)^T·H^(-1)·(g − c'^T·λ) + λ·c,

    with λ ≥ 0 but for equations. Any λ gives an upper bound, so no constraint need be called
    active: a multiplier counts with its slack. As the problem is convex in theta, no feasible
    point costs less by more than this (docs/theory, (6b)), with a log-det prior to second
    order. Matrix inequalities take part through
    ``u^T·(N − margin·E)·u ≥ 0``, u the eigenvectors of N and of the multiplier that the gradient
    asks for, which makes eigenvalues that meet no special case.

    Parameters
    ----------
    problem : Problem
        With a consistency.
    theta : ndarray, shape (p,)
        Feasible standard parameters, masses positive.

    Returns
    -------
    float
        Infinite where the cost is.
    """
    variables = PhysicalVariables(problem)
    constraints = PhysicalConstraints(variables)
    x = variables.from_theta(theta)
    J = variables.jacobian(x)
    try:
        slope = problem.gradient(theta)
    except DataError:
        return np.inf
    steps = preconditioner(problem, theta, J, _FLATTEST)
    g = slope @ J
    values = np.maximum(constraints.at_least(x), 0.0)
    slopes = constraints.at_least_jacobian(x)
    both = constraints.zero_jacobian(x)
    slopes = np.vstack([slopes, both, -both])
    values = np.append(values, np.zeros(2 * len(both)))
    spectral = np.arange(len(values)) < 3 * problem.feasible.n_links
    least, rest = np.inf, g
    for _ in range(_ROUNDS):
        vectors = _gradient_eigenvectors(variables, rest)
        more = constraints.normals(vectors)
        slopes = np.vstack([slopes, more])
        values = np.concatenate([values, np.maximum(more @ x - constraints.margin, 0.0)])
        spectral = np.concatenate([spectral, np.ones(len(more), dtype=bool)])
        multipliers = _multipliers(slopes @ steps, values, steps @ g)
        left = steps @ (g - multipliers @ slopes)
        least = min(least, float(0.5 * left @ left + multipliers @ values))
        # What the others do not explain is left to the matrix inequalities.
        rest = g - np.where(spectral, 0.0, multipliers) @ slopes
    return least / max(problem.cost_of(theta), cost_scale(problem))


def preconditioner(problem: Problem, theta: Array, jacobian: Array, flattest: float) -> Array:
    """Return H^(-1/2) of the cost's Gauss–Newton matrix H, shape (count, count).

    Parameters
    ----------
    problem : Problem
        The problem.
    theta : ndarray, shape (p,)
        Where; a log-det prior only has curvature inside of what can exist.
    jacobian : ndarray, shape (p, count)
        Derivative of theta in the variables.
    flattest : float
        Least eigenvalue of H, as a share of the largest.
    """
    G = problem.squared.matrix @ jacobian
    H = 2.0 * G.T @ G
    with suppress(DataError):
        rows = problem.log_det.curvature_rows(theta) @ jacobian
        H = H + 2.0 * rows.T @ rows
    values, vectors = np.linalg.eigh(H)
    values = np.maximum(values, flattest * values[-1])
    return np.asarray((vectors / np.sqrt(values)) @ vectors.T)


def _gradient_eigenvectors(variables: PhysicalVariables, slope: Array) -> Array:
    """Return eigenvectors (links, 3, 3) of the slope in what must exceed the margin."""
    full = np.zeros(len(variables.sizes))
    full[variables.free] = slope
    bodies = variables.problem.feasible.bodies(full / variables.sizes)
    matrices = tensor_slopes(bodies[:, :6])
    if variables.problem.consistency == "pseudo_inertia":
        matrices = complement(matrices)
    return np.asarray(np.linalg.eigh(matrices)[1])


def _multipliers(slopes: Array, values: Array, gradient: Array) -> Array:
    """Return λ ≥ 0 that minimizes ``½·‖gradient − slopes^T·λ‖² + λ·values``."""
    # The dual of a step of least distance, solved as nonnegative least squares [lawson1974]_:
    # y = step + gradient is to be shortest with ``slopes·y ≥ slopes·gradient − values``.
    from scipy.optimize import nnls

    size = float(np.linalg.norm(gradient))
    if not size > 0.0:
        return np.zeros(len(values))
    # In units of the gradient, and rows of unit length.
    lengths = np.maximum(np.linalg.norm(slopes, axis=1), np.finfo(float).tiny)
    rows = slopes / lengths[:, None]
    limits = (rows @ gradient - values / lengths) / size
    system = np.vstack([rows.T, limits])
    target = np.zeros(len(system))
    target[-1] = 1.0
    try:
        found, _ = nnls(system, target)
    except RuntimeError:
        return np.zeros(len(values))
    remainder = 1.0 - float(limits @ found)
    return np.asarray(found / lengths * size / remainder)
