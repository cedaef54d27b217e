"""Measured contact forces: what they bring, by the deviation that is stated of them.

Stand and trot of quadrupeds in MuJoCo as in `legged.py`, with an IMU, or with poses alone, and
force sensors in the feet with noise of 1 % and no bias, friction terms known. Forces are left out,
so that those of closed contacts are eliminated, or used with deviations from near those of the
filtered noise to more than the weight. Errors are those on a walk with the ground's forces known;
*held out* is what the result itself says of blocks of its recordings, forces eliminated.

* ``legged_forces.csv``: a row a robot, kind of base motion and stated deviation.

    python examples/evidence/legged_forces.py --out results
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
from legged import without_imu
from legged_defects import Sensed
from study import Study

from sdpid.estimation.compression.contact_noise import contact_noise
from sdpid.estimation.compression.rows import RowSource

STATED = (None, 0.05, 0.2, 2.0, 20.0, 1000.0)
COLUMNS = (
    "robot", "base_motion", "stated_n", "found_n", "joints_percent", "base_force_n",
    "mass_percent", "held_out_percent",
)  # fmt: skip


def rows(quadruped: Sensed, imu: bool) -> Iterator[tuple[object, ...]]:
    """Yield what every stated deviation gives."""
    logs = [quadruped.runs[motion].recording for motion in ("stand", "trot")]
    logs = logs if imu else [without_imu(log) for log in logs]
    for stated in STATED:
        result = quadruped.identify(logs, processing={"contact_force_std": stated})
        problem = result.problem
        found = None
        if stated is not None and isinstance(problem.rows, RowSource):
            found = stated * np.sqrt(contact_noise(problem.rows.with_force_scale(1.0))[2])
        held_out = result.held_out
        yield (
            quadruped.name, "IMU" if imu else "pose", stated, found,
            *quadruped.judged(result.estimate),
            None if held_out is None else 100.0 * held_out.fit.moving.relative,
        )  # fmt: skip


def main() -> None:
    """Write the table."""
    study = Study(
        __doc__,
        quick={"robots": ["solo12"], "seconds": 2.0},
        seconds=4.0,
        robots=["solo12", "go1"],
    )
    cases = itertools.product(study.robots, (True, False))
    study.rows(
        "legged_forces.csv",
        COLUMNS,
        cases,
        lambda case: rows(Sensed(case[0], 0, study.seconds), case[1]),
    )


if __name__ == "__main__":
    main()
