"""The largest value of functions along a curve, bounded at every instant.

Time is cut into cells. Over each cell a `CurveMeasure` bounds its functions; cells on which a bound
does not decide are cut in half, until every function is known to hold its limit or to break it at
an instant that was evaluated.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array
from sdpid.experiment.trajectory.curve import Curve

# Cells are at most this long at first, s: motions of arms change over tenths of a second.
_FIRST = 0.1
# Cells shorter than this (s) are not cut: what is undecided then is within a hair of its limit.
FINEST = 1e-7
# At most this many cells are looked at, a few seconds' work.
_MOST = 400_000
# Plans may touch their limits, and bounds are widened by rounding: so much is let pass, as a share
# of the limit, and of this number where the limit is smaller.
_TOUCHING, _SMALL = 1e-9, 1e-3

# Of m functions: upper bounds that hold at every instant, the largest values that were evaluated,
# and where, s; each of shape (m,).
Extremes = tuple[Array, Array, Array]


@dataclass(frozen=True, eq=False)
class Cells:
    """C cells of time along a curve, with what was evaluated at their ends.

    Attributes
    ----------
    curve : Curve
        The motion.
    start, stop : ndarray, shape (C,)
        Ends in s, increasing; cells do not overlap.
    left, right : ndarray, shape (C, d)
        Values of the measure's nodes at both ends, as seen from inside.
    """

    curve: Curve
    start: Array
    stop: Array
    left: Array
    right: Array

    @property
    def width(self) -> Array:
        """Lengths (C, 1) in s."""
        return (self.stop - self.start)[:, None]

    def enclose(self, derivative: int) -> tuple[Array, Array]:
        """Return bounds (C, n) of a derivative of the positions, below and above."""
        edges = np.union1d(self.start, self.stop)
        place = np.searchsorted(edges, self.start)
        lower, upper = self.curve.enclose(edges, derivative=derivative)
        return lower[place], upper[place]

    def largest(self, derivative: int) -> Array:
        """Return bounds (C, n) on the size of a derivative of the positions."""
        return np.asarray(np.maximum(*np.abs(self.enclose(derivative))))

    @cached_property
    def sizes(self) -> Array:
        """Bounds (5, C, n) on the sizes of the positions and their four derivatives."""
        return np.stack([self.largest(order) for order in range(5)])


class CurveMeasure(ABC):
    """m functions along a curve that must not grow too large."""

    @abstractmethod
    def nodes(self, curve: Curve, time: Array) -> Array:
        """Return what bounds need of an instant, (K,) to (K, d)."""

    def values(self, nodes: Array) -> Array:
        """Return the functions at instants, (K, d) to (K, m): by default the nodes."""
        return nodes

    @abstractmethod
    def bounds(self, cells: Cells) -> Array:
        """Return upper bounds (C, m) of the functions over cells."""


def extremes(curve: Curve, measure: CurveMeasure, limits: Array, resolution: Array) -> Extremes:
    """Return the largest values of functions along a curve.

    Parameters
    ----------
    curve : Curve
        The motion.
    measure : CurveMeasure
        The functions.
    limits : ndarray, shape (m,)
        Values that they must not exceed.
    resolution : ndarray, shape (m,)
        Bounds are refined until they are this close to a value that was evaluated, and further
        while a limit lies between the two.
    """
    start, stop = _first_cells(curve)
    # Just before the ends: a derivative that jumps is seen from the left there.
    left, right = measure.nodes(curve, start), measure.nodes(curve, np.nextafter(stop, -np.inf))
    known = np.concatenate([measure.values(left), measure.values(right)])
    reached, when = _top(known, np.concatenate([start, stop]))
    worst = reached
    allowed = with_tolerance(limits)
    seen = len(start)
    while True:
        ends = np.maximum(measure.values(left), measure.values(right))
        bounds = np.maximum(measure.bounds(Cells(curve, start, stop, left, right)), ends)
        # A bound may be far from what is reached, or from deciding.
        wide = (bounds > allowed) & (reached <= allowed) | (bounds > reached + resolution)
        cut = wide.any(axis=1) & (stop - start > FINEST) & (seen <= _MOST)
        worst = np.maximum(worst, bounds[~cut].max(axis=0, initial=-np.inf))
        if not cut.any():
            return np.maximum(worst, reached), reached, when
        start, stop, left, right = start[cut], stop[cut], left[cut], right[cut]
        middle = 0.5 * (start + stop)
        nodes = measure.nodes(curve, middle)
        top, place = _top(measure.values(nodes), middle)
        when = np.where(top > reached, place, when)
        reached = np.maximum(reached, top)
        seen += 2 * len(middle)
        start, stop, left, right = (
            np.stack(pair, axis=1).reshape(2 * len(middle), *pair[0].shape[1:])
            for pair in ((start, middle), (middle, stop), (left, nodes), (nodes, right))
        )


def with_tolerance(limits: ArrayLike) -> Array:
    """Return upper limits with what is let pass for rounding."""
    values = np.asarray(limits, dtype=np.float64)
    return np.asarray(values + _TOUCHING * np.maximum(np.abs(values), _SMALL))


def _top(values: Array, time: Array) -> tuple[Array, Array]:
    """Return the largest of values (K, m) of functions, and when."""
    best = np.argmax(values, axis=0)
    return values[best, np.arange(values.shape[1])], time[best]


def _first_cells(curve: Curve) -> tuple[Array, Array]:
    """Return the ends of cells between the breaks of a curve."""
    breaks = np.asarray(curve.breaks)
    count = np.maximum(1, np.ceil(np.diff(breaks) / _FIRST)).astype(int)
    parts = [
        low + (high - low) * np.arange(k) / k
        for low, high, k in zip(breaks[:-1], breaks[1:], count, strict=True)
    ]
    edges = np.append(np.concatenate(parts), breaks[-1])
    return edges[:-1], edges[1:]
