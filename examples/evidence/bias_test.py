"""Size and power of the test whether noise in the motion biases least squares.

Simulated arms under a PD controller with known parameters. Three tables:

* ``bias_size.csv``: nothing biases least squares (the motion is measured exactly, efforts have
  white or colored noise of 5 % of their rms), logs are filtered; arms of two to seven joints, logs
  of 12 to 90 s. How often `sdpid.check_bias` rejects at 5 %, and the textbook test, which takes all
  columns and independent samples. Instruments are the commanded motion, and in fewer runs the
  model's own in closed loop.
* ``bias_power.csv``: encoders have white noise, which the controller feeds back. How often the test
  rejects, by how much predictions shift, and the true errors of the efforts that least squares and
  `sdpid.solve_instrumental` predict.

    python examples/evidence/bias_test.py --runs 36 --power-runs 4 --out results
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from scipy.signal import lfilter
from scipy.special import stdtrit
from study import Study, grouped

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import SolverError
from sdpid.estimation.closed_loop.instruments import paired, products
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.posterior import fit_errors
from sdpid.estimation.problem import Problem
from sdpid.experiment.plant.simulate import default_parameters
from sdpid.experiment.preparation.twin import Twin
from sdpid.experiment.trajectory.fourier import FourierSeries
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.dynamics import RobotDynamics

LEVEL = 0.05

# White noise of the efforts, as a share of their rms.
EFFORT_NOISE = 0.05

# The loop's bandwidth (rad/s) and damping at the mean inertia.
BANDWIDTH, DAMPING = 25.0, 0.9

# Controllers run at this rate where encoders are noisy, and difference what they measure.
CONTROL_HZ = 5000.0

HARMONICS = 5

# Of one run in so many the model's own motion is the instrument, which has to be simulated.
SIMULATED = 5

# What is measured of each log: viscous friction alone needs no mask, exact Coulomb friction does.
FILTERED = {"reversal_time": None, "kept_share": 0.1, "order": 4}
MASKED = {**FILTERED, "reversal_speed": 0.05, "reversal_time": 0.02}

# Robot (a number: an arm of so many joints), seconds of motion, sample rate (Hz), cut-off (Hz),
# friction, mask, and the correlation of the efforts' noise from sample to sample.
SIZE = (
    ("2", 12.0, 200.0, 10.0, ("viscous",), FILTERED, 0.9),
    ("2", 30.0, 200.0, 20.0, ("viscous",), FILTERED, 0.0),
    ("3", 30.0, 250.0, 15.0, ("coulomb", "viscous"), MASKED, 0.9),
    ("4", 30.0, 250.0, 15.0, ("viscous",), FILTERED, 0.95),
    ("4", 90.0, 250.0, 15.0, ("viscous",), FILTERED, 0.0),
    ("5", 40.0, 250.0, 10.0, ("viscous",), FILTERED, 0.9),
    ("denso_vp6242", 20.0, 1000.0, 50.0, ("viscous",), FILTERED, 0.0),
    ("denso_vp6242", 20.0, 250.0, 20.0, ("coulomb", "viscous"), MASKED, 0.0),
    ("ur10_robot", 20.0, 1000.0, 50.0, ("viscous",), FILTERED, 0.0),
    ("ur10_robot", 20.0, 250.0, 20.0, ("coulomb", "viscous"), MASKED, 0.95),
    ("talos_left_arm", 20.0, 500.0, 30.0, ("viscous",), FILTERED, 0.0),
    ("talos_left_arm", 60.0, 250.0, 15.0, ("viscous",), FILTERED, 0.9),
)

# Seconds of the logs of which powers are measured.
SECONDS = 20.0

# Noise of the encoders in rad, cut-offs in Hz, and masks.
POWER = tuple(
    ("ur10_robot", noise, cutoff, mask)
    for noise in (1e-6, 1e-5, 5e-5)
    for cutoff, mask in ((130.0, FILTERED), (30.0, FILTERED), (30.0, MASKED))
)


# Robot, seconds, sample rate and cut-off in Hz, and noise of the encoders in rad.
COVERED = (
    ("2", 20.0, 200.0, 20.0, 5e-5),
    ("3", 15.0, 500.0, 20.0, 3e-5),
    ("4", 30.0, 250.0, 15.0, 2e-5),
)


@dataclass(frozen=True)
class Arm:
    """A simulated arm on a Fourier series, at a sample rate, with some friction."""

    name: str
    rate_hz: float
    friction: tuple[str, ...]
    seconds: float = SECONDS
    correlation: float = 0.0

    @cached_property
    def model(self) -> RobotDynamics:
        """The true arm."""
        robot = arm_of(int(self.name)) if self.name.isdigit() else sdpid.load_robot(self.name)
        theta = default_parameters(robot)
        bodies, coulomb, viscous = np.split(theta, [10 * robot.n_links, theta.size - robot.n])
        friction = {"coulomb": coulomb, "viscous": viscous}
        theta = np.concatenate([bodies, *(friction[each] for each in self.friction)])
        terms = FrictionModel.from_terms(self.friction, robot.joint_names)
        return RobotDynamics(robot=robot, terms=terms, theta=theta)

    @cached_property
    def motion(self) -> sdpid.Trajectory:
        """The commanded motion."""
        robot, rng = self.model.robot, np.random.default_rng(1)
        limits = np.tile([-2.0, 2.0], (robot.n, 1))
        if robot.position_limits is not None:
            limits = np.clip(np.asarray(robot.position_limits).reshape(-1, 2), -2.0, 2.0)
        shape = (robot.n, HARMONICS)
        harmonics = np.tile(np.arange(1, HARMONICS + 1), (robot.n, 1))
        sizes, phases = (
            rng.standard_normal(shape) / np.sqrt(harmonics),
            rng.uniform(0.0, 6.0, shape),
        )
        time = np.linspace(0.0, 1.0, 500)
        angle = 2.0 * np.pi * harmonics[:, :, None] * time + phases[:, :, None]
        reach = np.abs((sizes[:, :, None] * np.sin(angle)).sum(axis=1)).max(axis=1)
        room = 0.4 * np.ptp(limits, axis=1)
        return sdpid.Trajectory(
            joint_names=robot.joint_names,
            series=FourierSeries(
                period=self.seconds,
                center=limits.mean(axis=1),
                harmonics=harmonics,
                amplitudes=sizes * (room / reach)[:, None],
                phases=phases,
            ),
            rate_hz=self.rate_hz,
            periods=1,
            rest=0.5,
            connection=1.5,
            position_range=np.tile([-np.pi, np.pi], (robot.n, 1)),
            velocity_limit=np.full(robot.n, 20.0),
        )

    @cached_property
    def controller(self) -> sdpid.controllers.PD:
        """The loop."""
        poses = self.motion.sample()[0][:: int(self.rate_hz)]
        inertia = np.mean([np.diag(self.model.mass_matrix(q)) for q in poses], axis=0)
        return sdpid.controllers.PD(
            kp=BANDWIDTH**2 * inertia, kd=2.0 * DAMPING * BANDWIDTH * inertia
        )

    @cached_property
    def exact(self) -> sdpid.Recording:
        """The log without any noise, and what was commanded."""
        return self._recording(0.0, 0)

    def _recording(self, position_noise: float, seed: int) -> sdpid.Recording:
        noise = {}
        if position_noise:
            noise = {
                "position_noise": np.full(self.model.robot.n, position_noise),
                "control_hz": CONTROL_HZ,
                "seed": seed,
            }
        moved = sdpid.simulate_closed_loop(
            self.model, self.motion, self.controller, rate_hz=self.rate_hz, **noise
        )
        return sdpid.Recording(
            time=moved.time,
            position=moved.measured if position_noise else moved.position,
            effort=moved.effort,
            joint_names=self.model.robot.joint_names,
            reference=self.motion.sample()[0],
        )

    def log(self, seed: int, position_noise: float = 0.0) -> sdpid.Recording:
        """Return a log with noise of the efforts, and of the positions that the loop sees."""
        clean = self._recording(position_noise, seed) if position_noise else self.exact
        rng = np.random.default_rng((seed, 1))
        size = EFFORT_NOISE * np.sqrt(np.mean(self.exact.effort**2, axis=0))
        noise = rng.standard_normal(clean.effort.shape)
        if self.correlation:
            noise *= np.sqrt(1.0 - self.correlation**2)
            noise = lfilter([1.0], [1.0, -self.correlation], noise, axis=0)
        return replace(clean, effort=clean.effort + size * noise)

    def problem(self, log: sdpid.Recording, processing: sdpid.Processing) -> Problem:
        """Return the least-squares problem of a log."""
        samples = sdpid.process(log, processing, progress=False)
        robot = self.model.robot
        bounds = sdpid.Constraints.of_size(robot)
        return sdpid.build_problem(
            robot, samples, friction=self.friction, weighting="residual", constraints=bounds
        )


@cache
def sized(*arguments: Any) -> Arm:
    """Return an arm, which keeps what was simulated once."""
    return Arm(*arguments)


def arm_of(joints: int) -> sdpid.RobotModel:
    """Return an arm of some joints, with axes that cross in turn, of rods of 2 kg."""
    right = np.pi / 2.0
    rows = [{"r": 0.2}]
    rows += [
        {"alpha": right if j % 2 else 0.0, "d": 0.0 if j % 2 else 0.3} for j in range(1, joints)
    ]
    mass, half = 2.0, 0.15
    own = [mass, mass * half, 0.0, 0.05 * mass, 0.02, 0.08, 0.08, 0.0, 0.0, 0.0]
    return sdpid.RobotModel.from_mdh(rows, inertias=np.tile(own, (joints, 1)), name=f"arm{joints}")


def solved(problem: Problem) -> Estimate:
    """Return the constrained estimate, also where its optimum is proven to less than 1e-6."""
    try:
        return sdpid.solve_sdp(problem)
    except SolverError as error:
        if not isinstance(error.found, Estimate) or not error.found.feasible:
            raise
        return error.found


def processing_of(rate: float, cutoff: float, settings: dict[str, object]) -> sdpid.Processing:
    """Return the processing, decimated to twice the cut-off and a little more."""
    return sdpid.Processing(
        cutoff_hz=cutoff, decimation=max(1, int(rate / (2.5 * cutoff))), **settings
    )


def textbook(problem: Problem, instruments: sdpid.Samples) -> float:
    """Return p of the test of all columns of V, samples taken as independent."""
    from scipy.special import fdtrc

    sums = products(problem, [paired(problem, problem.samples, instruments)])
    gram, target, r = sums[:-1, :-1], sums[:-1, -1], len(sums) // 2
    explained = target @ np.linalg.lstsq(gram, target, rcond=1e-12)[0]
    fit = target[r:] @ np.linalg.solve(gram[r:, r:], target[r:])
    total = float(problem.rhs @ problem.rhs) + problem.floor
    freedom = problem.n_rows - 2 * r
    statistic = (explained - fit) / r / ((total - explained) / freedom)
    return float(fdtrc(r, freedom, statistic))


def size_rows(number: int, seed: int) -> Iterator[tuple[object, ...]]:
    """Yield p of a log that nothing biases, by each test."""
    name, seconds, rate, cutoff, friction, settings, correlation = SIZE[number]
    arm = sized(name, rate, friction, seconds, correlation)
    processing = processing_of(rate, cutoff, settings)
    log = arm.log(seed)
    problem = arm.problem(log, processing)
    # What was commanded is the same in every log.
    twin = Twin.of(problem.robot, log, processing, measured=problem.samples)
    commanded = twin.samples(log.reference)
    test = sdpid.check_bias(problem, instruments=commanded)
    own = None
    if seed % SIMULATED == 0:
        how = {"processing": processing, "controller": arm.controller}
        own = sdpid.check_bias(problem, log, **how).p
    yield number, test.p, own, textbook(problem, commanded), sum(test.freedom)


def sizes(found: Sequence[dict[str, Any]]) -> Iterator[list[object]]:
    """Yield the rows of the table of sizes."""
    for (number,), own in grouped(found, "case"):
        name, seconds, rate, cutoff, friction, settings, correlation = SIZE[number]
        robot = sized(name, rate, friction, seconds, correlation).model.robot
        told, terms = "masked" if settings is MASKED else "filtered", " and ".join(friction)
        logs = seconds, rate, told, cutoff, terms, correlation, int(own["blocks"][-1])
        yield [robot.name, robot.n, *logs, *_shares(own)]
    for _, own in grouped(found):
        yield ["all", *[None] * 8, *_shares(own)]


def _shares(own: Mapping[str, Array]) -> list[object]:
    """Return runs and rejections in per cent."""
    out: list[object] = []
    for key in ("commanded", "simulated", "textbook"):
        p = own[key].astype(float)
        p = p[~np.isnan(p)]
        out += [len(p)] if key != "textbook" else []
        out.append(100.0 * np.mean(p < LEVEL))
    return out


def power_rows(number: int, seed: int) -> Iterator[tuple[object, ...]]:
    """Yield what noisy encoders do to a log: rejected, biased, shift, and true errors."""
    name, noise, cutoff, settings = POWER[number]
    arm = sized(name, 1000.0, ("coulomb", "viscous"))
    processing = processing_of(arm.rate_hz, cutoff, settings)
    log = arm.log(seed, noise)
    problem = arm.problem(log, processing)
    how = {"processing": processing, "controller": arm.controller}
    test = sdpid.check_bias(problem, log, **how)
    estimate = sdpid.solve_instrumental(problem, log, solver=solved, **how)
    errors = (_error(arm, problem, each.base, processing) for each in (solved(problem), estimate))
    yield number, test.p < LEVEL, test.biased, test.shift, *errors


def powers(found: Sequence[dict[str, Any]]) -> Iterator[list[object]]:
    """Yield the rows of the table of powers."""
    for (number,), own in grouped(found, "case"):
        _, noise, cutoff, settings = POWER[number]
        shares = (100.0 * own[name].mean() for name in ("rejected", "biased"))
        medians = (100.0 * np.median(own[name]) for name in ("shift", "least", "second"))
        told = "masked" if settings is MASKED else "filtered"
        yield [noise, cutoff, told, len(own["shift"]), *shares, *medians]


def coverage_rows(number: int, seed: int) -> Iterator[tuple[object, ...]]:
    """Yield shares of intervals that hold: encoders have noise that the loop does not see."""
    name, seconds, rate, cutoff, noise = COVERED[number]
    arm, processing = (
        sized(name, rate, ("viscous",), seconds),
        processing_of(rate, cutoff, FILTERED),
    )
    log, rng = arm.log(seed), np.random.default_rng((seed, 2))
    log = replace(log, position=log.position + noise * rng.standard_normal(log.effort.shape))
    problem = arm.problem(log, processing)
    truth = problem.base_of(arm.model.theta)
    second = sdpid.solve_instrumental(
        problem, log, processing=processing, instruments="reference", solver=sdpid.solve_wls
    )
    held = []
    for estimate, groups in (
        (sdpid.solve_wls(problem), "frequencies"),
        (second, "frequencies"),
        (second, "blocks"),
    ):
        errors = fit_errors(estimate, groups)
        T = errors.root
        deviation = np.sqrt(np.diag(T @ errors.scores @ T.T))
        half = stdtrit(errors.freedom(T), 0.975) * deviation
        held.append(np.mean(np.abs(estimate.base - truth) <= half))
    yield number, -(-problem.samples.n_samples // problem.samples.block), *held


def coverages(found: Sequence[dict[str, Any]]) -> Iterator[list[object]]:
    """Yield the rows of the table of coverages."""
    for (number,), own in grouped(found, "case"):
        name, seconds, rate, cutoff, noise = COVERED[number]
        robot = sized(name, rate, ("viscous",), seconds).model.robot.name
        shares = (100.0 * own[each].mean() for each in ("least", "second", "second, blocks"))
        yield [robot, seconds, cutoff, noise, int(own["blocks"][-1]), len(own["least"]), *shares]


def _error(arm: Arm, problem: Problem, base: Array, processing: sdpid.Processing) -> float:
    """Return the error of predicted efforts on the exact motion, as a share of the efforts."""
    samples = sdpid.process(arm.exact, processing, progress=False)
    rows = RowSource(problem.robot, problem.friction, problem.base, samples)
    W = rows.regressor(slice(None))
    truth = W @ problem.base_of(arm.model.theta)
    return float(np.linalg.norm(W @ base - truth) / np.linalg.norm(truth))


SIZES = (
    "robot", "joints", "seconds", "rate_hz", "processing", "cutoff_hz", "friction", "correlation",
    "blocks", "runs", "rejected_percent", "runs_simulated", "rejected_simulated_percent",
    "textbook_percent",
)  # fmt: skip
POWERS = (
    "noise_rad", "cutoff_hz", "processing", "runs", "rejected_percent", "biased_percent",
    "shift_percent", "error_least_squares_percent", "error_instruments_percent",
)  # fmt: skip

COVERAGES = (
    "robot", "seconds", "cutoff_hz", "noise_rad", "blocks", "runs",
    "least_squares_percent", "instruments_percent", "instruments_blocks_percent",
)  # fmt: skip


PARTS: dict[str, tuple[Any, ...]] = {
    "size": (
        *(SIZES, SIZE, size_rows, sizes),
        ("case", "commanded", "simulated", "textbook", "blocks"),
    ),
    "power": (
        *(POWERS, POWER, power_rows, powers),
        ("case", "rejected", "biased", "shift", "least", "second"),
    ),
    "coverage": (
        *(COVERAGES, COVERED, coverage_rows, coverages),
        ("case", "blocks", "least", "second", "second, blocks"),
    ),
}


def main() -> None:
    """Write the tables."""
    study = Study(
        __doc__,
        quick={"runs": 2, "power_runs": 1, "coverage_runs": 1, "most": 1},
        runs=36,
        power_runs=4,
        coverage_runs=60,
        parts=[*PARTS],
        most=(len(SIZE), "cases of each table"),
    )
    for part in study.parts:
        header, cases, rows_of, table, columns = PARTS[part]
        runs = study.runs if part == "size" else getattr(study, f"{part}_runs")
        every = itertools.product(range(min(len(cases), study.most)), range(runs))
        found = study.rows(f"{part}.csv", columns, every, lambda case, of=rows_of: of(*case))
        study.write(f"bias_{part}.csv", header, table(found))


if __name__ == "__main__":
    main()
