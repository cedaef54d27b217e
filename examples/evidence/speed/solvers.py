"""Every solver on one problem, against the time that Clarabel itself takes.

Clarabel's own time is what it reports of the semidefinite program, all attempts and the choice on
the optimal face together. All else is the whole call. The re-solve is the same problem with efforts
moved by noise: what bootstrapping repeats.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from denso import denso_problem
from harness import LEAST, Bench, Row, timed

from sdpid.assurance.certificate.certificate import certify
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.local.log_cholesky import solve_log_cholesky
from sdpid.estimation.local.run import random_start
from sdpid.estimation.local.slsqp import solve_slsqp
from sdpid.estimation.prior.prior import Prior, prior_terms
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.cvxpy_form import to_cvxpy
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.wls import solve_wls

# Of the one random start of the local solvers, and of the noise.
SEED = 0

AGAINST = "Clarabel alone"


def case_study(bench: Bench) -> Mapping[str, Problem]:
    """Return the Denso's problem under either consistency, with the case study's margins, kg·m²."""
    return {
        "6x6": denso_problem(bench).constrained(
            consistency="spatial_inertia", constraints=Constraints(margin=0.01)
        ),
        "4x4": denso_problem(bench).constrained(
            consistency="pseudo_inertia", constraints=Constraints(margin=0.005)
        ),
    }


def measure(bench: Bench) -> Iterator[Row]:
    """Yield a row a solver, under either consistency."""
    for label, problem in case_study(bench).items():
        yield from _measure(label, problem, bench)


def _measure(label: str, problem: Problem, bench: Bench) -> Iterator[Row]:
    best = solve_sdp(problem)
    bound = certify(best).bound
    start = random_start(problem, np.random.default_rng(SEED))
    rng = np.random.default_rng(SEED)
    belief = Prior(bodies=problem.feasible.bodies(np.array(best.theta)))
    believed = replace(problem, prior=prior_terms(belief, problem.rows))

    def moved() -> Problem:
        return replace(problem, rhs=problem.rhs + rng.standard_normal(len(problem.rhs)))

    programs: dict[str, Callable[[], Problem]] = {
        "sdp, whole call": lambda: problem,
        "sdp, re-solve": moved,
        "sdp, with a prior": lambda: believed,
    }
    others: dict[str, Callable[[Problem], Estimate]] = {
        "wls": solve_wls,
        "sdp, through CVXPY": _through_cvxpy,
        "slsqp": partial(solve_slsqp, start=start),
        "log_cholesky": partial(solve_log_cholesky, start=start),
    }
    found = bench.in_turn(
        {name: partial(_solved, made) for name, made in programs.items()}
        | {name: partial(timed, partial(solve, problem), LEAST) for name, solve in others.items()}
    )
    seconds = {name: np.array([each for each, _ in runs]) for name, runs in found.items()}
    last = {name: runs[-1][1] for name, runs in found.items()}
    own = {name: np.array([run.solve_time for _, run in found[name]]) for name in programs}
    clarabel = own["sdp, whole call"]
    # Its point before it is moved inside is not kept; gap and violation are those of the call.
    said = last["sdp, whole call"].message.split(";")[0].removeprefix("clarabel: ")
    yield Row.of(f"sdp, Clarabel alone {label}", clarabel, AGAINST, clarabel, status=said)
    for name in ("sdp, re-solve", "sdp, with a prior"):
        facts = {"gap": certify(last[name]).gap, "status": last[name].status}
        what = f"{name} {label}"
        yield Row.of(what, seconds[name], "Clarabel in the same call", own[name], **facts)
    for name in ("sdp, whole call", *others):
        yield Row.of(
            f"{name} {label}",
            seconds[name],
            AGAINST,
            clarabel,
            gap=certify(last[name], bound=bound).gap,
            violation=last[name].violation,
            status=last[name].status,
        )


def _solved(made: Callable[[], Problem]) -> tuple[float, Estimate]:
    """Return the seconds of solving a problem, which is made before."""
    problem = made()
    return timed(lambda: solve_sdp(problem))


def _through_cvxpy(problem: Problem) -> Estimate:
    """Solve the program as CVXPY states it; nothing is repaired or proven."""
    model, theta = to_cvxpy(problem)
    model.solve(solver="CLARABEL")
    return Estimate.of_theta(problem, theta.value, method="sdp", status=str(model.status))
