"""Robots on legs with known inertias: what their motions identify, judged on a walk, in five parts.

Go1, A1, Solo12 and a humanoid, Talos, which steps in place of the trot, in MuJoCo; their links are
15 % off the description, with friction, rotor inertia and noise. Dry friction has a Stribeck peak
and a smooth sign that differ from seed to seed. Errors are those of the efforts that the estimate
predicts for the walk as it was, with the forces of the ground known: of the joints in per cent of
their rms effort, of the force on the base in N. Tables have a median and a worst of all seeds.

* ``motions``: which motions and sensors show how much, where the estimate knows the law of friction
  or takes what `identify` chooses by the data.
* ``excitation``: what a planned motion of a standing robot brings (``planned``:
  `sdpid.design_standing` with the description), beside sines of the base in all six directions, up
  to 2 Hz (``sway``), and where the search for the plan starts, one step on (``random``).
* ``mirror``: what it brings to say that left and right legs are alike. A trot alone is fitted;
  links are 15 % off in two ways: *mirrored*, right links being the images of left ones and friction
  the same on both sides, or *unlike*. Said beside the data and the prior is ``nothing``; that links
  are mirror images, exactly or as a belief; that friction is equal, or nearly; or both.
* ``forces``: what measured contact forces of stand and trot bring, by the deviation that is stated
  of them: none (those of closed contacts are eliminated), or from near those of the filtered noise
  of 1 % to more than the weight. *Held out* is what the result says of blocks of its recordings,
  forces eliminated.
* ``certified``: results of robots of 13 to 44 links, with and without a prior, proven from the log
  on: saved, and checked from their logs as `sdpid verify --data` does.

    python examples/evidence/legged.py --parts motions --seeds 5 --out results
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from typing import Any

import numpy as np
from study import Rows, Study

import sdpid
from sdpid._common.arrays import Array
from sdpid.constraints import Condition, Layout, Row, equal_friction, mirror_pairs
from sdpid.estimation.compression.contact_noise import contact_noise
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.prior.prior import prior_terms
from sdpid.estimation.problem import Problem
from sdpid.experiment.plant.legged.simulate import LeggedRun, Sensors, simulate_legged
from sdpid.experiment.plant.legged.truth import DryFriction, TrueMotion, changed_parameters
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.legs import Legs, find_legs
from sdpid.workflow.formulate import formulate

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
GRAVITY = 9.81
WITH_FORCES = Sensors(forces=True)


@dataclass(frozen=True)
class Walker:
    """A robot that differs from its description, and its runs.

    Attributes
    ----------
    name, seed : str, int
        The robot, and what its links and friction are drawn from.
    seconds : float
        Of each motion.
    sensors : Sensors or None
        None has an IMU, and no sensors of forces.
    plain : bool
        Whether dry friction is a smooth sign alone, that of the plant.
    """

    name: str
    seed: int
    seconds: float
    sensors: Sensors | None = None
    plain: bool = False
    kept: dict[str, LeggedRun] = field(default_factory=dict, compare=False, repr=False)

    @cached_property
    def robot(self) -> sdpid.RobotModel:
        """The description."""
        return sdpid.load_robot(self.name, root="free_flyer")

    @cached_property
    def theta(self) -> Array:
        """True parameters."""
        return changed_parameters(self.robot, seed=self.seed)

    @property
    def masses(self) -> Array:
        """True masses of the links, kg."""
        return self.theta[: 10 * self.robot.n_links : 10]

    @property
    def weight(self) -> float:
        """Of the robot as it is, N."""
        return GRAVITY * float(self.masses.sum())

    @cached_property
    def law(self) -> DryFriction:
        """Its law of dry friction."""
        rng = np.random.default_rng([2026, self.seed])
        width, speed = (float(np.exp(rng.uniform(*np.log(each)))) for each in (WIDTHS, PEAK_SPEEDS))
        return DryFriction(width=width, peak=float(rng.uniform(*PEAKS)), peak_speed=speed)

    @property
    def friction(self) -> tuple[Any, ...]:
        """The terms of its friction; their sizes are not told."""
        return (*self.law.terms, "viscous", "rotor_inertia")

    def moved(self, motion: Any, seed: int) -> LeggedRun:
        """Let it move: one of the plant's motions, or a plan."""
        return simulate_legged(
            self.robot,
            motion,
            theta=self.theta,
            duration=self.seconds,
            seed=10 * self.seed + seed,
            sensors=self.sensors,
            friction=None if self.plain else self.law,
        )

    def run(self, motion: str) -> LeggedRun:
        """Return one of its motions, or the walk."""
        if motion not in self.kept:
            number = (*ROBOTS[self.name], "walk").index(motion)
            self.kept[motion] = self.moved(motion, number)
        return self.kept[motion]

    def logs(self, *motions: str, imu: bool = True) -> list[sdpid.Recording]:
        """Return the recordings of some motions, with an IMU or without."""
        found = [self.run(motion).recording for motion in motions]
        return found if imu else [without_imu(log) for log in found]

    @cached_property
    def walk(self) -> tuple[TrueMotion, Array]:
        """The walk as it was, some of its samples, and their true efforts without the ground's."""
        whole = self.run("walk").motion
        motion = TrueMotion(**{key: value[::STRIDE] for key, value in vars(whole).items()})
        bodies = self.theta[: 10 * self.robot.n_links].reshape(-1, 10)
        return motion, self._efforts(bodies, motion)

    def _efforts(self, bodies: Array, motion: TrueMotion) -> Array:
        """Return the efforts of bodies without the ground's, with the true friction and rotors."""
        states = motion.position, motion.velocity, motion.acceleration
        efforts = self.robot.inverse_dynamics(bodies, *states)
        rotor = self.theta[10 * self.robot.n_links :].reshape(3, -1)[2]
        efforts[:, 6:] += motion.friction + rotor * motion.acceleration[:, 6:]
        return efforts

    def _off(self, predicted: Array) -> tuple[float, float]:
        """Return errors of joints in % of rms effort, and of the force on the base in N."""
        motion, needed = self.walk
        off = predicted - needed
        effort = np.sqrt(np.mean(motion.effort[:, 6:] ** 2))
        joints = 100.0 * float(np.sqrt(np.mean(off[:, 6:] ** 2)) / effort)
        return joints, float(np.sqrt(np.mean(np.sum(off[:, :3] ** 2, axis=1))))

    def errors(self, problem: Problem, base: Array) -> tuple[float, float]:
        """Return these errors of base parameters."""
        motion, needed = self.walk
        exact = sdpid.Samples(
            position=motion.position,
            velocity=motion.velocity,
            acceleration=motion.acceleration,
            effort=needed,
            joint_names=problem.robot.joint_names,
        )
        rows = RowSource(problem.robot, problem.friction, problem.base, exact)
        return self._off(np.asarray(rows.regressor(slice(None)) @ base))

    @cached_property
    def described(self) -> tuple[float, float]:
        """These errors of the description, with the true friction."""
        return self._off(self._efforts(self.robot.prior, self.walk[0]))

    def judged(self, estimate: Estimate) -> tuple[float, float, float]:
        """Return errors of joints in %, of the base in N, and of the mass in %."""
        assert estimate.theta is not None
        mass = estimate.theta[: 10 * self.robot.n_links : 10].sum() / self.masses.sum()
        off = 100.0 * abs(float(mass - 1.0))
        return *self.errors(estimate.problem, estimate.base), off

    def identify(self, logs: Sequence[sdpid.Recording], **options: Any) -> Any:
        """Identify from logs, the terms of friction known unless the options say otherwise."""
        given = {"friction": self.friction, "effects": "none", "intervals": False}
        return sdpid.identify(self.robot, list(logs), **{**given, **options})


def without_imu(log: sdpid.Recording) -> sdpid.Recording:
    """Return a log of the pose alone."""
    assert log.base is not None
    return replace(log, base=replace(log.base, imu=None))


# Of a table: medians and the worst of errors of joints, of the base and of the mass.
ERRORS = ("joints", "base_force", "mass")
SUMMARY = {
    "seeds": "count joints",
    "joints_percent": "median joints",
    "joints_worst_percent": "max joints",
    "base_force_n": "median base_force",
    "base_force_worst_n": "max base_force",
    "mass_percent": "median mass",
    "mass_worst_percent": "max mass",
}

# What is measured: which motions, whether with an IMU, and whether the data choose friction.
CASES: tuple[tuple[slice, bool, bool], ...] = (
    (slice(None), True, True),
    (slice(None), True, False),
    (slice(1, 2), True, True),
    (slice(1, 2), True, False),
    (slice(None), False, True),
    (slice(None), False, False),
)


def motions(study: Study, seconds: float) -> None:
    """Write which motions show how much."""
    walker = cache(partial(Walker, seconds=seconds))
    by = ("robot", "motions", "base_motion", "friction")

    def cells(seed: int, name: str, number: int) -> Rows:
        which, imu, chosen = CASES[number]
        own, names = walker(name, seed), ROBOTS[name][which]
        known = {"friction": None, "effects": "auto"} if chosen else {}
        logs = own.logs(*names, imu=imu)
        start = time.process_time()
        found = own.identify(logs, **known)
        used = time.process_time() - start
        labels = ", ".join(names), "IMU" if imu else "pose", "chosen" if chosen else "known"
        least, _ = own.errors(found.problem, found.wls.base)
        yield name, *labels, seed, *own.judged(found.estimate), least, *own.described, used

    header = (*by, "seed", *ERRORS, "least", "described_joints", "described_base", "cpu")
    # Seed by seed, so that what is there after an interruption is about all robots.
    axes = range(study.seeds), study.robots, study.cases
    columns = {
        **SUMMARY,
        "least_squares_joints_percent": "median least",
        "description_joints_percent": "median described_joints",
        "description_base_force_n": "median described_base",
        "cpu_s": "median cpu",
    }
    study.summary("legged.csv", study.rows("cells.csv", header, cells, *axes), by, columns)


def quadrupeds(study: Study) -> list[str]:
    """Return the robots on four legs."""
    return [name for name in study.robots if ROBOTS[name] == THREE]


def excitation(study: Study, seconds: float) -> None:
    """Write what a planned motion of a standing robot brings."""
    # Steps of the search; None for the motion that no search made.
    searches = {"planned": 30, "sway": None, "random": 1}

    def cells(seed: int, name: str, kind: str) -> Rows:
        own, motion, steps = Walker(name, seed, seconds), "stand", searches[kind]
        if steps is not None:
            # The plan knows the description alone; its seed is that of the robot.
            how = {"duration": seconds, "seed": seed, "progress": False}
            plan = sdpid.design_standing(own.robot, steps=min(steps, study.most), **how)
            motion = plan.motion
        result = own.identify([own.moved(motion, 0).recording])
        yield name, kind, seed, *own.judged(result.estimate), own.described[0]

    header = ("robot", "motion", "seed", *ERRORS, "described")
    axes = range(study.seeds), quadrupeds(study), searches
    found = study.rows("stand.csv", header, cells, *axes)
    columns = {**SUMMARY, "description_joints_percent": "median described"}
    study.summary("legged_excitation.csv", found, ("robot", "motion"), columns)


# Drives that are not alike differ by about this share, as their links do.
CHANGE = 0.15
# What is said of links (by how much they differ) and of friction; None says nothing.
SAID: dict[str, tuple[float | None, float | None]] = {
    "nothing": (None, None),
    "mirror": (0.0, None),
    "within 5 %": (0.05, None),
    "within 20 %": (0.2, None),
    "friction": (None, 0.0),
    "friction within 20 %": (None, 0.2),
    "both within 20 %": (0.2, 0.2),
}


@dataclass(frozen=True)
class Mirrored(Walker):
    """A robot whose left and right are alike, or not."""

    alike: bool = True

    @cached_property
    def theta(self) -> Array:
        """True parameters."""
        theta = np.array(changed_parameters(self.robot, change=CHANGE, seed=self.seed))
        friction = slice(10 * self.robot.n_links, None)
        if not self.alike:
            rng = np.random.default_rng([18, self.seed])
            theta[friction] *= np.exp(CHANGE * rng.normal(size=len(theta[friction])))
            return theta
        layout = Layout(self.robot, FrictionModel.from_terms((), self.robot.joint_names, first=6))
        for pair in mirror_pairs(self.robot):
            own = slice(10 * layout.link(pair.second), 10 * layout.link(pair.second) + 10)
            rows = [row for row in pair.compile(layout) if isinstance(row, Row)]
            # The second link is what it is less the difference that should be none.
            theta[own] -= np.array([row.coefficients @ theta[: layout.count] for row in rows])
        joints = list(self.robot.joint_names[self.robot.n_base :])
        sizes = theta[friction].reshape(3, -1)
        for drives in equal_friction(self.robot):
            sizes[:, joints.index(drives.second)] = sizes[:, joints.index(drives.first)]
        return theta

    def said(self, problem: Problem, what: str) -> Problem:
        """Return the problem with what is said."""
        within, friction = SAID[what]
        others: list[Condition] = []
        if within == 0.0:
            others += mirror_pairs(self.robot)
        if friction is not None:
            others += equal_friction(self.robot, within=friction)
        problem = problem.constrained(constraints=problem.constraints.replace(others=others))
        if within:
            prior = sdpid.Prior(alike=mirror_pairs(self.robot), within=within)
            problem = replace(problem, prior=prior_terms(prior, problem.require_rows("study")))
        return problem


def mirror(study: Study, seconds: float) -> None:
    """Write what it brings to say that left and right are alike."""

    def cells(seed: int, name: str, truth: str) -> Rows:
        own = Mirrored(name, seed, seconds, alike=truth == "mirrored")
        problem = formulate(own.robot, own.logs("trot"), friction=own.friction, effects="none")
        for what in SAID:
            estimate = sdpid.solve_sdp(own.said(problem, what))
            yield name, truth, what, seed, *own.judged(estimate)

    by = ("robot", "truth", "said")
    axes = range(study.seeds), quadrupeds(study), ("mirrored", "unlike")
    found = study.rows("trot.csv", (*by, "seed", *ERRORS), cells, *axes)
    columns = {name: how for name, how in SUMMARY.items() if name != "mass_worst_percent"}
    study.summary("legged_mirror.csv", found, by, columns)


STATED = (None, 0.05, 0.2, 2.0, 20.0, 1000.0)


def forces(study: Study, seconds: float) -> None:
    """Write what measured forces bring."""

    def cells(name: str, base_motion: str) -> Rows:
        own = Walker(name, 0, seconds, WITH_FORCES)
        logs = own.logs("stand", "trot", imu=base_motion == "IMU")
        for stated in STATED[: study.most]:
            result = own.identify(logs, processing={"contact_force_std": stated})
            rows, held, found = result.problem.rows, result.held_out, None
            if stated is not None and isinstance(rows, RowSource):
                found = stated * np.sqrt(contact_noise(rows.with_force_scale(1.0))[2])
            share = None if held is None else 100.0 * held.fit.moving.relative
            yield name, base_motion, stated, found, *own.judged(result.estimate), share

    header = ("robot", "base_motion", "stated_n", "found_n", "joints_percent", "base_force_n")
    header = (*header, "mass_percent", "held_out_percent")
    robots = [name for name in quadrupeds(study) if name != "a1"]
    study.rows("legged_forces.csv", header, cells, robots, ("IMU", "pose"))


G1 = "g1_29dof_with_hand_rev_1_0"
# Each robot and the motions that are identified from together.
MOTIONS = {**ROBOTS, G1: ROBOTS["talos_reduced"]}
# What the description of a G1 does not say: where its soles are (here at the ankles' axes), and
# how it stands, its hips having pitch, roll and yaw in this order.
FEET = ("left_ankle_roll_link", "right_ankle_roll_link")
BENT = {"hip_pitch": -0.4, "hip_roll": 0.0, "hip_yaw": 0.0, "knee": 0.8, "ankle_pitch": -0.4}
PLAIN = (sdpid.friction.Coulomb(width=DryFriction().width), "viscous", "rotor_inertia")
PROVEN = (
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


def proven(seconds: float, priors: tuple[bool, ...], name: str) -> Rows:
    """Yield the rows of one robot."""
    robot = sdpid.load_robot(name, root="free_flyer")
    legs = legs_of(robot)
    logs = [
        sdpid.simulate_legged(robot, motion, duration=seconds, seed=i, legs=legs).recording
        for i, motion in enumerate(MOTIONS[name])
    ]
    known = {"friction": PLAIN, "effects": "none", "intervals": False}
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


def certified(study: Study, seconds: float) -> None:
    """Prove results from the log on, with and without a prior."""
    priors = (True,) if study.quick else (True, False)
    robots = study.robots if study.quick else [*study.robots, G1]
    study.rows("legged_certified.csv", PROVEN, partial(proven, seconds, priors), robots)


# Of each part what it does, and the seconds of its motions.
PARTS: dict[str, tuple[Callable[[Study, float], None], float]] = {
    "motions": (motions, 10.0),
    "excitation": (excitation, 10.0),
    "mirror": (mirror, 4.0),
    "forces": (forces, 4.0),
    "certified": (certified, 2.0),
}


def main() -> None:
    """Write the tables that are asked for."""
    study = Study(
        __doc__,
        quick={"seeds": 1, "seconds": 2.0, "robots": ["solo12"], "cases": [1], "most": 2},
        parts=[*PARTS],
        seeds=5,
        seconds=(0.0, "of each motion; 0 for those of the tables"),
        robots=[*ROBOTS],
        cases=[*range(len(CASES))],
        most=(30, "steps of a search, and stated deviations"),
    )
    for part in study.parts:
        run, seconds = PARTS[part]
        run(study, study.seconds or seconds)


if __name__ == "__main__":
    main()
