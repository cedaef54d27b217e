"""Estimate again and again while samples come in, with old ones fading.

Samples are folded into the triangular factor of the cost and forgotten: memory does not grow. What
weighs them is fixed at the start. A solve takes the program of the solve before, in which only the
numbers of the squares change; the solution is proven as any other, and where that fails everything
starts from scratch (`sdpid.solve_sdp`).
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.tables import Shown
from sdpid._common.threads import one_thread
from sdpid.errors import DataError
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.triangle import Triangle
from sdpid.estimation.compression.whitening import whitened_chunks
from sdpid.estimation.duality.bound import TINY_COST
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.information import require_excitation
from sdpid.estimation.problem import Problem, check_samples
from sdpid.estimation.sdp.program import ReusableProgram
from sdpid.estimation.sdp.solve import Attempts, solve_sdp
from sdpid.experiment.processing.samples import Samples

# What Clarabel adds to the diagonal of its linear systems: the first that `solve_sdp` tries.
_REGULARIZATION = 1e-10


class RecursiveEstimator(Shown):
    """An estimator that takes samples while the robot works, and is solved at any time.

    Weights are those of the start, for good: its covariance (``gls``, ``residual``), or that of
    each sample (``gls_per_sample``). So are friction terms with their numbers, and a prior.

    Parameters
    ----------
    start : Problem
        The problem to go on from; its samples count as the newest. Where they are too few to show
        every base parameter it needs a prior.
    forgetting : float, optional
        Factor, in (0, 1], of the weight of all samples before at every sample. They count as
        ``1 / (1 − forgetting)`` samples; 1 forgets nothing.
    memory : float, optional
        The same in time, in s: weights fall by e in so long. Needs samples with times.

    Raises
    ------
    DataError
        When a number makes no sense, or the problem's cost is no sum over measured samples:
        weightings ``eq9`` and ``eq18``, robust weights, instruments.

    Examples
    --------
    >>> start = sdpid.build_problem(robot, samples.between(0, 500))
    >>> online = sdpid.RecursiveEstimator(start, forgetting=0.999)
    >>> online.update(samples.between(500, 1000))
    >>> online.solve().status
    'optimal'
    """

    _facts = ("_problem.robot.name", "_problem.base.count", "_forgets")

    def __init__(
        self, start: Problem, *, forgetting: float = 1.0, memory: float | None = None
    ) -> None:
        if not 0.0 < forgetting <= 1.0:
            raise DataError(
                f"forgetting: is {forgetting}; give a factor a sample in (0, 1], such as 0.999, "
                "or 1 to forget nothing."
            )
        if memory is not None and not (0.0 < memory < np.inf and forgetting == 1.0):
            raise DataError(
                f"memory: is {memory} s with forgetting {forgetting}; give one of them, a time "
                "above zero or a factor a sample."
            )
        start.require_plain("recursive estimation")
        self.forgetting, self.memory = forgetting, memory
        b = start.base.count
        factor = np.zeros((b + 1, b + 1))
        factor[:b, :b], factor[:b, b], factor[b, b] = start.A, start.rhs, np.sqrt(start.floor)
        self._triangle = Triangle(b + 1)
        self._triangle.add(factor)
        self._problem = start.without_rows()
        self._folded = True
        self._time: float | None = None
        # The program of the solves to come, and what it is about.
        self._program: ReusableProgram | None = None
        self._about: Estimate | None = None
        self._bounds_included = start.feasible.bounded
        self._last: Array | None = None

    @property
    def _forgets(self) -> str:
        return f"{self.forgetting:g} a sample" if self.memory is None else f"{self.memory:g} s"

    @one_thread
    def update(self, samples: Samples) -> None:
        """Take samples in, the newest last.

        Parameters
        ----------
        samples : Samples
            Filtered and differentiated as the start's.

        Raises
        ------
        DataError
            When their joints are not the robot's, or times or covariances are missing; nothing is
            taken in then.
        """
        problem = self._problem
        check_samples(self._problem.robot, samples)
        weights, kept, time = self._weights(samples)
        sigma = problem.sigma
        if problem.weighting == "gls_per_sample":
            if samples.covariance is None:
                raise DataError(
                    "samples: have no covariance, which the weighting 'gls_per_sample' needs."
                )
            sigma = samples.covariance
        rows = RowSource(problem.robot, problem.friction, problem.base, samples)
        roots = np.sqrt(weights)
        # A copy, which takes the place of the factor only when all rows are in.
        triangle = copy(self._triangle)
        if kept < 1.0:
            triangle.scale(float(np.sqrt(kept)))
        for part, weighted, _ in whitened_chunks(rows, sigma):
            faded = weighted * roots[part, None, None]
            triangle.add(faded.reshape(-1, weighted.shape[2]))
        self._triangle, self._time, self._folded = triangle, time, False
        self._problem = replace(
            problem,
            n_samples=problem.n_samples + samples.n_samples,
            n_rows=problem.n_rows + samples.n_rows,
        )

    def _weights(self, samples: Samples) -> tuple[Array, float, float | None]:
        """Return the samples' weights (K,), the factor for all before, and the time it is."""
        if self.memory is None:
            ages = np.arange(samples.n_samples - 1, -1, -1.0)
            return self.forgetting**ages, self.forgetting**samples.n_samples, None
        if samples.time is None:
            raise DataError(
                "samples: have no time, which a memory in s needs; give `time`, or a factor a "
                "sample (`forgetting`)."
            )
        time = samples.time
        before = float(time[0]) if self._time is None else self._time
        step = float(np.diff(time, prepend=before).min())
        if step < 0.0:
            raise DataError(
                f"samples: time goes back by {-step:.6g} s (the last update ended at "
                f"{before:.6g} s); give each sample once, in order."
            )
        now = float(time[-1])
        weights = np.exp((time - now) / self.memory)
        return weights, float(np.exp((before - now) / self.memory)), now

    @property
    def problem(self) -> Problem:
        """The problem as it stands, as large as the first however much has been seen."""
        if not self._folded:
            A, rhs, floor = self._triangle.split()
            self._problem = replace(self._problem, A=frozen(A), rhs=frozen(rhs), floor=floor)
            self._folded = True
        return self._problem

    @one_thread
    def solve(self) -> Estimate:
        """Return the global optimum of the problem as it stands.

        Returns
        -------
        Estimate
            As of `sdpid.solve_sdp`: proven to be within 1e-6 of the optimum, or that raises. Of all
            optimal parameters it is some, not those nearest to the description; the base
            parameters are the same.

        Raises
        ------
        IdentifiabilityError
            When what is remembered leaves a base parameter undetermined and there is no prior.
        InfeasibleError, SolverError
            As of `sdpid.solve_sdp`.
        """
        problem = self.problem
        if problem.prior is None:
            require_excitation(problem.excitation)
        estimate = self._quick(problem)
        if estimate is None:
            estimate = solve_sdp(problem)
            self._prepare(estimate)
        self._last = estimate.theta
        return estimate

    def _prepare(self, estimate: Estimate) -> None:
        """Keep the program about an estimate for the solves to come."""
        problem = estimate.problem
        if len(problem.log_det.links):
            # The weight of its logarithms is in units of the cost, which changes.
            return
        theta = np.array(estimate.theta)
        self._about = estimate
        self._program = ReusableProgram.about(problem, theta, estimate.cost, self._bounds_included)

    def _quick(self, problem: Problem) -> Estimate | None:
        """Return what is found without starting from scratch; None where nothing is proven so."""
        while self._program is not None and self._about is not None and self._last is not None:
            efforts = float(problem.rhs @ problem.rhs) + problem.floor
            # What is found cannot cost more than what was found before.
            cost = max(problem.cost_of(self._last), TINY_COST * efforts, np.finfo(float).tiny)
            solution = self._program.solve(
                problem.A, problem.rhs, cost=cost, regularization=_REGULARIZATION
            )
            program = self._program.program
            scaling = replace(program.scaling, cost=cost)
            start = scaling, program.coordinates.origin
            search = Attempts(problem, start, self._bounds_included)
            search.take(replace(program, problem=problem, scaling=scaling), solution)
            if search.bounds_included is self._bounds_included:
                if not search.proven:
                    return None
                estimate, _ = search.result()
                message = f"{estimate.message}; any point of the optimal face"
                return replace(estimate, message=message)
            # theta_max matters after all: from now on with the bounds that were overstepped.
            self._bounds_included = search.bounds_included
            self._prepare(self._about)
        return None
