"""Do the stated 95 % intervals hold the truth 95 % of the time? Counted over simulated seeds.

Each seed draws its own excitation and noise for the Denso plant. Counted are the intervals of
Gauss and Markov, the profile likelihood and the block bootstrap of `sdpid.confidence_intervals`,
for a robot well inside all constraints and for one whose links lie exactly on them.

    python examples/evidence/interval_coverage.py --out results --seeds 40
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

import sdpid
from sdpid._common.progress import progress
from sdpid._common.tables import Table
from sdpid.estimation.cluster_robust import ScoreBlocks
from sdpid.experiment.plant.simulate import true_parameters
from sdpid.robot.inertia import (
    complement,
    physical_parameters,
    second_moment_from_inertia,
    theta_from_physical,
)

ROBOT = "denso_vp6242"
CASES = ("inside", "on the boundary")
METHODS = ("1.96 errors", "gauss_markov", "profile", "bootstrap")

# Margin of the second case, kg·m²: links thinner than that could not be simulated.
MARGIN = 0.02

# Standard normal quantile.
NORMAL = 1.959963984540054


def on_the_boundary(theta: np.ndarray) -> np.ndarray:
    """Return parameters whose links all have exactly the margin.

    The first three links become plates, the next two rods, and the last a rod along its axis.
    """
    out = theta.copy()
    links = out[:60].reshape(6, 10)
    mass, com, inertia = physical_parameters(links)
    for i in range(6):
        values, vectors = np.linalg.eigh(second_moment_from_inertia(inertia[i]))
        if i == 5:
            com[i, :2] = 0.0
            vectors = np.eye(3)
        kept = values * [0.0, float(i < 3), 1.0]
        second = (vectors * kept) @ vectors.T + MARGIN * np.eye(3)
        inertia[i] = complement(second)
    out[:60] = theta_from_physical(mass, com, inertia).ravel()
    return out


def main() -> int:
    """Run the experiments and count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--seeds", type=int, help="experiments of each case (default 40)")
    parser.add_argument("--periods", type=int, default=12)
    parser.add_argument("--period", type=float, default=76.0, help="s; the paper's is 380")
    parser.add_argument("--resamples", type=int, default=200, help="of the bootstrap")
    parser.add_argument("--cases", nargs="*", choices=CASES, default=list(CASES))
    parser.add_argument("--standard", action="store_true", help="standard parameters too (slow)")
    parser.add_argument("--quick", action="store_true", help="one short run of the first case")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    rows: list[tuple[object, ...]] = []
    if options.quick:
        options.cases, options.seeds, options.period = CASES[:1], 1, 19.0
    for case in options.cases:
        rows += run(case, options)
    table = Table(
        ("case", "intervals", "parameters", "coverage_percent", "error_percent", "width"),
        tuple(rows),
    )
    table.write(options.out / "coverage.csv")
    print(table.text(4))
    return 0


def run(case: str, options: argparse.Namespace) -> list[tuple[object, ...]]:
    """Return coverage of every kind of interval in one case."""
    robot = sdpid.load_robot(ROBOT)
    theta = np.array(true_parameters(ROBOT))
    constraints = sdpid.Constraints()
    if case != CASES[0]:
        theta = on_the_boundary(theta)
        constraints = sdpid.Constraints(margin=MARGIN)
    seeds = options.seeds or 40
    resamples = 80 if options.quick else options.resamples
    base, pressed = None, []
    inside: dict[tuple[str, str], list[float]] = {}
    widths: dict[tuple[str, str], list[float]] = {}
    with progress(seeds, case) as advance:
        for seed in range(seeds):
            path = sdpid.paper_excitation(
                ROBOT, seed, periods=options.periods, period=options.period
            )
            log = sdpid.simulate(robot, path, theta=theta, seed=seed, progress=False)
            samples = sdpid.process(log, progress=False)
            problem = sdpid.build_problem(robot, samples, base=base, constraints=constraints)
            base = problem.base
            truth = problem.base_of(theta)
            fit, estimate = sdpid.solve_wls(problem), sdpid.solve_sdp(problem)
            pressed.append((estimate.cost - fit.cost) / fit.cost > 1e-6)
            half = NORMAL * np.sqrt(np.diag(ScoreBlocks.of(problem).covariance))
            ends: dict[str, tuple[Any, Any]] = {METHODS[0]: (fit.base - half, fit.base + half)}
            for method in METHODS[1:]:
                found = sdpid.confidence_intervals(
                    estimate,
                    method=method,  # type: ignore[arg-type]
                    parameters=base.names,
                    resamples=resamples,
                    seed=seed,
                )
                ends[method] = found.lower[: base.count], found.upper[: base.count]
            for method, (lower, upper) in ends.items():
                key = method, "base"
                inside.setdefault(key, []).append(np.mean((lower <= truth) & (truth <= upper)))
                widths.setdefault(key, []).append(np.median((upper - lower) / (2.0 * half)))
            if options.standard:
                found = sdpid.confidence_intervals(estimate, parameters=base.theta_names[:60])
                held = found.contains(theta[:60])
                labels = np.array(found.label)
                for label in np.unique(labels):
                    key = "profile", str(label)
                    inside.setdefault(key, []).append(held[labels == label].mean())
            advance(1)
    print(f"{case}: a constraint costs something in {sum(pressed)} of {seeds} experiments")
    out: list[tuple[object, ...]] = []
    for (method, which), values in inside.items():
        # Parameters of one experiment are correlated, experiments are not: they are the units.
        error = float(np.std(values, ddof=1) / np.sqrt(seeds))
        width = float(np.median(widths[method, which])) if (method, which) in widths else None
        out.append((case, method, which, 100.0 * float(np.mean(values)), 100.0 * error, width))
    return out


if __name__ == "__main__":
    sys.exit(main())
