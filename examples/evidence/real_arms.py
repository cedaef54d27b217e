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
from arms import METHODS, MODELS, Arm, Fall, read_arm, release
from data_sets import QUICK, SETS, Records, records_of
from joblib import Parallel, delayed
from study import Rows, Study

COLUMNS = (
    *("arm", "method", "eigenvalue_min", "eigenvalue_max", "any_posture", "proven_bound"),
    *("driving_joints", "held_out_percent", "diverged_s"),
)


def compared(records: Records, duration: float) -> tuple[Arm, dict[str, Fall]]:
    """Return an arm with its estimates, and its motion after the release with each."""
    arm = read_arm(records)
    start = arm.log.position[0]
    falls = {method: release(arm.model(method), start, duration) for method in METHODS}
    arm.smallest  # noqa: B018 - looked for here, arm beside arm
    return arm, falls


def rows(arm: Arm, falls: dict[str, Fall]) -> Rows:
    """Yield a row of the table for each method."""
    for method, values in arm.eigenvalues.items():
        smallest = arm.smallest[method]
        bounds = values.min(), values.max(), smallest.value, smallest.lower_bound
        held_out = 100.0 * arm.held_out[method]
        yield arm.name, method, *bounds, arm.driving[method], held_out, falls[method].diverged


def main() -> None:
    """Compare the arms whose records are there; write tables, pictures and animation."""
    study = Study(
        __doc__,
        data=True,
        quick={"sets": [*QUICK], "duration": 0.3},
        sets=[*SETS],
        duration=(1.0, "of the fall, s"),
    )
    done = Parallel(n_jobs=-1)(
        delayed(compared)(each, study.duration) for each in records_of(study.data, study.sets)
    )
    study.write("real_arms.csv", COLUMNS, (row for each in done for row in rows(*each)))
    arms = [arm for arm, _ in done]
    shares = ([arm.name, *(100.0 * arm.missed[name] for name in MODELS)] for arm in arms)
    study.write("missed.csv", ("arm", *MODELS), shares)
    if arms:
        falls = {(arm.name, method): fall for arm, found in done for method, fall in found.items()}
        arm_pictures.bars(arms, study.out / "front_bars.png")
        arm_pictures.summary(arms, falls, study.out / "real_arms.png")
        arm_pictures.animation(arms, falls, study.out / "released.gif")


if __name__ == "__main__":
    main()
