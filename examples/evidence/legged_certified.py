"""Results of robots on legs, of 13 to 44 links, proven from the log on.

Quadrupeds and humanoids in MuJoCo, their links 15 % off the description, identified with and
without a prior. Each result is saved and checked from its log as `sdpid verify --data` does.

* ``legged_certified.csv``: consistency, gap and times.

    python examples/evidence/legged_certified.py --out results
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator

import numpy as np
from study import Study

import sdpid
from sdpid.experiment.plant.legged.truth import DryFriction
from sdpid.robot.legs import Legs, find_legs

# Each robot and the motions that are identified from together.
ROBOTS = {
    "solo12": ("stand", "trot", "hang"),
    "go1": ("stand", "trot", "hang"),
    "a1": ("stand", "trot", "hang"),
    "talos_reduced": ("stand", "step", "hang"),
    "g1_29dof_with_hand_rev_1_0": ("stand", "step", "hang"),
}
# What the description of a G1 does not say: where its soles are (here at the ankles' axes), and
# how it stands, its hips having pitch, roll and yaw in this order.
FEET = {"g1_29dof_with_hand_rev_1_0": ("left_ankle_roll_link", "right_ankle_roll_link")}
BENT = {"hip_pitch": -0.4, "hip_roll": 0.0, "hip_yaw": 0.0, "knee": 0.8, "ankle_pitch": -0.4}
FRICTION = (sdpid.friction.Coulomb(width=DryFriction().width), "viscous", "rotor_inertia")
COLUMNS = (
    "robot", "links", "joints", "base_parameters", "prior", "samples", "rows",
    "consistent", "least_margin", "gap", "certified", "from_log",
    "identify_cpu_s", "certify_cpu_s", "verify_cpu_s", "from_log_cpu_s",
)  # fmt: skip


def legs_of(robot: sdpid.RobotModel) -> Legs:
    """Return the legs of a robot, by the names of its links or as stated above."""
    feet = FEET.get(robot.name)
    if feet is None:
        return find_legs(robot)
    lower, upper = robot.position_limits[robot.n_base :].T
    inside = np.minimum(0.25, (upper - lower) / 4.0)
    angles = np.clip(0.0, lower + inside, upper - inside)
    for joint, name in enumerate(robot.joint_names[robot.n_base :]):
        for part, angle in BENT.items():
            if f"_{part}_" in name:
                angles[joint] = angle
    return find_legs(robot, feet=feet, standing=angles)


def rows(name: str, seconds: float, priors: tuple[bool, ...]) -> Iterator[tuple[object, ...]]:
    """Yield the rows of one robot."""
    robot = sdpid.load_robot(name, root="free_flyer")
    legs = legs_of(robot)
    logs = [
        sdpid.simulate_legged(robot, motion, duration=seconds, seed=i, legs=legs).recording
        for i, motion in enumerate(ROBOTS[name])
    ]
    for prior in priors:
        times = [time.process_time()]
        result = sdpid.identify(
            robot,
            logs,
            friction=FRICTION,
            effects="none",
            intervals=False,
            prior=None if prior else False,
        )
        times.append(time.process_time())
        certificate = sdpid.certify(result.estimate)
        passed = certificate.passed
        times.append(time.process_time())
        with tempfile.TemporaryDirectory() as folder:
            result.save(folder, figures=False)
            written = time.process_time()
            alone = sdpid.verify(folder)
            times.append(times[-1] + time.process_time() - written)
            written = time.process_time()
            whole = sdpid.verify(folder, data=logs)
            times.append(times[-1] + time.process_time() - written)
        for problem in (*alone.problems, *whole.problems):
            print(problem, flush=True)
        margins = certificate.margins or ()
        problem = result.problem
        yield (
            name,
            robot.n_links,
            robot.n - robot.n_base,
            problem.base.count,
            "one nat" if prior else "none",
            problem.n_samples,
            problem.n_rows,
            certificate.feasible,
            min((each for each in margins if each is not None), default=None),
            certificate.gap,
            passed and alone.passed,
            whole.passed,
            *np.diff(times).tolist(),
        )


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
    study.rows(
        "legged_certified.csv",
        COLUMNS,
        study.robots,
        lambda name: rows(name, study.seconds, priors),
    )


if __name__ == "__main__":
    main()
