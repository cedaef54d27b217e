"""Check that feet that are said to be down stand still, and not above the others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.experiment.inspection.evidence import window_means
from sdpid.experiment.inspection.finding import Finding
from sdpid.experiment.inspection.kinds import exchanged, found
from sdpid.experiment.inspection.subject import Subject, check
from sdpid.robot.model.contacts.jacobians import frame_places

# A foot that is down and moves faster than this on average (m/s) is not down, or slips. Feet of
# simulated robots roll and slip by less than a tenth of it.
_SLIPS = 0.1
# The ground is not known to be level; a foot this far above the others' median (m) is in the air.
_HIGH = 0.05
# Exchanged flags make down feet faster by this factor.
_BETTER = 3.0
# Feet that are always down, or so often in the same state, cannot be told from each other.
_LEAST_SHARE = 0.02
# Permutations of more feet than this are too many.
_MOST_FEET = 4
# Samples in which a foot has just landed or is about to lift do not count.
_SURE_WINDOWS = 1


@dataclass(frozen=True, kw_only=True)
class Feet:
    """Feet over windows of a recording.

    Attributes
    ----------
    names : tuple of str
    speed : (K, c) ndarray
        Of the contact points, m/s.
    height : (K, c) ndarray
        m, above the base's origin where the base's position is not known.
    down : (K, c) ndarray of bool
        Whether each foot is down throughout a window and its neighbors.
    """

    names: tuple[str, ...]
    speed: Array
    height: Array
    down: Mask


def feet_of(subject: Subject) -> Feet | None:
    """Return the feet of the longest piece; None without a robot, position or flags."""
    robot = subject.floating
    if robot is None or subject.based is None:
        return None
    log, base = subject.based
    contacts = log.contacts
    if contacts is None or contacts.down is None or base.position is None:
        return None
    parts = [base.position, base.orientation, log.position]
    q = window_means(np.hstack([np.asarray(part) for part in parts]), log.step)
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    if len(q) < 3:
        return None
    place = q[:, None, :3] + frame_places(robot, q, contacts.frames) + contacts.offset
    step = log.step * max(1, (log.n_samples - 1) // len(q))
    speed = np.linalg.norm(np.gradient(place, step, axis=0), axis=-1)
    always = window_means(contacts.down.astype(np.float64), log.step) > 1.0 - 1e-9
    return Feet(names=contacts.frames, speed=speed, height=place[:, :, 2], down=_surely(always))


def _surely(down: Mask) -> Mask:
    """Return where feet are down before and after as well."""
    sure = down.copy()
    for shift in range(1, _SURE_WINDOWS + 1):
        sure[shift:] &= down[:-shift]
        sure[:-shift] &= down[shift:]
    return sure


def _speed_down(speed: Array, down: Mask) -> Array:
    """Return the rms speed of each foot while it is down; 0 where it never is."""
    counts = np.maximum(down.sum(axis=0), 1)
    return np.asarray(np.sqrt((speed**2 * down).sum(axis=0) / counts))


@check
def feet_down(subject: Subject) -> Iterator[Finding]:
    """Find feet that are said to be down and move, and flags of one foot given to another."""
    feet = feet_of(subject)
    if feet is None:
        return
    own = _speed_down(feet.speed, feet.down)
    seen = feet.down.mean(axis=0) > _LEAST_SHARE
    order = _exchanged(feet)
    if order is not None:
        better = float(np.sqrt(np.mean(_speed_down(feet.speed, feet.down[:, order]) ** 2)))
        worse = float(np.sqrt(np.mean(own**2)))
        yield found(
            "feet_exchanged",
            feet=exchanged(feet.names, order),
            mended=(
                f"; feet that are down then move by {better:.3g} m/s (rms) in place of "
                f"{worse:.3g}, limit a factor of {_BETTER:g}"
            ),
            speed=worse,
            exchanged=better,
            limit=_BETTER,
        )
        return
    for i in np.flatnonzero(seen & (own > _SLIPS)).tolist():
        what = (
            f"{feet.names[i]} moves by {own[i]:.3g} m/s (rms) while it is said to be down, limit "
            f"{_SLIPS:g}: it slips, its flags are wrong, or the pose of the base is"
        )
        yield found("foot_moves", what=what, speed=own[i], limit=_SLIPS)
    yield from _high(feet, seen)


def _high(feet: Feet, seen: Mask) -> Iterator[Finding]:
    """Find feet that are said to be down, far above those that are."""
    several = feet.down.sum(axis=1) >= 2
    if np.count_nonzero(seen) < 2 or not several.any():
        return
    heights = np.where(feet.down, feet.height, np.nan)[several]
    level = np.nanmedian(heights, axis=1)
    for i in np.flatnonzero(seen & ~np.isnan(heights).all(axis=0)).tolist():
        height = float(np.nanmedian(heights[:, i] - level))
        if height > _HIGH:
            yield found("foot_high", foot=feet.names[i], height=height, limit=_HIGH)


def _exchanged(found: Feet) -> tuple[int, ...] | None:
    """Return which foot's flags each foot should have, None where they are right, or unknown."""
    c = len(found.names)
    if not 2 <= c <= _MOST_FEET or (found.down == found.down[:, :1]).all():
        return None
    own = _speed_down(found.speed, found.down)
    costs = {
        order: float(np.mean(_speed_down(found.speed, found.down[:, list(order)]) ** 2))
        for order in permutations(range(c))
    }
    best = min(costs, key=lambda order: costs[order])
    worse = float(np.mean(own**2))
    if best == tuple(range(c)) or costs[best] * _BETTER**2 > worse or worse < (_SLIPS / 2.0) ** 2:
        return None
    return best
