"""`Curve`: joint positions as a function of time, with bounds that hold at every instant.

Piecewise polynomials are evaluated and enclosed by their blossoms.


The blossom of a polynomial of degree q is the symmetric function of q arguments, affine in each,
that equals the polynomial where all arguments are equal. Its values at repeated ends of an
interval are the Bernstein coefficients there, and the polynomial stays between the least and the
largest of them [farin2002]_.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
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
# Bounds are widened by this much of the largest number that enters them: a blossom of degree q is
# q convex combinations of at most five roundings each, a derivative a few more.
ROUNDING = 64.0 * float(np.finfo(np.float64).eps)


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


def blossom(control: Array, knots: Array, arguments: Sequence[Array]) -> Array:
    """Return blossoms of S polynomials by de Boor's algorithm.

    Parameters
    ----------
    control : ndarray, shape (q + 1, S, n)
        The control points of each polynomial.
    knots : ndarray, shape (2q, S)
        Their knots; the polynomial lives between the middle two.
    arguments : sequence of q ndarrays, each (S,)

    Returns
    -------
    ndarray, shape (S, n)
    """
    degree = len(control) - 1
    points: list[Array] = list(control)
    for level, argument in enumerate(arguments, 1):
        for j in range(degree, level - 1, -1):
            low, high = knots[j - 1], knots[degree + j - level]
            share = ((argument - low) / (high - low))[:, None]
            points[j] = (1.0 - share) * points[j - 1] + share * points[j]
    return points[degree]


class Pieces(ABC):
    """A curve of polynomials between breaks."""

    duration: float

    @property
    @abstractmethod
    def n(self) -> int:
        """Number of joints."""

    @property
    @abstractmethod
    def breaks(self) -> Array:
        """Times (M + 1,) from 0 to the duration between which all derivatives are smooth."""

    @abstractmethod
    def _polynomials(self, derivative: int, piece: Any) -> tuple[Array, Array, Array]:
        """Return control points (q+1, S, n), knots (2q, S) and rounding (S, n) of S pieces."""

    def _piece(self, time: Array) -> Any:
        found = np.searchsorted(self.breaks, time, side="right") - 1
        return np.clip(found, 0, len(self.breaks) - 2)

    def evaluate(self, time: Any, *, derivative: int = 0) -> Array:
        """Return a derivative of the positions at given times, (K,) to (K, n).

        Where a derivative jumps at a break, its value is that of the piece that begins there.

        Raises
        ------
        DataError
            When a time is not within [0, duration].
        """
        time = times_within(time, self.duration)
        control, knots, _ = self._polynomials(derivative, self._piece(time))
        return blossom(control, knots, [time] * (len(control) - 1))

    def enclose(self, edges: Any, *, derivative: int = 0) -> tuple[Array, Array]:
        """Return bounds of a derivative that hold at every instant of each cell.

        They are the least and the largest Bernstein coefficients on the cell, piece by piece,
        widened by their rounding. The excess falls with the square of the cell's length.

        Parameters
        ----------
        edges : array_like, shape (C + 1,)
            Increasing times within [0, duration]; the breaks need not be among them.
        derivative : int, optional
            0 for positions, 1 for velocities and so on.

        Returns
        -------
        lower, upper : ndarray, shape (C, n)

        Raises
        ------
        DataError
            When the edges do not increase or leave [0, duration].
        """
        edges = cells_within(edges, self.duration)
        inner = self.breaks[(self.breaks > edges[0]) & (self.breaks < edges[-1])]
        points = np.union1d(edges, inner)
        low, high = points[:-1], points[1:]
        control, knots, rounding = self._polynomials(derivative, self._piece(low))
        degree = len(control) - 1
        lower = upper = blossom(control, knots, [low] * degree)
        for count in range(1, degree + 1):
            values = blossom(control, knots, [low] * (degree - count) + [high] * count)
            lower, upper = np.minimum(lower, values), np.maximum(upper, values)
        first = np.searchsorted(points, edges[:-1])
        return (
            np.minimum.reduceat(lower - rounding, first, axis=0),
            np.maximum.reduceat(upper + rounding, first, axis=0),
        )
