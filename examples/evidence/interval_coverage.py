"""Do the stated 95 % intervals hold the truth 95 % of the time? Counted over simulated seeds.

Each seed draws its own excitation and noise for the Denso plant. Counted are the intervals of
Gauss and Markov, the profile likelihood and the block bootstrap of `sdpid.confidence_intervals`,
for a robot well inside all constraints and for one whose links lie exactly on them.

    python examples/evidence/interval_coverage.py --out results --seeds 40
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
from boundary_coverage import MARGIN, denso
from study import Study, grouped

import sdpid
from sdpid.estimation.cluster_robust import ScoreBlocks

ROBOT = "denso_vp6242"
CASES = ("inside", "on the boundary")
METHODS = ("1.96 errors", "gauss_markov", "profile", "bootstrap")

# Standard normal quantile.
NORMAL = 1.959963984540054


def counted(case: str, seed: int, study: Study) -> Iterator[tuple[object, ...]]:
    """Yield of every kind of interval the share that holds, and its width beside 1.96 errors."""
    robot = sdpid.load_robot(ROBOT)
    boundary = case != CASES[0]
    theta = denso(boundary=boundary).theta
    constraints = sdpid.Constraints(margin=MARGIN) if boundary else sdpid.Constraints()
    path = sdpid.paper_excitation(ROBOT, seed, periods=study.periods, period=study.period)
    log = sdpid.simulate(robot, path, theta=theta, seed=seed, progress=False)
    problem = sdpid.build_problem(
        robot, sdpid.process(log, progress=False), constraints=constraints
    )
    base, truth = problem.base, problem.base_of(theta)
    fit, estimate = sdpid.solve_wls(problem), sdpid.solve_sdp(problem)
    half = NORMAL * np.sqrt(np.diag(ScoreBlocks.of(problem).covariance))
    ends: dict[str, tuple[Any, Any]] = {METHODS[0]: (fit.base - half, fit.base + half)}
    for method in METHODS[1:]:
        found = sdpid.confidence_intervals(
            estimate,
            method=method,  # type: ignore[arg-type]
            parameters=base.names,
            resamples=study.resamples,
            seed=seed,
        )
        ends[method] = found.lower[: base.count], found.upper[: base.count]
    pressed = (estimate.cost - fit.cost) / fit.cost > 1e-6
    for method, (lower, upper) in ends.items():
        held, width = np.mean((lower <= truth) & (truth <= upper)), (upper - lower) / (2.0 * half)
        yield case, method, "base", held, np.median(width), pressed


def main() -> None:
    """Run the experiments and count."""
    study = Study(
        __doc__,
        quick={"cases": [CASES[0]], "seeds": 1, "period": 19.0, "resamples": 80},
        seeds=(40, "experiments of each case"),
        periods=12,
        period=(76.0, "s; the paper's is 380"),
        resamples=(200, "of the bootstrap"),
        cases=[*CASES],
    )
    cases = itertools.product(study.cases, range(study.seeds))
    header = ("case", "intervals", "parameters", "held", "width", "pressed")
    found = study.rows("each.csv", header, cases, lambda case: counted(*case, study))
    rows = []
    for key, own in grouped(found, "case", "intervals", "parameters"):
        held, width = own["held"], np.median(own["width"])
        # Parameters of one experiment are correlated, experiments are not: they are the units.
        error = np.std(held, ddof=1) / np.sqrt(len(held)) if len(held) > 1 else None
        shares = 100.0 * held.mean(), None if error is None else 100.0 * error
        rows.append((*key, *shares, width if np.isfinite(width) else None))
    header = ("case", "intervals", "parameters", "coverage_percent", "error_percent", "width")
    study.write("coverage.csv", header, rows)
    for (case,), own in grouped([row for row in found if row["intervals"] == METHODS[0]], "case"):
        count = int(own["pressed"].sum())
        print(f"{case}: a constraint costs something in {count} of {study.seeds} experiments")


if __name__ == "__main__":
    main()
