"""What is true of a simulated robot with legs: parameters, friction, motion without sensors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen, frozen_view, generator
from sdpid.errors import DataError
from sdpid.experiment.plant.simulate import check_bodies
from sdpid.robot.friction.terms import Coulomb, Stribeck
from sdpid.robot.inertia import from_pseudo_inertia, pseudo_inertia
from sdpid.robot.legs import Legs, find_legs
from sdpid.robot.model.model import RobotModel

# Friction and rotor inertia of a joint, where nobody gives them. Coulomb friction is this share of
# what the joint bears at its lever, viscous friction this share of that at 1 rad/s, and the rotor
# inertia this share of the robot's mass at a leg's length, less where a joint bears less: 0.2 N·m,
# 0.06 N·m·s and 0.01 kg·m² on a quadruped of 13 kg, 0.03, 0.009 and 0.001 on one of 2.5 kg.
_COULOMB, _VISCOUS, _ROTOR = 0.03, 0.3, 0.02
_GRAVITY = 9.81


# The narrowest sign over its height at which steps of 1 ms integrate without chatter, rad/s: the
# slope of friction damps a rotor of the default size by 1/ms there, for a leg of 0.25 m; the
# method of Runge and Kutta bears 2.8/ms.
_NARROWEST = 0.015


@dataclass(frozen=True, kw_only=True)
class DryFriction:
    """Dry friction of joints, as a multiple of their Coulomb friction.

    The torque ``Fs·(1 + peak·exp(−(v/peak_speed)²))·tanh(v/width)``: Coulomb friction with a
    smooth sign, and a Stribeck peak [armstrong1994]_.

    Attributes
    ----------
    width : float
        Speed that makes the sign smooth, rad/s.
    peak : float
        Friction above Coulomb's at low speed, as a share of it.
    peak_speed : float
        Speed at which the peak has fallen to 1/e, rad/s.

    Raises
    ------
    DataError
        When a speed is not positive, the peak is negative, or friction is too steep to integrate.

    Examples
    --------
    >>> from sdpid.experiment.plant.legged.truth import DryFriction
    >>> law = DryFriction(width=0.05, peak=0.3, peak_speed=0.2)
    >>> law(np.array([-1.0, 0.0, 0.1, 1.0])).round(3)
    array([-1.   ,  0.   ,  1.189,  1.   ])
    >>> run = sdpid.simulate_legged("solo12", "hang", duration=0.1, friction=law)
    >>> run.friction
    DryFriction(width=0.05, peak=0.3, peak_speed=0.2)
    """

    width: float = 0.02
    peak: float = 0.0
    peak_speed: float = 0.1

    def __post_init__(self) -> None:
        for name in ("width", "peak_speed"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise DataError(f"{name}: {getattr(self, name)}; give a positive speed in rad/s.")
        if not 0.0 <= self.peak < np.inf:
            raise DataError(f"peak: {self.peak}; give a share of Coulomb friction, 0 or more.")
        if self.width < _NARROWEST * (1.0 + self.peak):
            raise DataError(
                f"width: {self.width:g} rad/s with a peak of {self.peak:g} is too steep to be "
                f"integrated; the limit is {_NARROWEST * (1.0 + self.peak):.3g} rad/s."
            )

    def __call__(self, velocity: Array) -> Array:
        """Return the friction of a joint over its Coulomb friction at velocities in rad/s."""
        peak = self.peak * np.exp(-((velocity / self.peak_speed) ** 2)) if self.peak else 0.0
        return np.asarray((1.0 + peak) * np.tanh(velocity / self.width))

    @property
    def terms(self) -> tuple[Coulomb, ...] | tuple[Coulomb, Stribeck]:
        """The friction terms of `sdpid.identify` with which an estimate can follow this law."""
        coulomb = Coulomb(width=self.width)
        if not self.peak:
            return (coulomb,)
        return coulomb, Stribeck(velocity=self.peak_speed, width=self.width)


@dataclass(frozen=True, kw_only=True, eq=False)
class TrueMotion:
    """A motion as it was, in Pinocchio's order, without sensors.

    Attributes
    ----------
    position : ndarray, shape (N, nq)
        Base position, quaternion (x, y, z, w), joints: the robot's coordinates, as all of these.
    velocity, acceleration : ndarray, shape (N, nv)
        Of the base linear and angular in base axes, then of the joints.
    effort : ndarray, shape (N, nv)
        Zeros for the base, then torques of the motors, N·m.
    friction : ndarray, shape (N, joints)
        Torques that friction takes, N·m.
    wrenches : ndarray, shape (N, c, 6)
        Forces and torques on the robot at the frames of the contacts, world axes.
    down : ndarray, shape (N, c)
        Whether a contact is closed.
    """

    position: Array
    velocity: Array
    acceleration: Array
    effort: Array
    friction: Array
    wrenches: Array
    down: Mask

    def after(self, samples: int) -> TrueMotion:
        """Return the motion without its first samples."""
        return TrueMotion(
            **{name: frozen_view(value[samples:]) for name, value in vars(self).items()}
        )


def changed_parameters(
    robot: RobotModel,
    *,
    change: float = 0.15,
    seed: int | np.random.Generator = 0,
    legs: Legs | None = None,
) -> Array:
    """Return parameters of a robot that differs from its description, with friction.

    Every link's mass, center of mass and inertia change together, and stay those of a body: its
    pseudo-inertia is moved along a random direction by `change` in the body's own units, so that
    masses change by about this share.

    Parameters
    ----------
    robot : RobotModel
        The robot, on a floating base.
    change : float, optional
        Size of the change; 0 leaves the links as described.
    seed : int or numpy.random.Generator, optional
        Randomness of the change.
    legs : Legs, optional
        Its legs; by default `find_legs`.

    Returns
    -------
    ndarray, shape (10·links + 3·joints,)
        The links' standard parameters, then Coulomb and viscous friction and rotor inertia of all
        joints.

    Raises
    ------
    ModelError
        When a link of the description is no body.

    Examples
    --------
    >>> from sdpid.experiment.plant.legged.truth import changed_parameters
    >>> quadruped = sdpid.load_robot("solo12", root="free_flyer")
    >>> theta = changed_parameters(quadruped, seed=1)
    >>> (theta[:130:10] / quadruped.prior[:, 0]).round(2)[:3]
    array([1.11, 1.01, 0.84])
    """
    rng = generator(seed)
    legs = find_legs(robot) if legs is None else legs
    # Nothing can be near a body that cannot exist.
    check_bodies(robot, robot.prior)
    bodies = np.empty_like(robot.prior)
    for i, body in enumerate(robot.prior):
        step = change * rng.normal(size=(4, 4))
        values, axes = np.linalg.eigh((step + step.T) / 2.0)
        root = np.linalg.cholesky(pseudo_inertia(body))
        moved = root @ (axes * np.exp(values)) @ axes.T @ root.T
        bodies[i] = from_pseudo_inertia(moved)
    return frozen(np.concatenate([bodies.ravel(), *default_friction(legs, robot)]))


def default_friction(legs: Legs, robot: RobotModel) -> tuple[Array, Array, Array]:
    """Return Coulomb and viscous friction and rotor inertia of all joints, or their motors."""
    mass, lever = legs.loads
    gears = np.abs(robot.expansion[6:, 6:])
    coulomb = (_COULOMB * _GRAVITY * mass * lever) @ gears
    rotor = (_ROTOR * len(legs.frames) * mass * lever**2) @ gears**2
    return coulomb, _VISCOUS * coulomb, rotor
