"""Simulate a closed-loop experiment with an arm: controller, drives, friction and sensors."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, generator, real_array
from sdpid._common.extras import require
from sdpid._common.files import load_toml, read_regular
from sdpid._common.progress import progress as progress_bar
from sdpid.errors import DataError, ModelError
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.simulation.arm import SimulatedArm
from sdpid.experiment.simulation.closed_loop import LONGEST_STEP, simulate_closed_loop
from sdpid.experiment.simulation.controllers import P, keep_per_joint
from sdpid.experiment.trajectory.drawn import default_motion, plant_folder
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.robot.consistent import raise_second_moments
from sdpid.robot.description.catalog import bundled_robots
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.inertia import margin
from sdpid.robot.model.dynamics import RobotDynamics
from sdpid.robot.model.model import RobotModel

# A loop whose state after a period is the one before it to this (rad, rad/s) has settled: a
# thousandth of an encoder count, and far above the rounding of a period's steps.
SETTLED = 1e-9
# Most samples that are simulated at once: enough to drown what a call costs, few enough for memory.
_AT_ONCE = 20_000
# A link without mass in its description gets that of a screw (kg), and every link second moments
# (kg·m²) that a simulation can divide by.
_LEAST_MASS, _LEAST_MOMENT = 1e-3, 1e-7
# Friction where the description has none: Coulomb friction is this share of a joint's rms effort
# in the default motion, and viscous friction is as large at its rms speed.
_FRICTION = 0.1
# Poles of the velocity loop in 1/s, and of the position loop: far below what a step of 1 ms
# allows, and slow against each other.
_VELOCITY_POLE, _POSITION_POLE = 400.0, 8.0
# An error of position that is half the way from end to end is as large as the motion itself.
_MOST_LAG = 0.5
# Encoder counts a turn of the joint, and noise of the effort as a share of its rms.
_COUNTS, _NOISE = 2**19, 0.01
# Poles up to this many a step of the integrator are resolved: beyond, a loop is only damped.
_RESOLVED = 2.0
# States of the motion at which efforts and inertias are looked at.
_STATES = 200

# Moves a robot along samples start … stop − 1 from a state (2, n), None for the trajectory's first,
# to positions, velocities and efforts (3, K, n), and the state after them.
Move: TypeAlias = Callable[[int, int, Array | None], tuple[Array, Array]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Unmodeled:
    """Losses and ripple that a model linear in its parameters cannot hold.

    They are losses between motor and joint that the drive's inner loop makes up for: the motion
    is that of the robot without them, and the current shows them. To identification this is a
    robot whose effort has these terms beside the modeled ones.

    Attributes
    ----------
    ripple_amplitude, ripple_cycles : ndarray, shape (n,)
        N·m, and cycles a turn of the joint.
    eccentricity_amplitude : ndarray, shape (n,)
        N·m, twice a turn of the joint.
    stribeck_torque, stribeck_velocity : ndarray, shape (n,)
        N·m that friction at rest exceeds Coulomb friction, and the speed (rad/s) by which that
        has fallen to 1/e.
    coulomb_asymmetry : ndarray, shape (n,)
        N·m that friction is larger forwards and smaller backwards.
    viscous_curvature : ndarray, shape (n,)
        N·m·s²/rad², times ``v·|v|``.
    """

    ripple_amplitude: Array
    ripple_cycles: Array
    eccentricity_amplitude: Array
    stribeck_torque: Array
    stribeck_velocity: Array
    coulomb_asymmetry: Array
    viscous_curvature: Array

    def __post_init__(self) -> None:
        ripples = ("ripple_amplitude", "eccentricity_amplitude")
        signed = (*ripples, "coulomb_asymmetry", "viscous_curvature")
        names = [each.name for each in fields(self)]
        what, zero = "unmodeled effects", ("stribeck_torque",)
        keep_per_joint(self, what, names, signed=signed, not_negative=zero)

    def torque(self, position: Array, velocity: Array) -> Array:
        """Return what the motors supply for them, shape (K, n), in N·m."""
        stribeck = self.stribeck_torque * np.exp(-((velocity / self.stribeck_velocity) ** 2))
        return np.asarray(
            self.ripple_amplitude * np.sin(self.ripple_cycles * position)
            + self.eccentricity_amplitude * np.sin(2.0 * position)
            + stribeck * np.sign(velocity)
            + self.coulomb_asymmetry
            + self.viscous_curvature * velocity * np.abs(velocity)
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Drives:
    """Motors, controller and sensors of the n joints.

    For a prismatic joint read N for N·m and m for rad; its gear ratio is in rad/m.

    Attributes
    ----------
    torque_constant : ndarray, shape (n,)
        Motor torque per current, N·m/A.
    gear_ratio : ndarray, shape (n,)
        Motor turns per joint turn.
    proportional_gain : ndarray, shape (n,)
        Position loop, 1/s: velocity command per position error.
    velocity_gain : ndarray, shape (n,)
        Velocity loop, N·m·s/rad: joint torque per velocity error.
    encoder_counts : ndarray, shape (n,)
        Counts a turn of the motor.
    current_noise : ndarray, shape (n,)
        Root mean square of the white noise on measured currents, A.
    unmodeled : Unmodeled, optional
        Effects added on request.

    Raises
    ------
    DataError
        When a value is not finite or not positive, or lengths differ.

    Examples
    --------
    >>> from sdpid.experiment.plant.simulate import load_drives
    >>> drives = load_drives("denso_vp6242")
    >>> drives.n, drives.effort_scale.round(2)
    (6, array([45.6, 60.8, 26.4, 21. , 21. , 21. ]))
    """

    torque_constant: Array
    gear_ratio: Array
    proportional_gain: Array
    velocity_gain: Array
    encoder_counts: Array
    current_noise: Array
    unmodeled: Unmodeled | None = None

    def __post_init__(self) -> None:
        names = [each.name for each in fields(self) if each.name != "unmodeled"]
        keep_per_joint(self, "drives", names, not_negative=("current_noise",))
        if self.unmodeled is not None and len(self.unmodeled.ripple_cycles) != self.n:
            raise DataError(
                f"drives: {self.n} joints, but unmodeled effects of "
                f"{len(self.unmodeled.ripple_cycles)}."
            )

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.torque_constant)

    @property
    def effort_scale(self) -> Array:
        """Joint torque per current, N·m/A, shape (n,)."""
        return np.asarray(self.torque_constant * self.gear_ratio)

    @property
    def resolution(self) -> Array:
        """Smallest step of a measured joint position, rad, shape (n,)."""
        return np.asarray(2.0 * np.pi / (self.encoder_counts * self.gear_ratio))


def load_drives(folder: str | os.PathLike[str]) -> Drives:
    """Read ``drives.toml`` of a bundled robot, or of a folder.

    Raises
    ------
    DataError
        When the file is missing or not understood.
    """
    path = plant_folder(folder) / "drives.toml"
    values = load_toml(path)
    effects = values.pop("unmodeled", None)
    try:
        return Drives(**values, unmodeled=None if effects is None else Unmodeled(**effects))
    except TypeError as cause:
        raise DataError(f"{path}: not understood ({cause}).") from None


def default_parameters(robot: RobotModel) -> Array:
    """Return theta from a robot's description, with assumed friction where it has none.

    They do not depend on what is simulated: several motions are of one robot.

    Returns
    -------
    ndarray, shape (10·links + 2n,)
        Standard parameters of the links, then Coulomb and viscous friction of all joints.
    """
    bodies = np.array(robot.prior)
    massless = bodies[:, 0] < _LEAST_MASS
    bodies[massless] = 0.0
    bodies[massless, 0] = _LEAST_MASS
    bodies = raise_second_moments(bodies, _LEAST_MOMENT)
    effort, speed = _usual(robot, bodies, default_motion(robot))
    viscous, coulomb = robot.described_friction()
    coulomb = np.where(coulomb > 0.0, coulomb, _FRICTION * effort)
    viscous = np.where(viscous > 0.0, viscous, _FRICTION * effort / speed)
    return np.concatenate([bodies.ravel(), coulomb, viscous])


def default_drives(robot: RobotModel, theta: Array, trajectory: Trajectory) -> Drives:
    """Return drives that move a robot along a trajectory; efforts are measured in N·m.

    Gains follow the inertia that each joint feels, so that the fastest pole of the velocity loop
    is at 400/s. Encoders have 2^19 counts a turn, efforts noise of 1 % of their rms.
    """
    mobility = np.linalg.inv(robot.mass_matrix(theta, _states(trajectory)[0]))
    felt = (1.0 / np.diagonal(mobility, axis1=1, axis2=2)).min(axis=0)
    fastest = _fastest(mobility, felt)
    ones = np.ones(robot.n)
    effort, _ = _usual(robot, theta, trajectory)
    return Drives(
        torque_constant=ones,
        gear_ratio=ones,
        proportional_gain=_POSITION_POLE * ones,
        velocity_gain=_VELOCITY_POLE / fastest * felt,
        encoder_counts=_COUNTS * ones,
        current_noise=_NOISE * effort,
    )


def follows(robot: RobotModel, theta: Array, drives: Drives, trajectory: Trajectory) -> bool:
    """Tell whether the drives can move every joint against its friction.

    A light link with the friction that descriptions copy from heavy ones stays where it is.
    """
    coulomb, viscous = theta[10 * robot.n_links :].reshape(2, robot.n)
    speed = np.sqrt(np.mean(trajectory.velocity_period**2, axis=0))
    lag = (coulomb + viscous * speed) / (drives.velocity_gain * drives.proportional_gain)
    return bool(np.all(lag <= _MOST_LAG * np.ptp(trajectory.position_period, axis=0)))


def _states(trajectory: Trajectory) -> list[Array]:
    """Return positions, velocities and accelerations spread over a period."""
    step, first = max(1, trajectory.samples_per_period // _STATES), trajectory.lead_samples
    period = trajectory.sample(first, first + trajectory.samples_per_period)
    return [values[::step] for values in period]


def _usual(robot: RobotModel, bodies: Array, trajectory: Trajectory) -> tuple[Array, Array]:
    """Return the rms effort and the rms speed of every joint, neither zero."""
    states = _states(trajectory)
    effort = np.sqrt(np.mean(robot.inverse_dynamics(bodies, *states) ** 2, axis=0))
    speed = np.sqrt(np.mean(states[1] ** 2, axis=0))
    # A joint that bears next to nothing still has friction: a thousandth of the largest effort.
    least = 1e-3 * max(float(effort.max()), 1e-3)
    return np.maximum(effort, least), np.maximum(speed, 1e-3)


def fastest_pole(
    robot: RobotModel, trajectory: Trajectory, theta: Array, drives: Drives
) -> tuple[float, float]:
    """Return the velocity loop's fastest pole along a trajectory, and the limit of it, in 1/s."""
    damping = drives.velocity_gain + theta[10 * robot.n_links + robot.n :]
    period = trajectory.position_period
    few = period[:: max(1, len(period) // 20)]
    mobility = np.linalg.inv(robot.mass_matrix(theta, few))
    steps = np.ceil(1.0 / (trajectory.rate_hz * LONGEST_STEP) - 1e-9)
    return _fastest(mobility, damping), float(_RESOLVED * trajectory.rate_hz * steps)


def _fastest(mobility: Any, damping: Array) -> float:
    """Return the fastest pole of M·a = −D·v, 1/s."""
    # M⁻¹·D has the eigenvalues of D^½·M⁻¹·D^½.
    root = np.sqrt(damping)
    return float(np.linalg.eigvalsh(root[:, None] * mobility * root).max())


def check_bodies(robot: RobotModel, bodies: Array) -> None:
    """Refuse links that no body has.

    Raises
    ------
    ModelError
        When one is not physically consistent.
    """
    margins = margin(bodies, "pseudo_inertia")
    for name, body, value in zip(robot.link_names, bodies, margins, strict=True):
        # Not a number where the mass is not positive.
        if not value >= 0.0:
            raise ModelError(
                f"plant of '{robot.name}': no body has the parameters given for {name}: mass "
                f"{body[0]:.3g} kg, smallest second moment about the center of mass {value:.3g} "
                "kg·m² (limits 0); a plant needs physically consistent links."
            )


def true_parameters(folder: str | os.PathLike[str]) -> Array:
    """Read theta of a plant from ``true_parameters.csv`` of a bundled robot or a folder.

    Returns
    -------
    ndarray, shape (10·links + 2n,)

    Raises
    ------
    DataError
        When the file is missing or its column ``value`` is not all numbers.
    """
    path = plant_folder(folder) / "true_parameters.csv"
    content = read_regular(path)
    try:
        rows = csv.DictReader(content.decode("utf-8").splitlines())
        values = [float(row["value"]) for row in rows]
    except (KeyError, TypeError, ValueError) as cause:
        raise DataError(f"{path}: {cause!r}; it needs a column 'value' of numbers.") from None
    return np.array(values)


def simulate(
    robot: RobotModel,
    trajectory: Trajectory | None = None,
    *,
    theta: ArrayLike | None = None,
    seed: int | np.random.Generator = 0,
    drives: Drives | None = None,
    unmodeled: bool = False,
    noise: bool = True,
    exact: bool = False,
    progress: bool | None = None,
) -> Recording:
    """Run a trajectory on a simulated robot and record positions and efforts.

    A proportional position controller commands the drives' velocity loop:
    ``torque = velocity_gain·(proportional_gain·(q_d − q) − v)``. Joints have Coulomb and viscous
    friction. Recorded are encoder positions, the desired ones (`Recording.reference`), and noisy
    motor currents, as efforts in N·m.

    The record has `trajectory.n_samples` samples: whole periods from ``Recording.start`` on, after
    one settling period that is not recorded. A motion that ends elsewhere than it starts is run
    once, and its record has no periods.

    With `exact` the robot follows the trajectory exactly, and its efforts are those of its
    equation of motion. So does a robot with mimic joints, and one whose description has so much
    damping that default drives would not move it as desired. `Recording.notes` say so.

    Parameters
    ----------
    robot : RobotModel
        The robot, on a fixed base.
    trajectory : Trajectory, optional
        The desired motion; its joints are the robot's. By default `default_motion`, which is
        five periods of 20 s.
    theta : array_like, shape (10·links + 2n,), optional
        True parameters: the links' standard parameters, then Coulomb and viscous friction of
        all joints. By default those of the bundled robot of this name, or `default_parameters`.
    seed : int or numpy.random.Generator, optional
        The only source of randomness: the current noise.
    drives : Drives, optional
        Motors, gains and sensors; by default those of the bundled robot of this name, or
        `default_drives`.
    unmodeled : bool, optional
        Add `drives.unmodeled`.
    noise : bool, optional
        Without it the same motion and torques are recorded without quantization and noise.
    exact : bool, optional
        Follow the trajectory exactly, without a controller.
    progress : bool, optional
        Show a progress bar; by default on a terminal.

    Returns
    -------
    Recording
        The log; its efforts are the measured currents times torque constant and gear ratio.

    Raises
    ------
    MissingExtraError
        When the arm is simulated under its controller, without the extra ``fast``.
    DataError
        When joints do not match, theta has the wrong length, or the loop is unstable.
    ModelError
        When theta belongs to no real robot.

    Examples
    --------
    >>> run = sdpid.simulate(robot, motion, exact=True, seed=1)
    >>> run
    Recording(38000 samples, 6 joints, 1000 Hz, 2 periods of 10 s, with reference)
    >>> run.notes
    ('simulated without a controller: the robot follows its motion exactly',)
    """
    rng = generator(seed)
    if trajectory is None:
        trajectory = default_motion(robot, rng)
    made_up = drives is None and robot.name not in bundled_robots()
    theta, drives = plant_parts(robot, trajectory, theta, drives)
    exact = exact or robot.expansion.shape != (robot.n, robot.n)
    if made_up and not exact:
        fastest, limit = fastest_pole(robot, trajectory, theta, drives)
        exact = fastest >= limit or not follows(robot, theta, drives, trajectory)
    if unmodeled and exact:
        raise DataError(
            f"simulate: '{robot.name}' follows its motion exactly, as asked, or for mimic joints "
            "or large damping; unmodeled effects are not simulated."
        )
    if unmodeled and drives.unmodeled is None:
        raise DataError("simulate: these drives have no unmodeled effects; set them.")
    terms = FrictionModel.from_terms(("coulomb", "viscous"), robot.joint_names)
    model = RobotDynamics(robot=robot, terms=terms, theta=theta)
    move = _followed(model, trajectory) if exact else controlled(model, trajectory, drives)

    def measured(start: int, stop: int, state: Array | None) -> tuple[Array, Array]:
        (q, v, torque), after = move(start, stop, state)
        if unmodeled and drives.unmodeled:
            torque = torque + drives.unmodeled.torque(q, v)
        if noise:
            q = np.rint(q / resolution) * resolution
        return np.stack([q, torque, trajectory.sample(start, stop)[0]]), after

    position, effort, reference = np.empty((3, trajectory.n_samples, robot.n))
    row, scale, resolution = 0, drives.effort_scale, drives.resolution
    settling = trajectory.samples_per_period if trajectory.closed else 0
    total = trajectory.n_samples + settling
    with progress_bar(total, "simulating", enabled=progress) as advance:
        for q, torque, desired in _parts(trajectory, settling, measured, advance):
            rows = slice(row, row + len(q))
            row += len(q)
            current = torque / scale
            if noise:
                current += drives.current_noise * rng.standard_normal(current.shape)
            position[rows], effort[rows], reference[rows] = q, current * scale, desired
    rate, lead = trajectory.rate_hz, trajectory.lead_samples
    notes = ("simulated without a controller: the robot follows its motion exactly",)
    return Recording(
        time=np.arange(trajectory.n_samples) / rate,
        position=position,
        effort=effort,
        reference=reference,
        joint_names=robot.joint_names,
        period=trajectory.period if trajectory.closed else None,
        start=lead / rate if trajectory.closed else None,
        periods=trajectory.periods if trajectory.closed else None,
        notes=notes if exact else (),
    )


def controlled(model: RobotDynamics, trajectory: Trajectory, drives: Drives) -> Move:
    """Return what moves a robot in closed loop along samples of a trajectory.

    Raises
    ------
    MissingExtraError
        Without a compiler, which 100 s of an arm need to take seconds and not minutes.
    ModelError
        When the base floats, a joint has no motor, or links are no bodies.
    DataError
        When the velocity loop is too fast for the sample rate.
    """
    require("numba", extra="fast")
    robot, rate = model.robot, trajectory.rate_hz
    arm = SimulatedArm.of(model)
    check_bodies(robot, model.theta[: 10 * robot.n_links].reshape(-1, 10))
    fastest, limit = fastest_pole(robot, trajectory, model.theta, drives)
    if not fastest < limit:
        raise DataError(
            f"plant of '{robot.name}': the velocity loop's fastest pole is at {fastest:.4g}/s, "
            f"too fast for a rate of {rate:g} Hz (limit {limit:.4g}/s); lower velocity_gain or "
            "raise the sample rate."
        )
    law = P(drives.proportional_gain, drives.velocity_gain)

    def move(start: int, stop: int, state: Array | None) -> tuple[Array, Array]:
        if stop - start > _AT_ONCE:
            middle = (start + stop) // 2
            before, now = move(start, middle, state)
            after, end = move(middle, stop, now)
            return np.concatenate([before, after], axis=1), end
        # With the sample after these, which has the state after them.
        told = np.stack(trajectory.sample(start, min(stop + 1, trajectory.n_samples)))
        # A last sample alone is held.
        told = told if told.shape[1] > 1 else np.repeat(told, 2, axis=1)
        begin = (told[0][0], np.zeros(robot.n)) if state is None else tuple(state)
        found = simulate_closed_loop(arm, tuple(told), law, rate_hz=rate, start=begin)
        if found.diverged is not None:
            raise DataError(
                f"plant: the motion diverges {found.diverged:.3g} s after sample {start}: the loop "
                "is unstable; lower velocity_gain or proportional_gain."
            )
        states = np.stack([found.position, found.velocity, found.effort])
        return states[:, : stop - start], states[:2, -1]

    return move


def _followed(model: RobotDynamics, trajectory: Trajectory) -> Move:
    """Return what follows a trajectory exactly; its state never changes."""

    def move(start: int, stop: int, state: Array | None) -> tuple[Array, Array]:
        states = trajectory.sample(start, stop)
        effort = model.inverse_dynamics(*states)
        return np.stack([*states[:2], effort]), np.zeros((2, model.robot.n))

    return move


def _parts(
    trajectory: Trajectory, settling: int, measured: Move, advance: Callable[[float], None]
) -> Iterator[Array]:
    """Yield the record in parts: positions, efforts and desired positions, (3, K, n)."""
    lead, end, period = trajectory.lead_samples, trajectory.n_samples, trajectory.samples_per_period
    # Rest, connection and the settling period, within which the record begins; then the periods.
    spans = [(0, lead + settling, settling), *[(lead, lead + period, 0)] * trajectory.periods]
    state: Array | None = None
    done, settled = (0, 0, 0), False
    for span in (*spans, (end - lead, end, 0)):
        start, stop, skipped = span
        if start == stop:
            continue
        # A loop that has settled moves as in the period before.
        if span != done or not settled:
            states, after = measured(start, stop, state)
            settled = state is not None and bool(np.abs(after - state).max() <= SETTLED)
            done, state = span, after
        advance(stop - start)
        yield states[:, skipped:]


def plant_parts(
    robot: RobotModel, trajectory: Trajectory, theta: ArrayLike | None, drives: Drives | None
) -> tuple[Array, Drives]:
    """Return parameters and drives: the given ones, the bundled robot's, or made-up ones."""
    if trajectory.joint_names != robot.joint_names:
        raise DataError(
            f"simulate: the trajectory moves {', '.join(trajectory.joint_names)}; robot "
            f"'{robot.name}' has {', '.join(robot.joint_names)}."
        )
    bundled = robot.name in bundled_robots()
    if theta is None:
        theta = true_parameters(robot.name) if bundled else default_parameters(robot)
    values = real_array(theta, "theta", ndim=1, error=ModelError)
    expected = 10 * robot.n_links + 2 * robot.n
    if values.shape != (expected,):
        raise DataError(
            f"theta: {values.size} numbers, a plant of '{robot.name}' needs {expected}: "
            f"10 for each of {robot.n_links} links, then Coulomb and viscous friction of "
            f"{robot.n} joints."
        )
    friction = values[10 * robot.n_links :]
    if friction.min() < 0.0:
        raise ModelError(f"theta: friction of {friction.min():.3g}; it cannot be negative.")
    if drives is None:
        drives = load_drives(robot.name) if bundled else default_drives(robot, values, trajectory)
    if drives.n != robot.n:
        raise DataError(f"simulate: {drives.n} drives, robot '{robot.name}' has {robot.n} joints.")
    return values, drives
