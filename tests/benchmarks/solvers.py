"""Every solver on one problem, against the time that Clarabel itself takes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.certificate import certify
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.local.log_cholesky import solve_log_cholesky
from sdpid.estimation.local.slsqp import solve_slsqp
from sdpid.estimation.local.starts import random_start
from sdpid.estimation.prior.prior import Prior, prior_terms
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.cvxpy_form import to_cvxpy
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.wls import solve_wls
from sdpid.robot.inertia import Consistency
from tests.benchmarks.timing import Row, clock

# The case study's margins, kg·m².
PROBLEMS: tuple[tuple[str, Consistency, float], ...] = (
    ("6x6", "spatial_inertia", 0.01),
    ("4x4", "pseudo_inertia", 0.005),
)

# What takes longer than this (s) is repeated so many times only.
SLOW, SLOW_REPEATS = 2.0, 3

# Of the one random start of the local solvers.
SEED = 0

AGAINST = "Clarabel alone"


def measure(problem: Problem, repeats: int) -> Iterator[Row]:
    """Yield a row a solver, under either consistency."""
    for label, consistency, margin in PROBLEMS:
        constraints = Constraints(margin=margin)
        constrained = problem.constrained(consistency=consistency, constraints=constraints)
        yield from _measure(label, constrained, repeats)


def _measure(label: str, problem: Problem, repeats: int) -> Iterator[Row]:
    """Time all solvers in turn in each repeat.

    Clarabel's own time is what it reports of the semidefinite program, all attempts and the choice
    on the optimal face together. All else is the whole call. The re-solve is the same problem with
    efforts moved by noise: what bootstrapping repeats.
    """
    best = solve_sdp(problem)
    bound = certify(best).bound
    start = random_start(problem, np.random.default_rng(SEED))
    others: dict[str, Callable[..., Estimate]] = {
        "wls": solve_wls,
        "slsqp": partial(solve_slsqp, start=start),
        "log_cholesky": partial(solve_log_cholesky, start=start),
        "sdp, through CVXPY": _through_cvxpy,
    }
    # Imports and caches are not counted.
    solve_wls(problem)
    for local in ("slsqp", "log_cholesky"):
        others[local](problem, max_iterations=2)

    clarabel, whole, again, noisy = (np.empty(repeats) for _ in range(4))
    rng = np.random.default_rng(SEED)
    belief = Prior(bodies=problem.feasible.bodies(np.array(best.theta)))
    believed = replace(problem, prior=prior_terms(belief, problem.rows))
    prior, prior_clarabel = np.empty(repeats), np.empty(repeats)
    seconds: dict[str, list[float]] = {name: [] for name in others}
    found: dict[str, Estimate] = {}

    def run(name: str) -> None:
        found[name] = others[name](problem)

    for repeat in range(repeats):
        begin = time.perf_counter()
        best = solve_sdp(problem)
        whole[repeat] = time.perf_counter() - begin
        clarabel[repeat] = best.solve_time
        moved = replace(problem, rhs=problem.rhs + rng.standard_normal(len(problem.rhs)))
        begin = time.perf_counter()
        resolved = solve_sdp(moved)
        again[repeat] = time.perf_counter() - begin
        noisy[repeat] = resolved.solve_time
        begin = time.perf_counter()
        with_prior = solve_sdp(believed)
        prior[repeat] = time.perf_counter() - begin
        prior_clarabel[repeat] = with_prior.solve_time
        for name in others:
            if repeat < SLOW_REPEATS or min(seconds[name]) <= SLOW:
                seconds[name].append(clock(partial(run, name)))

    def row(name: str, times: Sequence[float] | Array, estimate: Estimate) -> Row:
        return Row.of(
            f"{name} {label}",
            np.asarray(times),
            AGAINST,
            clarabel[: len(times)],
            gap=certify(estimate, bound=bound).gap,
            violation=estimate.violation,
            status=estimate.status,
        )

    yield row("wls", seconds["wls"], found["wls"])
    # Its point before it is moved inside is not kept; gap and violation are those of the call.
    said = best.message.split(";")[0].removeprefix("clarabel: ")
    yield Row.of(f"sdp, Clarabel alone {label}", clarabel, AGAINST, clarabel, status=said)
    yield row("sdp, whole call", whole, best)
    gap, own = certify(resolved).gap, "Clarabel in the same call"
    yield Row.of(f"sdp, re-solve {label}", again, own, noisy, gap=gap, status=resolved.status)
    gap = certify(with_prior).gap
    yield Row.of(
        f"sdp, with a prior {label}", prior, own, prior_clarabel, gap=gap, status=with_prior.status
    )
    for name in ("sdp, through CVXPY", "slsqp", "log_cholesky"):
        yield row(name, seconds[name], found[name])


def _through_cvxpy(problem: Problem) -> Estimate:
    """Solve the program as CVXPY states it; nothing is repaired or proven."""
    model, theta = to_cvxpy(problem)
    model.solve(solver="CLARABEL")
    return Estimate.of_theta(problem, theta.value, method="sdp", status=str(model.status))
