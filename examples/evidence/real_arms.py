"""Compare what five real arms are simulated with: which estimate is a robot.

Five public records (docs/evidence/data.md), each fitted by least squares, by ridge regression
towards the description, and by `sdpid.identify` with its defaults. Of each: the least eigenvalue
of the mass matrix on the recorded motion, errors on what was held out, and how long the arm can be
simulated once it is let go of.

    python examples/evidence/real_arms.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import arm_pictures
from arms import METHODS, Arm, read_arm
from data_sets import QUICK, SETS, Records, records_of
from joblib import Parallel, delayed
from release import Fall, release
from study import Study

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


def _compared(records: Records, duration: float) -> tuple[Arm, dict[str, Fall]]:
    """Return an arm with its estimates, and its motion after the release with each."""
    arm = read_arm(records)
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
    """Compare the arms whose records are there; write tables, pictures and animation."""
    study = Study(
        __doc__,
        data=True,
        quick={"sets": [*QUICK], "duration": QUICK_DURATION},
        sets=[*SETS],
        duration=(DURATION, "of the fall, s"),
    )
    there = records_of(study.data, study.sets)
    done = Parallel(n_jobs=-1)(delayed(_compared)(each, study.duration) for each in there)
    arms = [arm for arm, _ in done]
    falls = {(arm.name, method): fall for arm, found in done for method, fall in found.items()}
    study.write("real_arms.csv", COLUMNS, (row for arm, own in done for row in _rows(arm, own)))
    missed = {arm.name: arm.missed for arm in arms}
    models = [*dict.fromkeys(model for each in missed.values() for model in each)]
    shares = ([name, *(100.0 * each[m] for m in models)] for name, each in missed.items())
    study.write("missed.csv", ("arm", *models), shares)
    if arms:
        arm_pictures.bars(arms, study.out / "front_bars.png")
        arm_pictures.summary(arms, falls, study.out / "real_arms.png")
        arm_pictures.animation(arms, falls, study.out / "released.gif")


if __name__ == "__main__":
    main()
