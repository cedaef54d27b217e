"""Motions of a robot with legs: where the base and the feet shall be, and when feet are down."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.errors import DataError
from sdpid.experiment.trajectory.whole_body import WholeBodyMotion
from sdpid.robot.legs import Legs

# Gaits: seconds a cycle, share of it that a foot is down, height of a step and speed (m/s) for a
# leg of 1 m, how far the base leans over the feet that are down, and its sway as a share of that of
# a robot that stands. Feet on a diagonal trot together; otherwise one after the other is lifted, of
# two soles once the weight is over the other.
_STAND, _TROT = (1.0, 1.0, 0.0, 0.0, 0.0, 1.0), (0.5, 0.6, 0.2, 0.0, 0.0, 0.25)
_STEP, _WALK = (2.0, 0.85, 0.2, 0.0, 1.0, 0.25), (2.0, 0.85, 0.2, 0.4, 1.0, 0.25)
_STEP_ON_SOLES = (3.0, 0.75, 0.05, 0.0, 1.45, 0.25)
_WALK_ON_SOLES = (3.0, 0.75, 0.05, 0.03, 1.45, 0.25)
# By name: of balls, and of soles.
_GAITS = {
    "stand": (_STAND, _STAND),
    "trot": (_TROT, None),
    "step": (_STEP, _STEP_ON_SOLES),
    "walk": (_WALK, _WALK_ON_SOLES),
}
MOTIONS = (*_GAITS, "hang")
# Instants a second at which inverse kinematics is solved: splines between them are exact to 1e-6
# of a motion of 3 Hz.
_KNOT_RATE = 200.0
# The robot stands for this long before it moves, s: what falls to the ground comes to rest.
LEAD = 1.0
# The motion grows to its size over this long, s.
RAMP = 0.5
# Amplitudes of the base: metres for a leg of 1 m, and rad. Sines in each of the six directions.
_SWAY, _TILT = 0.12, 0.18
_SWAY_HZ = ((0.35, 0.9, 1.7), (0.45, 1.1, 1.9), (0.4, 1.3, 2.1))
_TILT_HZ = ((0.5, 1.2, 2.0), (0.55, 1.0, 1.8), (0.3, 0.8, 1.5))
# Shares of the sines: slower ones are larger, so that all accelerate alike.
_SHARES = (0.6, 0.3, 0.1)
# Robots on soles sway less along the ground, so that the pressure under them stays inside, and
# less up and about, which their ankles follow.
_SWAY_ON_SOLES, _TURN_ON_SOLES = 0.12, 0.3
# Joints beside the legs swing by this share of what they do when the robot hangs.
_FREE_SHARE = 0.5
# Hanging: amplitudes of the joints in rad, and frequencies in Hz.
_SWING = 0.35
_SWING_HZ = (0.4, 0.7, 1.1, 1.6, 2.3)
# Rounds in which the base of a robot on soles is moved until the weight is where it is planned:
# legs are a third of its mass, so that each round leaves a third of the error.
_ROUNDS = 3

Path: TypeAlias = Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class LeggedPlan:
    """A desired motion.

    Attributes
    ----------
    joints : callable
        Joint positions and velocities wanted at times (K,), two arrays (K, joints).
    base : callable
        Positions of the base and its rotation vectors at times, (K, 6).
    down : callable
        Which feet shall bear weight, (K, c) bool.
    held : bool
        Whether the base is held in the air.
    duration : float
        Length without the lead, s.
    effort : callable, optional
        Torques (K, joints) that carry the motion; by default those that carry the weight.
    """

    joints: Callable[[Array], tuple[Array, Array]]
    base: Path
    down: Callable[[Array], Mask]
    held: bool
    duration: float
    effort: Path | None = None


def planned(
    legs: Legs,
    duration: float,
    rng: np.random.Generator,
    base: Path,
    feet: Path,
    down: Callable[[Array], Mask],
) -> LeggedPlan:
    """Plan a motion: solve for the joints at knots.

    Parameters
    ----------
    legs : Legs
        The robot.
    duration : float
        Seconds after the lead.
    rng : numpy.random.Generator
        Phases of the joints beside the legs, which swing.
    base : callable
        Motion of the base about the place of the neutral one. Of a robot on soles its horizontal
        part is that of the center of mass about the middle of the feet, and the base follows.
    feet : callable
        Centers of the feet in the frame of the neutral base at times (K,), (K, c, 3).
    down : callable
        Which feet shall bear weight.
    """
    from scipy.interpolate import make_interp_spline
    from scipy.spatial.transform import Rotation

    knots = np.arange(0.0, LEAD + duration + 2.0 / _KNOT_RATE, 1.0 / _KNOT_RATE)
    position, turn = np.split(base(knots), 2, axis=1)
    places, axes = feet(knots), Rotation.from_rotvec(turn).as_matrix()
    swing = joint_sines(len(legs.free), rng) if len(legs.free) else None
    wave = 0.0 if swing is None else _FREE_SHARE * swing(knots)[0]

    def solved(moved: Array) -> Array:
        away = places - position[:, None]
        away[:, :, :2] -= moved[:, None]
        wanted = np.einsum("kji,kcj->kci", axes, away)
        reached = legs.reach(wanted, np.swapaxes(axes, 1, 2))
        reached[:, legs.free] = legs.standing[legs.free] + wave
        return reached

    moved = np.zeros((len(knots), 2))
    if legs.flat:
        # The weight where the base is planned, from the middle of the feet.
        target = position[:, :2] + legs.feet(legs.standing[None])[0, :, :2].mean(axis=0)
        for _ in range(_ROUNDS):
            center = np.einsum("kij,kj->ki", axes, legs.centers_of_mass(solved(moved)))
            moved = target - position[:, :2] - center[:, :2]
    spline = make_interp_spline(knots, solved(moved), k=5)
    slope, shift = spline.derivative(), make_interp_spline(knots, moved, k=5)
    height = legs.radius - legs.feet(legs.standing[None])[0, :, 2].min()

    def lifted(t: Array) -> Array:
        return np.asarray(
            base(t) + np.pad(shift(t), ((0, 0), (0, 4))) + height * (np.arange(6) == 2)
        )

    def joints(t: Array) -> tuple[Array, Array]:
        return spline(t), slope(t)

    return LeggedPlan(joints, lifted, down, False, duration)


def joint_sines(n: int, rng: np.random.Generator) -> Callable[[Array], tuple[Array, Array]]:
    """Return sines of joints about zero, and their rates."""
    frequency = rng.permuted(np.tile(_SWING_HZ, (n, 1)), axis=1)[:, :3] * rng.uniform(
        0.9, 1.1, (n, 3)
    )
    phase = rng.uniform(0.0, 2.0 * np.pi, (n, 3))
    size = _SWING * np.array(_SHARES) / frequency

    def joints(t: Array) -> tuple[Array, Array]:
        angle = 2.0 * np.pi * frequency * t[:, None, None] + phase
        ramp, rate = rise(t)
        wave = np.sum(size * np.sin(angle), axis=2)
        slope = np.sum(size * 2.0 * np.pi * frequency * np.cos(angle), axis=2)
        return ramp[:, None] * wave, ramp[:, None] * slope + rate[:, None] * wave

    return joints


def base_sines(legs: Legs, rng: np.random.Generator, scale: float) -> Path:
    """Return sines of the base about the height at which it stands."""
    frequency = np.array([*_SWAY_HZ, *_TILT_HZ]) * rng.uniform(0.9, 1.1, (6, 3))
    phase = rng.uniform(0.0, 2.0 * np.pi, (6, 3))
    size = np.repeat([_SWAY * legs.height, _TILT], 3)[:, None] * scale * np.array(_SHARES)
    size[:2] *= _SWAY_ON_SOLES if legs.flat else 1.0
    size[2:] *= _TURN_ON_SOLES if legs.flat else 1.0

    def base(t: Array) -> Array:
        wave = np.sum(size * np.sin(2.0 * np.pi * frequency * t[:, None, None] + phase), axis=2)
        return np.asarray(rise(t)[0][:, None] * wave)

    return base


def rise(t: Array) -> tuple[Array, Array]:
    """Return a smooth rise from 0 to 1 after the lead, and its rate."""
    x = np.clip((t - LEAD) / RAMP, 0.0, 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2), 30.0 * (x * (1.0 - x)) ** 2 / RAMP


def plan_motion(
    legs: Legs, motion: str, *, duration: float, rng: np.random.Generator
) -> LeggedPlan:
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
    if motion == "hang":
        return _hang(legs, duration, rng)
    gait = _GAITS[motion][legs.flat]
    if gait is None:
        raise DataError(
            f"motion '{motion}': '{legs.robot.name}' stands on {len(legs.frames)} soles; there "
            f"are {', '.join(name for name in MOTIONS if name != motion)}."
        )
    cycle, duty, lift, speed, shift, share_of_sway = gait
    places, length = legs.feet(legs.standing[None])[0], legs.height
    phases = _phases(legs, places, cycle, duty, motion == "trot")
    sway, stride = base_sines(legs, rng, share_of_sway), speed * length * cycle
    # A pair of feet on a diagonal bears the weight alone; soles are planned by the weight anyway.
    middle = places[:, :2].mean(axis=0) - legs.center_of_mass[:2]
    middle = np.zeros(2) if legs.flat or duty == 1.0 else middle

    def phase(t: Array) -> Array:
        return np.asarray(np.mod(t[:, None] / cycle + phases, 1.0))

    def feet(t: Array) -> Array:
        # In the frame that moves along with the walk: back while down, forth while lifted.
        share = phase(t)
        swing = np.clip((share - duty) / max(1.0 - duty, 1e-9), 0.0, 1.0)
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

    def base(t: Array) -> Array:
        # Away from the foot that is lifted, ahead of time and smoothly: the first harmonic.
        angle = 2.0 * np.pi * (t[:, None] / cycle + phases - (1.0 + duty) / 2.0)
        lean = -shift * 0.5 * np.mean(np.cos(angle)[:, :, None] * places[:, :2], axis=1)
        return np.asarray(sway(t) + np.pad(rise(t)[0][:, None] * (lean + middle), ((0, 0), (0, 4))))

    return planned(legs, duration, rng, base, feet, down)


def _hang(legs: Legs, duration: float, rng: np.random.Generator) -> LeggedPlan:
    swing = joint_sines(legs.n_joints, rng)

    def joints(t: Array) -> tuple[Array, Array]:
        wave, slope = swing(t)
        return legs.standing + wave, slope

    height = 2.0 * float(np.abs(legs.feet(legs.standing[None])).max())

    def base(t: Array) -> Array:
        return np.tile(height * (np.arange(6) == 2), (len(t), 1))

    def down(t: Array) -> Mask:
        return np.zeros((len(t), len(legs.frames)), bool)

    return LeggedPlan(joints, base, down, True, duration)


def _phases(legs: Legs, places: Array, cycle: float, duty: float, together: bool) -> Array:
    """Return the phases of the feet of a gait.

    One by one, a hind foot comes first, then the fore foot on its side, then the other side; of two
    feet the first is lifted so that the motion begins with the weight between them.
    """
    fore, left = places[:, 0] > 0.0, places[:, 1] > 0.0
    if together:
        return np.where(fore == left, 0.0, 0.5)
    if legs.flat:
        first = LEAD + 0.5 * RAMP + 0.25 * cycle - 0.5 * (1.0 - duty) * cycle
        return np.where(left, 0.0, 0.5) + duty - first / cycle
    return np.asarray(0.25 * fore + 0.5 * left)


def follow(legs: Legs, motion: WholeBodyMotion, duration: float | None) -> LeggedPlan:
    """Return the plan of a motion; the robot stands in its first pose for a while before.

    Parameters
    ----------
    legs : Legs
        The robot.
    motion : WholeBodyMotion
        What it shall do.
    duration : float, optional
        Seconds of it; by default all.

    Raises
    ------
    DataError
        When the motion is of other joints or feet, or shorter.
    """
    from scipy.interpolate import make_interp_spline
    from scipy.spatial.transform import Rotation

    joints, feet = legs.robot.joint_names[6:], legs.frames
    if motion.joint_names != joints or motion.frames != feet:
        raise DataError(
            f"motion: of {len(motion.joint_names)} joints and feet {', '.join(motion.frames)}; "
            f"'{legs.robot.name}' has {len(joints)} joints and feet {', '.join(feet)}, in this "
            "order."
        )
    length = motion.duration if duration is None else duration
    if not length <= motion.duration:
        raise DataError(f"duration: {length:g} s, the motion ends after {motion.duration:g} s.")
    turn = Rotation.from_quat(motion.base_orientation).as_rotvec()
    position, effort, place = (
        make_interp_spline(motion.time, values, k=3)
        for values in (motion.position, motion.effort, np.hstack([motion.base_position, turn]))
    )
    slope = position.derivative()

    def at(t: Array) -> Array:
        return np.clip(t - LEAD, 0.0, motion.duration)

    def wanted(t: Array) -> tuple[Array, Array]:
        return position(at(t)), slope(at(t)) * (t > LEAD)[:, None]

    def base(t: Array) -> Array:
        return np.asarray(place(at(t)))

    def down(t: Array) -> Mask:
        return motion.down[np.minimum(np.searchsorted(motion.time, at(t)), len(motion.time) - 1)]

    return LeggedPlan(wanted, base, down, False, length, lambda t: np.asarray(effort(at(t))))
