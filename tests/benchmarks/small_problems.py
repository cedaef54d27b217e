"""How many small hard problems the semidefinite program proves.

python -m tests.benchmarks.small_problems [--csv out.csv]
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections import Counter
from pathlib import Path

from sdpid._common.tables import Table
from sdpid.errors import SolverError
from sdpid.estimation.sdp.solve import solve_sdp
from tests.estimation.sdp.test_solve import BOTH, ROBOTS, noisy

# Margins (kg·m²), weightings and seeds; with three robots under either consistency 648 problems.
MARGINS = (0.0, 1e-3, 0.005)
WEIGHTINGS = ("gls", "eq9", "eq18")
SEEDS = range(12)


def main() -> int:
    """Solve all, and print those without a proof and their number."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.small_problems")
    parser.add_argument("--csv", type=Path, help="write the counts here as well")
    options = parser.parse_args()
    count: Counter[tuple[str, str]] = Counter()
    unproven: Counter[tuple[str, str]] = Counter()
    for name, consistency, margin, weighting, seed in itertools.product(
        ROBOTS, BOTH, MARGINS, WEIGHTINGS, SEEDS
    ):
        problem = noisy(
            ROBOTS[name], seed, consistency=consistency, margin=margin, weighting=weighting
        )
        count[consistency, weighting] += 1
        try:
            solve_sdp(problem)
        except SolverError as error:
            unproven[consistency, weighting] += 1
            print(f"{name}, {consistency}, margin {margin:g}, {weighting}, seed {seed}: {error}")
    rows = tuple((*kind, number, unproven[kind]) for kind, number in count.items())
    table = Table(("consistency", "weighting", "problems", "without a proof"), rows)
    print(table.text())
    if options.csv is not None:
        table.write(options.csv)
    return 0


if __name__ == "__main__":
    sys.exit(main())
