"""How far a compressed cost can be from the cost of its rows, as proven over all parameters.

Every record of docs/evidence/data.md with default settings, and the simulated case study under all
weightings. `relative` and `absolute` are the two numbers of a certificate's `compression`; `gap` is
that of the certificate, with them, and `compressed_gap` without.

    python examples/studies/compression.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from data_sets import ROBOTS, SETS

import sdpid
from sdpid._common.tables import Table
from sdpid.assurance.certificate.compression import prove_compression
from sdpid.estimation.compression.covariance import WEIGHTINGS
from sdpid.estimation.duality.bound import relative_gap
from sdpid.estimation.problem import Problem
from sdpid.experiment.plant.simulate import simulate, true_parameters
from sdpid.workflow.formulate import formulate

ROBOT, QUICK = "denso_vp6242", ("panda_unisa",)

# Of the paper, with a tenth of its length; its margin on the second moments.
PERIODS, PERIOD, MARGIN = 12, 38.0, 0.005

HEADER = ("log", "rows", "cost", "relative", "absolute", "gap", "compressed_gap")


def problems(data: Path | None, sets: tuple[str, ...]) -> Iterator[tuple[str, Problem]]:
    """Yield the problems by name."""
    robot, theta = sdpid.load_robot(ROBOT), true_parameters(ROBOT)
    trajectory = sdpid.paper_excitation(ROBOT, 0, periods=PERIODS, period=PERIOD)
    log = simulate(robot, trajectory, theta=theta, seed=0, progress=False)
    samples = sdpid.process(log, sdpid.Processing.paper(), progress=False)
    for weighting in WEIGHTINGS:
        constraints = sdpid.Constraints(margin=MARGIN)
        yield (
            f"Denso, {weighting}",
            sdpid.build_problem(robot, samples, weighting=weighting, constraints=constraints),
        )
    for name in sets:
        if data is None or not (data / name).is_dir():
            where = "SDPID_DATA is not set" if data is None else f"not in {data}"
            print(
                f"{name}: skipped, {where}; docs/evidence/data.md says where it comes from",
                flush=True,
            )
            continue
        for record in SETS[name].records:
            log = sdpid.read_recording(data / name / f"{record}.npz")
            arm = sdpid.load_robot(data / name / SETS[name].urdf)
            yield f"{ROBOTS[name]}, {record}", formulate(arm, log)


def row(name: str, problem: Problem) -> tuple[object, ...]:
    """Return the numbers of one problem."""
    certificate = sdpid.certify(sdpid.solve_sdp(problem))
    found = prove_compression(problem)
    if found is None:
        raise SystemExit(f"{name}: the compression is not proven.")
    estimate, bound = certificate.estimate, certificate.bound
    return (
        name,
        problem.n_rows,
        problem.cost(estimate.base),
        found.relative,
        found.absolute,
        certificate.gap,
        relative_gap(problem, estimate.cost, bound.value),
    )


def main() -> int:
    """Print the table and write it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=os.environ.get("SDPID_DATA"))
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--quick", action="store_true", help="the case study and one real log")
    options = parser.parse_args()
    found = []
    for name, problem in problems(options.data, QUICK if options.quick else tuple(SETS)):
        found.append(row(name, problem))
        print(Table(HEADER, (found[-1],)).text(3).splitlines()[1], flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    table = Table(HEADER, tuple(found))
    table.write(options.out / "compression.csv")
    print(f"\n{table.text(3)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
