"""Lines of long records, recordings one after the other, and shaded stretches."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid.errors import DataError
from sdpid.plots.figures import SHADE

# Pixels across a panel are a few hundred: more points than this a line do not show.
POINTS = 1500

# Between recordings, as a share of all their time.
_GAP = 0.02


def long_line(axis: Any, x: Array, y: Array, **style: Any) -> Any:
    """Draw a line; of many points the least and the greatest of each stretch."""
    options = {"linewidth": 0.9, "solid_joinstyle": "round", **style}
    return axis.plot(*decimate(x, y), **options)[0]


def stretch(count: int, *, points: int = POINTS) -> int:
    """Return the length of the stretches of which `decimate` keeps two samples; 1 keeps all."""
    return 1 if count <= points else -(-count // max(points // 2, 1))


def decimate(x: ArrayLike, y: ArrayLike, *, points: int = POINTS) -> tuple[Array, Array]:
    """Return at most about `points` points that draw the same line.

    Each stretch keeps its least and its greatest value at their own places, so that peaks and the
    thickness of noise stay; the first and the last point stay too. Where y is NaN the line is
    broken.

    Parameters
    ----------
    x, y : array_like, shape (K,)
        The line.
    points : int, optional
        About how many points to keep.

    Returns
    -------
    x, y : ndarray
    """
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    count = len(y)
    if count <= points:
        return x, y
    size = stretch(count, points=points)
    # The last stretch is filled up with the last point; gaps count as nothing, and stay gaps.
    padded = np.concatenate([y, np.full(-count % size, y[-1])])
    gaps = np.isnan(padded).reshape(-1, size)
    blocks = np.where(gaps, 0.0, padded.reshape(-1, size))
    at = np.arange(len(blocks)) * size
    kept = [at + blocks.argmin(axis=1), at + blocks.argmax(axis=1), [0, count - 1]]
    kept.append((at + gaps.argmax(axis=1))[gaps.any(axis=1)])
    index = np.unique(np.minimum(np.concatenate(kept), count - 1))
    return x[index], y[index]


@dataclass(frozen=True, eq=False)
class TimeLine:
    """The time axis of a plot, with recordings one after the other.

    No line is drawn from one piece to the next, and a gap is left between them.

    Attributes
    ----------
    time : ndarray, shape (K + pieces - 1,)
        With one instant more in every gap.
    label : str
        Of the axis.
    """

    time: Array
    label: str
    _breaks: tuple[int, ...]

    @classmethod
    def of(cls, time: Array | None, count: int, starts: Sequence[int]) -> TimeLine:
        """Lay out `count` samples; without time they are counted."""
        own = np.arange(count, dtype=np.float64) if time is None else np.array(time)
        label = "sample" if time is None else "time [s]"
        breaks = tuple(starts[1:])
        if not breaks:
            return cls(own, label, ())
        pieces = [piece - piece[0] for piece in np.split(own, breaks)]
        gap = _GAP * sum(float(piece[-1]) for piece in pieces)
        shifted, begin = [pieces[0]], float(pieces[0][-1])
        for piece in pieces[1:]:
            shifted += [np.array([begin + 0.5 * gap]), begin + gap + piece]
            begin = float(shifted[-1][-1])
        return cls(np.concatenate(shifted), f"{label}, recordings behind each other", breaks)

    @property
    def instants(self) -> Array:
        """Where the samples are on the axis, (K,)."""
        return np.delete(self.time, np.add(self._breaks, range(len(self._breaks))).astype(int))

    def broken(self, y: Array) -> Array:
        """Return values (K,) with a break in every gap."""
        return np.insert(y, self._breaks, np.nan) if self._breaks else y

    def kept(self, flags: Any) -> Any:
        """Return flags (K, ...) that are set in the gaps."""
        return np.insert(flags, self._breaks, True, axis=0) if self._breaks else flags


def spans(x: Array, flags: ArrayLike) -> tuple[Array, Array]:
    """Return where the stretches of x begin and end in which a flag is set.

    A sample stands for what is nearer to it than to its neighbors.
    """
    padded = np.concatenate([[False], np.asarray(flags, dtype=bool), [False]])
    ends = np.flatnonzero(padded[1:] != padded[:-1])
    edges = np.concatenate([x[:1], 0.5 * (x[1:] + x[:-1]), x[-1:]])
    return edges[ends[::2]], edges[ends[1::2]]


def shade(axis: Any, x: Array, flags: ArrayLike) -> None:
    """Shade the stretches of x where a flag is set, over the full height."""
    low, high = spans(x, flags)
    if not len(low):
        return
    corners = np.zeros((len(low), 4, 2))
    corners[:, :2, 0], corners[:, 2:, 0], corners[:, 1:3, 1] = low[:, None], high[:, None], 1.0
    polygons = require("matplotlib.collections", extra="plot").PolyCollection
    style = {"facecolor": SHADE, "linewidth": 0, "zorder": 0.5}
    drawn = polygons(corners, transform=axis.get_xaxis_transform(), **style)
    axis.add_collection(drawn, autolim=False)


def same_length(arrays: Iterable[tuple[str, Array]], length: int) -> None:
    """Check that arrays have `length` rows.

    Raises
    ------
    DataError
        Naming the first that has not.
    """
    for name, array in arrays:
        if len(array) != length:
            raise DataError(f"plot: {name} has {len(array)} rows, time has {length}.")
