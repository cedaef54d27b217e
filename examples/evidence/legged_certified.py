"""Results of robots on legs, of 13 to 44 links, proven from the log on.

Quadrupeds and humanoids in MuJoCo, their links 15 % off the description, identified with and
without a prior. Each result is saved and checked from its log as `sdpid verify --data` does.

* ``legged_certified.csv``: consistency, gap and times.

    python examples/evidence/legged_certified.py --out results
"""

from __future__ import annotations

import tempfile
import time
from functools import partial

import numpy as np
from legged import ROBOTS as EVERY
from study import Rows, Study

import sdpid
from sdpid.experiment.plant.legged.truth import DryFriction
from sdpid.robot.legs import Legs, find_legs

G1 = "g1_29dof_with_hand_rev_1_0"
# Each robot and the motions that are identified from together.
ROBOTS = {**EVERY, G1: EVERY["talos_reduced"]}
# What the description of a G1 does not say: where its soles are (here at the ankles' axes), and
# how it stands, its hips having pitch, roll and yaw in this order.
FEET = ("left_ankle_roll_link", "right_ankle_roll_link")
BENT = {"hip_pitch": -0.4, "hip_roll": 0.0, "hip_yaw": 0.0, "knee": 0.8, "ankle_pitch": -0.4}
FRICTION = (sdpid.friction.Coulomb(width=DryFriction().width), "viscous", "rotor_inertia")
COLUMNS = (
    *("robot", "links", "prior", "rows", "least_margin", "gap", "certified", "from_log"),
    *("identify_cpu_s", "certify_cpu_s", "from_log_cpu_s"),
)


def legs_of(robot: sdpid.RobotModel) -> Legs:
    """Return the legs of a robot, by the names of its links or as stated above."""
    if robot.name != G1:
        return find_legs(robot)
    lower, upper = robot.position_limits[robot.n_base :].T
    inside = np.minimum(0.25, (upper - lower) / 4.0)
    angles = np.clip(0.0, lower + inside, upper - inside)
    for joint, name in enumerate(robot.joint_names[robot.n_base :]):
        for part, angle in BENT.items():
            if f"_{part}_" in name:
                angles[joint] = angle
    return find_legs(robot, feet=FEET, standing=angles)


def rows(seconds: float, priors: tuple[bool, ...], name: str) -> Rows:
    """Yield the rows of one robot."""
    robot = sdpid.load_robot(name, root="free_flyer")
    legs = legs_of(robot)
    logs = [
        sdpid.simulate_legged(robot, motion, duration=seconds, seed=i, legs=legs).recording
        for i, motion in enumerate(ROBOTS[name])
    ]
    known = {"friction": FRICTION, "effects": "none", "intervals": False}
    for prior in priors:
        times = [time.process_time()]
        result = sdpid.identify(robot, logs, prior=None if prior else False, **known)
        times.append(time.process_time())
        certificate = sdpid.certify(result.estimate)
        passed = certificate.passed
        times.append(time.process_time())
        with tempfile.TemporaryDirectory() as folder:
            result.save(folder, figures=False)
            alone = sdpid.verify(folder)
            start = time.process_time()
            whole = sdpid.verify(folder, data=logs)
            verified = time.process_time() - start
        for problem in (*alone.problems, *whole.problems):
            print(problem, flush=True)
        margins = [each for each in certificate.margins or () if each is not None]
        said = "one nat" if prior else "none", result.problem.n_rows, min(margins, default=None)
        proofs = certificate.gap, passed and alone.passed, whole.passed
        yield name, robot.n_links, *said, *proofs, *np.diff(times), verified


def main() -> None:
    """Write the table."""
    study = Study(
        __doc__,
        quick={"robots": ["solo12"], "seconds": 1.0, "with_prior": True},
        seconds=(2.0, "of each motion"),
        robots=[*ROBOTS],
        with_prior=(False, "with a prior alone"),
    )
    priors = (True,) if study.with_prior else (True, False)
    rows_of = partial(rows, study.seconds, priors)
    study.rows("legged_certified.csv", COLUMNS, rows_of, study.robots)


if __name__ == "__main__":
    main()
