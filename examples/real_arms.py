"""Compare what five real arms are simulated with: which estimate is a robot.

Five public records (docs/evidence/data.md), each fitted by least squares, by ridge regression
towards the
description, and by `sdpid.identify` with its defaults. Of each: the least eigenvalue of the mass
matrix on the recorded motion, errors on what was held out, and how long the arm can be simulated
once it is let go of.

    python examples/real_arms.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import pandas as pd
from case_study import arm_pictures
from case_study.arms import ARMS, METHODS, Arm, read_arm
from case_study.release import Fall, release
from joblib import Parallel, delayed

DATA = Path(os.environ.get("SDPID_DATA", "../shared/data"))

COLUMNS = (
    "arm",
    "method",
    "eigenvalue_min",
    "eigenvalue_max",
    "any_posture",
    "proven_bound",
    "driving_joints",
    "held_out_percent",
    "diverged_s",
    "fastest_rad_s",
    "strength_nats",
    "gap",
)

# Seconds after the release.
DURATION, QUICK_DURATION = 1.0, 0.3


def run(out: Path, data: Path = DATA, *, quick: bool = False) -> pd.DataFrame:
    """Compare the arms whose records are there; write table, picture and animation."""
    out.mkdir(parents=True, exist_ok=True)
    names = ("Panda",) if quick else tuple(ARMS)
    there = [name for name in names if (data / ARMS[name][0]).is_dir()]
    for name in sorted(set(names) - set(there)):
        where = data / ARMS[name][0]
        print(
            f"{name}: left out, {where} is not there; docs/evidence/data.md says where it comes "
            "from"
        )
    duration = QUICK_DURATION if quick else DURATION
    done = Parallel(n_jobs=-1)(delayed(_compared)(data, name, duration) for name in there)
    arms = [arm for arm, _ in done]
    falls = {(arm.name, method): fall for arm, found in done for method, fall in found.items()}
    table = pd.DataFrame([row for arm, found in done for row in _rows(arm, found)], columns=COLUMNS)
    table.to_csv(out / "real_arms.csv", index=False)
    if arms:
        print(f"\nReal arms\n{table.to_string(index=False, float_format='{:.3g}'.format)}")
        missed = {arm.name: arm.missed for arm in arms}
        of_arms = 100.0 * pd.DataFrame.from_dict(missed, orient="index")
        of_arms.to_csv(out / "missed.csv", index_label="arm")
        arm_pictures.bars(arms, out / "front_bars.png")
        arm_pictures.summary(arms, falls, out / "real_arms.png")
        arm_pictures.animation(arms, falls, out / "released.gif")
    return table


def _compared(data: Path, name: str, duration: float) -> tuple[Arm, dict[str, Fall]]:
    """Return an arm with its estimates, and its motion after the release with each."""
    arm = read_arm(data, name)
    start = arm.log.position[0]
    falls = {method: release(arm.model(method), start, duration) for method in METHODS}
    arm.smallest  # noqa: B018 - looked for here, arm beside arm
    return arm, falls


def _rows(arm: Arm, falls: dict[str, Fall]) -> list[tuple[object, ...]]:
    """Return a row of the table for each method."""
    rows = []
    for method, values in arm.eigenvalues.items():
        fall, smallest = falls[method], arm.smallest[method]
        rows.append(
            (
                arm.name,
                method,
                float(values.min()),
                float(values.max()),
                smallest.value,
                smallest.lower_bound,
                arm.driving[method],
                100.0 * arm.held_out[method],
                fall.diverged,
                None if fall.diverged is not None else float(fall.speed.max()),
                float(arm.strength) if method == "ridge, cross-validated" else None,
                arm.result.certificate.gap if method == "this package" else None,
            )
        )
    return rows


def main() -> None:
    """Run the comparison."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"), help="folder for the results")
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the public records")
    parser.add_argument("--quick", action="store_true", help="one arm, a short fall")
    options = parser.parse_args()
    begin = time.perf_counter()
    run(options.out, options.data, quick=options.quick)
    print(f"{time.perf_counter() - begin:.0f} s: {options.out}")


if __name__ == "__main__":
    main()
