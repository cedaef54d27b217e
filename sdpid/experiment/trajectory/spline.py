"""`Spline`: joint motion as a B-spline on uniform, clamped knots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen, real_array
from sdpid.errors import DataError
from sdpid.experiment.trajectory.curve import ROUNDING, Pieces, blossom, times_within

# Position, velocity and acceleration at an end are those of as many control points.
_END = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class Spline(Pieces):
    """A B-spline on uniform knots over [0, duration], clamped at both ends.

    Its derivatives are splines of lower degree whose control points bound them (`control`). With
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
    def n(self) -> int:
        """Number of joints."""
        return int(self.control_points.shape[1])

    @property
    def smooth(self) -> int:
        """The highest derivative that is continuous."""
        return self.degree - 1

    @property
    def knots(self) -> Array:
        """The m + degree + 1 knots in s, the ends degree + 1 times."""
        intervals = len(self.control_points) - self.degree
        return self.duration * (_knots(intervals, self.degree) / intervals)

    @property
    def breaks(self) -> Array:
        """The distinct knots in s, shape (m - degree + 1,)."""
        return self.knots[self.degree : -self.degree]

    def matrix(self, time: ArrayLike, derivative: int = 0) -> Any:
        """Return the sparse matrix (K, m) from control points to a derivative at given times."""
        return self.basis(len(self.control_points), self.duration, time, derivative, self.degree)

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

    def control(self, derivative: int = 0, halvings: int = 0) -> Array:
        """Return control points of a derivative after its knots were halved some times.

        Their least and largest bound the derivative at every instant; each halving brings the
        bounds about four times closer.

        Returns
        -------
        ndarray, shape (rows, n)
        """
        points = self._derivative(derivative)
        intervals = len(self.control_points) - self.degree
        for _ in range(halvings):
            points = _halved(intervals, max(self.degree - derivative, 0)) @ points
            intervals *= 2
        return points

    @staticmethod
    def control_matrix(
        m: int, duration: float, derivative: int = 0, halvings: int = 0, degree: int = 5
    ) -> Any:
        """Return the linear map from m control points to what `control` returns.

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
