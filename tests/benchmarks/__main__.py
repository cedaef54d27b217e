"""Measure; nothing is asserted.

    python -m tests.benchmarks [--repeat 5] [--csv out.csv]

Times depend on the machine, so all are ratios to a reference timed in the same repeat: the
median over the repeats, and the smallest and the largest. One thread of linear algebra, unless
OPENBLAS_NUM_THREADS says otherwise.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
from importlib.metadata import version
from pathlib import Path

from sdpid.estimation.problem import build_problem
from sdpid.experiment.excitation import paper_excitation
from sdpid.experiment.plant import simulate, true_parameters
from sdpid.experiment.processing import process
from sdpid.robot.load import load_robot
from tests.benchmarks import chain, solvers
from tests.benchmarks.timing import Row, table

ROBOT = "denso_vp6242"
PERIODS, PERIOD, SEED = 8, 38.0, 0

# Fewer have no spread worth printing.
LEAST_REPEATS = 5


def main() -> int:
    """Run everything and print the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description="Measure.")
    parser.add_argument("--repeat", type=int, default=LEAST_REPEATS, help="at least 5 (default)")
    parser.add_argument("--csv", type=Path, help="write the table here as well")
    options = parser.parse_args()
    repeats: int = options.repeat
    if repeats < LEAST_REPEATS:
        parser.error(f"--repeat: is {repeats}; at least {LEAST_REPEATS} give a spread.")

    def say(what: str) -> None:
        print(what, file=sys.stderr, flush=True)

    rows: list[Row] = []
    say("import")
    rows += chain.importing(repeats)
    say("simulating the experiment")
    robot = load_robot(ROBOT)
    trajectory = paper_excitation(ROBOT, SEED, periods=PERIODS, period=PERIOD)
    log = simulate(robot, trajectory, theta=true_parameters(ROBOT), seed=SEED, progress=False)
    say("processing")
    rows += chain.processing(log, repeats)
    samples = process(log, progress=False)
    say("regressor")
    rows += chain.regressor(robot, samples, repeats)
    rows += chain.regressor_blocks(repeats)
    say("compression")
    problem = build_problem(robot, samples)
    rows += chain.compression(problem, repeats)
    say("solvers")
    rows += solvers.measure(problem, repeats)

    libraries = ("numpy", "scipy", "pin", "clarabel", "cvxpy")
    used = ", ".join(f"{name} {version(name)}" for name in libraries)
    threads = os.environ.get("OPENBLAS_NUM_THREADS", "?")
    print(f"Python {platform.python_version()} on {platform.machine()}, {used}")
    print(
        f"{os.cpu_count()} cores, OpenBLAS threads {threads}, {repeats} repeats "
        f"({solvers.SLOW_REPEATS} of what takes over {solvers.SLOW:g} s)"
    )
    print(
        f"{ROBOT}: {log.n_samples} samples of {2 * log.n} channels, {len(samples.effort)} after "
        f"processing, {problem.n_rows} rows, {problem.n_theta} parameters\n"
    )
    result = table(rows)
    print(result.text(digits=3))
    if options.csv is not None:
        result.write(options.csv)
    return 0


if __name__ == "__main__":
    sys.exit(main())
