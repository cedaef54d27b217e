"""How far the rows of real logs are from those of the equations of motion, as bounded.

Every record of docs/evidence/data.md with default settings, and the simulated case study. `box` is
the bound
over every feasible theta beside the root of the cost, `theta` that at the estimate; by the first
the root of a proven bound falls, by the second the root of the estimate's cost rises. What friction
columns are results of processing is named. Times are those of the bound beside compressing the same
rows.

    python examples/studies/row_errors.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from data_sets import ROBOTS, SETS

import sdpid
from sdpid._common.tables import Table
from sdpid.assurance.log_proof.row_error import row_error
from sdpid.estimation.compression.covariance import Weighting
from sdpid.estimation.compression.factor import Factor
from sdpid.estimation.problem import Problem
from sdpid.experiment.plant.simulate import simulate, true_parameters
from sdpid.workflow.formulate import formulate

QUICK = ("panda_unisa",)

HEADER = ("log", "rows", "cost", "box", "theta", "as_computed", "seconds", "compressing_s", "worst")


def problems(
    data: Path | None, sets: tuple[str, ...], quick: bool
) -> Iterator[tuple[str, Problem]]:
    """Yield the problems by name."""
    robot = sdpid.load_robot("denso_vp6242")
    periods, period = (2, 76.0) if quick else (8, None)
    trajectory = sdpid.paper_excitation("denso_vp6242", 0, periods=periods, period=period)
    theta = true_parameters("denso_vp6242")
    log = simulate(robot, trajectory, theta=theta, seed=0, progress=False)
    samples = sdpid.process(log, progress=False)
    weightings: tuple[Weighting, ...] = ("gls",) if quick else ("gls", "eq9", "eq18")
    for weighting in weightings:
        yield f"Denso, {weighting}", sdpid.build_problem(robot, samples, weighting=weighting)
    for name in sets:
        if data is None or not (data / name).is_dir():
            where = "SDPID_DATA is not set" if data is None else f"not in {data}"
            print(
                f"{name}: skipped, {where}; docs/evidence/data.md says where it comes from",
                flush=True,
            )
            continue
        folder, chosen = data / name, SETS[name]
        robot = sdpid.load_robot(folder / chosen.urdf)
        for record in chosen.records:
            log = sdpid.read_recording(folder / f"{record}.npz")
            yield f"{ROBOTS[name]}, {record}", formulate(robot, log)


def row(name: str, problem: Problem) -> tuple[object, ...]:
    """Return the numbers of one problem."""
    rows = problem.require_rows("study")
    start = time.perf_counter()
    Factor.of(rows, problem.weighting)
    compressing = time.perf_counter() - start
    start = time.perf_counter()
    error = row_error(rows, problem.sigma, problem.weighting, problem.feasible)
    seconds = time.perf_counter() - start
    estimate = sdpid.solve_sdp(problem)
    if error is None or estimate.theta is None:
        raise SystemExit(f"{name}: no bound.")
    size = float(np.sqrt(problem.cost(estimate.base)))
    worst = f"{error.worst.joint} {error.worst.parameter} {error.worst.error:.1e}"
    return (
        name,
        problem.n_rows,
        size**2,
        error.total / size,
        error.at(estimate.theta) / size,
        " ".join(error.taken_as_computed),
        seconds,
        compressing,
        worst,
    )


def main() -> None:
    """Print the table and write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=os.environ.get("SDPID_DATA"))
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--quick", action="store_true", help="a short simulated log, one real one")
    arguments = parser.parse_args()
    found = []
    sets = QUICK if arguments.quick else tuple(SETS)
    for name, problem in problems(arguments.data, sets, arguments.quick):
        found.append(row(name, problem))
        print(name, "done", file=sys.stderr)
    table = Table(HEADER, tuple(found))
    arguments.out.mkdir(parents=True, exist_ok=True)
    table.write(arguments.out / "row_errors.csv")
    print(table.text())


if __name__ == "__main__":
    main()
