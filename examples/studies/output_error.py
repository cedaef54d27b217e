"""Output error on a simulated arm: wrong gains of the controller, far starts, and time.

A UR10 with Coulomb and viscous friction under a PD controller at 5 kHz that differences noisy
positions. One table, ``output_error.csv``: how far efforts of the parameters found are off,
iterations, and seconds of the processor.

    python examples/studies/output_error.py --runs 2 --out results
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from bias_test import CONTROL_HZ, MASKED, Arm, processing_of

import sdpid
from sdpid._common.progress import progress
from sdpid._common.tables import Table

# Deviation of the encoders' noise, rad.
NOISE = 1e-5

RATE_HZ, CUTOFF_HZ = 250.0, 30.0

# Factors of the controller's gains, and spreads of the start's parameters.
GAINS, SPREADS = (1.0, 1.05, 1.2), (0.15, 0.3, 0.6)

HEADER = ("method", "gains", "start_percent", "runs", "error_percent", "iterations", "seconds")


def rows(
    runs: int, gains: tuple[float, ...] = GAINS, spreads: tuple[float, ...] = SPREADS
) -> Iterator[tuple[Any, ...]]:
    """Yield the medians over runs of each method, error of the gains, and start."""
    arm = Arm("ur10_robot", RATE_HZ, ("coulomb", "viscous"))
    processing, truth = processing_of(RATE_HZ, CUTOFF_HZ, MASKED), arm.model.theta
    problems = []
    for seed in range(runs):
        log = arm.log(seed, NOISE)
        problems.append((log, arm.problem(log, processing)))
    cases: list[tuple[str, float, float]] = [("least squares", 1.0, 0.0)]
    for method in ("didim", "closed_loop"):
        cases += [(method, gain, 0.0) for gain in gains]
        cases += [(method, 1.0, spread) for spread in spreads]
    for method, gain, spread in cases:
        found = []
        for seed, (log, problem) in enumerate(problems):
            law = sdpid.controllers.PD(gain * arm.controller.kp, gain * arm.controller.kd)
            rng = np.random.default_rng((seed, 2))
            start = truth * (1.0 + spread * rng.uniform(-1.0, 1.0, len(truth)))
            begin = time.process_time()
            if method == "least squares":
                estimate = sdpid.solve_sdp(problem)
            else:
                estimate = sdpid.solve_output_error(
                    problem,
                    log,
                    method=method,
                    controller=law,
                    start=start if spread else None,
                    processing=processing,
                    control_hz=CONTROL_HZ,
                    controller_tolerance=np.inf,
                )
            seconds = time.process_time() - begin
            right = problem.A @ problem.base_of(truth)
            error = np.linalg.norm(problem.A @ estimate.base - right) / np.linalg.norm(right)
            count = 1 if method == "least squares" else estimate.iterations
            found.append((100.0 * float(error), count, seconds))
        medians = [float(each) for each in np.median(np.array(found), axis=0)]
        yield method, gain, 100.0 * spread, runs, *medians


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--quick", action="store_true", help="one log, the right gains")
    parser.add_argument("--out", type=Path, default=Path("results"))
    chosen = parser.parse_args()
    gains, spreads = GAINS, SPREADS
    if chosen.quick:
        chosen.runs, gains, spreads = 1, GAINS[:1], ()
    chosen.out.mkdir(parents=True, exist_ok=True)
    kept = []
    with progress(1 + 2 * (len(gains) + len(spreads)), "output_error.csv") as advance:
        for row in rows(chosen.runs, gains, spreads):
            kept.append(row)
            print(*row, flush=True)
            advance(1)
    Table(HEADER, tuple(kept)).write(chosen.out / "output_error.csv")


if __name__ == "__main__":
    main()
