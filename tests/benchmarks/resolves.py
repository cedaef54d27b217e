"""Problems solved again and again, against the time that Clarabel itself takes.

    python -m tests.benchmarks.resolves [--repeat 5] [--resamples 1000] [--csv out.csv]

The reference is Clarabel's own time, added up over all solves and divided by the jobs: once of the
solves of the same call, and once, for the bootstrap, of the same draws one after the other in one
thread. The stream is timed by the clock: 50 samples folded in, then the problem solved and proven.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.certificate import certify
from sdpid.assurance.intervals.bootstrap import resample
from sdpid.assurance.intervals.intervals import confidence_intervals
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.recursive import RecursiveEstimator
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.experiment.plant.simulate import simulate, true_parameters
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.trajectory.paper import paper_excitation
from sdpid.robot.model.load import load_robot
from tests.benchmarks.solvers import PROBLEMS
from tests.benchmarks.timing import Row, table

RESAMPLES = 1000

# Draws whose own time is measured one after the other.
ALONE = 200

# Samples an update, and the most updates of a repeat: half a second at 100 Hz, and 20 s.
UPDATE, UPDATES = 50, 40

# Of the samples before at every sample: some 10 s at 100 Hz.
FORGETTING = 0.999


def measure(
    problem: Problem, repeats: int, *, resamples: int = RESAMPLES, jobs: int | None = None
) -> Iterator[Row]:
    """Yield the rows of bootstrap, profile intervals and stream, under either consistency."""
    count = jobs or os.cpu_count() or 1
    for label, consistency, margin in PROBLEMS:
        constraints = Constraints(margin=margin)
        constrained = problem.constrained(consistency=consistency, constraints=constraints)
        estimate = solve_sdp(constrained)
        yield from _bootstrap(label, estimate, repeats, resamples, count)
        yield _profile(label, estimate, repeats, count)
        yield from _stream(label, constrained, repeats)


def _bootstrap(
    label: str, estimate: Estimate, repeats: int, resamples: int, jobs: int
) -> Iterator[Row]:
    whole, own, alone = (np.empty(repeats) for _ in range(3))
    resample(estimate, resamples=jobs, n_jobs=jobs)
    lost = 0
    for repeat in range(repeats):
        few = min(ALONE, resamples)
        alone[repeat] = resample(estimate, resamples=few, n_jobs=1).seconds * resamples / few
        begin = time.perf_counter()
        found = resample(estimate, resamples=resamples, n_jobs=jobs)
        whole[repeat] = time.perf_counter() - begin
        own[repeat], lost = found.seconds, found.lost
    what, status = f"{resamples} resamples {label}", f"{lost} lost"
    yield Row.of(what, whole, f"Clarabel's own sum / {jobs}", own / jobs, status=status)
    against = f"Clarabel's own sum in one thread / {jobs}"
    yield Row.of(what, whole, against, alone / jobs, status=status)


def _profile(label: str, estimate: Estimate, repeats: int, jobs: int) -> Row:
    whole, own = (np.empty(repeats) for _ in range(2))
    confidence_intervals(estimate, parameters=estimate.problem.base.names[:1], n_jobs=jobs)
    count = solves = 0
    for repeat in range(repeats):
        begin = time.perf_counter()
        found = confidence_intervals(estimate, n_jobs=jobs)
        whole[repeat] = time.perf_counter() - begin
        own[repeat], count, solves = found.seconds, len(found), found.solves
    what, against = f"{count} profile intervals {label}", f"Clarabel's own sum / {jobs}"
    return Row.of(what, whole, against, own / jobs, status=f"{solves} solves")


def _stream(label: str, problem: Problem, repeats: int) -> Iterator[Row]:
    """Time updates and solves of a stream, the median of each repeat."""
    update, solve, own = (np.empty(repeats) for _ in range(3))
    gap = 0.0
    full = 0
    for repeat in range(repeats):
        stream = RecursiveEstimator(problem, forgetting=FORGETTING)
        stream.solve()
        times: list[tuple[float, float, float]] = []
        for samples in islice(_pieces(problem.samples), UPDATES):
            begin = time.perf_counter()
            stream.update(samples)
            middle = time.perf_counter()
            found = stream.solve()
            end = time.perf_counter()
            times.append((middle - begin, end - middle, found.solve_time))
            full += "any point" not in found.message
        gap = max(gap, certify(found).gap)
        update[repeat], solve[repeat], own[repeat] = np.median(times, axis=0)
    status = f"{full} of {repeats * len(times)} in full"
    what, against = f"stream, update and solve {label}", "Clarabel in the same call"
    yield Row.of(what, update + solve, against, own, gap=gap, status=status)
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


def denso() -> Problem:
    """Return the case study's problem in small: 48 base parameters, 8 periods of 38 s."""
    name = "denso_vp6242"
    robot = load_robot(name)
    trajectory = paper_excitation(name, 0, periods=8, period=38.0)
    log = simulate(robot, trajectory, theta=true_parameters(name), seed=0, progress=False)
    return build_problem(robot, process(log, progress=False))


def main() -> int:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.resolves", description="Measure."
    )
    parser.add_argument("--repeat", type=int, default=5, help="at least 5 (default)")
    parser.add_argument("--resamples", type=int, default=RESAMPLES, help="draws (default 1000)")
    parser.add_argument("--jobs", type=int, help="jobs (default one a core)")
    parser.add_argument("--csv", type=Path, help="write the table here as well")
    options = parser.parse_args()
    if options.repeat < 5:
        parser.error(f"--repeat: is {options.repeat}; at least 5 give a spread.")
    rows = measure(denso(), options.repeat, resamples=options.resamples, jobs=options.jobs)
    result = table(list(rows))
    print(result.text(digits=3))
    if options.csv is not None:
        result.write(options.csv)
    return 0


if __name__ == "__main__":
    sys.exit(main())
