"""Motions of a robot with legs: where the base and the feet shall be, and when feet are down."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.errors import DataError
from sdpid.experiment.plant.legged.paths import (
    LEAD,
    RAMP,
    Plan,
    base_sines,
    joint_sines,
    planned,
    rise,
)
from sdpid.robot.legs.legs import Legs

# Gaits: seconds a cycle, share of it that a foot is down, and height of a step for a leg of 1 m.
_TROT = (0.5, 0.6, 0.2)
_WALK = (2.0, 0.85, 0.2)
# Of robots on soles, which shift their weight over one foot before the other is lifted.
_STEP = (3.0, 0.75, 0.05)
# Speed of the walk for a leg of 1 m, m/s, and of robots on soles.
_SPEED, _SLOW = 0.4, 0.03
# How far the base leans over the feet that are down: of two feet, all the way.
_LEAN, _LEAN_ON_SOLES = 1.0, 1.45


def plan_motion(legs: Legs, motion: str, *, duration: float, rng: np.random.Generator) -> Plan:
    """Plan a motion by its name.

    Parameters
    ----------
    legs : Legs
        The robot.
    motion : {"stand", "trot", "step", "walk", "hang"}
        Stand with a swaying base, trot in place, lift one foot after the other in place, walk
        forward, or move all joints with the base held in the air.
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
    places = legs.feet(legs.standing[None])[0]
    return planned(
        legs,
        duration,
        rng,
        base_sines(legs, rng, 1.0),
        lambda t: np.broadcast_to(places, (len(t), *places.shape)),
        lambda t: np.ones((len(t), len(places)), bool),
    )


def _trot(legs: Legs, duration: float, rng: np.random.Generator) -> Plan:
    if legs.flat:
        raise DataError(
            f"motion 'trot': '{legs.robot.name}' stands on {len(legs.frames)} soles; there are "
            "stand, step, walk, hang."
        )
    return _gait(legs, duration, rng, _TROT, _diagonal(legs), speed=0.0, shift=0.0)


def _step(legs: Legs, duration: float, rng: np.random.Generator) -> Plan:
    return _one_foot_at_a_time(legs, duration, rng, 0.0)


def _walk(legs: Legs, duration: float, rng: np.random.Generator) -> Plan:
    return _one_foot_at_a_time(legs, duration, rng, _SLOW if legs.flat else _SPEED)


def _one_foot_at_a_time(
    legs: Legs, duration: float, rng: np.random.Generator, speed: float
) -> Plan:
    gait, lean = (_STEP, _LEAN_ON_SOLES) if legs.flat else (_WALK, _LEAN)
    return _gait(legs, duration, rng, gait, _one_by_one(legs), speed=speed, shift=lean)


def _hang(legs: Legs, duration: float, rng: np.random.Generator) -> Plan:
    swing = joint_sines(legs.n_joints, rng)

    def joints(t: Array) -> tuple[Array, Array]:
        wave, slope = swing(t)
        return legs.standing + wave, slope

    height = np.array([0.0, 0.0, 2.0 * float(np.abs(legs.feet(legs.standing[None])).max())])

    def base(t: Array) -> tuple[Array, Array]:
        return np.broadcast_to(height, (len(t), 3)), np.zeros((len(t), 3))

    return Plan(joints, base, lambda t: np.zeros((len(t), len(legs.frames)), bool), True, duration)


MOTIONS: dict[str, Callable[[Legs, float, np.random.Generator], Plan]] = {
    "stand": _stand,
    "trot": _trot,
    "step": _step,
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
    sway = base_sines(legs, rng, 0.25)
    stride = speed * length * cycle
    # A pair of feet on a diagonal bears the weight alone; soles are planned by the weight anyway.
    middle = np.zeros(2) if legs.flat else places[:, :2].mean(axis=0) - legs.center_of_mass[:2]

    def phase(t: Array) -> Array:
        return np.asarray(np.mod(t[:, None] / cycle + phases, 1.0))

    def feet(t: Array) -> Array:
        # In the frame that moves along with the walk: back while down, forth while lifted.
        share = phase(t)
        swing = np.clip((share - duty) / (1.0 - duty), 0.0, 1.0)
        smooth = swing**3 * (10.0 - 15.0 * swing + 6.0 * swing**2)
        ramp = rise(t)[0][:, None]
        out = np.tile(places, (len(t), 1, 1))
        along = np.where(share < duty, 0.5 - share / duty, smooth - 0.5)
        out[:, :, 0] += ramp * stride * duty * along
        # Zero slope and zero acceleration at both ends.
        out[:, :, 2] += ramp * lift * length * 64.0 * (swing * (1.0 - swing)) ** 3
        return out

    def down(t: Array) -> Mask:
        bearing = phase(t) < duty
        return np.asarray(bearing | (t < LEAD)[:, None] if legs.flat else bearing)

    def base(t: Array) -> tuple[Array, Array]:
        position, turn = sway(t)
        # Away from the foot that is lifted, ahead of time and smoothly: the first harmonic.
        angle = 2.0 * np.pi * (t[:, None] / cycle + phases - (1.0 + duty) / 2.0)
        lean = -shift * 0.5 * np.mean(np.cos(angle)[:, :, None] * places[:, :2], axis=1)
        position = position.copy()
        position[:, :2] += rise(t)[0][:, None] * (lean + middle)
        return position, turn

    return planned(legs, duration, rng, base, feet, down)


def _diagonal(legs: Legs) -> Array:
    """Return the phases of a trot: legs on one diagonal together."""
    places = legs.feet(legs.standing[None])[0]
    return np.where(places[:, 0] * places[:, 1] > 0.0, 0.0, 0.5)


def _one_by_one(legs: Legs) -> Array:
    """Return the phases of a walk: a hind foot, the fore foot on its side, then the other side.

    Of two feet the first is lifted so that the motion begins with the weight between them.
    """
    places = legs.feet(legs.standing[None])[0]
    fore, left = places[:, 0] > 0.0, places[:, 1] > 0.0
    if legs.flat:
        cycle, duty, _ = _STEP
        first = LEAD + 0.5 * RAMP + 0.25 * cycle - 0.5 * (1.0 - duty) * cycle
        return np.where(left, 0.0, 0.5) + duty - first / cycle
    return np.asarray(0.25 * fore + 0.5 * left)
