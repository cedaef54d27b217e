"""Solvers on the Denso's problem, once and again and again, against Clarabel's own time.

Clarabel's own time is what it reports of the semidefinite program, all attempts and the choice on
the optimal face together; all else is the whole call. Of bootstrap and profile intervals it is
added up over all solves and divided by the jobs: once of the solves of the same call, and once, for
the bootstrap, of the same draws one after the other in one thread. The stream is timed by the
clock: 50 samples folded in, then the problem solved and proven.
"""

from __future__ import annotations

import itertools
import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import cache, partial

import numpy as np
from harness import LEAST, Bench, ratio, timed

import sdpid
from sdpid._common.tables import Table
from sdpid.assurance.intervals.bootstrap import resample
from sdpid.estimation.local.run import random_start
from sdpid.estimation.problem import Problem
from sdpid.estimation.recursive import RecursiveEstimator

DENSO = "denso_vp6242"
# Periods, and seconds of one, of records that are only to show that all runs.
QUICK = (8, 6.0)
# The case study's margins, kg·m².
MARGINS = {"6x6": ("spatial_inertia", 0.01), "4x4": ("pseudo_inertia", 0.005)}
CLARABEL = "Clarabel alone"

# Draws of the bootstrap, and those whose own time is measured one after the other.
RESAMPLES, ALONE = 1000, 200
# Samples an update, and the most updates of a repeat: half a second at 100 Hz, and 20 s; and the
# weight of the samples before at every sample: some 10 s at 100 Hz.
UPDATE, UPDATES, FORGETTING = 50, 40, 0.999

Ratios = Iterator[tuple[object, ...]]


@cache
def denso_log(periods: int | None, period: float | None) -> sdpid.Recording:
    """Return a record of the simulated Denso; by default as long as the paper's."""
    trajectory = sdpid.paper_excitation(DENSO, 0, periods=periods, period=period)
    return sdpid.simulate(sdpid.load_robot(DENSO), trajectory, seed=0, progress=False)


def measure(bench: Bench) -> Ratios:
    """Yield the rows under either consistency, of the case study's experiment in small."""
    samples = sdpid.process(denso_log(*bench.size((8, 38.0), QUICK)), progress=False)
    whole = sdpid.build_problem(sdpid.load_robot(DENSO), samples)
    for label, (consistency, margin) in MARGINS.items():
        constraints = sdpid.Constraints(margin=margin)
        problem = whole.constrained(consistency=consistency, constraints=constraints)
        for measured in (once, resampled, profiled, streamed):
            yield from measured(label, problem, bench)


def once(label: str, problem: Problem, bench: Bench) -> Ratios:
    """Yield the time of solvers; local ones begin at one random start."""
    start = random_start(problem, np.random.default_rng(0))
    solvers = {
        "sdp, whole call": sdpid.solve_sdp,
        "slsqp": partial(sdpid.solve_slsqp, start=start),
        "log_cholesky": partial(sdpid.solve_log_cholesky, start=start),
    }
    found = bench.in_turn(
        {name: partial(timed, partial(solve, problem), LEAST) for name, solve in solvers.items()}
    )
    clarabel = np.array([run.solve_time for _, run in found["sdp, whole call"]])
    for name, runs in found.items():
        yield ratio(f"{name} {label}", np.array([each for each, _ in runs]), CLARABEL, clarabel)


def resampled(label: str, problem: Problem, bench: Bench) -> Ratios:
    """Yield the time of the bootstrap."""
    estimate, count, jobs = sdpid.solve_sdp(problem), bench.size(RESAMPLES, 20), os.cpu_count() or 1
    few = min(ALONE, count)
    alone, every = bench.in_turn(
        {
            "alone": partial(timed, partial(resample, estimate, resamples=few, n_jobs=1)),
            "all": partial(timed, partial(resample, estimate, resamples=count, n_jobs=jobs)),
        }
    ).values()
    whole = np.array([seconds for seconds, _ in every])
    apart, own = (np.array([run.seconds for _, run in runs]) for runs in (alone, every))
    what = f"{count} resamples {label}"
    yield ratio(what, whole, f"Clarabel's own sum / {jobs}", own / jobs)
    against = f"Clarabel's own sum in one thread / {jobs}"
    yield ratio(what, whole, against, apart * count / few / jobs)


def profiled(label: str, problem: Problem, bench: Bench) -> Ratios:
    """Yield the time of profile intervals."""
    estimate, jobs = sdpid.solve_sdp(problem), os.cpu_count() or 1
    names = problem.base.names[:2] if bench.quick else None
    intervals = partial(sdpid.confidence_intervals, estimate, parameters=names, n_jobs=jobs)
    (runs,) = bench.in_turn({"profile": partial(timed, intervals)}).values()
    whole, own = np.array([(seconds, run.seconds) for seconds, run in runs]).T
    what = f"{len(runs[-1][1])} profile intervals {label}"
    yield ratio(what, whole, f"Clarabel's own sum / {jobs}", own / jobs)


def streamed(label: str, problem: Problem, bench: Bench) -> Ratios:
    """Yield the time of an update and solve of a stream, the median of each repeat."""
    # Without what belongs to the whole of the record.
    plain = replace(problem.samples, covariance=None, periods=None, effort_periods=None)
    starts = range(0, plain.n_samples - UPDATE + 1, UPDATE)[: bench.size(UPDATES, 3)]

    def run() -> np.ndarray:
        stream = RecursiveEstimator(problem, forgetting=FORGETTING)
        stream.solve()
        times = []
        for start in starts:
            samples = plain.between(start, start + UPDATE)
            update, _ = timed(partial(stream.update, samples))
            solve, found = timed(stream.solve)
            times.append((update + solve, found.solve_time))
        return np.median(times, axis=0)

    whole, own = np.array(bench.in_turn({"stream": run})["stream"]).T
    what = f"stream, update with {UPDATE} samples and solve {label}"
    yield ratio(what, whole, "Clarabel in the same call", own)


def small_problems(bench: Bench) -> Table:
    """Solve 648 small hard problems, print those without a proof, and count them."""
    from tests.estimation.test_sdp import BOTH, ROBOTS, noisy

    count: Counter[tuple[str, str]] = Counter()
    unproven: Counter[tuple[str, str]] = Counter()
    for name, consistency, margin, weighting, seed in itertools.product(
        ("pendulum", "planar", "arm2"),
        BOTH,
        (0.0, 1e-3, 0.005),
        ("gls", "eq9", "eq18"),
        range(bench.size(12, 1)),
    ):
        asked = {"consistency": consistency, "margin": margin, "weighting": weighting}
        problem = noisy(ROBOTS[name], seed, **asked)
        count[consistency, weighting] += 1
        try:
            sdpid.solve_sdp(problem)
        except sdpid.errors.SolverError as error:
            unproven[consistency, weighting] += 1
            print(f"{name}, {consistency}, margin {margin:g}, {weighting}, seed {seed}: {error}")
    rows = tuple((*kind, number, unproven[kind]) for kind, number in count.items())
    return Table(("consistency", "weighting", "problems", "without a proof"), rows)
