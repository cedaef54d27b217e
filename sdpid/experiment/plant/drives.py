"""Drives, sensors and parameters of a simulated arm, given or made up."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.files import load_toml
from sdpid.errors import DataError, ModelError
from sdpid.experiment.plant.default_motion import default_motion
from sdpid.experiment.simulation.closed_loop import LONGEST_STEP
from sdpid.experiment.simulation.controllers import keep_per_joint
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.robot.consistent import raise_second_moments
from sdpid.robot.description.catalog import bundled_folder, bundled_robots
from sdpid.robot.inertia import margin
from sdpid.robot.model.model import RobotModel

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
    >>> from sdpid.experiment.plant.drives import load_drives
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

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any], *, what: str = "drives") -> Drives:
        """Build from the content of a TOML file (see ``models/denso_vp6242/drives.toml``).

        Raises
        ------
        DataError
            When an entry is missing or unknown.
        """
        values = dict(data)
        extra = values.pop("unmodeled", None)
        try:
            effects = None if extra is None else Unmodeled(**extra)
            return cls(**values, unmodeled=effects)
        except TypeError as cause:
            raise DataError(f"{what}: not understood ({cause}).") from None


def load_drives(folder: str | os.PathLike[str]) -> Drives:
    """Read ``drives.toml`` of a bundled robot, or of a folder.

    Raises
    ------
    DataError
        When the file is missing or not understood.
    """
    path = plant_folder(folder) / "drives.toml"
    return Drives.from_mapping(load_toml(path), what=str(path))


def plant_folder(folder: str | os.PathLike[str]) -> Path:
    """Return the folder of a bundled robot, or the path as it is."""
    if isinstance(folder, str) and folder in bundled_robots():
        return bundled_folder(folder)
    return Path(folder)


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
