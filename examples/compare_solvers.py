"""Compare local solvers with the global optimum, by their distance from the proven bound.

python examples/compare_solvers.py --out results
"""

import argparse
from pathlib import Path

import numpy as np

import sdpid

ROBOT = "denso_vp6242"
TRUTH = Path(__file__).resolve().parents[1] / "models" / ROBOT / "true_parameters.csv"


def main() -> None:
    """Run the semidefinite program once, and two local solvers from random starts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--starts", type=int, default=8, help="random starts of each local solver")
    parser.add_argument("--seed", type=int, default=0, help="random seed of motion and starts")
    parser.add_argument("--quick", action="store_true", help="a short record and one start")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)

    robot = sdpid.load_robot(ROBOT)
    theta = np.loadtxt(TRUTH, delimiter=",", skiprows=1, usecols=2)
    size = {"periods": 4, "period": 19.0 if options.quick else 76.0}
    motion = sdpid.paper_excitation(ROBOT, options.seed, **size)
    log = sdpid.simulate(robot, motion, theta=theta, seed=options.seed)
    problem = sdpid.build_problem(
        robot, sdpid.process(log), constraints=sdpid.Constraints(margin=0.005)
    )
    starts = 1 if options.quick else options.starts
    comparison = sdpid.compare(problem, starts=starts, seed=options.seed)
    print(comparison.table())
    print(comparison.certificate.summary())
    comparison.to_csv(options.out / "comparison.csv")
    comparison.certificate.to_json(options.out / "certificate.json")
    sdpid.plots.save_figure(comparison.plot(), options.out / "convergence.png")


if __name__ == "__main__":
    main()
