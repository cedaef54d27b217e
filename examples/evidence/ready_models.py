"""What people use beside what is identified, on motion that no model was fitted to.

Trained as in held_out.py, on one run or on the first 60 % of a record, so the identified models
are not those of `models/`, which are fitted to all rows. Beside them stand the vendor's URDF as it
is and with friction fitted to the same training part, and MuJoCo Menagerie's model as it is. Of
each: the effort missed on the held-out motion; how far the arm leaves it in simulation, let go of
under the measured efforts; and how far from it the controller of docs/start.md keeps a stand-in of
the arm, which is identified from the held-out motion alone. The inertia of a model is also the
stiffness of that controller, so it runs once more with every joint as stiff on average as with the
stand-in's inertia.

    python examples/evidence/ready_models.py --data /path/to/data --menagerie /path/to/checkout
        --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from data_sets import EVERY
from held_out import QUICK, Case, first_of_arms, moving
from rollouts import STARTS, chosen, spacing
from study import Rows, Study

import sdpid
from sdpid._common.arrays import frozen
from sdpid.assurance.diagnostics.described import described_dynamics, predicted_efforts
from sdpid.assurance.diagnostics.held_out import friction_fitted
from sdpid.experiment.processing.choose import default_processing
from sdpid.robot.model.dynamics import RobotDynamics

# Files of Menagerie, whose joints turn as those of the URDF do.
MENAGERIE = {
    "Panda": "franka_emika_panda/panda_nohand.xml",
    "Gen3": "kinova_gen3/gen3.xml",
    "UR10e": "universal_robots_ur10e/ur10e.xml",
}
# Times after the release, s, and the gains of docs/start.md, 1/s² and 1/s.
HORIZONS = (0.1, 0.5)
KP, KD = 100.0, 20.0
# Of the motion at which mass matrices are looked at.
POSTURES = 500

HEADER = (
    *("arm", "model", "missed_percent", "released_100_mrad", "released_500_mrad", "ran_away"),
    *("tracking_deg", "worst_joint_deg", "as_stiff_deg"),
)


def models(
    case: Case, samples: sdpid.Samples, menagerie: Path | None
) -> Iterator[tuple[str, RobotDynamics]]:
    """Yield the models of an arm, what is trained seeing the training part alone."""
    yield "URDF", described_dynamics(case.robot, samples)
    file = MENAGERIE.get(case.robot_name)
    if file and menagerie is not None and (menagerie / file).is_file():
        yield "Menagerie", described_dynamics(sdpid.load_robot(menagerie / file), samples)
    estimate = case.identify().estimate
    fitted = replace(estimate.model(), theta=frozen(friction_fitted(estimate)))
    yield "URDF, friction fitted", fitted
    yield "identified", estimate.model()


def rows(starts: int, menagerie: Path | None, case: Case) -> Rows:
    """Yield a row a model of an arm."""
    log = chosen(case)
    samples = case.held_out(case.common)
    shown = moving(samples)
    given = case.arguments({})
    arm = sdpid.identify(case.robot, log, intervals=False, **given).estimate.model()
    for name, model in models(case, samples, menagerie):
        missed = (samples.effort - predicted_efforts(model, samples))[shown]
        released = sdpid.rollout(
            model,
            replace(log, joint_names=model.robot.joint_names),
            HORIZONS,
            free="all",
            start_every=spacing(case, starts),
            processing=default_processing(case.log),
            baselines=False,
        )
        with np.errstate(divide="ignore"):
            same = stiffness(arm, samples) / stiffness(model, samples)
        own = tracked(arm, model, samples, 1.0)
        yield (
            *(case.robot_name, name),
            100.0 * np.linalg.norm(missed) / np.linalg.norm(samples.effort[shown]),
            *(1e3 * released.median),
            100.0 * released.diverged[-1],
            *(np.median(own), own.max(), np.median(tracked(arm, model, samples, same))),
        )


def stiffness(model: RobotDynamics, samples: sdpid.Samples) -> np.ndarray:
    """Return the mean inertia (n,) of each joint on a motion."""
    q = samples.position[:: max(1, samples.n_samples // POSTURES)]
    return np.asarray(np.einsum("kjj->j", model.mass_matrix(q)) / len(q))


def tracked(
    arm: RobotDynamics,
    model: RobotDynamics,
    samples: sdpid.Samples,
    share: np.ndarray | float,
) -> np.ndarray:
    """Return the errors (n,), degrees rms, of an arm that computed torque moves along the motion.

    NaN if it diverges, or where `share`, which multiplies the gains, is not finite: a joint without
    inertia cannot be as stiff as another.
    """
    none = np.full(samples.effort.shape[1], np.nan)
    gains = np.ones(len(none)) * share
    if not np.all(np.isfinite(gains)):
        return none
    law = sdpid.controllers.ComputedTorque(model, KP * gains, KD * gains)
    assert samples.time is not None
    rate_hz = (samples.n_samples - 1) / (samples.time[-1] - samples.time[0])
    reference = samples.position, samples.velocity, samples.acceleration
    moved = sdpid.simulate_closed_loop(arm, reference, law, rate_hz=rate_hz)
    if len(moved.position) < len(samples.position):
        return none
    missed = np.rad2deg(moved.position - samples.position)
    return np.asarray(np.sqrt(np.mean(missed**2, axis=0)))


def main() -> None:
    """Run every arm and write the table."""
    study = Study(
        __doc__,
        data=True,
        quick={"sets": [*QUICK][:1], "starts": 2},
        sets=[*EVERY],
        starts=(STARTS, "of a record, at most"),
        menagerie=(None, "checkout of MuJoCo Menagerie"),
    )
    menagerie = None if study.menagerie is None else Path(study.menagerie)
    arms = first_of_arms(study.data, study.sets, known_drives=True)
    for name in set(MENAGERIE) & set(arms):
        if menagerie is None or not (menagerie / MENAGERIE[name]).is_file():
            print(f"{name}: without Menagerie's model, not in --menagerie {menagerie}")
    study.rows("models.csv", HEADER, partial(rows, study.starts, menagerie), arms.values())


if __name__ == "__main__":
    main()
