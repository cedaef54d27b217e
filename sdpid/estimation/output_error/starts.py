"""Where output error begins: parameters that a simulation can take."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import frozen
from sdpid.errors import DataError
from sdpid.estimation.estimate import FEASIBLE, Estimate
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.wls import solve_wls

Solver = Callable[[Problem], Estimate]


def solver_of(problem: Problem, given: Solver | None) -> Solver:
    """Return what solves linearized problems: without consistency they have a closed form."""
    if given is not None:
        return given
    return solve_wls if problem.consistency == "none" else solve_sdp


def starting(problem: Problem, start: ArrayLike | Estimate | None, solver: Solver) -> Estimate:
    """Return where iterations begin.

    Parameters
    ----------
    problem : Problem
        Of the measured samples.
    start : Estimate, or array_like of shape (p,) or (b,), optional
        Standard or base parameters. Such as are not feasible are replaced by the feasible ones
        whose predicted efforts are nearest: base parameters that are off by 15 % each make mass
        matrices indefinite, and what has one cannot be simulated. By default the solution of the
        problem.

    solver : callable
        What solves the problem.

    Raises
    ------
    DataError
        When the start has another shape, or is not finite.
    """
    free = solver is solve_wls or problem.consistency == "none"
    if start is None:
        return solver(problem)
    given = (
        (start.theta if start.theta is not None else start.base)
        if (isinstance(start, Estimate))
        else start
    )
    values = np.asarray(given, dtype=np.float64)
    p, b = problem.n_theta, problem.base.count
    if values.shape not in ((p,), (b,)) or not np.all(np.isfinite(values)):
        raise DataError(
            f"start: has shape {values.shape}, expected ({p},) standard or ({b},) base parameters, "
            "all finite."
        )
    if values.shape == (p,) and (free or problem.feasible.violation(values) <= FEASIBLE):
        return Estimate.of_theta(problem, values, method="given", status="given")
    base = values if values.shape == (b,) else problem.base_of(values)
    if free:
        return Estimate(
            problem=problem, method="given", base=frozen(base), theta=None, status="given"
        )
    return solve_sdp(replace(problem, rhs=frozen(problem.A @ base), floor=0.0, prior=None))
