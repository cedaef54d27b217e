"""Block bootstrap: resample the data of a constrained estimate and solve its problem again.

Drawn are blocks of consecutive samples, as many as there are, each beginning anywhere (the record
wraps around at its end) [politis1992]_: residuals of filtered signals are correlated, but hardly
from one block to the next. Every draw brings its own regressor, so nothing is assumed of the
noise's distribution or of how it depends on the motion. Rows are compressed beforehand: a draw adds
up small matrices. Or whole periods are drawn, of which only the efforts differ. Where efforts were
made of currents, every draw has its own gains too. A bias that the fit is thought to have is in
each draw by another share, normal with a mean square of one, as the other intervals count it.

The intervals are about base parameters and what they determine. At a boundary of the feasible set
the bootstrap is known not to be consistent [andrews2000]_: an estimate that a constraint holds
scatters to one side only.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import chain
from typing import Any, Literal, NamedTuple

import numpy as np

from sdpid._common.arrays import Array, frozen, generator
from sdpid._common.threads import parallel
from sdpid.errors import DataError, SolverError
from sdpid.estimation.cluster_robust import Groups, ScoreBlocks
from sdpid.estimation.compression.covariance import PRINTED
from sdpid.estimation.conic.solve import Retried, solve_with_retries
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.information import information_root, information_rows
from sdpid.estimation.posterior import gain_errors
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.program import ReusableProgram
from sdpid.estimation.sdp.solve import solve_sdp

Kind = Literal["percentile", "basic"]
KINDS: tuple[Kind, ...] = ("percentile", "basic")

# Pieces of a block at which a drawn block may begin.
_PIECES = 2

# Tell a draw's generators of gains and of biases from that of its blocks.
_OF_GAINS, _OF_BIASES = 1, 2

# Clarabel's regularizations, in turn until one ends with an accurate point.
_REGULARIZATIONS = (1e-10, 1e-8)

# A cost that may be this share above the optimum, by the solver's own account, is no solution:
# with a million rows that is a hundredth of a variance.
_ACCURATE = 1e-8

# Draws that are one job: what they share is sent once.
_TOGETHER = 25

# Draws that must be expected beyond each end: fewer say nothing about where it is.
_BEYOND = 2.0

# Where more draws than this share come without a solution, the rest is no sample of anything.
_MOST_LOST = 0.02


class Resampled(NamedTuple):
    """Estimates from resampled data.

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


def bootstrap_intervals(
    estimate: Estimate, functionals: Array, level: float, kind: Kind, **how: Any
) -> dict[str, Any]:
    """Return the ends of intervals of functions (k, b) of the base parameters, as their fields.

    Parameters
    ----------
    estimate : Estimate
        From any solver.
    functionals : ndarray, shape (k, b)
        The functions.
    level : float
        Probability.
    kind : {"percentile", "basic"}
        Quantiles of the draws, or mirrored about the estimate.
    **how
        For `resample`.
    """
    drawn = resample(estimate, **how)
    if kind not in KINDS:
        raise DataError(f"bootstrap: kind is {kind!r}; use 'percentile' or 'basic'.")
    tail = 0.5 * (1.0 - level)
    # A probability of 1 − 0.95 is not exactly 0.05.
    needed = int(np.ceil(_BEYOND / tail - 1e-6))
    if len(drawn.base) < needed:
        raise DataError(
            f"bootstrap: {len(drawn.base)} resamples say too little of the ends at level "
            f"{level}; at least {needed} are needed."
        )
    # The ends are the draws number (count + 1)·tail from either side.
    values = drawn.base @ functionals.T
    low, high = np.quantile(values, [tail, 1.0 - tail], axis=0, method="weibull")
    if kind == "basic":
        middle = 2.0 * functionals @ estimate.base
        low, high = middle - high, middle - low
    ends = {"lower": frozen(low), "upper": frozen(high)}
    return {**ends, "seconds": drawn.seconds, "solves": len(drawn.base)}


def resample(
    estimate: Estimate,
    *,
    resamples: int = 400,
    groups: Groups = "blocks",
    seed: int | np.random.Generator = 0,
    n_jobs: int | None = None,
) -> Resampled:
    """Resample the data of an estimate and estimate from every resample.

    Parameters
    ----------
    estimate : Estimate
        From any solver. Unconstrained estimates are repeated in closed form, all others as the
        global optimum under the problem's constraints.
    resamples : int, optional
        Number of draws.
    groups : {"blocks", "periods"}, optional
        What is drawn.
    seed : int or numpy.random.Generator, optional
        Of the draws. Each draw has its own generator, of this seed and its number: the first 400
        of 1000 draws are those of 400.
    n_jobs : int, optional
        Jobs (joblib), by default one a core: threads, or the backend of a surrounding
        ``joblib.parallel_config``, such as Dask's. The result does not depend on it.

    Returns
    -------
    Resampled

    Raises
    ------
    DataError
        When there are too few groups or draws, or the seed is no whole number from 0 on.
    SolverError
        When too many draws have no solution.
    """
    if resamples < 1:
        raise DataError(f"bootstrap: {resamples} resamples; at least 1 is needed.")
    from joblib import delayed

    problem = estimate.problem
    if groups == "blocks":
        size = max(problem.samples.block // _PIECES, 1)
        pieces, run = ScoreBlocks.of(problem, groups, size=size), _PIECES if size > 1 else 1
    else:
        pieces, run = ScoreBlocks.of(problem, groups), 1
    T, gains = pieces.coordinates, gain_errors(problem)
    turn = T.T if problem.weighting in PRINTED else (problem.A @ T).T
    beside = [
        (tag, turn @ problem.A @ np.hstack(moves))
        for tag, moves in (
            (_OF_GAINS, [] if gains is None else [gains.root]),
            (_OF_BIASES, [source.moves for source in problem.errors]),
        )
        if moves
    ]
    draws = _Resampling(pieces, run, _whole(seed), Refit.of(estimate), beside)
    starts = range(0, resamples, _TOGETHER)
    tasks = (delayed(draws.solve)(range(i, min(i + _TOGETHER, resamples))) for i in starts)
    done = list(chain.from_iterable(parallel(n_jobs, threads=True)(tasks)))
    base = [found for found, _ in done if found is not None]
    lost = resamples - len(base)
    if lost > _MOST_LOST * resamples:
        raise SolverError(
            f"bootstrap: {lost} of {resamples} draws have no solution (limit "
            f"{_MOST_LOST:.0%}); use method='profile'.",
            problem=problem,
        )
    return Resampled(base=frozen(base), lost=lost, seconds=sum(seconds for _, seconds in done))


def _whole(seed: int | np.random.Generator) -> int:
    """Return a seed as a number, from which each draw's generator is made."""
    rng = generator(seed)
    return int(rng.integers(2**63)) if isinstance(seed, np.random.Generator) else int(seed)


class _Resampling(NamedTuple):
    """Compressed pieces of the data and the program to solve; small enough to send to a worker.

    Attributes
    ----------
    pieces : ScoreBlocks
        The data.
    run : int
        Consecutive pieces that are drawn together.
    seed : int
        Of all draws.
    refit : Refit
        The estimate.
    beside : list of (int, ndarray (r, k))
        What tells the generators of other errors apart, and how the target moves with such errors
        of variance one: those of gains, and the fit's biases.
    """

    pieces: ScoreBlocks
    run: int
    seed: int
    refit: Refit
    beside: list[tuple[int, Array]]

    def times(self, number: int) -> Array:
        """Return the weight of each piece in draw `number`, (G,)."""
        count = self.pieces.count
        rng = np.random.default_rng([self.seed, number])
        starts = rng.integers(0, count, max(round(count / self.run), 1))
        drawn = (starts[:, None] + np.arange(self.run)).ravel() % count
        times = np.bincount(drawn, minlength=count).astype(float)
        # As many as there are: where they do not divide, the weight is shared out.
        times *= count / times.sum()
        if self.pieces.groups == "periods":
            # A mean of G draws varies less than one of G periods by (G − 1)/G.
            times = 1.0 + (times - 1.0) * np.sqrt(count / (count - 1.0))
        return times

    def solve(self, numbers: range) -> list[tuple[Array | None, float]]:
        """Return the base parameters of some draws, and the seconds in the solver."""
        pieces, found = self.pieces, []
        for number in numbers:
            # Each draw is added up by itself and without BLAS, piece by piece: a product of the
            # weights of many draws rounds by how many there are.
            times = self.times(number)
            information = np.einsum("g,gij->ij", times, pieces.information)
            target = np.einsum("g,gi->i", times, pieces.target)
            for tag, moves in self.beside:
                rng = np.random.default_rng([self.seed, number, tag])
                target += moves @ rng.standard_normal(moves.shape[1])
            found.append(self.refit.solve(information, target))
        return found


class Refit(NamedTuple):
    """The estimate's problem, to be solved for other data.

    Attributes
    ----------
    problem : Problem
        Without its rows. Data are given in the coordinates of its excitation (see `ScoreBlocks`).
    programs : tuple of ReusableProgram
        What is solved: with the bounds that any data need, then with all of them; nothing where
        there is a closed form.
    """

    problem: Problem
    programs: tuple[ReusableProgram, ...]

    @classmethod
    def of(cls, estimate: Estimate) -> Refit:
        """Put the programs into solver form once."""
        problem = estimate.problem.without_rows()
        if estimate.method == "wls" or estimate.theta is None:
            return cls(problem, ())
        theta, few = np.array(estimate.theta), problem.feasible.bounded
        programs = [
            ReusableProgram.about(problem, theta, estimate.cost, included)
            for included in (few, np.ones_like(few))
        ]
        return cls(problem, tuple(programs))

    def solve(self, information: Array, target: Array) -> tuple[Array | None, float]:
        """Return the base parameters (b,) of some data, None without a solution, and seconds.

        Where both programs end short of a solution the problem is solved from scratch.
        """
        inverse, seconds = self.problem.excitation.inverse, 0.0
        if self.problem.weighting in PRINTED:
            A, rhs = inverse.T @ information @ inverse, inverse.T @ target
        else:
            X = information_rows(information)
            root = information_root(X)
            A, rhs = X @ inverse, X @ root @ (root.T @ target)
        if not self.programs:
            root = information_root(A)
            seen = root.shape[1] == A.shape[1]
            return root @ ((A @ root).T @ rhs) if seen else None, 0.0
        for program in self.programs:
            found = _solved(program, A, rhs)
            seconds += found.seconds
            theta = found.value if found.accepted else None
            if theta is not None and np.all(program.inside(theta)):
                return self.problem.base_of(theta), seconds
        try:
            again = solve_sdp(replace(self.problem, A=frozen(A), rhs=frozen(rhs)))
        except SolverError:
            return None, seconds
        return again.base, seconds + again.solve_time


def _solved(program: ReusableProgram, A: Array, rhs: Array) -> Retried[Array]:
    """Return the most accurate parameters of a program with other data."""
    return solve_with_retries(
        lambda regularization: program.solve(A, rhs, regularization=regularization),
        _REGULARIZATIONS,
        lambda x, solution: (program.program.coordinates.theta(x), solution.error),
        enough=_ACCURATE,
    )
