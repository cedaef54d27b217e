"""Count how often estimates of one robot agree, and those of a changed robot differ.

Pairs of logs of a simulated UR5, 100 s each, each with its own motion and noise, are
identified and compared (`Estimate.compare_to`): of the same robot, and with one link heavier.

    python examples/studies/agreement.py --pairs 40 --out results
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import sdpid
from sdpid._common.progress import progress
from sdpid._common.tables import Table
from sdpid.estimation.estimate import Estimate
from sdpid.experiment.plant.simulate import default_parameters
from sdpid.workflow.formulate import formulate

ROBOT = "ur5_robot"

# The forearm, and by what share its ten parameters grow.
LINK, HEAVIER = 3, 0.2


def main() -> None:
    """Count and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="number of the first pair's seeds")
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--quick", action="store_true", help="one pair only")
    options = parser.parse_args()
    pairs = 1 if options.quick else options.pairs
    options.out.mkdir(parents=True, exist_ok=True)
    robot = sdpid.load_robot(ROBOT)
    theta = default_parameters(robot)
    changed = np.array(theta)
    changed[10 * LINK : 10 * LINK + 10] *= 1.0 + HEAVIER

    def estimate(seed: int, parameters: np.ndarray) -> Estimate:
        # The seed draws the motion, too.
        log = sdpid.simulate(robot, theta=parameters, seed=seed, progress=False)
        return sdpid.solve_sdp(formulate(robot, log))

    found: dict[str, list] = {"same robot": [], f"link {LINK + 1} +{100 * HEAVIER:g} %": []}
    with progress(pairs, "pairs") as advance:
        for pair in range(options.first, options.first + pairs):
            first = estimate(2 * pair, theta)
            for case, parameters in zip(found, (theta, changed), strict=True):
                found[case].append(first.compare_to(estimate(2 * pair + 1, parameters)))
            advance(1)
    rows = []
    for case, results in found.items():
        tested = sum(d.agree is not None for r in results for d in r.differences)
        outside = sum(len(r.outside) for r in results)
        differ = np.mean([not r.agree for r in results])
        rows.append(
            (case, len(results), f"{100 * differ:.0f} %", f"{100 * outside / tested:.1f} %")
        )
    table = Table(("case", "pairs", "joint test differs", "single parameters differ"), tuple(rows))
    print(table.text())
    table.write(options.out / "agreement.csv")


if __name__ == "__main__":
    main()
