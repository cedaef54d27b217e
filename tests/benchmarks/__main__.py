"""Measure; nothing is asserted.

    python -m tests.benchmarks [--only PART ...] [--repeat 5] [--csv out.csv] [--out FOLDER]

Times depend on the machine, so all are ratios to a reference timed in the same repeat: the
median over the repeats, and the smallest and the largest. One thread of linear algebra, unless
OPENBLAS_NUM_THREADS says otherwise. The whole job at paper size comes with its peak memory, and
beside each stage what moving its bytes takes at the bandwidth of the memory, measured in the same
run. Other programs, many robots and small hard problems have scripts of their own beside this.
"""

from __future__ import annotations

import argparse
import functools
import os
import platform
import sys
import tempfile
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

from sdpid.estimation.problem import Problem, build_problem
from sdpid.experiment.plant.simulate import simulate, true_parameters
from sdpid.experiment.processing.process import process
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.trajectory.paper import paper_excitation
from sdpid.robot.model.load import load_robot
from tests.benchmarks import (
    chain,
    compression_proof,
    from_log,
    kernels,
    resolves,
    solvers,
    whole_job,
)
from tests.benchmarks.timing import Row, table

ROBOT = "denso_vp6242"
PERIODS, PERIOD, SEED = 8, 38.0, 0

# Fewer have no spread worth printing.
LEAST_REPEATS = 5

PARTS = ("import", "processing", "kernels", "compression", "solvers", "resolves", "log", "job")


@functools.cache
def experiment() -> tuple[Recording, Problem]:
    """Return a record of the simulated Denso, and its problem."""
    robot = load_robot(ROBOT)
    trajectory = paper_excitation(ROBOT, SEED, periods=PERIODS, period=PERIOD)
    log = simulate(robot, trajectory, theta=true_parameters(ROBOT), seed=SEED, progress=False)
    problem = build_problem(robot, process(log, progress=False))
    print(
        f"{ROBOT}: {log.n_samples} samples of {2 * log.n} channels, "
        f"{problem.samples.n_samples} after processing, {problem.n_rows} rows, "
        f"{problem.n_theta} parameters"
    )
    return log, problem


def measured(part: str, repeats: int, log: Path | None) -> Iterator[Row]:
    """Yield the rows of a part."""
    if part == "import":
        yield from chain.importing(repeats)
    elif part == "processing":
        yield from chain.processing(experiment()[0], repeats)
    elif part == "kernels":
        yield from kernels.measure(repeats)
    elif part == "compression":
        yield from compression_proof.proofs(repeats)
    elif part == "solvers":
        yield from solvers.measure(experiment()[1], repeats)
    elif part == "resolves":
        yield from resolves.measure(experiment()[1], repeats)
    elif part == "log":
        yield from from_log.measure(repeats)
    else:
        with tempfile.TemporaryDirectory() as folder:
            file = log or Path(folder) / "paper.parquet"
            if log is None:
                whole_job.make_log(file)
            found = whole_job.Measured(file, repeats)
        whole_job.show(found, "paper size")
        yield from whole_job.rows_of(found)


def main() -> int:
    """Run everything and print the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description="Measure.")
    parser.add_argument("--only", choices=PARTS, action="append", help="a part (default all)")
    parser.add_argument("--repeat", type=int, default=LEAST_REPEATS, help="at least 5 (default)")
    parser.add_argument("--log", type=Path, help="paper-size log, from `sdpid simulate`")
    parser.add_argument("--csv", type=Path, help="write the table here as well")
    parser.add_argument("--out", type=Path, help="a folder for a table of each part")
    options = parser.parse_args()
    repeats: int = options.repeat
    if repeats < LEAST_REPEATS:
        parser.error(f"--repeat: is {repeats}; at least {LEAST_REPEATS} give a spread.")
    libraries = ("numpy", "scipy", "pin", "clarabel", "numba")
    used = ", ".join(f"{name} {version(name)}" for name in libraries)
    threads = os.environ.get("OPENBLAS_NUM_THREADS", "?")
    print(f"Python {platform.python_version()} on {platform.machine()}, {used}")
    print(
        f"{os.cpu_count()} cores, OpenBLAS threads {threads}, {repeats} repeats "
        f"({solvers.SLOW_REPEATS} of what takes over {solvers.SLOW:g} s)"
    )
    rows: list[Row] = []
    for part in options.only or PARTS:
        print(part, file=sys.stderr, flush=True)
        found = list(measured(part, repeats, options.log))
        rows += found
        if options.out is not None:
            options.out.mkdir(parents=True, exist_ok=True)
            table(found).write(options.out / f"{part}.csv")
    result = table(rows)
    print(f"\n{result.text(digits=3)}")
    if options.csv is not None:
        result.write(options.csv)
    return 0


if __name__ == "__main__":
    sys.exit(main())
