"""Curves: joint positions as functions of time, with bounds that hold at every instant.

Piecewise polynomials are evaluated and enclosed by their blossoms.


The blossom of a polynomial of degree q is the symmetric function of q arguments, affine in each,
that equals the polynomial where all arguments are equal. Its values at repeated ends of an
interval are the Bernstein coefficients there, and the polynomial stays between the least and the
largest of them [farin2002]_.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen, real_array, shaped
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
    breaks: Array
    control_points: Array

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.control_points.shape[-1])

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


# Position, velocity and acceleration at an end are those of as many control points.
_END = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class Spline(Pieces):
    """A B-spline on uniform knots over [0, duration], clamped at both ends.

    Its derivatives are splines of lower degree whose control points bound them. With
    three equal control points at an end it starts or ends at rest, without acceleration.

    Attributes
    ----------
    duration : float
        Duration in s.
    control_points : ndarray, shape (m, n)
        Control points of n joints, in rad (m for prismatic joints).
    degree : int
        Degree of the polynomials; 5 by default.

    Raises
    ------
    DataError
        When the duration is not positive, the degree not a whole number from 1, or there are not
        at least degree + 1 control points, all finite.
    """

    duration: float
    control_points: Array
    degree: int = 5

    def __post_init__(self) -> None:
        points = real_array(self.control_points, "control_points", ndim=2)
        _intervals(len(points), self.duration, self.degree)
        object.__setattr__(self, "duration", float(self.duration))
        object.__setattr__(self, "degree", int(self.degree))
        object.__setattr__(self, "control_points", frozen(points))

    @property
    def smooth(self) -> int:
        """The highest derivative that is continuous."""
        return self.degree - 1

    @property
    def knots(self) -> Array:
        """The m + degree + 1 knots in s, the ends degree + 1 times."""
        intervals = len(self.control_points) - self.degree
        return self.duration * (_knots(intervals, self.degree) / intervals)

    @cached_property
    def breaks(self) -> Array:  # type: ignore[override]
        """The distinct knots in s, shape (m - degree + 1,)."""
        return self.knots[self.degree : -self.degree]

    @staticmethod
    def basis(
        m: int, duration: float, time: ArrayLike, derivative: int = 0, degree: int = 5
    ) -> Any:
        """Return a derivative of the m basis functions at given times.

        Returns
        -------
        scipy.sparse.csr_array, shape (K, m)

        Raises
        ------
        DataError
            When a time is not within [0, duration], or m is too small for the degree.
        """
        from scipy.interpolate import BSpline
        from scipy.sparse import csr_array

        intervals = _intervals(m, duration, degree)
        time = times_within(time, duration)
        if derivative > degree:
            return csr_array((len(time), m))
        units = np.minimum(time / duration * intervals, intervals)
        lower = degree - derivative
        values = BSpline.design_matrix(units, _knots(intervals, lower), lower)
        return csr_array(values) @ Spline.control_matrix(m, duration, derivative, 0, degree)

    @staticmethod
    def control_matrix(
        m: int, duration: float, derivative: int = 0, halvings: int = 0, degree: int = 5
    ) -> Any:
        """Return the linear map from m control points to those of a derivative.

        They are control points after the knots were halved some times: their least and largest
        bound the derivative at every instant; each halving brings the bounds about four times
        closer.

        Returns
        -------
        scipy.sparse.csr_array, shape (rows, m)
            For derivative 0 the rows are not negative and sum to one.

        Raises
        ------
        DataError
            When m is too small for the degree, or the derivative is higher than the degree.
        """
        from scipy.sparse import csr_array, diags_array

        intervals = _intervals(m, duration, degree)
        if not 0 <= derivative <= degree:
            raise DataError(f"derivative: is {derivative}; give 0 to the degree, {degree}.")
        matrix = csr_array(diags_array(np.ones(m)))
        for order in range(derivative):
            rates = _rates(intervals, degree - order)
            matrix = (
                diags_array([-rates, rates], offsets=[0, 1], shape=(m - order - 1, m - order))
                @ matrix
            )
        matrix = matrix * (intervals / duration) ** derivative
        for _ in range(halvings):
            matrix = _halved(intervals, degree - derivative) @ matrix
            intervals *= 2
        return csr_array(matrix)

    @classmethod
    def from_free(
        cls, free: ArrayLike, duration: float, *, closed: bool = True, degree: int = 5
    ) -> Spline:
        """Make the spline that is at rest at its ends from its free control points (f, n).

        Raises
        ------
        DataError
            When they are too few for the degree, or the duration is not positive.
        """
        points = real_array(free, "free", ndim=2)
        m = len(points) + 2 * (_END - 1) + closed
        return cls(
            duration=duration,
            control_points=cls.expansion(m, closed=closed) @ points,
            degree=degree,
        )

    @staticmethod
    def expansion(m: int, *, closed: bool = True) -> Any:
        """Return the map from free control points to all m of a spline at rest at its ends.

        The first three are equal, and so are the last three; of a closed spline all six are.

        Returns
        -------
        scipy.sparse.csr_array, shape (m, f)
            With f = m - 5 of a closed spline, m - 4 of an open one.

        Raises
        ------
        DataError
            When m is below 6.
        """
        from scipy.sparse import csr_array

        if m < 2 * _END:
            raise DataError(f"m: {m} control points; give at least {2 * _END}, three at each end.")
        f = m - 2 * (_END - 1) - closed
        column = np.clip(np.arange(m) - (_END - 1), 0, m - 2 * _END + 1)
        return csr_array((np.ones(m), (np.arange(m), column % f)), shape=(m, f))

    def _derivative(self, order: int) -> Array:
        """Return the control points (rows, n) of a derivative, zero where they are equal."""
        points = self.control_points
        intervals = len(points) - self.degree
        if order > self.degree:
            return np.zeros((intervals, self.n))
        for k in range(order):
            rates = _rates(intervals, self.degree - k) * (intervals / self.duration)
            points = rates[:, None] * np.diff(points, axis=0)
        return points

    def _polynomials(self, derivative: int, piece: Any) -> tuple[Array, Array, Array]:
        """Return control points (q+1, S, n), knots (2q, S) and rounding (S, n) of S pieces."""
        degree = max(self.degree - derivative, 0)
        lost = self.degree - degree
        knots = self.knots[lost : len(self.knots) - lost]
        local = np.arange(2 * degree)[:, None] + piece[None, :] + 1
        points = self._derivative(derivative)[np.arange(degree + 1)[:, None] + piece[None, :]]
        # What a derivative's control points come from by differences, each within rounding.
        scale = np.abs(self.control_points if lost == 0 else self._derivative(1)).max(axis=0)
        rate = 2.0 * (len(self.control_points) - self.degree) / self.duration
        for order in range(1, lost):
            scale = scale * rate * (self.degree - order)
        return points, knots[local], np.broadcast_to(ROUNDING * scale, points.shape[1:])


def _intervals(m: int, duration: float, degree: int) -> int:
    """Return the number of intervals between knots, or say what is wrong with the arguments."""
    if not (np.isfinite(duration) and duration > 0.0):
        raise DataError(f"spline: duration is {duration}; give a positive time in s.")
    if int(degree) != degree or degree < 1:
        raise DataError(f"spline: degree is {degree}; give a whole number from 1.")
    if m <= degree:
        raise DataError(
            f"spline: {m} control points are too few for degree {degree}; give at least "
            f"{degree + 1}."
        )
    return m - int(degree)


def _knots(intervals: int, degree: int) -> Array:
    """Return clamped knots at whole numbers."""
    return np.pad(np.arange(intervals + 1.0), degree, mode="edge")


def _rates(intervals: int, degree: int) -> Array:
    """Return degree over the knots' distance, for each difference of two control points."""
    knots = _knots(intervals, degree)[1:-1]
    return degree / (knots[degree:] - knots[:-degree])


def _halved(intervals: int, degree: int) -> Any:
    """Return the sparse map to the control points on knots half as far apart.

    A new control point is the blossom of the old spline at the inner knots of its support.
    """
    from scipy.sparse import csr_array

    old, new = _knots(intervals, degree), _knots(2 * intervals, degree) / 2.0
    rows = np.arange(2 * intervals + degree)
    # Any piece under the new basis function will do; the middle one keeps the shares small.
    inside = np.clip(rows + (degree + 1) // 2, degree, degree + 2 * intervals - 1)
    piece = (inside - degree) // 2
    unit = np.broadcast_to(np.eye(degree + 1)[:, None, :], (degree + 1, len(rows), degree + 1))
    knots = old[np.arange(2 * degree)[:, None] + piece + 1]
    weights = blossom(unit, knots, [new[rows + 1 + k] for k in range(degree)])
    weights = np.where(np.abs(weights) < ROUNDING, 0.0, weights)
    columns = piece[:, None] + np.arange(degree + 1)
    where = (np.repeat(rows, degree + 1), columns.ravel())
    matrix = csr_array((weights.ravel(), where), shape=(len(rows), intervals + degree))
    matrix.eliminate_zeros()
    return matrix


@dataclass(frozen=True, kw_only=True, eq=False)
class SampledCurve(Pieces):
    """A piecewise polynomial through samples of a motion.

    With velocities and accelerations the pieces are of fifth degree and meet both; with velocities
    only they are cubic and meet those; positions alone are joined by the cubic spline whose
    accelerations are continuous.

    Attributes
    ----------
    time : ndarray, shape (K,)
        Increasing times in s; the curve starts at the first, which need not be zero.
    position : ndarray, shape (K, n)
        Positions in rad (m for prismatic joints).
    velocity, acceleration : ndarray, shape (K, n), optional
        In rad/s and rad/s² (m/s, m/s²).

    Raises
    ------
    DataError
        When shapes differ, there are fewer than two samples, a value is not finite, time does not
        increase, or there are accelerations without velocities.
    """

    time: Array
    position: Array
    velocity: Array | None = None
    acceleration: Array | None = None

    def __post_init__(self) -> None:
        time = real_array(self.time, "time", ndim=1)
        if len(time) < 2:
            raise DataError(f"sampled motion: {len(time)} samples; at least two are needed.")
        short = np.flatnonzero(np.diff(time) <= 0.0)
        if short.size:
            k = int(short[0])
            raise DataError(
                f"sampled motion: time does not increase at sample {k + 1}: {time[k + 1]} s after "
                f"{time[k]} s."
            )
        object.__setattr__(self, "time", frozen(time))
        n = real_array(self.position, "position", ndim=2).shape[1]
        for name in ("position", "velocity", "acceleration"):
            if (values := getattr(self, name)) is not None:
                what = ": one row a sample, one column a joint"
                values = shaped(values, f"sampled motion: {name}", (len(time), n), what)
                object.__setattr__(self, name, values)
        if self.acceleration is not None and self.velocity is None:
            raise DataError("sampled motion: accelerations without velocities; give both.")

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.position.shape[1])

    @cached_property
    def duration(self) -> float:  # type: ignore[override]
        """Duration in s."""
        return float(self.time[-1] - self.time[0])

    @cached_property
    def breaks(self) -> Array:  # type: ignore[override]
        """Times of the samples from the first on, (K,), in s."""
        return frozen(self.time - self.time[0])

    @property
    def smooth(self) -> int:
        """The highest derivative that is continuous: 1 where only velocities are given, else 2."""
        return 1 if self.velocity is not None and self.acceleration is None else 2

    @cached_property
    def _offsets(self) -> Array:
        """Bernstein coefficients of each piece, less its first position, (q + 1, K - 1, n)."""
        h, moved = np.diff(self.breaks)[:, None], np.diff(self.position, axis=0)
        velocity = self.velocity
        if velocity is None:
            from scipy.interpolate import CubicSpline

            velocity = CubicSpline(self.breaks, self.position)(self.breaks, 1)
        inner = [velocity[:-1] * h / 3.0, moved - velocity[1:] * h / 3.0]
        if self.acceleration is not None:
            leave, arrive = velocity[:-1] * h / 5.0, velocity[1:] * h / 5.0
            first, last = (a * h**2 / 20.0 for a in (self.acceleration[:-1], self.acceleration[1:]))
            inner = [leave, 2.0 * leave + first, moved - 2.0 * arrive + last, moved - arrive]
        return np.stack([np.zeros_like(moved), *inner, moved])

    @cached_property
    def control_points(self) -> Array:  # type: ignore[override]
        """Bernstein coefficients of each piece, (q + 1, K - 1, n), in rad."""
        return np.asarray(self._offsets + self.position[:-1])

    def _polynomials(self, derivative: int, piece: Any) -> tuple[Array, Array, Array]:
        """Return control points (q+1, S, n), knots (2q, S) and rounding (S, n) of S pieces."""
        from scipy.interpolate import BPoly

        h, degree = np.diff(self.breaks)[piece, None], len(self._offsets) - 1
        if derivative == 0:
            points = self._offsets[:, piece] + self.position[piece]
            scale = np.abs(points).max(axis=0)
        else:
            points = BPoly(self._offsets, self.breaks).derivative(derivative).c[:, piece]
            scale = np.abs(self._offsets[:, piece]).max(axis=0)
        for order in range(derivative):
            scale = scale * 2.0 * max(degree - order, 0) / h
        ends = self.breaks[np.stack([piece, piece + 1])]
        return points, np.repeat(ends, len(points) - 1, axis=0), ROUNDING * scale
