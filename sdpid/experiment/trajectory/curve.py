"""`Curve`: joint positions as a function of time, with bounds that hold at every instant."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from sdpid._common.arrays import Array, real_array
from sdpid.errors import DataError

# A time counts as within [0, duration] when it leaves it by less than this part of the duration:
# above the rounding of sums of time steps, below any intended timing.
_OUTSIDE = 1e-9
# States that differ by less than this (rad, rad/s, rad/s²; m for prismatic joints) are the same,
# and motion below it is rest: less than an encoder resolves, more than six printed decimals lose.
SAME_STATE = 1e-6


class Curve(Protocol):
    """Joint positions on [0, duration], smooth between `breaks`."""

    @property
    def n(self) -> int:
        """Number of joints."""

    @property
    def duration(self) -> float:
        """Duration in s."""

    @property
    def breaks(self) -> Array:
        """Times (M + 1,) from 0 to the duration between which all derivatives are smooth."""

    def evaluate(self, time: Any, *, derivative: int = 0) -> Array:
        """Return a derivative of the positions at given times, (K,) to (K, n)."""

    def enclose(self, edges: Any, *, derivative: int = 0) -> tuple[Array, Array]:
        """Return bounds (C, n) of a derivative, below and above, over C cells of time."""


def end_states(curve: Curve) -> Array:
    """Return position, velocity and acceleration at either end, shape (3, 2, n)."""
    ends = np.array([0.0, curve.duration])
    return np.stack([curve.evaluate(ends, derivative=order) for order in range(3)])


def is_closed(curve: Curve) -> bool:
    """Return whether the state at the end is that at the start, so that periods can follow."""
    states = end_states(curve)
    return bool(np.abs(states[:, 1] - states[:, 0])[: _continuous(curve)].max() <= SAME_STATE)


def rests_at_ends(curve: Curve) -> bool:
    """Return whether velocity and acceleration vanish at either end."""
    return bool(np.abs(end_states(curve)[1 : _continuous(curve)]).max() <= SAME_STATE)


def _continuous(curve: Curve) -> int:
    """Return how many of position, velocity and acceleration do not jump anywhere in a curve.

    Where accelerations jump at every sample, they need not agree at the ends either.
    """
    return min(int(getattr(curve, "smooth", 2)), 2) + 1


def times_within(time: Any, duration: float) -> Array:
    """Return times as an array (K,), moved into [0, duration] where rounding put them outside.

    Raises
    ------
    DataError
        When one is not finite or lies outside.
    """
    values = real_array(time, "time", ndim=1)
    slack = _OUTSIDE * duration
    outside = (values < -slack) | (values > duration + slack)
    if outside.any():
        first = int(np.argmax(outside))
        raise DataError(
            f"time: {values[first]} s at index {first} is not within 0 to {duration} s, the "
            "duration of the motion."
        )
    return np.clip(values, 0.0, duration)


def cells_within(edges: Any, duration: float) -> Array:
    """Return the edges of cells as an array (C + 1,).

    Raises
    ------
    DataError
        When there are fewer than two, they do not increase, or lie outside of [0, duration].
    """
    values = times_within(edges, duration)
    if len(values) < 2 or not (np.diff(values) > 0.0).all():
        raise DataError("edges: give at least two times in increasing order.")
    return values
