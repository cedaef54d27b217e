"""Piecewise polynomials, evaluated and enclosed by their blossoms.

The blossom of a polynomial of degree q is the symmetric function of q arguments, affine in each,
that equals the polynomial where all arguments are equal. Its values at repeated ends of an
interval are the Bernstein coefficients there, and the polynomial stays between the least and the
largest of them [farin2002]_.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.trajectory.curve import cells_within, times_within

# Bounds are widened by this much of the largest number that enters them: a blossom of degree q is
# q convex combinations of at most five roundings each, a derivative a few more.
ROUNDING = 64.0 * float(np.finfo(np.float64).eps)


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
