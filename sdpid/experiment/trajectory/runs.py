"""Motions for one purpose: postures to rest in, and single joints at constant speeds.

Every part is a polynomial of fifth degree between states without acceleration, so positions,
velocities and accelerations are continuous.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, real_array
from sdpid.errors import DataError
from sdpid.experiment.trajectory.sampled import SampledCurve

__all__ = ["joint_runs", "through_postures"]

# Largest velocity, acceleration and jerk of the move 10u³ − 15u⁴ + 6u⁵ from rest to rest over unit
# distance in unit time, and largest acceleration and jerk of a change of speed 3u² − 2u³.
_MOVE = (15.0 / 8.0, 10.0 / np.sqrt(3.0), 60.0)
_RAMP = (1.5, 6.0)
# Times are longer by this much than the limits ask for, so that rounding breaks none.
_ROUNDING = 1.0 + 1e-9


def through_postures(
    postures: ArrayLike,
    *,
    velocity: ArrayLike,
    acceleration: ArrayLike,
    jerk: ArrayLike = np.inf,
    hold: float = 1.0,
) -> SampledCurve:
    """Return the motion that rests in one posture after the other.

    All joints move at once, as fast as the slowest of them may.

    Parameters
    ----------
    postures : array_like, shape (P, n)
        Positions in rad (m for prismatic joints). With the last equal to the first the motion is
        closed.
    velocity, acceleration, jerk : array_like, shape (n,) or ()
        What the joints may reach, in rad/s, rad/s², rad/s³ (m for prismatic joints).
    hold : float, optional
        Rest in each posture in s.

    Raises
    ------
    DataError
        When there are fewer than two postures, two neighbors are equal and nothing is held, or a
        limit is not positive.
    """
    points = real_array(postures, "postures", ndim=2)
    limits = _limits(points.shape[1], velocity, acceleration, jerk)
    if len(points) < 2 or not (np.isfinite(hold) and hold >= 0.0):
        raise DataError(
            f"postures: {len(points)} of them, hold {hold} s; give two or more, and a time from 0."
        )
    path = _Path(points[0])
    path.cruise(0.0, hold)
    for posture in points[1:]:
        path.move(posture, limits)
        path.cruise(0.0, hold)
    return path.curve()


def joint_runs(
    start: ArrayLike,
    ranges: ArrayLike,
    speeds: Sequence[float],
    *,
    acceleration: ArrayLike,
    jerk: ArrayLike = np.inf,
    velocity: ArrayLike = np.inf,
    joints: Sequence[int] | None = None,
) -> SampledCurve:
    """Return the motion in which each joint in turn runs both ways at constant speeds.

    The other joints rest at the start meanwhile, and all end there.

    Parameters
    ----------
    start : array_like, shape (n,)
        Where the joints rest, in rad (m for prismatic joints).
    ranges : array_like, shape (n, 2)
        From where to where each joint runs.
    speeds : sequence of float
        The speeds in rad/s (m/s). Those above a joint's velocity limit, or that it cannot reach
        within half of its range, are left out for that joint.
    acceleration, jerk, velocity : array_like, shape (n,) or ()
        What the joints may reach.
    joints : sequence of int, optional
        The joints that run, numbered from 0; by default all.

    Raises
    ------
    DataError
        When no speed is left for a joint, a range is empty, or a limit is not positive.
    """
    rest = real_array(start, "start", ndim=1)
    spans = real_array(ranges, "ranges", ndim=2)
    limits = _limits(len(rest), velocity, acceleration, jerk)
    path = _Path(rest)
    for j in range(len(rest)) if joints is None else joints:
        low, high = spans[j]
        kept = []
        for speed in speeds:
            ramp = _ROUNDING * max(
                _RAMP[0] * speed / limits[1, j], np.sqrt(_RAMP[1] * speed / limits[2, j])
            )
            # A ramp takes up half of its time at full speed, and there are two.
            if 0.0 < speed <= limits[0, j] and speed * ramp <= 0.5 * (high - low):
                kept.append((speed, ramp))
        if not kept:
            raise DataError(
                f"runs of joint {j + 1}: none of the speeds {list(speeds)} is positive, within the "
                f"limit of {limits[0, j]:g} and reached within half of {high - low:g}; give lower "
                "speeds or a wider range."
            )
        unit = np.eye(len(rest))[j]
        path.move(rest + (low - rest[j]) * unit, limits)
        for speed, ramp in kept:
            for way in (speed, -speed):
                path.ramp(way * unit, ramp)
                path.cruise(way * unit, (high - low) / speed - ramp)
                path.ramp(0.0 * unit, ramp)
        path.move(rest, limits)
    return path.curve()


class _Path:
    """States without acceleration, one after the other."""

    def __init__(self, start: Array) -> None:
        self._time, self._states = [0.0], [(start, np.zeros_like(start))]

    def _add(self, seconds: float, position: Array, velocity: Array) -> None:
        self._time.append(self._time[-1] + seconds)
        self._states.append((position, velocity))

    def move(self, end: Array, limits: Array) -> None:
        """Move from rest to rest as fast as the limits (3, n) allow."""
        distance = np.abs(end - self._states[-1][0])
        orders = np.array([1.0, 2.0, 3.0])[:, None]
        seconds = ((np.array(_MOVE)[:, None] * distance / limits) ** (1.0 / orders)).max()
        if seconds > 0.0:
            self._add(_ROUNDING * float(seconds), end, np.zeros_like(end))

    def ramp(self, velocity: Array, seconds: float) -> None:
        """Change to another velocity."""
        position, before = self._states[-1]
        self._add(seconds, position + 0.5 * seconds * (before + velocity), velocity)

    def cruise(self, velocity: Array | float, seconds: float) -> None:
        """Keep a velocity for some time."""
        if seconds > 0.0:
            position = self._states[-1][0]
            self._add(seconds, position + seconds * velocity, velocity + np.zeros_like(position))

    def curve(self) -> SampledCurve:
        """Return the curve through the states."""
        position, velocity = (np.array(values) for values in zip(*self._states, strict=True))
        return SampledCurve(
            time=np.array(self._time),
            position=position,
            velocity=velocity,
            acceleration=np.zeros_like(position),
        )


def _limits(n: int, velocity: ArrayLike, acceleration: ArrayLike, jerk: ArrayLike) -> Array:
    """Return the limits of each joint, shape (3, n), checked."""
    values = np.array([np.broadcast_to(x, n) for x in (velocity, acceleration, jerk)], dtype=float)
    if not (values > 0.0).all():
        raise DataError("motion: limits of velocity, acceleration and jerk must be positive.")
    return values
