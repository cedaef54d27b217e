"""Check that feet that are down stand still, on the ground, by the frames and points said."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.experiment.inspection.block_fit import BlockSums, sure_part
from sdpid.experiment.inspection.delays.kinematic import Standing
from sdpid.experiment.inspection.kinds import Finding, exchanged, found, vector
from sdpid.experiment.inspection.subject import Subject, check
from sdpid.experiment.recording.floating.contacts import Contacts
from sdpid.robot.inertia import skew
from sdpid.robot.model.contacts.jacobians import contact_jacobians, frame_axes, frame_places
from sdpid.robot.model.model import RobotModel

# Told from five standard errors on and from this size (m), about half the radius of a quadruped's
# foot. Right logs of three quadrupeds are off by 4.4 mm at most, where feet land hard in a trot.
SIZE = 0.01
# Least number of samples at which a foot stands, and those at which other frames are looked at.
_LEAST, _FEW = 60, 150
# Few stances have errors of their own, which their spread does not show: blocks of time (of 20) in
# which feet stand.
_LEAST_BLOCKS = 10
# A foot that is down and faster than this (m/s, rms) is not down, or slips. Feet of simulated
# robots roll and slip by less than a tenth of it.
_SLIPS = 0.1
# The ground is not known to be level; a foot this far above the others' median (m) is in the air.
_HIGH = 0.05
# Exchanged flags make down feet faster by this factor.
_FASTER = 3.0
# Feet that are always down, or so often in the same state, cannot be told from each other.
_LEAST_SHARE = 0.02
# Permutations of more feet than this are too many.
_MOST_FEET = 4
# A frame that is faster than this does not rest.
_STILL = 0.05
# Another frame rests where it is slower by this factor, and farther away than this (m).
BETTER, _AWAY = 3.0, 0.03
# Nothing is farther off than this: m, s.
_MOST_PLACE, _MOST_LATE = 0.5, 0.1
# A point rests that is slower than so many times what noise makes, or than this (m/s): of
# simulated quadrupeds right points have 1.25 times the noise at most.
_NOISES, _RESTS = 1.5, 2e-3


@check
def feet_down(subject: Subject) -> Iterator[Finding]:
    """Find feet that are said to be down and move, and flags of one foot given to another."""
    standing, contacts = subject.standing, subject.log.contacts
    if standing is None or contacts is None:
        return
    down, names, every = standing.stands, contacts.frames, np.arange(len(standing.rows))
    squares = np.sum(_motion(standing, every, names, contacts.offset)[0] ** 2, axis=2)

    def mean_squares(order: Sequence[int]) -> Array:
        taken = down[:, list(order)]
        return np.asarray((squares * taken).sum(axis=0) / np.maximum(taken.sum(axis=0), 1))

    own, seen = np.sqrt(mean_squares(range(len(names)))), down.mean(axis=0) > _LEAST_SHARE
    order = tuple(range(len(names)))
    if 2 <= len(names) <= _MOST_FEET and (down != down[:, :1]).any():
        order = min(permutations(order), key=lambda each: float(mean_squares(each).mean()))
    better, worse = (float(np.sqrt(np.mean(x))) for x in (mean_squares(order), own**2))
    if better * _FASTER <= worse and worse >= _SLIPS / 2.0:
        mended = (
            f"; feet that are down then move by {better:.3g} m/s (rms) in place of {worse:.3g}, "
            f"limit a factor of {_FASTER:g}"
        )
        numbers = {"speed": worse, "exchanged": better, "limit": _FASTER}
        yield found("feet_exchanged", feet=exchanged(names, order), mended=mended, **numbers)
        return
    for i in np.flatnonzero(seen & (own > _SLIPS)).tolist():
        what = (
            f"{names[i]} moves by {own[i]:.3g} m/s (rms) while it is said to be down, limit "
            f"{_SLIPS:g}: it slips, its flags are wrong, or the pose of the base is"
        )
        yield found("foot_moves", what=what, speed=own[i], limit=_SLIPS)
    several = down.sum(axis=1) >= 2
    if np.count_nonzero(seen) < 2 or not several.any():
        return
    above = frame_places(standing.robot, standing.position, names) + contacts.offset
    heights = np.where(down, above[..., 2], np.nan)[several]
    level = np.nanmedian(heights, axis=1)
    for i in np.flatnonzero(seen & ~np.isnan(heights).all(axis=0)).tolist():
        height = float(np.nanmedian(heights[:, i] - level))
        if height > _HIGH:
            yield found("foot_high", foot=names[i], height=height, limit=_HIGH)


@check
def points(subject: Subject) -> Iterator[Finding]:
    """Find contacts whose frame is not the foot's, or whose point is elsewhere."""
    standing, contacts = subject.standing, subject.log.contacts
    if standing is None or contacts is None:
        return
    if any(finding.kind == "feet_exchanged" for finding in feet_down(subject)):
        return
    others = resting_frames(standing, contacts)
    if others:
        pairs = "; ".join(
            f"{name} by {speed:.2g} m/s (rms), {resting} by {least:.2g}"
            for speed, name, least, resting in others
        )
        speed, _, least, _ = max(others)
        frames = ", ".join(resting for *_, resting in others)
        numbers = {"speed": speed, "resting": least, "limit": BETTER}
        yield found("contact_frame", pairs=pairs, frames=frames, **numbers)
        return
    limit = max(_NOISES * standing.noise, _RESTS)
    for point in foot_points(standing, contacts):
        names = ", ".join(contacts.frames[i] for i in point.feet)
        if point.left > limit:
            what = (
                f"{names}: no point rests while a foot is said to be down; the slowest moves by "
                f"{point.left:.2g} m/s (rms along an axis), limit {limit:.2g}: it slips"
            )
            yield found("foot_moves", what=what, speed=point.left, limit=limit)
        else:
            yield _other_point(contacts, names, point)


def _other_point(contacts: Contacts, names: str, point: FootPoint) -> Finding:
    stated = contacts.offset[list(point.feet)].mean(axis=0)
    size, offset = float(np.linalg.norm(point.change)), vector(stated + point.change)
    told = f"(standard error {point.error:.2g} m, limit {SIZE:g} m)"
    where = (
        f"touch the ground at {offset} m from the frame, {size:.3g} m from the stated offset "
        f"{vector(stated)}: that point rests while a foot is down {told}"
    )
    remedy = f"give the contacts' offset={offset}"
    if point.in_link:
        where = (
            f"rest, while down, at a point {vector(point.change)} m from the stated one in the "
            f"frame's axes {told}"
        )
        remedy = "give the frame of the foot; where there is none, add one to the description"
    numbers = {"distance": size, "error": point.error, "limit": SIZE}
    return found("contact_point", feet=names, where=where, remedy=remedy, **numbers)


def resting_frames(standing: Standing, contacts: Contacts) -> list[tuple[float, str, float, str]]:
    """Return frames of contacts that move, and those that rest in their place, with speeds."""
    others = []
    for i, name in enumerate(contacts.frames):
        rows = np.flatnonzero(standing.stands[:, i])
        behind = _beyond(standing.robot, name)
        if len(rows) < _LEAST or not behind:
            continue
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, _FEW).astype(np.intp))]
        velocities, _, _ = _motion(standing, rows, [name, *behind], contacts.offset[i])
        speeds = np.sqrt(np.mean(np.sum(velocities**2, axis=2), axis=0)).tolist()
        best = int(np.argmin(speeds))
        if best and speeds[best] < _STILL and BETTER * speeds[best] < speeds[0]:
            others.append((speeds[0], name, speeds[best], behind[best - 1]))
    return others


@dataclass(frozen=True, kw_only=True, eq=False)
class FootPoint:
    """Where feet touch the ground.

    Attributes
    ----------
    feet : tuple of int
        Numbers of the contacts.
    change : ndarray, shape (3,)
        From the stated offset to that of the point that rests, in the world's axes, m.
    error : float
        Standard error of it, that of its least certain direction.
    in_link : bool
        Whether the point is one of the link rather than below it: `change` is then in the axes
        of the frame.
    left : float
        Speed of that point, along an axis, m/s rms.
    """

    feet: tuple[int, ...]
    change: Array
    error: float
    in_link: bool
    left: float


def foot_points(standing: Standing, contacts: Contacts) -> list[FootPoint]:
    """Return where feet roll, of contacts that are points: all alike, or single ones.

    A foot that stands turns about the point where it touches: ``v + w x (o + x) = 0`` for the
    velocity v of its frame, its angular velocity w and the stated offset o.
    """
    parts: dict[int, BlockSums] = {}
    for i, kind in enumerate(contacts.kind):
        rows = np.flatnonzero(standing.stands[:, i])
        if kind != "point" or len(rows) < _LEAST:
            continue
        sums = _sums(standing, contacts, i)
        if 3.0 * sums.power < sums.count * _SLIPS**2:
            parts[i] = sums
    together = _point(parts, tuple(parts))
    if together is not None and _agree(parts, together):
        return [together]
    return [found for i in parts if (found := _point(parts, (i,))) is not None]


# Columns: the point in the world's axes, in those of the frame, and a delay of the pose.
_IN_WORLD, _IN_LINK = (0, 1, 2, 6), (3, 4, 5, 6)
_SCALE = np.array([*6 * [_MOST_PLACE], _MOST_LATE])


def _point(parts: dict[int, BlockSums], feet: tuple[int, ...]) -> FootPoint | None:
    if not feet:
        return None
    sums = parts[feet[0]]
    for i in feet[1:]:
        sums = sums.plus(parts[i])
    if sums.filled < _LEAST_BLOCKS:
        return None
    world, link = sums.fit(_IN_WORLD), sums.fit(_IN_LINK)
    # What is as small as a ball's radius is one below a ball.
    in_link = link.left < world.left and float(np.linalg.norm(link.values[:3])) > _AWAY
    best, columns = (link, _IN_LINK) if in_link else (world, _IN_WORLD)
    sure = sure_part(*best.of(columns[:3]), SIZE)
    if sure is None:
        return None
    return FootPoint(feet=feet, change=sure[0], error=sure[1], in_link=in_link, left=best.left)


def _agree(parts: dict[int, BlockSums], together: FootPoint) -> bool:
    """Tell whether no foot's own point is surely another than that of all."""
    columns = _IN_LINK if together.in_link else _IN_WORLD
    for sums in parts.values():
        value, covariance = sums.fit(columns).of(columns[:3])
        if sums.filled >= _LEAST_BLOCKS and sure_part(value - together.change, covariance, SIZE):
            return False
    return True


def _sums(standing: Standing, contacts: Contacts, i: int) -> BlockSums:
    """Return the normal equations of a foot at the samples at which it stands."""
    every = np.arange(len(standing.rows))
    name, stands = contacts.frames[i], standing.stands[:, i]
    velocity, turning, late = _motion(standing, every, [name], contacts.offset[i])
    across = skew(turning[:, 0])
    axes = frame_axes(standing.robot, standing.position, [name])[:, 0]
    columns = np.concatenate([across, across @ axes, late[:, 0, :, None]], axis=2)
    return BlockSums.of(
        columns * stands[:, None, None],
        -velocity[:, 0] * stands[:, None],
        _SCALE,
        3 * int(np.count_nonzero(stands)),
    )


def _motion(
    standing: Standing, rows: Indices, frames: Sequence[str], offset: Array
) -> tuple[Array, Array, Array]:
    """Return velocities of points at frames, angular velocities, and what a delay of the pose adds.

    Each has the shape (K, frames, 3).
    """
    J = contact_jacobians(standing.robot, standing.position[rows], frames, offset)
    velocity = np.hstack([standing.base[standing.rows[rows]], standing.speeds[rows]])
    rate = np.gradient(standing.base, standing.step, axis=0)[standing.rows[rows]]
    moved = np.einsum("kcij,kj->kci", J, velocity)
    late = np.einsum("kcij,kj->kci", J[:, :, :3, :6], rate)
    return moved[:, :, :3], moved[:, :, 3:], late


def _beyond(robot: RobotModel, name: str) -> list[str]:
    """Return frames of bodies on the link of a frame, and on those behind it, away from it."""
    model = robot.pin_model
    own = model.frames[robot.frame_numbers[name]]
    found = []
    for other, number in robot.frame_numbers.items():
        frame = model.frames[number]
        if str(frame.type) != "BODY" or own.parentJoint not in model.supports[frame.parentJoint]:
            continue
        away = np.linalg.norm(frame.placement.translation - own.placement.translation)
        if frame.parentJoint != own.parentJoint or away > _AWAY:
            found.append(other)
    return found
