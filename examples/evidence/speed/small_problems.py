"""How many small hard problems the semidefinite program proves."""

from __future__ import annotations

import itertools
from collections import Counter

from harness import Bench

from sdpid._common.tables import Table
from sdpid.errors import SolverError
from sdpid.estimation.sdp.solve import solve_sdp
from tests.estimation.test_sdp import BOTH, ROBOTS, noisy

# Robots, margins (kg·m²), weightings and seeds; under either consistency 648 problems.
NAMES = ("pendulum", "planar", "arm2")
MARGINS = (0.0, 1e-3, 0.005)
WEIGHTINGS = ("gls", "eq9", "eq18")
SEEDS = range(12)


def measure(bench: Bench) -> Table:
    """Solve all, print those without a proof, and count them."""
    count: Counter[tuple[str, str]] = Counter()
    unproven: Counter[tuple[str, str]] = Counter()
    for name, consistency, margin, weighting, seed in itertools.product(
        NAMES, BOTH, MARGINS, WEIGHTINGS, bench.size(SEEDS, range(1))
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
    return Table(("consistency", "weighting", "problems", "without a proof"), rows)
