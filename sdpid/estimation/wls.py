"""Weighted least squares in closed form: what the data say without physics."""

from __future__ import annotations

import time

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.threads import one_thread
from sdpid.errors import SolverError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.information import least_squares
from sdpid.estimation.problem import Problem

# Newton's method on a cost with a log-det term stops where a step promises less than this share
# of the cost, which is rounding; squares alone take one step, and one more to refine it.
_SETTLED = 1e-14
_STEPS = 100

# Log-determinants count this many times less from one stage to the next.
_FADED = 4.0

# A step is halved until it brings this share of what its slope promises, at most so often.
_PROMISED = 1e-4
_HALVINGS = 60


@one_thread
def solve_wls(problem: Problem) -> Estimate:
    """Minimize the cost without constraints.

    Parameters
    ----------
    problem : Problem
        The problem; its constraints are not used.

    Returns
    -------
    Estimate
        With `theta` None: base parameters alone say nothing about single links. With a prior
        (ridge regression, or Newton's method where it has log-determinants) all standard
        parameters are determined and returned.

    Raises
    ------
    SolverError
        When Newton's method does not settle.

    Examples
    --------
    >>> wls = sdpid.solve_wls(problem)
    >>> wls.theta is None, bool(wls.cost <= estimate.cost)
    (True, True)
    >>> round(wls.named()["Fv1"])
    151
    """
    start = time.perf_counter()
    theta, steps, message = None, 1, "closed form"
    if problem.prior is None:
        base = least_squares(problem.A, problem.rhs)
    else:
        found, steps = _newton(problem)
        base, theta = problem.base_of(found), frozen(found)
        message = f"unconstrained, with the prior; {steps} Newton steps"
    return Estimate(
        problem=problem,
        method="wls",
        base=frozen(base),
        theta=theta,
        status="optimal",
        message=message,
        iterations=steps,
        solve_time=time.perf_counter() - start,
    )


def _newton(problem: Problem) -> tuple[Array, int]:
    """Return the theta of the least cost without constraints, and the number of steps.

    Log-determinants count more at first, and less from stage to stage: Newton's method crawls
    along the boundary of the cone when it gets there before their pull back is felt.
    """
    squared, log_det = problem.squared, problem.log_det
    theta = log_det.center()
    size = float(squared.rhs @ squared.rhs) + problem.floor
    weight = max(1.0, squared.value(theta) / log_det.strength) if len(log_det.links) else 1.0
    for step in range(1, _STEPS + 1):
        rows = np.sqrt(weight) * log_det.curvature_rows(theta)
        # R with R^T·R half the Hessian, and r with R^T·r half the gradient.
        pull = np.linalg.lstsq(rows.T, 0.5 * weight * log_det.gradient(theta), rcond=None)[0]
        matrix = np.vstack([squared.matrix, rows])
        move = -least_squares(matrix, np.concatenate([squared.residual(theta), pull]))
        promised = float(np.sum((matrix @ move) ** 2))
        length = _length(problem, theta, move, promised, weight)
        theta = theta + length * move
        if weight == 1.0 and (promised <= _SETTLED * size or length == 0.0):
            return theta, step
        if promised <= weight * log_det.strength:
            weight = max(1.0, weight / _FADED)
    raise SolverError(
        f"solve_wls: Newton's method has not settled in {_STEPS} steps (the last one promised "
        f"{promised:.1e} of a cost of {problem.cost_of(theta):.3e}); use solve_sdp, or a prior of "
        "kind 'pullback'."
    )


def _length(problem: Problem, theta: Array, move: Array, promised: float, weight: float) -> float:
    """Return the share of a step that brings what its slope promises, 0 where rounding hides it."""

    def cost(at: Array) -> float:
        return problem.squared.value(at) + weight * problem.log_det.value(at)

    before, length = cost(theta), 1.0
    for _ in range(_HALVINGS):
        if cost(theta + length * move) <= before - _PROMISED * length * promised:
            return length
        length *= 0.5
    return 0.0
