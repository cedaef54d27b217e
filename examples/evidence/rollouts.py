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

import argparse
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from held_out import QUICK, TITLES, Case, cases

import sdpid
from sdpid._common.tables import Table
from sdpid.assurance.diagnostics.light_joints import light_joints
from sdpid.assurance.diagnostics.validation import validate
from sdpid.workflow.result import Identification

HORIZONS = (0.1, 0.5, 2.0)

# Of records with several runs to predict, the one that is simulated.
PREDICTED = {"UR10e": "8 harmonics"}

# Starts of a record, at most, and the least time between them, s.
STARTS, EVERY = 20, 0.25

# What may bound a joint that is too light.
BOUNDS: dict[str, dict[str, object]] = {
    "default": {},
    "rotor inertia asked for": {"effects": ("rotor_inertia",)},
    "Prior(strength=10)": {"prior": sdpid.Prior(strength=10.0)},
    "Prior(strength=100)": {"prior": sdpid.Prior(strength=100.0)},
}
LIGHT = "LWR 4+"
WRIST = -1

HEADER = ("arm", "free", "model", "starts", *(
    f"{kind} {horizon:g} s"
    for horizon in HORIZONS
    for kind in ("median", "p90", "tip", "ran away")
))  # fmt: skip
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
    from data_sets import part

    first = int(np.searchsorted(log.time, case.after, side="right"))
    return part(log, first, log.n_samples)


def spacing(case: Case, count: int) -> float:
    """Return the time between starts, s."""
    return max(EVERY, (chosen(case).duration - HORIZONS[-1]) / count)


def identified(case: Case, **options: object) -> Identification:
    """Return what identify finds with its defaults, and the drive's terms where they are known."""
    return sdpid.identify(case.robot, case.log, intervals=False, **case.arguments(options))  # type: ignore[arg-type]


def simulated(
    case: Case, result: Identification, every: float
) -> Iterator[tuple[tuple[object, ...], list[tuple[object, ...]]]]:
    """Yield rows of models, and of joints, of each way to free the joints."""
    log = chosen(case)
    for free in ("all", "each"):
        moved = sdpid.rollout(
            result.estimate, log, HORIZONS, free=free, start_every=every, processing=how(case)
        )
        for name, errors in moved.models.items():
            cells: list[object] = [case.robot_name, free, name, len(moved.start)]
            columns = errors.quantile(0.5), errors.quantile(0.9), errors.tips(), errors.diverged
            found = list(zip(*(each.tolist() for each in columns), strict=True))
            for k in range(len(HORIZONS)):
                if k < len(found):
                    middle, high, tip, gone = found[k]
                    cells += [1e3 * middle, 1e3 * high, 1e3 * tip, 100.0 * gone]
                else:
                    cells += [None] * 4
            joints: list[tuple[object, ...]] = []
            if free == "each" and name == moved.own:
                joints = list(of_joints(case, result, log, errors.joints()))
            yield tuple(cells), joints


def how(case: Case) -> sdpid.Processing:
    """Return the processing of the training part."""
    from sdpid.experiment.processing.choose import default_processing

    return default_processing(case.log)


def of_joints(
    case: Case, result: Identification, log: sdpid.Recording, medians: np.ndarray
) -> Iterator[tuple[object, ...]]:
    """Yield a row a joint: its drift, and how it moves alone."""
    samples = result.problem.samples
    errors = validate(result.estimate).moving
    every = light_joints(result.estimate.model(), samples, errors, limit=0.0)
    for each in every:
        j = case.robot.joint_names.index(each.joint)
        yield (
            case.robot_name,
            j + 1,
            each.inertia,
            each.error,
            each.inertia * each.acceleration,
            each.ratio,
            1e3 * float(medians[0, j]),
            1e3 * float(medians[1, j]),
            1e2 * each.velocity,
        )


def bounded(case: Case, every: float) -> Iterator[tuple[object, ...]]:
    """Yield what bounds a light wrist: its inertia, held-out error and motion."""
    log = chosen(case)
    wrist = case.robot.joint_names[WRIST]
    for name, options in BOUNDS.items():
        result = identified(case, **options)
        samples = result.problem.samples
        moved = sdpid.rollout(
            result.estimate,
            log,
            HORIZONS[:2],
            free=wrist,
            start_every=every,
            processing=how(case),
            baselines=False,
        )
        fresh = sdpid.validate(result.estimate, sdpid.process(log, how(case)))
        position = samples.position[:: max(1, samples.n_samples // 50)]
        inertia = np.median(result.estimate.model().mass_matrix(position)[:, WRIST, WRIST])
        medians = 1e3 * moved.median
        yield name, float(inertia), 100.0 * fresh.moving.relative, *medians.tolist()


def main() -> int:
    """Run every case and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--data", type=Path, default=os.environ.get("SDPID_DATA"))
    parser.add_argument("--set", action="append", choices=tuple(TITLES), help="default all")
    parser.add_argument("--starts", type=int, default=STARTS, help="of a record, at most")
    parser.add_argument("--quick", action="store_true", help="two sets, few starts")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    names = options.set or (QUICK if options.quick else tuple(TITLES))
    count = 2 if options.quick else options.starts
    models: list[tuple[object, ...]] = []
    joints: list[tuple[object, ...]] = []
    lights: list[tuple[object, ...]] = []
    seen: set[str] = set()
    for case in cases(options.data, names):
        # The first case of an arm: without terms that are known of its drive, and joint torques.
        if case.robot_name in seen:
            continue
        seen.add(case.robot_name)
        result = identified(case)
        for cells, own in simulated(case, result, spacing(case, count)):
            models.append(cells)
            joints += own
            print(Table(HEADER, (cells,)).text(3).splitlines()[1], flush=True)
        Table(HEADER, tuple(models)).write(options.out / "rollouts.csv")
        Table(JOINTS, tuple(joints)).write(options.out / "joints.csv")
        if case.robot_name == LIGHT:
            lights = list(bounded(case, spacing(case, count)))
            Table(LIGHTS, tuple(lights)).write(options.out / "bounds.csv")
            print(Table(LIGHTS, tuple(lights)).text(3), flush=True)
    print(Table(JOINTS, tuple(joints)).text(3))
    return 0


if __name__ == "__main__":
    sys.exit(main())
