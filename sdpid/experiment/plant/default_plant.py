"""Default parameters and drives of a simulated robot."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.plant.default_motion import default_motion
from sdpid.experiment.plant.drives import Drives
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.robot.consistent import raise_second_moments
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
# States of the motion at which efforts and inertias are looked at.
_STATES = 200


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
    bodies = theta[: 10 * robot.n_links].reshape(-1, 10)
    felt = np.full(robot.n, np.inf)
    inverses = [np.linalg.inv(robot.mass_matrix(bodies, q)) for q in _states(trajectory)[0]]
    for inverse in inverses:
        felt = np.minimum(felt, 1.0 / np.diagonal(inverse))
    # M⁻¹·D has the eigenvalues of D^½·M⁻¹·D^½.
    root = np.sqrt(felt)
    fastest = max(np.linalg.eigvalsh(root[:, None] * inverse * root)[-1] for inverse in inverses)
    ones = np.ones(robot.n)
    effort, _ = _usual(robot, bodies, trajectory)
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


def _states(trajectory: Trajectory) -> tuple[Array, Array, Array]:
    """Return positions, velocities and accelerations spread over a period."""
    step = max(1, trajectory.samples_per_period // _STATES)
    return (
        trajectory.position_period[::step],
        trajectory.velocity_period[::step],
        trajectory.acceleration_period[::step],
    )


def _usual(robot: RobotModel, bodies: Array, trajectory: Trajectory) -> tuple[Array, Array]:
    """Return the rms effort and the rms speed of every joint, neither zero."""
    states = _states(trajectory)
    effort = np.sqrt(np.mean(robot.inverse_dynamics(bodies, *states) ** 2, axis=0))
    speed = np.sqrt(np.mean(states[1] ** 2, axis=0))
    # A joint that bears next to nothing still has friction: a thousandth of the largest effort.
    least = 1e-3 * max(float(effort.max()), 1e-3)
    return np.maximum(effort, least), np.maximum(speed, 1e-3)
