"""What local solvers share: starts, the history of a run, and whether its end is an optimum."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen, real_array
from sdpid._common.kept import kept
from sdpid.errors import DataError, SolverError
from sdpid.estimation.duality.bound import bound_of, relative_gap
from sdpid.estimation.estimate import Estimate, Status, Step
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.estimation.sdp.solve import proven_optimum
from sdpid.robot.inertia import theta_from_central_moments

# A local result may lie this far outside a constraint (kg·m², kg, …) and still count as feasible;
# SLSQP works on scaled constraints and stops near 1e-10 of them.
FEASIBLE_LOCAL = 1e-7

# Why a local solver is not needed.
UNCONSTRAINED = "consistency is 'none', nothing constrains; use solve_wls."

# Solvers sometimes report success where they merely stopped making progress. Their word is
# checked: a point is optimal where its cost exceeds the proven bound by no more than this share.
OPTIMAL = 1e-4


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
            Status of a feasible point that is no optimum.
        message : str
            The solver's own words.
        """
        # The last step is the point that is handed back.
        self.history[-1] = last = self._step(theta)
        status = stopped
        if last.violation > FEASIBLE_LOCAL:
            status = "infeasible"
        elif relative_gap(self.problem, last.cost, least_cost(self.problem)) <= OPTIMAL:
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


# Of many starts of one problem it is found once.
@kept
def least_cost(problem: Problem) -> float:
    """Return a proven lower bound on the cost of feasible parameters, −∞ where there is none."""
    try:
        return proven_optimum(problem)[1].value
    except SolverError as error:
        return -np.inf if error.found is None else bound_of(problem, error.found.proof).value
