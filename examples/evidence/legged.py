"""Robots on legs with known inertias: what stand, trot and hang identify, judged on a walk.

Go1, A1, Solo12 and a humanoid, Talos, which steps in place of the trot, in MuJoCo; their links are
15 % off the description, with friction, rotor inertia and noise. Dry friction has a Stribeck peak
and a smooth sign that differ from seed to seed; the estimate knows this law, or takes what
`identify` chooses by the data. Errors are those of the efforts that the estimate predicts for the
walk as it was, with the forces of the ground known: of the joints in per cent of their rms effort,
of the force on the base in N.

* ``legged.csv``: which motions and sensors show how much; a median and a worst of all seeds.

    python examples/evidence/legged.py --seeds 5 --out results
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import Any, ClassVar

import numpy as np
from study import Study, grouped

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.experiment.plant.legged.sensors import Sensors
from sdpid.experiment.plant.legged.simulate import LeggedRun, simulate_legged
from sdpid.experiment.plant.legged.truth import DryFriction, TrueMotion, changed_parameters

THREE = ("stand", "trot", "hang")
# The motions of each robot; the second is its gait.
ROBOTS = {
    "go1": THREE,
    "a1": THREE,
    "solo12": THREE,
    "talos_reduced": ("stand", "step", "hang"),
}
# Ranges from which each seed draws its law of dry friction: width of the sign and speed of the peak
# in rad/s, and height of the peak over Coulomb friction.
WIDTHS, PEAK_SPEEDS, PEAKS = (0.03, 0.1), (0.1, 0.4), (0.0, 0.5)
# Every so many samples of the walk are predicted.
STRIDE = 10


@dataclass(frozen=True)
class Walker:
    """A robot that differs from its description, and its runs."""

    name: str
    seed: int
    seconds: float

    # None has an IMU, and no sensors of forces.
    sensors: ClassVar[Sensors | None] = None

    @cached_property
    def robot(self) -> sdpid.RobotModel:
        """The description."""
        return sdpid.load_robot(self.name, root="free_flyer")

    @cached_property
    def theta(self) -> Array:
        """True parameters."""
        return changed_parameters(self.robot, seed=self.seed)

    @cached_property
    def law(self) -> DryFriction:
        """Its law of dry friction."""
        rng = np.random.default_rng([2026, self.seed])
        width, speed = (float(np.exp(rng.uniform(*np.log(each)))) for each in (WIDTHS, PEAK_SPEEDS))
        return DryFriction(width=width, peak=float(rng.uniform(*PEAKS)), peak_speed=speed)

    @property
    def friction(self) -> tuple[sdpid.friction.FrictionTerm | str, ...]:
        """The terms of its friction; their sizes are not told."""
        return (*self.law.terms, "viscous", "rotor_inertia")

    def run(self, motion: str) -> LeggedRun:
        """Let it move."""
        order = (*ROBOTS[self.name], "walk").index(motion)
        return simulate_legged(
            self.robot,
            motion,
            theta=self.theta,
            duration=self.seconds,
            seed=10 * self.seed + order,
            sensors=self.sensors,
            friction=self.law,
        )

    @cached_property
    def runs(self) -> dict[str, LeggedRun]:
        """All motions."""
        return {motion: self.run(motion) for motion in (*ROBOTS[self.name], "walk")}

    @cached_property
    def walk(self) -> tuple[TrueMotion, Array]:
        """The walk as it was, some of its samples, and their true efforts without the ground's."""
        whole = self.runs["walk"].motion
        motion = TrueMotion(**{key: value[::STRIDE] for key, value in vars(whole).items()})
        bodies = self.theta[: 10 * self.robot.n_links].reshape(-1, 10)
        return motion, self._efforts(bodies, motion)

    def _efforts(self, bodies: Array, motion: TrueMotion) -> Array:
        """Return the efforts of bodies without the ground's, with the true friction and rotors."""
        efforts = self.robot.inverse_dynamics(
            bodies, motion.position, motion.velocity, motion.acceleration
        )
        rotor = self.theta[10 * self.robot.n_links :].reshape(3, -1)[2]
        efforts[:, 6:] += motion.friction + rotor * motion.acceleration[:, 6:]
        return efforts

    def errors(self, predicted: Array) -> tuple[float, float, float]:
        """Return errors of joints in % of rms effort, of the base in N and N·m."""
        motion, needed = self.walk
        off = predicted - needed
        effort = np.sqrt(np.mean(motion.effort[:, 6:] ** 2))
        return (
            100.0 * float(np.sqrt(np.mean(off[:, 6:] ** 2)) / effort),
            float(np.sqrt(np.mean(np.sum(off[:, :3] ** 2, axis=1)))),
            float(np.sqrt(np.mean(np.sum(off[:, 3:6] ** 2, axis=1)))),
        )

    def predicted(self, problem: Problem, base: Array) -> Array:
        """Return the efforts that base parameters predict for the walk."""
        motion, needed = self.walk
        exact = sdpid.Samples(
            position=motion.position,
            velocity=motion.velocity,
            acceleration=motion.acceleration,
            effort=needed,
            joint_names=problem.robot.joint_names,
        )
        rows = RowSource(problem.robot, problem.friction, problem.base, exact)
        return np.asarray(rows.regressor(slice(None)) @ base)

    @cached_property
    def described(self) -> tuple[float, float, float]:
        """Errors of the description, with the true friction."""
        motion, _ = self.walk
        return self.errors(self._efforts(self.robot.prior, motion))

    def mass_error(self, theta: Array) -> float:
        """Return the error of the total mass in %."""
        links = 10 * self.robot.n_links
        return 100.0 * abs(float(theta[:links:10].sum() / self.theta[:links:10].sum() - 1.0))

    def identify(
        self, logs: Sequence[sdpid.Recording], **options: Any
    ) -> sdpid.workflow.result.Identification:
        """Identify from logs, the terms of friction known unless the options say otherwise."""
        known = {"friction": self.friction, "effects": "none", "intervals": False}
        return sdpid.identify(self.robot, list(logs), **{**known, **options})

    def judged(self, estimate: Estimate) -> tuple[float, float, float]:
        """Return errors of joints in %, of the base in N, and of the mass in %."""
        assert estimate.theta is not None
        joints, force, _ = self.errors(self.predicted(estimate.problem, estimate.base))
        return joints, force, self.mass_error(estimate.theta)


def without_imu(log: sdpid.Recording) -> sdpid.Recording:
    """Return a log of the pose alone."""
    assert log.base is not None
    return replace(log, base=replace(log.base, imu=None))


# What is measured: which motions, whether with an IMU, and whether the data choose friction.
CASES: tuple[tuple[slice, bool, bool], ...] = (
    (slice(None), True, True),
    (slice(None), True, False),
    (slice(1, 2), True, True),
    (slice(1, 2), True, False),
    (slice(None), False, True),
    (slice(None), False, False),
)


def identified(
    walker: Walker, logs: Sequence[sdpid.Recording], *, chosen: bool = False, **options: Any
) -> list[object]:
    """Identify a robot and return what is said of the result in a row."""
    start = time.process_time()
    known = {"friction": None, "effects": "auto"} if chosen else {}
    result = walker.identify(logs, **known, **options)
    seconds = time.process_time() - start
    estimate, problem = result.estimate, result.problem
    certificate = result.certificate
    least = walker.errors(walker.predicted(problem, result.wls.base))
    return [
        *walker.errors(walker.predicted(problem, estimate.base)),
        walker.mass_error(estimate.theta),
        *least[:2],
        certificate is not None and bool(certificate.passed),
        None if certificate is None else certificate.gap,
        seconds,
    ]


def cell(walker: Walker, number: int) -> list[object]:
    """Return what a robot gives in a case, with the errors of its description."""
    which, imu, chosen = CASES[number]
    logs = [walker.runs[motion].recording for motion in ROBOTS[walker.name][which]]
    logs = logs if imu else [without_imu(log) for log in logs]
    row = identified(walker, logs, chosen=chosen)
    return [*row, *walker.described[:2]]


COLUMNS = (
    "robot", "motions", "base_motion", "friction", "seeds",
    "joints_percent", "joints_worst_percent", "base_force_n", "base_force_worst_n",
    "mass_percent", "mass_worst_percent",
    "least_squares_joints_percent", "least_squares_base_force_n",
    "description_joints_percent", "description_base_force_n",
    "certified", "worst_gap", "cpu_s",
)  # fmt: skip


CELL = (
    *("robot", "seed", "case", "joints", "base_force", "base_torque", "mass"),
    *("least_squares_joints", "least_squares_base_force", "passed", "gap", "cpu_s"),
    *("described_joints", "described_base_force"),
)


def main() -> None:
    """Write the table: medians and worst of all seeds."""
    study = Study(
        __doc__,
        quick={"seeds": 1, "seconds": 3.0, "robots": ["solo12"], "cases": [1]},
        seeds=5,
        seconds=10.0,
        robots=[*ROBOTS],
        cases=[*range(len(CASES))],
    )
    walker = cache(partial(Walker, seconds=study.seconds))

    def cells(case: tuple[int, str, int]) -> Iterator[tuple[object, ...]]:
        seed, name, number = case
        yield name, seed, number, *cell(walker(name, seed), number)

    # Seed by seed, so that what is there after an interruption is about all robots.
    cases = itertools.product(range(study.seeds), study.robots, study.cases)
    rows = []
    for (name, number), own in grouped(
        study.rows("cells.csv", CELL, cases, cells), "robot", "case"
    ):
        which, imu, chosen = CASES[number]
        rows.append((
            name, ", ".join(ROBOTS[name][which]), "IMU" if imu else "pose",
            "chosen" if chosen else "known", len(own["seed"]),
            *(value for each in ("joints", "base_force", "mass")
              for value in (np.median(own[each]), own[each].max())),
            *(np.median(own[each]) for each in (*CELL[7:9], *CELL[12:])),
            own["passed"].sum(), own["gap"].astype(float).max(), np.median(own["cpu_s"]),
        ))  # fmt: skip
    study.write("legged.csv", COLUMNS, rows)


if __name__ == "__main__":
    main()
