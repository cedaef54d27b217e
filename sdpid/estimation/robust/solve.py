"""Robust and reweighted costs: the solver is called again until its weights are its own result's.

Every round solves a plain weighted problem, so all solvers can be used, and what certifies their
estimates certifies these.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.errors import DataError, SolverError
from sdpid.estimation.cluster_robust import covariance
from sdpid.estimation.compression.covariance import JointRows, correlation_time, residual_covariance
from sdpid.estimation.compression.triangle import Triangle
from sdpid.estimation.duality.bound import PROVEN, relative_gap
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.information import require_excitation
from sdpid.estimation.problem import Problem
from sdpid.estimation.robust.huber import HuberLoss
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.wls import solve_wls

Loss = Literal["huber", "reweighted"]
LOSSES: tuple[Loss, ...] = ("huber", "reweighted")

# 95 % of least squares' efficiency where errors are normal.
THRESHOLD = 1.345

# The weights have settled when the weighted cost is above the Huber cost by at most this share of
# it. It is never below, and where they are equal the weights belong to the estimate. The SDP
# itself spends as much on the choice among optimal points.
_SETTLED = 1e-7

# Rounds without constraints before the first with them: they cost next to nothing.
_FREE_ROUNDS = 10

# Variances have settled when none changes by this share: they change the estimate in proportion,
# and its cost by the square of that.
_VARIANCE_SETTLED = 1e-4


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RobustEstimate(Estimate):
    """An estimate under a robust cost; `problem` is the weighted one that it solves.

    Attributes
    ----------
    loss : str
        ``"huber"`` or ``"reweighted"``.
    rounds : int
        How often the solver was called.
    robust_cost : float
        Value of the loss, with a prior's part. For ``"reweighted"`` the cost under the variances
        found.
    robust_gap : float or None
        How far above the optimum of the Huber cost it can be, proven, relative to it. None
        for ``"reweighted"``: that iteration has a fixed point, not an objective whose global
        optimum could be proven.
    curvature : ndarray, shape (b, b), or None
        Half the second derivative of the Huber cost of the data.
    """

    loss: Loss
    rounds: int
    robust_cost: float
    robust_gap: float | None = None
    curvature: Array | None = field(default=None, repr=False)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the base parameters, (b, b), as if no constraint were active.

        The sandwich estimate of the weighted problem, with the curvature of the Huber cost
        in place of the weighted least squares': rows beyond their threshold have none.
        """
        plain = covariance(self.problem)
        if self.curvature is None:
            return frozen(plain)
        A = self.problem.A
        turn = np.linalg.solve(self.curvature, A.T @ A)
        return frozen(turn @ plain @ turn.T)


def solve_robust(
    problem: Problem,
    loss: Loss = "huber",
    *,
    threshold: float = THRESHOLD,
    max_rounds: int = 50,
    solver: Callable[[Problem], Estimate] = solve_sdp,
) -> RobustEstimate:
    """Minimise a cost that outliers, or joints of unknown noise, do not dominate.

    ``"huber"`` counts whitened residuals with their square up to a threshold, and linearly
    beyond (see `sdpid.estimation.robust.huber`). The cost is convex, so with `solve_sdp` the
    estimate is the global optimum under all constraints, and that is proven. ``"reweighted"``
    estimates one variance a joint, as the weighting ``"residual"`` does, but from the residuals of
    the constrained estimate, until the variances are those of their own result.

    Parameters
    ----------
    problem : Problem
        The problem. Its weighting whitens the residuals; ``"reweighted"`` replaces it.
    loss : {"huber", "reweighted"}, optional
        Which cost.
    threshold : float, optional
        Of the Huber loss, in standard deviations of a single residual, which are estimated
        robustly, joint by joint.
    max_rounds : int, optional
        Largest number of solves.
    solver : callable, optional
        What solves each weighted problem: `solve_sdp`, `solve_wls` or another.

    Returns
    -------
    RobustEstimate
        Its `problem` is the weighted one, for `sdpid.certify`; the message says loss, rounds,
        the Huber cost and its proven gap.

    Raises
    ------
    DataError
        When an option is none, or the problem's weighting has no rows to weight.
    SolverError
        When the weights have not settled, or the gap is not proven; the last estimate is
        attached. And whatever the solver raises.
    """
    if loss not in LOSSES:
        raise DataError(f"solve_robust: loss is {loss!r}; use one of {', '.join(LOSSES)}.")
    if max_rounds < 1:
        raise DataError(f"solve_robust: max_rounds is {max_rounds}, at least 1 is needed.")
    if loss == "huber":
        return _huber(problem, threshold, max_rounds, solver)
    return _reweighted(problem, max_rounds, solver)


def _huber(
    problem: Problem, threshold: float, max_rounds: int, solver: Callable[[Problem], Estimate]
) -> RobustEstimate:
    """Majorise, solve, and majorise again at what was found [lange2000]_."""
    loss = HuberLoss.of(problem, threshold=threshold)
    base = solve_wls(problem).base
    for _ in range(_FREE_ROUNDS):
        base = solve_wls(loss.majorised(base)).base
    seconds, iterations = 0.0, 0
    estimate: RobustEstimate | None = None
    for rounds in range(1, max_rounds + 1):
        weighted = loss.majorised(base)
        if weighted.prior is None:
            require_excitation(weighted.excitation)
        found = solver(weighted)
        seconds, iterations = seconds + found.solve_time, iterations + found.iterations
        base = found.base
        cost = found.cost - weighted.cost(base) + loss.cost(base)
        settled = relative_gap(weighted, found.cost, cost) <= _SETTLED
        gap = relative_gap(weighted, cost, loss.bound(found)) if settled else None
        proof = "no gap proven" if gap is None else f"proven gap {gap:.1e}"
        estimate = _robust(
            found,
            f"Huber loss, threshold {threshold:g} deviations: {rounds} rounds, cost {cost:.10g}, "
            f"{proof}",
            loss="huber",
            rounds=rounds,
            robust_cost=cost,
            robust_gap=gap,
            iterations=iterations,
            solve_time=seconds,
        )
        # What has no multipliers has nothing to prove with.
        if gap is not None and (found.multipliers is None or gap <= PROVEN):
            return replace(estimate, curvature=frozen(loss.curvature(base)))
    raise SolverError(
        f"Huber cost of '{problem.robot.name}': not settled after {max_rounds} rounds "
        f"({'' if estimate is None else estimate.message}; limits {_SETTLED:.0e} and "
        f"{PROVEN:.0e}); allow more rounds (max_rounds) or raise the threshold.",
        problem=problem,
        found=estimate,
    )


def _reweighted(
    problem: Problem, max_rounds: int, solver: Callable[[Problem], Estimate]
) -> RobustEstimate:
    """Estimate every joint's variance from the constrained estimate's residuals, in turn."""
    rows = problem.rows
    joints = JointRows.merged(rows.map(JointRows.of))
    sigma = residual_covariance(rows, joints)
    variance = np.zeros(len(sigma))
    rank = joints.fit(np.diag(sigma))[1]
    seconds, iterations = 0.0, 0
    estimate: RobustEstimate | None = None
    for rounds in range(1, max_rounds + 1):
        triangle = Triangle(rows.base.count + 1)
        triangle.add(joints.joined(np.diag(sigma)))
        A, rhs, floor = triangle.split()
        weighted = replace(
            problem,
            weighting="residual",
            sigma=frozen(sigma),
            A=frozen(A),
            rhs=frozen(rhs),
            floor=floor,
        )
        found = solver(weighted)
        seconds, iterations = seconds + found.solve_time, iterations + found.iterations
        updated = joints.variance(found.base, rank)
        change = float(np.max(np.abs(updated - variance) / updated))
        variance = updated
        estimate = _robust(
            found,
            f"joint-wise reweighted: {rounds} rounds, variances changed by {change:.1e}",
            loss="reweighted",
            rounds=rounds,
            robust_cost=found.cost,
            iterations=iterations,
            solve_time=seconds,
        )
        if change <= _VARIANCE_SETTLED:
            return estimate
        sigma = np.diag(variance * correlation_time(rows, found.base, joints))
    raise SolverError(
        f"joint-wise reweighting of '{problem.robot.name}': not settled after {max_rounds} rounds "
        f"({'' if estimate is None else estimate.message}; limit {_VARIANCE_SETTLED:.0e}); allow "
        "more rounds (max_rounds).",
        problem=problem,
        found=estimate,
    )


def _robust(found: Estimate, message: str, **changes: Any) -> RobustEstimate:
    """Return an estimate with what a robust one has more."""
    own = {f.name: getattr(found, f.name) for f in fields(found)}
    return RobustEstimate(**{**own, "message": f"{message}; {found.message}", **changes})
