"""Noise in the motion of arms that a controller moves, by simulated arms of known parameters.

Is it seen, and is it repaired? Arms are under a PD controller; five parts, a table each.

* ``size``: nothing biases least squares (the motion is measured exactly, efforts have white or
  colored noise of 5 % of their rms), logs are filtered; arms of two to seven joints, logs of 12 to
  90 s. How often `sdpid.check_bias` rejects at 5 %, and the textbook test, which takes all columns
  and independent samples. Instruments are the commanded motion, and in fewer runs the model's own
  in closed loop.
* ``power``: encoders have white noise, which the controller feeds back. How often the test rejects,
  by how much predictions shift, and the true errors of the efforts that least squares and
  `sdpid.solve_instrumental` predict.
* ``coverage``: encoders have noise that the loop does not see. How many true base parameters the
  intervals hold.
* ``check``: how often a controller is refused whose gains are right, or off.
* ``errors``: how far efforts of the parameters found are off with wrong gains and far starts, in
  how many runs the controller is refused, iterations, and seconds of the processor.

    python examples/evidence/closed_loop.py --parts size --runs 36 --out results
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from scipy.signal import lfilter
from scipy.special import fdtrc, stdtrit
from study import Rows, Study

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import DataError, SolverError
from sdpid.estimation.closed_loop.instruments import paired, products
from sdpid.estimation.closed_loop.loop import ClosedLoop, ControllerCheck
from sdpid.estimation.closed_loop.solve import CONTROLLER
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

# Output error: deviation of the encoders' noise, rad, rate and cut-off, Hz. Half the gains, and
# spreads of the start's parameters, are for the first robot: the other does not follow its commands
# then, which is told. Of the last one only the check is measured.
NOISE, RATE_HZ, CUTOFF_HZ = 1e-5, 250.0, 30.0
ROBOTS = ("ur10_robot", "kinova_description/kinova", "panda_description/panda")
GAINS, HALF, SPREADS = (1.0, 1.05, 1.2), 0.5, (0.15, 0.3, 0.6)
METHODS = ("instruments", "didim", "closed_loop")

# Of the check: noise of encoders, rad, factors of gains, and logs a run of output error.
NOISES, CHECKED, LOGS = (1e-6, 1e-5, 5e-5), (1.0, 0.95, 1.05, 0.9, 1.1), 4


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
        harmonics = np.tile(np.arange(1, HARMONICS + 1), (robot.n, 1))
        sizes = rng.standard_normal(harmonics.shape) / np.sqrt(harmonics)
        phases = rng.uniform(0.0, 6.0, harmonics.shape)
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


# Arms keep what was simulated once.
sized = cache(Arm)


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
    sums = products(problem, [paired(problem, problem.samples, instruments)])
    gram, target, r = sums[:-1, :-1], sums[:-1, -1], len(sums) // 2
    explained = target @ np.linalg.lstsq(gram, target, rcond=1e-12)[0]
    fit = target[r:] @ np.linalg.solve(gram[r:, r:], target[r:])
    total = float(problem.rhs @ problem.rhs) + problem.floor
    freedom = problem.n_rows - 2 * r
    statistic = (explained - fit) / r / ((total - explained) / freedom)
    return float(fdtrc(r, freedom, statistic))


def size_rows(number: int, seed: int) -> Rows:
    """Yield whether the tests reject a log that nothing biases."""
    name, seconds, rate, cutoff, friction, settings, correlation = SIZE[number]
    arm = sized(name, rate, friction, seconds, correlation)
    processing = processing_of(rate, cutoff, settings)
    log = arm.log(seed)
    problem = arm.problem(log, processing)
    # What was commanded is the same in every log.
    twin = Twin.of(problem.robot, log, processing, measured=problem.samples)
    commanded = twin.samples(log.reference)
    test, own = sdpid.check_bias(problem, instruments=commanded), None
    if seed % SIMULATED == 0:
        how = {"processing": processing, "controller": arm.controller}
        own = sdpid.check_bias(problem, log, **how).p < LEVEL
    logs = problem.robot.name, problem.robot.n, seconds, rate, words(settings), cutoff
    yield (
        *(*logs, " and ".join(friction), correlation, sum(test.freedom), test.p < LEVEL, own),
        textbook(problem, commanded) < LEVEL,
    )


def words(settings: dict[str, object]) -> str:
    """Return what is done about rows near reversals."""
    return "masked" if settings is MASKED else "filtered"


def size(study: Study) -> None:
    """Write the table of sizes, of each case and of all."""
    by = ("robot", "joints", "seconds", "rate_hz", "processing", "cutoff_hz", "friction")
    by = (*by, "correlation")
    header = (*by, "blocks", "commanded", "simulated", "textbook")
    axes = range(len(SIZE))[: study.most], range(study.runs)
    found = study.rows("size.csv", header, size_rows, *axes)
    every = ({**row, **dict.fromkeys((*by, "blocks")), "robot": "all"} for row in found)
    columns = {
        "blocks": "max blocks",
        "runs": "count commanded",
        "rejected_percent": "percent commanded",
        "runs_simulated": "count simulated",
        "rejected_simulated_percent": "percent simulated",
        "textbook_percent": "percent textbook",
    }
    study.summary("bias_size.csv", [*found, *every], by, columns)


def power_rows(number: int, seed: int) -> Rows:
    """Yield what noisy encoders do to a log: rejected, biased, shift, and true errors."""
    name, noise, cutoff, settings = POWER[number]
    arm = sized(name, 1000.0, ("coulomb", "viscous"))
    processing = processing_of(arm.rate_hz, cutoff, settings)
    log = arm.log(seed, noise)
    problem = arm.problem(log, processing)
    how = {"processing": processing, "controller": arm.controller}
    test = sdpid.check_bias(problem, log, **how)
    second = sdpid.solve_instrumental(problem, log, solver=solved, **how)
    # Of predicted efforts on the exact motion, as a share of the efforts.
    samples = sdpid.process(arm.exact, processing, progress=False)
    rows = RowSource(problem.robot, problem.friction, problem.base, samples)
    W = rows.regressor(slice(None))
    errors = (off(W, problem, arm, each.base) for each in (solved(problem), second))
    yield noise, cutoff, words(settings), test.p < LEVEL, test.biased, 100.0 * test.shift, *errors


def off(W: Array, problem: Problem, arm: Arm, base: Array) -> float:
    """Return the error of the efforts of base parameters over the true ones, %."""
    truth = W @ problem.base_of(arm.model.theta)
    return 100.0 * float(np.linalg.norm(W @ base - truth) / np.linalg.norm(truth))


def power(study: Study) -> None:
    """Write the table of powers."""
    by = ("noise_rad", "cutoff_hz", "processing")
    header = (*by, "rejected", "biased", "shift", "least", "second")
    axes = range(len(POWER))[: study.most], range(study.power_runs)
    columns = {
        "runs": "count shift",
        "rejected_percent": "percent rejected",
        "biased_percent": "percent biased",
        "shift_percent": "median shift",
        "error_least_squares_percent": "median least",
        "error_instruments_percent": "median second",
    }
    study.summary("bias_power.csv", study.rows("power.csv", header, power_rows, *axes), by, columns)


def coverage_rows(number: int, seed: int) -> Rows:
    """Yield shares of intervals that hold: encoders have noise that the loop does not see."""
    name, seconds, rate, cutoff, noise = COVERED[number]
    arm = sized(name, rate, ("viscous",), seconds)
    processing = processing_of(rate, cutoff, FILTERED)
    log, rng = arm.log(seed), np.random.default_rng((seed, 2))
    log = replace(log, position=log.position + noise * rng.standard_normal(log.effort.shape))
    problem = arm.problem(log, processing)
    truth = problem.base_of(arm.model.theta)
    first, how = sdpid.solve_wls(problem), {"instruments": "reference", "solver": sdpid.solve_wls}
    second = sdpid.solve_instrumental(problem, log, processing=processing, **how)
    held = []
    for estimate, groups in ((first, "frequencies"), (second, "frequencies"), (second, "blocks")):
        errors = fit_errors(estimate, groups)
        T = errors.root
        deviation = np.sqrt(np.diag(T @ errors.scores @ T.T))
        half = stdtrit(errors.freedom(T), 0.975) * deviation
        held.append(np.mean(np.abs(estimate.base - truth) <= half))
    blocks = -(-problem.samples.n_samples // problem.samples.block)
    yield problem.robot.name, seconds, cutoff, noise, blocks, *held


def coverage(study: Study) -> None:
    """Write the table of coverages."""
    by = ("robot", "seconds", "cutoff_hz", "noise_rad", "blocks")
    header = (*by, "least", "second", "of_blocks")
    axes = range(len(COVERED))[: study.most], range(study.coverage_runs)
    columns = {
        "runs": "count least",
        "least_squares_percent": "percent least",
        "instruments_percent": "percent second",
        "instruments_blocks_percent": "percent of_blocks",
    }
    study.summary(
        "bias_coverage.csv", study.rows("coverage.csv", header, coverage_rows, *axes), by, columns
    )


def check_rows(robot: str, noise: float, seed: int) -> Rows:
    """Yield which controllers are refused on a log.

    The misfit of the right one's efforts and the standard error of their ratio are those of the
    joint that has most.
    """
    processing = processing_of(RATE_HZ, CUTOFF_HZ, MASKED)
    arm = sized(robot, RATE_HZ, ("coulomb", "viscous"))
    right, size, refused = arm.controller, (0.0, 0.0), []
    twin = Twin.of(arm.model.robot, arm.log(seed, noise), processing)
    for gain in CHECKED:
        law = sdpid.controllers.PD(gain * right.kp, gain * right.kd)
        check = ControllerCheck(ClosedLoop(twin, law, control_hz=CONTROL_HZ))
        if gain == 1.0:
            size = 100.0 * float(check.misfit.max()), 100.0 * float(check.error.max())
        try:
            check.require(CONTROLLER)
            refused.append(False)
        except DataError:
            refused.append(True)
    yield robot.rpartition("/")[2], noise, *size, *refused


def check(study: Study) -> None:
    """Write the table of refused controllers."""
    refused = [f"refused_{round(100 * gain)}_percent" for gain in CHECKED]
    header = ("robot", "noise_rad", "misfit", "error", *refused)
    axes = study.robots, NOISES, range(LOGS * study.loop_runs)
    found = study.rows("checks.csv", header, check_rows, *axes)
    columns = {"runs": "count misfit", "misfit_percent": "median misfit"}
    columns |= {"error_percent": "median error"} | {each: f"percent {each}" for each in refused}
    study.summary("controller_check.csv", found, header[:2], columns)


def cases(robots: list[str], gains: list[float]) -> list[tuple[str, str, float, float]]:
    """Return robots, methods, factors of the gains, and spreads of starts."""
    found = []
    for robot in (each for each in robots if each in ROBOTS[:2]):
        found.append((robot, "least squares", 1.0, 0.0))
        first = robot == ROBOTS[0] and len(gains) > 1
        for method in METHODS:
            found += [(robot, method, gain, 0.0) for gain in (*gains, *([HALF] * first))]
            if first and method != "instruments":
                found += [(robot, method, 1.0, spread) for spread in SPREADS]
    return found


def error_rows(robot: str, method: str, gain: float, spread: float, seed: int) -> Rows:
    """Yield error, number of linear problems, and seconds of a case on a log."""
    processing = processing_of(RATE_HZ, CUTOFF_HZ, MASKED)
    arm = sized(robot, RATE_HZ, ("coulomb", "viscous"))
    truth, log = arm.model.theta, arm.log(seed, NOISE)
    problem = arm.problem(log, processing)
    law = sdpid.controllers.PD(gain * arm.controller.kp, gain * arm.controller.kd)
    common = {"controller": law, "processing": processing, "solver": solved}
    closed = {"method": method, "control_hz": CONTROL_HZ, **common}
    if spread:
        drawn = np.random.default_rng((seed, 2)).uniform(-1.0, 1.0, len(truth))
        closed["start"] = truth * (1.0 + spread * drawn)
    refused, begin = False, time.process_time()
    if method == "least squares":
        estimate = solved(problem)
    elif method == "instruments":
        estimate = sdpid.solve_instrumental(problem, log, **common)
    else:
        try:
            estimate = sdpid.solve_output_error(problem, log, **closed)
        except DataError:
            refused, begin = True, time.process_time()
            closed["controller_tolerance"] = np.inf
            estimate = sdpid.solve_output_error(problem, log, **closed)
    seconds = time.process_time() - begin
    # Linear problems that were solved.
    own = 1 if method == "least squares" else estimate.iterations
    known = robot.rpartition("/")[2], method, gain, 100.0 * spread, refused
    error = off(problem.A, problem, arm, estimate.base)
    yield *known, error, getattr(estimate, "rounds", own), seconds


def errors(study: Study) -> None:
    """Write the table of output error."""
    by = ("robot", "method", "gains", "start_percent")
    header = (*by, "refused", "error", "iterations", "seconds")
    wanted = cases(study.robots, study.gains)
    found = study.rows("runs.csv", header, error_rows, wanted, range(study.loop_runs))
    columns = {"runs": "count error", "refused": "sum refused", "error_percent": "median error"}
    columns |= {each: f"median {each}" for each in ("iterations", "seconds")}
    study.summary("output_error.csv", found, by, columns)


PARTS: dict[str, Callable[[Study], None]] = {
    each.__name__: each for each in (size, power, coverage, check, errors)
}


def main() -> None:
    """Write the tables that are asked for."""
    study = Study(
        __doc__,
        quick={
            **{"runs": 2, "power_runs": 1, "coverage_runs": 1, "loop_runs": 1, "most": 1},
            **{"robots": [ROBOTS[0]], "gains": [GAINS[0]]},
        },
        parts=[*PARTS],
        runs=(36, "of each case of size"),
        power_runs=4,
        coverage_runs=60,
        loop_runs=(3, "of output error"),
        most=(len(SIZE), "cases of size, power and coverage"),
        robots=[*ROBOTS],
        gains=[*GAINS],
    )
    for part in study.parts:
        PARTS[part](study)


if __name__ == "__main__":
    main()
