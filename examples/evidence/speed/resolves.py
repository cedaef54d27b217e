"""Problems solved again and again, against the time that Clarabel itself takes.

The reference is Clarabel's own time, added up over all solves and divided by the jobs: once of the
solves of the same call, and once, for the bootstrap, of the same draws one after the other in one
thread. The stream is timed by the clock: 50 samples folded in, then the problem solved and proven.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import islice

import numpy as np
from harness import Bench, Row, timed
from solvers import case_study

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.certificate import certify
from sdpid.assurance.intervals.bootstrap import resample
from sdpid.assurance.intervals.intervals import confidence_intervals
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.estimation.recursive import RecursiveEstimator
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.experiment.processing.samples import Samples

RESAMPLES = 1000

# Draws whose own time is measured one after the other.
ALONE = 200

# Samples an update, and the most updates of a repeat: half a second at 100 Hz, and 20 s.
UPDATE, UPDATES = 50, 40

# Of the samples before at every sample: some 10 s at 100 Hz.
FORGETTING = 0.999


def measure(bench: Bench) -> Iterator[Row]:
    """Yield the rows of bootstrap, profile intervals and stream, under either consistency."""
    jobs = os.cpu_count() or 1
    for label, problem in case_study(bench).items():
        estimate = solve_sdp(problem)
        yield from _bootstrap(label, estimate, bench, jobs)
        yield _profile(label, estimate, bench, jobs)
        yield from _stream(label, problem, bench)


def _bootstrap(label: str, estimate: Estimate, bench: Bench, jobs: int) -> Iterator[Row]:
    count = bench.size(RESAMPLES, 20)
    few = min(ALONE, count)
    found = bench.in_turn(
        {
            "alone": partial(timed, partial(resample, estimate, resamples=few, n_jobs=1)),
            "all": partial(timed, partial(resample, estimate, resamples=count, n_jobs=jobs)),
        }
    )
    alone, own = (np.array([run.seconds for _, run in runs]) for runs in found.values())
    whole = np.array([seconds for seconds, _ in found["all"]])
    what, status = f"{count} resamples {label}", f"{found['all'][-1][1].lost} lost"
    yield Row.of(what, whole, f"Clarabel's own sum / {jobs}", own / jobs, status=status)
    against = f"Clarabel's own sum in one thread / {jobs}"
    yield Row.of(what, whole, against, alone * count / few / jobs, status=status)


def _profile(label: str, estimate: Estimate, bench: Bench, jobs: int) -> Row:
    names = estimate.problem.base.names[:2] if bench.quick else None
    intervals = partial(confidence_intervals, estimate, parameters=names, n_jobs=jobs)
    (runs,) = bench.in_turn({"profile": partial(timed, intervals)}).values()
    found = runs[-1][1]
    whole, own = np.array([(seconds, run.seconds) for seconds, run in runs]).T
    what, against = f"{len(found)} profile intervals {label}", f"Clarabel's own sum / {jobs}"
    return Row.of(what, whole, against, own / jobs, status=f"{found.solves} solves")


def _stream(label: str, problem: Problem, bench: Bench) -> Iterator[Row]:
    """Time updates and solves of a stream, the median of each repeat."""
    gaps: list[float] = []
    full: list[bool] = []

    def run() -> Array:
        stream = RecursiveEstimator(problem, forgetting=FORGETTING)
        stream.solve()
        times = []
        for samples in islice(_pieces(problem.samples), bench.size(UPDATES, 3)):
            update, _ = timed(partial(stream.update, samples))
            solve, found = timed(stream.solve)
            times.append((update, solve, found.solve_time))
            full.append("any point" not in found.message)
        gaps.append(certify(found).gap)
        return np.median(times, axis=0)

    update, solve, own = np.array(bench.in_turn({"stream": run})["stream"]).T
    facts = {"gap": max(gaps), "status": f"{sum(full)} of {len(full)} in full"}
    what, against = f"stream, update and solve {label}", "Clarabel in the same call"
    yield Row.of(what, update + solve, against, own, **facts)
    yield Row.of(f"stream, update with {UPDATE} samples {label}", update, against, own)


def _pieces(samples: Samples) -> Iterator[Samples]:
    """Yield pieces of a record, without what belongs to the whole of it."""
    plain = replace(samples, covariance=None, periods=None, effort_periods=None)
    for start in range(0, plain.n_samples - UPDATE + 1, UPDATE):
        part = slice(start, start + UPDATE)

        def cut(values: Array | None, part: slice = part) -> Array | None:
            return None if values is None else values[part]

        yield Samples(
            position=plain.position[part],
            velocity=plain.velocity[part],
            acceleration=plain.acceleration[part],
            effort=plain.effort[part],
            mask=None if plain.mask is None else plain.mask[part],
            time=cut(plain.time),
        )
