"""Count how often estimates of one robot agree, and those of a changed robot differ.

Pairs of logs of a simulated UR5, 100 s each, each with its own motion and noise, are
identified and compared (`Estimate.compare_to`): of the same robot, and with one link heavier.

    python examples/evidence/agreement.py --pairs 40 --out results
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from study import Study, grouped

import sdpid
from sdpid.estimation.estimate import Estimate
from sdpid.experiment.plant.simulate import default_parameters
from sdpid.workflow.formulate import formulate

ROBOT = "ur5_robot"

# The forearm, and by what share its ten parameters grow.
LINK, HEAVIER = 3, 0.2
CASES = ("same robot", f"link {LINK + 1} +{100 * HEAVIER:g} %")


def compared(pair: int) -> Iterator[tuple[object, ...]]:
    """Yield whether the estimates of two logs agree, for each of the cases."""
    robot = sdpid.load_robot(ROBOT)
    theta = default_parameters(robot)
    changed = np.array(theta)
    changed[10 * LINK : 10 * LINK + 10] *= 1.0 + HEAVIER

    def estimate(seed: int, parameters: np.ndarray) -> Estimate:
        # The seed draws the motion, too.
        log = sdpid.simulate(robot, theta=parameters, seed=seed, progress=False)
        return sdpid.solve_sdp(formulate(robot, log))

    first = estimate(2 * pair, theta)
    for case, parameters in zip(CASES, (theta, changed), strict=True):
        found = first.compare_to(estimate(2 * pair + 1, parameters))
        tested = sum(each.agree is not None for each in found.differences)
        yield case, not found.agree, tested, len(found.outside)


def main() -> None:
    """Count and write."""
    study = Study(__doc__, quick={"pairs": 1}, pairs=40)
    header = ("case", "differ", "tested", "outside")
    found = study.rows("pairs.csv", header, range(study.pairs), compared)
    rows = []
    for (case,), own in grouped(found, "case"):
        differ, outside = own["differ"].mean(), own["outside"].sum() / own["tested"].sum()
        rows.append((case, len(own["differ"]), f"{100 * differ:.0f} %", f"{100 * outside:.1f} %"))
    header = ("case", "pairs", "joint test differs", "single parameters differ")
    study.write("agreement.csv", header, rows)


if __name__ == "__main__":
    main()
