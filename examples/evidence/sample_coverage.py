"""Count how often the draws of `sdpid.sample_parameters` surround the truth.

Two kinds of simulated robots, all with a known truth:

* ``logs``: the recordings of simulated_logs.py through `sdpid.identify` with its defaults,
* ``arms``: the arms of boundary_coverage.py, whose last link is inside of what is possible, or a
  rod, a plate or a point on its boundary, with a prior whose bodies differ from the truth anew in
  every run, and without a prior.

Of each run 1000 robots are drawn, and the central 95 % of the draws of each parameter are compared
with the truth: of base parameters, and with a prior of standard ones. Reported is the worst
parameter beside the average, the least effective sample size, the largest R-hat, and the time.

    python examples/evidence/sample_coverage.py --data /path/to/data --out results
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from boundary_coverage import CASES, measured
from simulated_logs import RADIUS, drawn, log_of, perturbed, there

import sdpid
from sdpid._common.arrays import Array
from sdpid._common.progress import progress
from sdpid._common.tables import Table
from sdpid.estimation.estimate import Estimate
from sdpid.robot.consistent import raise_second_moments

LEVEL = 0.95

# Arms whose truth is inside, and on the boundary.
ARMS = ("rod on the axis", "inside", "plate", "point")

# Standard deviation of the logarithms by which a prior's bodies differ from the truth, as those of
# simulated robots differ from their description.
DIFFERENT = 0.15

HEADER = (
    "case",
    "parameters",
    "runs",
    "intervals",
    "held_percent",
    "held_least_percent",
    "widths_outside_most",
    "least_effective_size",
    "largest_r_hat",
    "seconds",
)


@dataclass(frozen=True)
class Run:
    """One estimate's draws, compared with the truth.

    Attributes
    ----------
    names : sequence of str
        The parameters, base ones first.
    outside : ndarray
        How far the truth of each is outside of its range, in widths of the range; NaN where there
        is none.
    size, r_hat, seconds : float
        Least effective sample size, largest R-hat, seconds of one core.
    """

    names: Sequence[str]
    outside: Array
    size: float
    r_hat: float
    seconds: float


def compared(estimate: Estimate, truth: Array, count: int, seed: int) -> Run:
    """Draw, and compare with the true standard parameters; NaN are unknown."""
    start = time.process_time()
    samples = sdpid.sample_parameters(estimate, count, seed)
    seconds = time.process_time() - start
    base = estimate.problem.base
    unknown = np.isnan(truth)
    true_base = base.matrix @ np.where(unknown, 0.0, truth)
    true_base[np.any(base.matrix[:, unknown] != 0.0, axis=1)] = np.nan
    values = np.hstack([samples.base, samples.theta])
    true = np.concatenate([true_base, truth])
    lower, upper = np.quantile(values, [0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL)], axis=0)
    width = upper - lower
    # A parameter that the constraints fix is known, and has no range to speak of.
    outside = np.maximum(np.maximum(lower - true, true - upper), 0.0) / np.where(
        width > 0.0, width, np.nan
    )
    draws = samples.draws
    names = (*base.names, *base.theta_names)
    sizes = float(draws.effective_sizes.min()), float(draws.r_hat.max())
    return Run(names, outside, *sizes, seconds)


def of_arm(name: str, seeds: range, count: int, *, prior: bool) -> Iterator[Run]:
    """Yield the runs of an arm, each with noise and a prior of its own."""
    case = CASES[name]()
    motion, exact, base = measured(case)
    links = case.theta[: 10 * case.robot.n_links].reshape(-1, 10)
    thick = np.asarray(raise_second_moments(links, RADIUS**2 * links[:, 0]))
    for seed in seeds:
        rng = np.random.default_rng(seed)
        noise = case.noise * rng.standard_normal(exact.shape)
        bodies = perturbed(thick, DIFFERENT, rng)
        problem = sdpid.build_problem(
            case.robot,
            sdpid.Samples(**motion, effort=exact + noise, block=4),
            base=base,
            weighting="residual",
            constraints=case.constraints,
            consistency=case.consistency,
            prior=sdpid.Prior(bodies=bodies) if prior else None,
        )
        run = compared(sdpid.solve_sdp(problem), case.theta, count, seed)
        if not prior:
            # What the data leave open has no other range than the possible ones.
            run = replace(
                run,
                outside=np.where(np.arange(len(run.names)) < base.count, 1.0, np.nan) * run.outside,
            )
        yield run


def of_robot(
    name: str, seeds: range, count: int, data: Path | None, duration: float | None
) -> Iterator[Run]:
    """Yield the runs of a robot's logs through `identify`."""
    for seed in seeds:
        conditions = drawn(name, seed)
        if duration is not None:
            conditions = replace(conditions, duration=duration, rate_hz=100.0)
        log, truth = log_of(conditions, seed, data)
        result = sdpid.identify(truth.robot, log)
        yield compared(result.estimate, truth.theta(result.problem), count, seed)


def rows_of(name: str, runs: Sequence[Run]) -> Iterator[tuple[object, ...]]:
    """Yield a row for the base parameters of a case, and one for the standard ones."""
    every = dict.fromkeys(each for run in runs for each in run.names)
    sizes = min(run.size for run in runs), max(run.r_hat for run in runs)
    seconds = float(np.median([run.seconds for run in runs]))
    for kind in ("base", "standard"):
        shares: dict[str, float] = {}
        far: list[float] = []
        held: list[bool] = []
        for parameter in every:
            # Base parameters are numbered, of standard ones links with an underscore.
            if ("_" in parameter) != (kind == "standard"):
                continue
            own = [
                run.outside[k]
                for run in runs
                for k in [list(run.names).index(parameter)]
                if parameter in run.names and not np.isnan(run.outside[k])
            ]
            if own:
                shares[parameter] = 100.0 * float(np.mean(np.array(own) == 0.0))
                held += [each == 0.0 for each in own]
                far += own
        if held:
            worst = sorted(shares, key=lambda each: shares[each])[:3]
            listed = ", ".join(f"{each} {shares[each]:.0f}" for each in worst)
            mean = 100.0 * float(np.mean(held))
            yield name, kind, len(runs), len(held), mean, listed, max(far), *sizes, seconds


def main() -> int:
    """Run everything and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--data", type=Path, default=os.environ.get("SDPID_DATA"))
    parser.add_argument("--logs", type=int, default=6, help="logs of each robot")
    parser.add_argument("--runs", type=int, default=40, help="runs of each arm")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--count", type=int, default=1000, help="draws of each run")
    parser.add_argument("--arms", nargs="*", choices=list(CASES), default=list(ARMS))
    parser.add_argument("--quick", action="store_true", help="one arm, one run")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    logs = range(options.first, options.first + options.logs)
    seeds = range(options.first, options.first + (1 if options.quick else options.runs))
    count = 100 if options.quick else options.count
    cases: dict[str, Iterator[Run]] = {}
    if logs and not options.quick:
        for name in there(options.data):
            cases[name] = of_robot(name, logs, count, options.data, None)
    for name in options.arms[:1] if options.quick else options.arms:
        cases[f"arm, {name}"] = of_arm(name, seeds, count, prior=True)
        if not options.quick:
            cases[f"arm, {name}, no prior"] = of_arm(name, seeds, count, prior=False)
    rows: list[tuple[object, ...]] = []
    with progress(len(cases), "cases") as advance:
        for name, runs in cases.items():
            rows += rows_of(name, list(runs))
            Table(HEADER, tuple(rows)).write(options.out / "sample_coverage.csv")
            advance(1)
    print(Table(HEADER, tuple(rows)).text(3))
    return 0


if __name__ == "__main__":
    sys.exit(main())
