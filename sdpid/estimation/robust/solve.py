"""Minimize the Huber cost by weighted least squares, with weights from the last round's residuals.

Every round solves a plain weighted problem, so all solvers can be used, and what certifies their
estimates certifies these. Rounds end when the weights belong to their own result [lange2000]_.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sdpid._common.arrays import frozen
from sdpid.errors import DataError, SolverError
from sdpid.estimation.duality.bound import PROVEN, relative_gap
from sdpid.estimation.estimate import Estimate, extended
from sdpid.estimation.information import require_excitation
from sdpid.estimation.problem import Problem
from sdpid.estimation.robust.huber import HuberLoss
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.wls import solve_wls

# 95 % of least squares' efficiency where errors are normal.
THRESHOLD = 1.345

# The weights have settled when the weighted cost is above the Huber cost by at most this share of
# it. It is never below, and where they are equal the weights belong to the estimate. The SDP
# itself spends as much on the choice among optimal points.
_SETTLED = 1e-7

# Rounds without constraints before the first with them: they cost next to nothing.
_FREE_ROUNDS = 10


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RobustEstimate(Estimate):
    """An estimate under a robust cost; `problem` is the weighted one that it solves.

    Attributes
    ----------
    rounds : int
        How often the solver was called.
    robust_cost : float
        The Huber cost, with a prior's part.
    robust_gap : float or None
        How far above the optimum of the Huber cost it can be, proven, relative to it; None where
        the weights have not settled.

    Examples
    --------
    >>> robust = sdpid.solve_robust(problem)
    >>> robust.status, bool(robust.robust_gap < 1e-5)
    ('optimal', True)
    """

    rounds: int
    robust_cost: float
    robust_gap: float | None


def solve_robust(
    problem: Problem,
    *,
    threshold: float = THRESHOLD,
    max_rounds: int = 50,
    solver: Callable[[Problem], Estimate] = solve_sdp,
) -> RobustEstimate:
    """Minimize a cost that outliers do not dominate.

    Whitened residuals count with their square up to a threshold, and linearly beyond (see
    `sdpid.estimation.robust.huber`). The cost is convex, so with `solve_sdp` the estimate is the
    global optimum under all constraints, and that is proven.

    Parameters
    ----------
    problem : Problem
        The problem, whose weighting whitens the residuals.
    threshold : float, optional
        Of the Huber loss, in standard deviations of a single residual, which are estimated
        robustly, joint by joint. With contacts the loss is one of a sample's residuals together,
        beyond a norm that as many normal errors exceed.
    max_rounds : int, optional
        Largest number of solves.
    solver : callable, optional
        What solves each weighted problem: `solve_sdp`, `solve_wls` or another.

    Returns
    -------
    RobustEstimate
        Its `problem` is the weighted one, for `sdpid.certify`; the message gives rounds, the Huber
        cost and its proven gap.

    Raises
    ------
    DataError
        When an option makes no sense, or the problem's weighting has no rows to weight.
    SolverError
        When the weights have not settled, or the gap is not proven; the last estimate is
        attached. And whatever the solver raises.

    Examples
    --------
    >>> from dataclasses import replace
    >>> effort = samples.effort.copy()
    >>> effort[::50] += 50.0
    >>> hit = sdpid.build_problem(robot, replace(samples, effort=effort))
    >>> [sdpid.validate(solve(hit), samples).rmse.round(2).tolist()[:3]
    ...  for solve in (sdpid.solve_sdp, sdpid.solve_robust)]
    [[0.44, 1.12, 1.02], [0.23, 0.32, 0.15]]
    """
    if max_rounds < 1:
        raise DataError(f"solve_robust: max_rounds is {max_rounds}, at least 1 is needed.")
    loss = HuberLoss.of(problem, threshold=threshold)
    base = solve_wls(problem).base
    for _ in range(_FREE_ROUNDS):
        base = solve_wls(loss.majorized(base)).base
    seconds, iterations = 0.0, 0
    for rounds in range(1, max_rounds + 1):
        weighted = loss.majorized(base)
        if weighted.prior is None:
            require_excitation(weighted.excitation)
        found = solver(weighted)
        seconds, iterations = seconds + found.solve_time, iterations + found.iterations
        base = found.base
        cost = found.cost - weighted.cost(base) + loss.cost(base)
        settled = relative_gap(weighted, found.cost, cost) <= _SETTLED
        gap = relative_gap(weighted, cost, loss.bound(found)) if settled else None
        proof = "no gap proven" if gap is None else f"proven gap {gap:.1e}"
        message = f"Huber loss, threshold {threshold:g} deviations: {rounds} rounds, "
        message += f"cost {cost:.10g}, {proof}; {found.message}"
        estimate = extended(
            RobustEstimate,
            found,
            message=message,
            iterations=iterations,
            solve_time=seconds,
            curvature=frozen(loss.curvature(base, weighted.excitation.root)),
            rounds=rounds,
            robust_cost=cost,
            robust_gap=gap,
        )
        # What has no multipliers has nothing to prove with.
        if gap is not None and (found.multipliers is None or gap <= PROVEN):
            return estimate
    raise SolverError(
        f"Huber cost of '{problem.robot.name}': not settled after {max_rounds} rounds "
        f"({estimate.message}; limits {_SETTLED:.0e} and "
        f"{PROVEN:.0e}); allow more rounds (max_rounds) or raise the threshold.",
        problem=problem,
        found=estimate,
    )
