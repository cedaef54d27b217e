"""Check that feet that are down stand still, on the ground, at the stated frames and points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.experiment.inspection.block_fit import block_fit, sure_part
from sdpid.experiment.inspection.kinds import (
    KINDS,
    Finding,
    exchanged,
    found,
    refuse,
    vector,
    warning,
)
from sdpid.experiment.inspection.standing import Standing
from sdpid.experiment.inspection.subject import Subject, check
from sdpid.robot.inertia import skew
from sdpid.robot.model.jacobians import contact_jacobians, frame_axes, frame_places
from sdpid.robot.model.model import RobotModel

KINDS.update(
    foot_moves=warning(
        "{what}", "mark it as not down where it slips; check frames, offset and base", about="feet"
    ),
    foot_high=warning(
        "{foot} is {height:.3g} m above the other feet while it is said to be down, limit "
        "{limit:g} m",
        "check its flags and the order of the joints, unless the ground is not level",
        about="feet",
    ),
    contact_frame=refuse(
        "frames of contacts move while they are said to be down, and others behind them rest "
        "(limit a factor of {limit:g}): {pairs}",
        "give the contacts' frames as {frames}",
        hides=("foot_moves", "foot_high"),
        spoils=True,
        about="feet",
    ),
    contact_point=warning("{feet} {where}", "{remedy}", about="feet"),
)

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
# A frame that is faster than this does not rest.
_STILL = 0.05
# Another frame rests where it is slower by this factor, and farther away than this (m).
BETTER, _AWAY = 3.0, 0.03
# A point rests that is slower than so many times what noise makes, or than this (m/s): of
# simulated quadrupeds right points have 1.25 times the noise at most.
_NOISES, _RESTS = 1.5, 2e-3
# Columns of what a foot may do: stand on a point in the world's axes, or in those of its frame,
# while the pose is late; and how far off that is at most: m, s.
_IN_WORLD, _IN_LINK = (0, 1, 2, 6), (3, 4, 5, 6)
_MOST = np.array([0.5, 0.5, 0.5, 0.1])


def _motion(
    standing: Standing, frames: Sequence[str], offset: Array, rows: Indices | slice = slice(None)
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


@check
def feet(subject: Subject) -> Iterator[Finding]:
    """Find contacts with the flags of other feet, that move, or whose frame or point is elsewhere.

    Of feet with each other's flags there is no other finding.
    """
    from scipy.optimize import linear_sum_assignment

    standing = subject.standing
    if standing is None:
        return
    names, down = standing.contacts.frames, standing.stands
    velocity, _, _ = _motion(standing, names, standing.contacts.offset)
    # Mean squares of each foot's speed while the flag of each is down.
    squares = np.sum(velocity**2, axis=2).T @ down / np.maximum(down.sum(axis=0), 1)
    own, (rows, order) = np.diagonal(squares), linear_sum_assignment(squares)
    worse, better = (float(np.sqrt(np.mean(each))) for each in (own, squares[rows, order]))
    if better * _FASTER <= worse and worse >= _SLIPS / 2.0:
        mended = (
            f"; feet that are down then move by {better:.3g} m/s (rms) in place of {worse:.3g}, "
            f"limit a factor of {_FASTER:g}"
        )
        numbers = {"speed": worse, "exchanged": better, "limit": _FASTER}
        yield found("feet_exchanged", feet=exchanged(names, order), mended=mended, **numbers)
        return
    yield from moving_feet(standing, np.sqrt(own))
    yield from points(standing)


def moving_feet(standing: Standing, speeds: Array) -> Iterator[Finding]:
    """Find feet that are said to be down and move by (c,) m/s, or are above the others."""
    down, names = standing.stands, standing.contacts.frames
    seen = down.mean(axis=0) > _LEAST_SHARE
    for i in np.flatnonzero(seen & (speeds > _SLIPS)).tolist():
        what = (
            f"{names[i]} moves by {speeds[i]:.3g} m/s (rms) while it is said to be down, limit "
            f"{_SLIPS:g}: it slips, its flags are wrong, or the pose of the base is"
        )
        yield found("foot_moves", what=what, speed=speeds[i], limit=_SLIPS)
    several = down.sum(axis=1) >= 2
    if np.count_nonzero(seen) < 2 or not several.any():
        return
    places = frame_places(standing.robot, standing.position, names) + standing.contacts.offset
    heights = np.where(down, places[..., 2], np.nan)[several]
    level = np.nanmedian(heights, axis=1)
    for i in np.flatnonzero(seen & ~np.isnan(heights).all(axis=0)).tolist():
        height = float(np.nanmedian(heights[:, i] - level))
        if height > _HIGH:
            yield found("foot_high", foot=names[i], height=height, limit=_HIGH)


def points(standing: Standing) -> Iterator[Finding]:
    """Find contacts whose frame is not the foot's, or whose point is elsewhere."""
    others = _resting_frames(standing)
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
    parts = _parts(standing)
    together = _point([*parts.values()])
    groups = {tuple(parts): together}
    if together is None or any(
        _point([each], together.in_link, together.change) for each in parts.values()
    ):
        groups = {(i,): _point([each]) for i, each in parts.items()}
    for feet, point in groups.items():
        if point is not None:
            yield _point_finding(standing, [*feet], point)


def _point_finding(standing: Standing, feet: list[int], point: _Point) -> Finding:
    contacts, limit = standing.contacts, max(_NOISES * standing.noise, _RESTS)
    names = ", ".join(contacts.frames[i] for i in feet)
    if point.left > limit:
        what = (
            f"{names}: no point rests while a foot is said to be down; the slowest moves by "
            f"{point.left:.2g} m/s (rms along an axis), limit {limit:.2g}: it slips"
        )
        return found("foot_moves", what=what, speed=point.left, limit=limit)
    stated = contacts.offset[feet].mean(axis=0)
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


def _resting_frames(standing: Standing) -> list[tuple[float, str, float, str]]:
    """Return frames of contacts that move, and those that rest in their place, with speeds."""
    others = []
    for i, name in enumerate(standing.contacts.frames):
        rows, behind = np.flatnonzero(standing.stands[:, i]), _beyond(standing.robot, name)
        if len(rows) < _LEAST or not behind:
            continue
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, _FEW).astype(np.intp))]
        velocity, _, _ = _motion(standing, [name, *behind], standing.contacts.offset[i], rows)
        speeds = np.sqrt(np.mean(np.sum(velocity**2, axis=2), axis=0)).tolist()
        best = int(np.argmin(speeds))
        if best and speeds[best] < _STILL and BETTER * speeds[best] < speeds[0]:
            others.append((speeds[0], name, speeds[best], behind[best - 1]))
    return others


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


def _parts(standing: Standing) -> dict[int, tuple[Array, Array]]:
    """Return the equations of the contacts that are points and stand, zero where they do not.

    A foot that stands turns about the point where it touches: ``v + w x (o + x) = 0`` for the
    velocity v of its frame, its angular velocity w and the stated offset o.
    """
    names, parts = standing.contacts.frames, {}
    velocity, turning, late = _motion(standing, names, standing.contacts.offset)
    axes, across = frame_axes(standing.robot, standing.position, names), skew(turning)
    columns = np.concatenate([across, across @ axes, late[..., None]], axis=3)
    for i, kind in enumerate(standing.contacts.kind):
        stands = standing.stands[:, i, None]
        if kind != "point" or np.count_nonzero(stands) < _LEAST:
            continue
        signal = -velocity[:, i] * stands
        if np.sum(signal**2) < np.count_nonzero(stands) * _SLIPS**2:
            parts[i] = columns[:, i] * stands[..., None], signal
    return parts


class _Point(NamedTuple):
    """Where feet roll: from the stated point, with the error of its least certain direction, m.

    In the world's axes below the link or, if `in_link`, in those of its frame. That point moves by
    `left`, m/s rms along an axis.
    """

    change: Array
    error: float
    in_link: bool
    left: float


def _point(
    parts: list[tuple[Array, Array]], in_link: bool | None = None, known: Array | float = 0.0
) -> _Point | None:
    """Return where feet touch the ground that roll alike, None where it is as stated, or known."""
    if not parts:
        return None
    columns, signal = (np.concatenate(each, axis=1) for each in zip(*parts, strict=True))
    world, link = (block_fit(columns[..., at], signal, _MOST) for at in (_IN_WORLD, _IN_LINK))
    if in_link is None:
        # What is as small as a ball's radius is one below a ball.
        in_link = link.left < world.left and float(np.linalg.norm(link.values[:3])) > _AWAY
    fit = link if in_link else world
    sure = sure_part(fit.values[:3] - known, fit.covariance[:3, :3], SIZE)
    if sure is None or fit.filled < _LEAST_BLOCKS:
        return None
    return _Point(sure[0], sure[1], in_link, fit.left)
