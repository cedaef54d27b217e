"""Motions of a robot with legs: where the base and the feet shall be, and when feet are down."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.errors import DataError
from sdpid.experiment.plant.legged.legs import Legs

__all__ = ["MOTIONS", "Plan", "plan_motion"]

# Instants a second at which inverse kinematics is solved: splines between them are exact to 1e-6
# of a motion of 3 Hz.
_KNOT_RATE = 200.0
# The robot stands for this long before it moves, s: what falls to the ground comes to rest.
LEAD = 1.0
# The motion grows to its size over this long, s.
_RAMP = 0.5
# Amplitudes of the base: metres for a leg of 1 m, and rad. Sines in each of the six directions.
_SWAY, _TILT = 0.12, 0.18
_SWAY_HZ = ((0.35, 0.9, 1.7), (0.45, 1.1, 1.9), (0.4, 1.3, 2.1))
_TILT_HZ = ((0.5, 1.2, 2.0), (0.55, 1.0, 1.8), (0.3, 0.8, 1.5))
# Shares of the sines: slower ones are larger, so that all accelerate alike.
_SHARES = (0.6, 0.3, 0.1)
# Gaits: seconds a cycle, share of it that a foot is down, and height of a step for a leg of 1 m.
_TROT = (0.5, 0.6, 0.2)
_WALK = (2.0, 0.85, 0.2)
# Speed of the walk for a leg of 1 m, m/s.
_SPEED = 0.4
# Hanging: amplitudes of the joints in rad, and frequencies in Hz.
_SWING = 0.35
_SWING_HZ = (0.4, 0.7, 1.1, 1.6, 2.3)


@dataclass(frozen=True, eq=False)
class Plan:
    """A desired motion.

    Attributes
    ----------
    joints : callable
        Joint positions and velocities wanted at times (K,), two arrays (K, joints).
    base : callable
        Positions (K, 3) and rotation vectors (K, 3) of the base at times.
    down : callable
        Which feet shall bear weight, (K, c) bool.
    held : bool
        Whether the base is held in the air.
    duration : float
        Length without the lead, s.
    """

    joints: Callable[[Array], tuple[Array, Array]]
    base: Callable[[Array], tuple[Array, Array]]
    down: Callable[[Array], Mask]
    held: bool
    duration: float


def plan_motion(legs: Legs, motion: str, *, duration: float, rng: np.random.Generator) -> Plan:
    """Plan a motion by its name.

    Parameters
    ----------
    legs : Legs
        The robot.
    motion : {"stand", "trot", "walk", "hang"}
        Stand with a swaying base, trot in place, walk forward, or move all joints with the base
        held in the air.
    duration : float
        Seconds.
    rng : numpy.random.Generator
        Phases of the sines.

    Raises
    ------
    DataError
        For an unknown motion, or one that the legs cannot do.
    """
    if motion not in MOTIONS:
        raise DataError(f"motion {motion!r}: there are {', '.join(MOTIONS)}.")
    return MOTIONS[motion](legs, duration, rng)


def _stand(legs: Legs, duration: float, rng: np.random.Generator) -> Plan:
    sway = _base_sines(legs, rng, 1.0)
    places = legs.feet(legs.standing[None])[0]
    return _planned(
        legs,
        duration,
        sway,
        lambda t: np.broadcast_to(places, (len(t), *places.shape)),
        lambda t: np.ones((len(t), len(places)), bool),
    )


def _trot(legs: Legs, duration: float, rng: np.random.Generator) -> Plan:
    return _gait(legs, duration, rng, _TROT, _diagonal(legs), speed=0.0, shift=0.0)


def _walk(legs: Legs, duration: float, rng: np.random.Generator) -> Plan:
    return _gait(legs, duration, rng, _WALK, _one_by_one(legs), speed=_SPEED, shift=1.0)


def _hang(legs: Legs, duration: float, rng: np.random.Generator) -> Plan:
    n = legs.n_joints
    frequency = rng.permuted(np.tile(_SWING_HZ, (n, 1)), axis=1)[:, :3] * rng.uniform(
        0.9, 1.1, (n, 3)
    )
    phase = rng.uniform(0.0, 2.0 * np.pi, (n, 3))
    size = _SWING * np.array(_SHARES) / frequency

    def joints(t: Array) -> tuple[Array, Array]:
        angle = 2.0 * np.pi * frequency * t[:, None, None] + phase
        ramp, rate = _ramp(t)
        wave = np.sum(size * np.sin(angle), axis=2)
        slope = np.sum(size * 2.0 * np.pi * frequency * np.cos(angle), axis=2)
        return (
            legs.standing + ramp[:, None] * wave,
            ramp[:, None] * slope + rate[:, None] * wave,
        )

    height = np.array([0.0, 0.0, 2.0 * float(np.abs(legs.feet(legs.standing[None])).max())])

    def base(t: Array) -> tuple[Array, Array]:
        return np.broadcast_to(height, (len(t), 3)), np.zeros((len(t), 3))

    return Plan(joints, base, lambda t: np.zeros((len(t), len(legs.frames)), bool), True, duration)


MOTIONS: dict[str, Callable[[Legs, float, np.random.Generator], Plan]] = {
    "stand": _stand,
    "trot": _trot,
    "walk": _walk,
    "hang": _hang,
}


def _gait(
    legs: Legs,
    duration: float,
    rng: np.random.Generator,
    gait: tuple[float, float, float],
    phases: Array,
    *,
    speed: float,
    shift: float,
) -> Plan:
    """Plan a gait: feet lifted in turn, the base above those that are down."""
    cycle, duty, lift = gait
    places = legs.feet(legs.standing[None])[0]
    length = legs.height
    sway = _base_sines(legs, rng, 0.25)
    stride = speed * length * cycle
    # The weight above the middle of the feet: a pair of them on a diagonal bears it alone.
    middle = places[:, :2].mean(axis=0) - legs.center_of_mass[:2]

    def phase(t: Array) -> Array:
        return np.asarray(np.mod(t[:, None] / cycle + phases, 1.0))

    def feet(t: Array) -> Array:
        # In the frame that moves along with the walk: back while down, forth while lifted.
        share = phase(t)
        swing = np.clip((share - duty) / (1.0 - duty), 0.0, 1.0)
        smooth = swing**3 * (10.0 - 15.0 * swing + 6.0 * swing**2)
        ramp = _ramp(t)[0][:, None]
        out = np.tile(places, (len(t), 1, 1))
        along = np.where(share < duty, 0.5 - share / duty, smooth - 0.5)
        out[:, :, 0] += ramp * stride * duty * along
        # Zero slope and zero acceleration at both ends.
        out[:, :, 2] += ramp * lift * length * 64.0 * (swing * (1.0 - swing)) ** 3
        return out

    def down(t: Array) -> Mask:
        return np.asarray(phase(t) < duty)

    def base(t: Array) -> tuple[Array, Array]:
        position, turn = sway(t)
        # Away from the foot that is lifted, ahead of time and smoothly: the first harmonic.
        angle = 2.0 * np.pi * (t[:, None] / cycle + phases - (1.0 + duty) / 2.0)
        lean = -shift * 0.5 * np.mean(np.cos(angle)[:, :, None] * places[:, :2], axis=1)
        position = position.copy()
        position[:, :2] += _ramp(t)[0][:, None] * (lean + middle)
        return position, turn

    return _planned(legs, duration, base, feet, down)


def _planned(
    legs: Legs,
    duration: float,
    base: Callable[[Array], tuple[Array, Array]],
    feet: Callable[[Array], Array],
    down: Callable[[Array], Mask],
) -> Plan:
    """Solve for the joints at knots; feet are given in the frame of the undisturbed base."""
    from scipy.interpolate import make_interp_spline
    from scipy.spatial.transform import Rotation

    knots = np.arange(0.0, LEAD + duration + 2.0 / _KNOT_RATE, 1.0 / _KNOT_RATE)
    position, turn = base(knots)
    away = feet(knots) - position[:, None]
    wanted = np.einsum("kji,kcj->kci", Rotation.from_rotvec(turn).as_matrix(), away)
    spline = make_interp_spline(knots, legs.reach(wanted), k=5)
    slope = spline.derivative()
    height = np.array([0.0, 0.0, legs.radius - legs.feet(legs.standing[None])[0, :, 2].min()])

    def lifted(t: Array) -> tuple[Array, Array]:
        position, turn = base(t)
        return position + height, turn

    def joints(t: Array) -> tuple[Array, Array]:
        return spline(t), slope(t)

    return Plan(joints, lifted, down, False, duration)


def _base_sines(
    legs: Legs, rng: np.random.Generator, scale: float
) -> Callable[[Array], tuple[Array, Array]]:
    """Return sines of the base about the height at which it stands."""
    frequency = np.array([*_SWAY_HZ, *_TILT_HZ]) * rng.uniform(0.9, 1.1, (6, 3))
    phase = rng.uniform(0.0, 2.0 * np.pi, (6, 3))
    size = np.repeat([_SWAY * legs.height, _TILT], 3)[:, None] * scale * np.array(_SHARES)

    def base(t: Array) -> tuple[Array, Array]:
        wave = np.sum(size * np.sin(2.0 * np.pi * frequency * t[:, None, None] + phase), axis=2)
        wave *= _ramp(t)[0][:, None]
        return wave[:, :3], wave[:, 3:]

    return base


def _ramp(t: Array) -> tuple[Array, Array]:
    """Return a smooth rise from 0 to 1 after the lead, and its rate."""
    x = np.clip((t - LEAD) / _RAMP, 0.0, 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2), 30.0 * (x * (1.0 - x)) ** 2 / _RAMP


def _diagonal(legs: Legs) -> Array:
    """Return the phases of a trot: legs on one diagonal together."""
    places = legs.feet(legs.standing[None])[0]
    return np.where(places[:, 0] * places[:, 1] > 0.0, 0.0, 0.5)


def _one_by_one(legs: Legs) -> Array:
    """Return the phases of a walk: a hind foot, the fore foot on its side, then the other side."""
    places = legs.feet(legs.standing[None])[0]
    fore, left = places[:, 0] > 0.0, places[:, 1] > 0.0
    return np.asarray(0.25 * fore + 0.5 * left)
