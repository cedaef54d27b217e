"""Do the stated 95 % intervals hold the truth 95 % of the time? Counted over simulated seeds.

Each seed draws its own excitation and noise for the Denso plant; the intervals are those of the
unconstrained estimate, 1.96 sandwich standard errors either way.

    python examples/coverage.py --out results --seeds 40
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

import sdpid
from sdpid._progress import progress
from sdpid.experiment.plant import true_parameters
from sdpid.output.tables import Table

ROBOT = "denso_vp6242"


def main() -> int:
    """Run the experiments and count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--seeds", type=int, help="experiments (default 40)")
    parser.add_argument("--periods", type=int, default=12)
    parser.add_argument("--period", type=float, default=76.0, help="s; the paper's is 380")
    parser.add_argument("--quick", action="store_true", help="3 seeds")
    options = parser.parse_args()
    seeds = options.seeds or (3 if options.quick else 40)
    options.out.mkdir(parents=True, exist_ok=True)

    robot = sdpid.load_robot(ROBOT)
    theta = true_parameters(ROBOT)
    base = None
    scores = []
    with progress(seeds, "experiments") as advance:
        for seed in range(seeds):
            path = sdpid.paper_excitation(
                ROBOT, seed, periods=options.periods, period=options.period
            )
            log = sdpid.simulate(robot, path, theta=theta, seed=seed, progress=False)
            samples = sdpid.process(log, progress=False)
            problem = sdpid.build_problem(robot, samples, base=base)
            base = problem.base
            fit = sdpid.solve_wls(problem)
            scores.append((fit.base - problem.base_of(theta)) / fit.standard_errors)
            advance(1)
    assert base is not None
    z = np.array(scores)
    inside = np.abs(z) <= 1.96
    rows = zip(
        base.names,
        inside.mean(axis=0).tolist(),
        z.mean(axis=0).tolist(),
        np.sqrt((z**2).mean(axis=0)).tolist(),
        strict=True,
    )
    table = Table(("parameter", "coverage", "mean_z", "rms_z"), tuple(rows))
    table.write(options.out / "coverage.csv")
    print(table.text(3))
    # Parameters of one experiment are correlated, experiments are not: they are the units.
    share = inside.mean(axis=1)
    error = share.std(ddof=1) / np.sqrt(seeds)
    print(
        f"\n{seeds} seeds x {len(base.names)} parameters: {100 * share.mean():.1f} % inside "
        f"(standard error {100 * error:.1f} %), rms z {np.sqrt((z**2).mean()):.3f}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
