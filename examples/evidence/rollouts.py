"""Six real arms simulated under measured efforts, beside the measured motion.

Every set is trained as in held_out.py, on one run or on the first 60 % of its only record, and the
rest is simulated in open loop: all joints free, and one joint free at a time. Beside the estimate
stand the description as it is and with friction fitted, least squares, what keeps its velocity or
stands still, and what noise alone does. A second table has the drift of each joint under its own
effort error beside how it moves, a third what bounds a joint that is too light.

    python examples/evidence/rollouts.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from data_sets import EVERY, part
from held_out import QUICK, Case, first_of_arms
from study import Rows, Study

import sdpid
from sdpid.assurance.diagnostics.light_joints import light_joints
from sdpid.experiment.processing.choose import default_processing

HORIZONS = (0.1, 0.5, 2.0)

# Of records with several runs to predict, the one that is simulated.
PREDICTED = {"UR10e": "8 harmonics"}

# Starts of a record, at most, and the least time between them, s.
STARTS, APART = 20, 0.25

# What may bound a joint that is too light.
BOUNDS: dict[str, dict[str, object]] = {
    "default": {},
    "rotor inertia asked for": {"effects": ("rotor_inertia",)},
    "Prior(strength=10)": {"prior": sdpid.Prior(strength=10.0)},
    "Prior(strength=100)": {"prior": sdpid.Prior(strength=100.0)},
}
LIGHT = "LWR 4+"
WRIST = -1

HEADER = (
    *("arm", "free", "model", "starts"),
    *(f"{kind} {horizon:g} s" for horizon in HORIZONS for kind in ("median", "ran away")),
)
JOINTS = (
    "arm", "joint", "inertia", "effort error", "inertial effort", "drift over motion",
    "median 0.1 s", "median 0.5 s", "motion 0.1 s",
)  # fmt: skip
LIGHTS = ("model", "inertia", "held out", "median 0.1 s", "median 0.5 s")


def chosen(case: Case) -> sdpid.Recording:
    """Return the recording that is simulated: what was not trained on."""
    log = case.others.get(PREDICTED.get(case.robot_name, ""), next(iter(case.others.values())))
    if case.after is None:
        return log
    first = int(np.searchsorted(log.time, case.after, side="right"))
    return part(log, first, log.n_samples)


def spacing(case: Case, count: int) -> float:
    """Return the time between starts, s."""
    return max(APART, (chosen(case).duration - HORIZONS[-1]) / count)


def models(starts: int, case: Case) -> Rows:
    """Yield rows of models of each way to free the joints."""
    result = case.identify()
    for free in ("all", "each"):
        moved = rolled(case, result, starts, free=free)
        for name, errors in moved.models.items():
            cells = np.full((len(HORIZONS), 2), np.nan)
            medians = errors.quantile(0.5)
            cells[: len(medians)] = np.column_stack([1e3 * medians, 100.0 * errors.diverged])
            yield case.robot_name, free, name, len(moved.start), *cells.ravel()


def rolled(
    case: Case,
    result: Any,
    starts: int,
    horizons: tuple[float, ...] = HORIZONS,
    **how: Any,
) -> sdpid.Rollout:
    """Return the recording that was not trained on, simulated."""
    return sdpid.rollout(
        result.estimate,
        chosen(case),
        start_every=spacing(case, starts),
        # The processing of the training part.
        processing=default_processing(case.log),
        horizons=horizons,
        **how,
    )


def joints(starts: int, case: Case) -> Rows:
    """Yield a row a joint: its drift, and how it moves alone."""
    result = case.identify()
    moved = rolled(case, result, starts, free="each")
    medians = 1e3 * moved.models[moved.own].joints()
    errors = sdpid.validate(result.estimate).moving
    samples = result.problem.samples
    for each in light_joints(result.estimate.model(), samples, errors, limit=0.0):
        j = case.robot.joint_names.index(each.joint)
        needed, motion = each.inertia * each.acceleration, 1e2 * each.velocity
        sizes = each.inertia, each.error, needed, each.ratio
        yield case.robot_name, j + 1, *sizes, *medians[:2, j], motion


def bounded(starts: int, case: Case) -> Rows:
    """Yield what bounds a light wrist: its inertia, held-out error and motion."""
    wrist = case.robot.joint_names[WRIST]
    for name, options in BOUNDS.items():
        result = case.identify(**options)
        moved = rolled(case, result, starts, HORIZONS[:2], free=wrist, baselines=False)
        samples = sdpid.process(chosen(case), default_processing(case.log))
        fresh = 100.0 * sdpid.validate(result.estimate, samples).moving.relative
        samples = result.problem.samples
        position = samples.position[:: max(1, samples.n_samples // 50)]
        inertia = np.median(result.estimate.model().mass_matrix(position)[:, WRIST, WRIST])
        yield name, inertia, fresh, *(1e3 * moved.median)


def main() -> None:
    """Run every case and write the tables."""
    study = Study(
        __doc__,
        data=True,
        quick={"sets": [*QUICK], "starts": 2},
        sets=[*EVERY],
        starts=(STARTS, "of a record, at most"),
    )
    # Without terms that are known of a drive, and joint torques.
    arms = first_of_arms(study.data, study.sets, known_drives=False)
    light = [case for name, case in arms.items() if name == LIGHT]
    for file, header, rows_of, wanted in (
        ("rollouts.csv", HEADER, models, arms.values()),
        ("joints.csv", JOINTS, joints, arms.values()),
        ("bounds.csv", LIGHTS, bounded, light),
    ):
        study.rows(file, header, partial(rows_of, study.starts), wanted)


if __name__ == "__main__":
    main()
