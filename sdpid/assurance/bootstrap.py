"""How a constrained estimate scatters: its data drawn again, its problem solved again.

Drawn are blocks of consecutive samples, as many as there are, each beginning anywhere (the record
wraps around at its end) [politis1992]_: residuals of filtered signals are correlated, but hardly
from one block to the next. Every draw brings its own regressor, so nothing is assumed of the
noise's distribution or of how it depends on the motion. Rows are compressed beforehand: a draw adds
up small matrices. Or whole periods are drawn, of which only the efforts differ.

The intervals are about base parameters and what they determine. At a boundary of the feasible set
the bootstrap is known not to be consistent [andrews2000]_: an estimate that a constraint holds
scatters to one side only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sdpid._arrays import Array, frozen
from sdpid.assurance.score_blocks import Groups, ScoreBlocks
from sdpid.errors import DataError, SolverError
from sdpid.estimation.conic import solve_conic
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.estimation.sdp_program import Coordinates, SdpProgram

Kind = Literal["percentile", "basic"]
KINDS: tuple[Kind, ...] = ("percentile", "basic")

# Pieces of a block at which a drawn block may begin.
_PIECES = 2

# Clarabel's regularisations, in turn until one ends with a point.
_REGULARISATIONS = (1e-10, 1e-8)

# Draws that must be expected beyond each end: fewer say nothing about where it is.
_BEYOND = 2.0

# Where more draws than this share come without a solution, the rest is no sample of anything.
_MOST_LOST = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class Resampled:
    """Estimates of data that were drawn again.

    Attributes
    ----------
    base : ndarray, shape (draws, b)
        Base parameters of each.
    lost : int
        Draws without a solution.
    seconds : float
        In the solver.
    """

    base: Array
    lost: int
    seconds: float

    def quantiles(
        self, functionals: Array, level: float, kind: Kind, centre: Array
    ) -> tuple[Array, Array]:
        """Return the ends (k,) of intervals of functions (k, b) of the base parameters.

        Parameters
        ----------
        functionals : ndarray, shape (k, b)
            The functions.
        level : float
            Probability.
        kind : {"percentile", "basic"}
            Quantiles of the draws, or mirrored about the centre.
        centre : ndarray, shape (b,)
            The estimate.
        """
        if kind not in KINDS:
            raise DataError(f"bootstrap: kind is {kind!r}; use 'percentile' or 'basic'.")
        tail = 0.5 * (1.0 - level)
        # A probability of 1 − 0.95 is not exactly 0.05.
        needed = int(np.ceil(_BEYOND / tail - 1e-6))
        if len(self.base) < needed:
            raise DataError(
                f"bootstrap: {len(self.base)} resamples say too little of the ends at level "
                f"{level}; at least {needed} are needed."
            )
        drawn = self.base @ functionals.T
        # The ends are the draws number (count + 1)·tail from either side.
        low, high = np.quantile(drawn, [tail, 1.0 - tail], axis=0, method="weibull")
        if kind == "percentile":
            return np.asarray(low), np.asarray(high)
        middle = 2.0 * functionals @ centre
        return np.asarray(middle - high), np.asarray(middle - low)


def resampled(
    estimate: Estimate, *, resamples: int = 400, groups: Groups = "blocks", seed: int = 0
) -> Resampled:
    """Draw the data of an estimate again, and estimate every time.

    Parameters
    ----------
    estimate : Estimate
        From any solver. Unconstrained estimates are repeated in closed form, all others as the
        global optimum under the problem's constraints.
    resamples : int, optional
        Number of draws.
    groups : {"blocks", "periods"}, optional
        What is drawn.
    seed : int, optional
        Of the draws.

    Returns
    -------
    Resampled

    Raises
    ------
    DataError
        When there are too few groups or draws.
    SolverError
        When too many draws have no solution.
    """
    if resamples < 1:
        raise DataError(f"bootstrap: {resamples} resamples; at least 1 is needed.")
    problem = estimate.problem
    rng = np.random.default_rng(seed)
    if groups == "blocks":
        size = max(problem.samples.block // _PIECES, 1)
        pieces = ScoreBlocks.of(replace_block(problem, size), groups)
        run = _PIECES if size > 1 else 1
    else:
        pieces, run = ScoreBlocks.of(problem, groups), 1
    again = _Again.of(estimate)
    base, lost = [], 0
    for _ in range(resamples):
        starts = rng.integers(0, pieces.count, max(round(pieces.count / run), 1))
        drawn = (starts[:, None] + np.arange(run)).ravel() % pieces.count
        times = np.bincount(drawn, minlength=pieces.count).astype(float)
        # As many as there are: where they do not divide, the weight is shared out.
        times *= pieces.count / times.sum()
        if groups == "periods":
            # A mean of G draws varies less than one of G periods by (G − 1)/G.
            times = 1.0 + (times - 1.0) * np.sqrt(pieces.count / (pieces.count - 1.0))
        found = again.solve(np.tensordot(times, pieces.information, 1), times @ pieces.target)
        if found is None:
            lost += 1
        else:
            base.append(found)
    if lost > _MOST_LOST * resamples:
        raise SolverError(
            f"bootstrap: {lost} of {resamples} draws have no solution (limit "
            f"{_MOST_LOST:.0%}); use method='profile'.",
            problem=problem,
        )
    return Resampled(base=frozen(base), lost=lost, seconds=again.seconds)


def replace_block(problem: Problem, size: int) -> Problem:
    """Return the problem with other blocks; nothing else changes."""
    return replace(problem, samples=replace(problem.samples, block=size))


@dataclass(eq=False)
class _Again:
    """The problem of other data, about the estimate.

    Attributes
    ----------
    problem : Problem
        The problem.
    program : SdpProgram or None
        What is solved; None in closed form.
    cost : float
        Scale of the cost.
    seconds : float
        In the solver so far.
    """

    problem: Problem
    program: SdpProgram | None
    seconds: float = 0.0

    @classmethod
    def of(cls, estimate: Estimate) -> _Again:
        problem = estimate.problem
        if estimate.method == "wls" or estimate.theta is None:
            return cls(problem, None)
        theta = np.array(estimate.theta)
        scaling = Scaling.of(problem)
        scaling = replace(scaling, cost=max(scaling.cost, estimate.cost))
        coordinates = Coordinates.of(problem, scaling.basis(), theta)
        if coordinates is None:
            raise SolverError(
                "bootstrap: the equations among the constraints contradict each other.",
                problem=problem,
            )
        boxed = np.ones(problem.n_theta, dtype=bool)
        return cls(problem, SdpProgram.build(problem, scaling, coordinates, boxed))

    def solve(self, information: Array, target: Array) -> Array | None:
        """Return the base parameters of some data, None where none are found."""
        weighting = self.problem.weighting
        scale = np.sqrt(np.maximum(np.diagonal(information), np.finfo(float).tiny))
        if weighting in ("eq9", "eq18"):
            # Their cost is the norm of the normal equations' residual itself.
            A, rhs = information, target
        else:
            try:
                root = np.linalg.cholesky(information / np.outer(scale, scale))
            except np.linalg.LinAlgError:
                return None
            A = np.asarray(root.T * scale)
            rhs = np.asarray(np.linalg.solve(root, target / scale))
        if self.program is None:
            return np.asarray(np.linalg.solve(A / scale, rhs) / scale)
        program = self.program
        conic, unit = program.conic, np.sqrt(program.scaling.cost)
        matrix = self.problem.base.matrix
        count = self.problem.base.count
        M, m = conic.M.copy(), conic.m.copy()
        M[:count] = A @ (matrix @ program.coordinates.directions) / unit
        m[:count] = (A @ (matrix @ program.coordinates.origin) - rhs) / unit
        changed = replace(conic, M=M, m=m)
        for regularisation in _REGULARISATIONS:
            solution = solve_conic(changed, regularisation=regularisation)
            self.seconds += solution.seconds
            if solution.x is not None and "Infeasible" not in solution.status:
                return np.asarray(matrix @ program.theta(solution))
        return None
