"""Closed-loop output error: Gauss-Newton on the difference of measured and simulated positions."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.estimate import Estimate, Status
from sdpid.estimation.information import require_excitation
from sdpid.estimation.output_error.didim import Search
from sdpid.estimation.output_error.followed import ClosedLoop, Followed
from sdpid.estimation.output_error.result import moved
from sdpid.estimation.output_error.rows import (
    SensitivityRows,
    compressed,
    cost_in,
    linearized,
    position_covariance,
)
from sdpid.estimation.output_error.starts import Solver
from sdpid.estimation.output_error.trials import Trial, compared
from sdpid.estimation.problem import Problem

# Halvings of a step that does not lower the cost; what is left of it is then below 1 %.
_HALVINGS = 7

# A step that promises to lower the cost by less than this share of it is none.
_SETTLED = 1e-6

# The joints' variances have settled when none changes by more than this share: with others the
# cost is another, and iterations go on.
_REWEIGHTED = 0.2


def iterate(
    problem: Problem,
    loop: ClosedLoop,
    start: Estimate,
    followed: Followed,
    solver: Solver,
    max_iterations: int,
    tolerance: float,
) -> Search:
    """Minimize the squares of the position errors, a linearized problem at a time.

    A step is the solution of the linearized problem under all constraints, and is halved until the
    simulated motion itself is nearer: with the same variances the cost never rises. `followed` is
    the motion of the start.
    """
    begin = time.perf_counter()
    rows = problem.require_rows_here("output error")
    at, trials = start, list[Trial]()
    simulations = 1
    missed = loop.missed(followed)
    sigma: Array | None = None
    status: Status = "iteration limit"
    for _ in range(max_iterations):
        slopes = loop.slopes(at.model(), problem.base, followed)
        linear, fresh = _linear(problem, rows, slopes, missed, at, sigma)
        if sigma is None:
            sigma = fresh
        found = solver(linear)
        before = _cost(linear, missed, at)
        promised = before - found.cost
        # Until a step is taken, the parameters of before are those of the new problem too.
        at = replace(at, problem=linear, multipliers=None)
        if promised <= _SETTLED * before:
            at = found
        else:
            for halvings in range(_HALVINGS + 1):
                candidate = found if not halvings else moved(at, found, 0.5**halvings)
                motion = loop.follow(candidate.model())
                simulations += 1
                if motion is None:
                    continue
                miss = loop.missed(motion)
                if _cost(linear, miss, candidate) < before:
                    at, followed, missed = candidate, motion, miss
                    break
        now = _cost(linear, missed, at)
        trials.append(
            Trial(
                time.perf_counter() - begin,
                np.sum(missed**2, axis=0),
                now,
                np.diag(linear.sigma),
                at.violation or 0.0,
            )
        )
        if before - now > tolerance * before:
            continue
        settled = promised <= tolerance * before
        kept = np.abs(np.diag(fresh) / np.diag(linear.sigma) - 1.0).max() <= _REWEIGHTED
        if kept or not settled:
            status = "optimal" if settled else "stalled"
            break
        sigma = fresh
    return Search(at, followed, compared(trials), simulations, status)


def _linear(
    problem: Problem,
    rows: RowSource,
    slopes: Array,
    missed: Array,
    at: Estimate,
    sigma: Array | None,
) -> tuple[Problem, Array]:
    """Return the problem linearized about an estimate, and variances from its own residuals."""
    target = missed + slopes @ at.base
    source = SensitivityRows(
        rows.robot, rows.friction, rows.base, rows.samples, frozen(slopes), frozen(target)
    )
    fresh = position_covariance(source)
    chosen = fresh if sigma is None else sigma
    linear = linearized(problem, source, compressed(source, chosen))
    if problem.prior is None:
        require_excitation(linear.excitation)
    return linear, fresh


def _cost(problem: Problem, missed: Array, estimate: Estimate) -> float:
    """Return the true cost of an estimate whose motion misses the measured one by (K, n)."""
    data = float(np.sum(missed**2 / np.diag(problem.sigma)))
    return data + cost_in(problem, estimate) - problem.cost(estimate.base)
