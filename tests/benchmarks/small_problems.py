"""How many small hard problems the semidefinite program proves.

python -m tests.benchmarks.small_problems
"""

from __future__ import annotations

import itertools
import sys

from sdpid.errors import SolverError
from sdpid.estimation.sdp.solve import solve_sdp
from tests.estimation.sdp.test_solve import BOTH, ROBOTS, noisy

# Margins (kg·m²), weightings and seeds; with three robots under either consistency 648 problems.
MARGINS = (0.0, 1e-3, 0.005)
WEIGHTINGS = ("gls", "eq9", "eq18")
SEEDS = range(12)


def main() -> int:
    """Solve all, and print those without a proof and their number."""
    count = unproven = 0
    for name, consistency, margin, weighting, seed in itertools.product(
        ROBOTS, BOTH, MARGINS, WEIGHTINGS, SEEDS
    ):
        problem = noisy(
            ROBOTS[name], seed, consistency=consistency, margin=margin, weighting=weighting
        )
        count += 1
        try:
            solve_sdp(problem)
        except SolverError as error:
            unproven += 1
            print(f"{name}, {consistency}, margin {margin:g}, {weighting}, seed {seed}: {error}")
    print(f"{unproven} of {count} problems without a proof")
    return 0


if __name__ == "__main__":
    sys.exit(main())
