"""Count how often the draws of `sdpid.sample_parameters` surround the truth.

Two kinds of simulated robots, all with a known truth:

* ``logs``: the recordings of simulated_logs.py through `sdpid.identify` with its defaults,
* ``arms``: the arms of boundary_coverage.py, whose last link is inside of what is possible, or a
  rod, a plate or a point on its boundary, with a prior whose bodies differ from the truth anew in
  every run, and without a prior.

Of each run 1000 robots are drawn, and the central 95 % of the draws of each parameter are compared
with the truth: of base parameters, and with a prior of standard ones. Reported is the worst
parameter beside the average, the least effective sample size, the largest R-hat, and the time.

    python examples/evidence/sample_coverage.py --out results
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator

import numpy as np
from boundary_coverage import CASES, measured
from simulated_logs import RADIUS, drawn, log_of, perturbed, there
from study import Study, grouped

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.estimate import Estimate
from sdpid.robot.consistent import raise_second_moments

LEVEL = 0.95

# Arms whose truth is inside, and on the boundary.
ARMS = ("rod on the axis", "inside", "plate", "point")

ARM = "arm, "

# Standard deviation of the logarithms by which a prior's bodies differ from the truth, as those of
# simulated robots differ from their description.
DIFFERENT = 0.15

HEADER = (
    *("case", "parameters", "runs", "intervals", "held_percent", "held_least_percent"),
    *("widths_outside_most", "least_effective_size", "largest_r_hat", "seconds"),
)
# Of a parameter with a known truth: how far outside of its range the truth is, in widths of it.
# Of a run: least effective sample size, largest R-hat, seconds of one core.
CELL = ("case", "run", "parameters", "parameter", "outside", "size", "r_hat", "seconds")


def compared(
    case: str, seed: int, estimate: Estimate, truth: Array, count: int, *, standard: bool = True
) -> Iterator[tuple[object, ...]]:
    """Draw, and compare with the true standard parameters; NaN are unknown."""
    start = time.process_time()
    samples = sdpid.sample_parameters(estimate, count, seed)
    seconds = time.process_time() - start
    base = estimate.problem.base
    unknown = np.isnan(truth)
    true_base = base.matrix @ np.where(unknown, 0.0, truth)
    true_base[np.any(base.matrix[:, unknown] != 0.0, axis=1)] = np.nan
    sizes = samples.draws.effective_sizes.min(), samples.draws.r_hat.max()
    kinds = [("base", base.names, samples.base, true_base)]
    if standard:
        kinds.append(("standard", base.theta_names, samples.theta, truth))
    for kind, names, values, true in kinds:
        ends = 0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL)
        lower, upper = np.quantile(values, ends, axis=0)
        # A parameter that the constraints fix is known, and has no range to speak of.
        width = np.where(upper > lower, upper - lower, np.nan)
        outside = np.maximum(np.maximum(lower - true, true - upper), 0.0) / width
        for name, each in zip(names, outside, strict=True):
            if not np.isnan(each):
                yield case, seed, kind, name, each, *sizes, seconds


def of_arm(name: str, seed: int, count: int) -> Iterator[tuple[object, ...]]:
    """Yield a run of an arm, with noise and a prior of its own."""
    prior = not name.endswith(", no prior")
    label = name.removeprefix(ARM).removesuffix(", no prior")
    case = CASES[label]()
    motion, exact, base = measured(case)
    links = case.theta[: 10 * case.robot.n_links].reshape(-1, 10)
    thick = np.asarray(raise_second_moments(links, RADIUS**2 * links[:, 0]))
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
    # Without a prior, what the data leave open has no other range than the possible ones.
    estimate = sdpid.solve_sdp(problem)
    yield from compared(name, seed, estimate, case.theta, count, standard=prior)


def of_robot(name: str, seed: int, count: int) -> Iterator[tuple[object, ...]]:
    """Yield a run of a robot's log through `identify`."""
    log, truth = log_of(drawn(name, seed), seed)
    result = sdpid.identify(truth.robot, log)
    yield from compared(name, seed, result.estimate, truth.theta(result.problem), count)


def main() -> None:
    """Run everything and write the table."""
    study = Study(
        __doc__,
        quick={"arms": [ARMS[0]], "runs": 1, "count": 100, "logs": 0},
        logs=(6, "logs of each robot"),
        runs=(40, "runs of each arm"),
        count=(1000, "draws of each run"),
        arms=[*ARMS],
    )
    arms = (f"{ARM}{name}{prior}" for name in study.arms for prior in ("", ", no prior"))
    cases = [
        *itertools.product(there() if study.logs else (), range(study.logs)),
        *itertools.product(arms, range(study.runs)),
    ]

    def run(case: tuple[str, int]) -> Iterator[tuple[object, ...]]:
        of = of_arm if case[0].startswith(ARM) else of_robot
        yield from of(*case, study.count)

    found = study.rows("runs.csv", CELL, cases, run)
    rows = []
    for key, own in grouped(found, "case", "parameters"):
        parameters, held = own["parameter"], own["outside"] == 0.0
        shares = {each: 100.0 * held[parameters == each].mean() for each in np.unique(parameters)}
        worst = sorted(shares, key=lambda each: shares[each])[:3]
        listed = ", ".join(f"{each} {shares[each]:.0f}" for each in worst)
        mean, far = 100.0 * held.mean(), own["outside"].max()
        ends = own["size"].min(), own["r_hat"].max(), np.median(own["seconds"])
        rows.append((*key, len(np.unique(own["run"])), len(held), mean, listed, far, *ends))
    study.write("sample_coverage.csv", HEADER, rows)


if __name__ == "__main__":
    main()
