"""Read the kept part of a record period by period, with samples on either side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.recording.uniform_grid import Grid


@dataclass(frozen=True, kw_only=True, eq=False)
class Window:
    """`periods` stretches of `length` grid points from `first` on, one after the other.

    Attributes
    ----------
    grid : Grid
        The uniform grid of the record.
    first, length, periods : int
        Where the first stretch begins, how long each is, and how many there are.
    circular : bool
        True for a periodic record, which continues at either end of the window with its other
        end; False for one that is continued by point reflection at the ends of the record.
    """

    grid: Grid
    first: int
    length: int
    periods: int
    circular: bool

    def read(self, column: Array, period: int, pad: int) -> Array:
        """Return one stretch of a channel, with `pad` points on either side.

        Parameters
        ----------
        column : (N,) ndarray
            The recorded samples of the channel.
        period : int
            Which stretch, from 0.
        pad : int
            How many points of the neighborhood on either side. Recorded ones are used where all
            of them were recorded, else the record is continued as `circular` says.

        Returns
        -------
        (length + 2 pad,) ndarray
        """
        start = self.first + period * self.length
        stop = start + self.length
        low, high = start - pad, stop + pad
        if low >= 0 and high <= self.grid.count:
            return self.grid.read(column, low, high)
        if self.circular:
            left = self._wrapped(column, low, start) if low < 0 else None
            right = self._wrapped(column, stop, high) if high > self.grid.count else None
            middle = self.grid.read(
                column, low if left is None else start, high if right is None else stop
            )
            return np.concatenate([part for part in (left, middle, right) if part is not None])
        inner = self.grid.read(column, max(low, 0), min(high, self.grid.count))
        return _reflected(inner, max(0, -low), max(0, high - self.grid.count))

    def _wrapped(self, column: Array, low: int, high: int) -> Array:
        """Return grid points that lie outside the window from inside it, cyclically."""
        total = self.periods * self.length
        parts = []
        while low < high:
            begin = (low - self.first) % total
            end = min(total, begin + high - low)
            parts.append(self.grid.read(column, self.first + begin, self.first + end))
            low += end - begin
        return np.concatenate(parts)


def _reflected(signal: Array, left: int, right: int) -> Array:
    """Continue a signal by point reflection at its ends, then by its last value."""
    before, after = min(left, signal.size - 1), min(right, signal.size - 1)
    extended = np.pad(signal, (before, after), mode="reflect", reflect_type="odd")
    return np.pad(extended, (left - before, right - after), mode="edge")
