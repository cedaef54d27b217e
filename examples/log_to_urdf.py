"""From a log to a URDF: record a motion, identify the robot, read the verdict, save the results.

The recordings are simulated here; with a robot of your own, only the last lines are needed:

    result = sdpid.identify("arm.urdf", "run.csv", validation="another_run.csv")

    python examples/log_to_urdf.py --out results
"""

import argparse
from pathlib import Path

import numpy as np

import sdpid

ROBOT = "denso_vp6242"
TRUTH = Path(__file__).resolve().parents[1] / "models" / ROBOT / "true_parameters.csv"


def main() -> None:
    """Simulate two recordings, identify from one, predict the other."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--quick", action="store_true", help="shorter recordings")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)

    robot = sdpid.load_robot(ROBOT)
    theta = np.loadtxt(TRUTH, delimiter=",", skiprows=1, usecols=2)
    size = {"periods": 4, "period": 19.0 if options.quick else 76.0}
    for seed, name in ((0, "run.parquet"), (1, "another_run.parquet")):
        motion = sdpid.paper_excitation(ROBOT, seed, **size)
        sdpid.simulate(robot, motion, theta=theta, seed=seed).to_parquet(options.out / name)

    result = sdpid.identify(
        robot, options.out / "run.parquet", validation=options.out / "another_run.parquet"
    )
    print(result.summary(), *result.verdict, sep="\n")
    for file in result.save(options.out):
        print(file)


if __name__ == "__main__":
    main()
