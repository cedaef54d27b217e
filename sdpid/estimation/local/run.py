"""One run of a local solver: its scaled cost, the history of its steps, and its status."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.errors import DataError
from sdpid.estimation.estimate import Estimate, Status, Step
from sdpid.estimation.local.stationarity import STATIONARY, stationarity_gap
from sdpid.estimation.problem import Problem

# A local result may lie this far outside a constraint (kg·m², kg, …) and still count as feasible;
# SLSQP works on scaled constraints and stops near 1e-10 of them.
FEASIBLE_LOCAL = 1e-7


class LocalRun(ABC):
    """A problem in the variables of a local solver, and the steps that it takes.

    Attributes
    ----------
    problem : Problem
        The problem.
    scale : float
        Factor of residuals, with which the squared efforts sum to one.
    G, rhs : ndarray, shapes (k, p) and (k,)
        The problem's squares, scaled.
    history : list of Step
        The start and one entry a step; the last one is where the run stands.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
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

    def estimate(
        self, method: str, start: Array, theta: Array, *, stopped: Status, message: str
    ) -> Estimate:
        """Return the estimate at the end of the run.

        Parameters
        ----------
        method : str
            Name of the solver.
        start, theta : ndarray, shape (p,)
            Where the run began and ended.
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
            start=frozen(start),
        )


def require_consistency(problem: Problem, solver: str) -> None:
    """Raise when a problem has no consistency to obey.

    Raises
    ------
    DataError
        When its consistency is ``"none"``.
    """
    if problem.consistency == "none":
        raise DataError(f"{solver}: consistency is 'none', nothing constrains; use solve_wls.")
