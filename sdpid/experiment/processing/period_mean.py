"""Filter a channel period by period; return the mean period and the spread about it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array
from sdpid.experiment.processing.filters import Stencil, ZeroPhaseFilter
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Chain:
    """A filter, the window that it is run over, and the samples of its output to keep.

    Attributes
    ----------
    window : Window
        The part of the record to be filtered.
    low_pass : ZeroPhaseFilter
        The filter; a pass is forward and backward.
    stencil : Stencil
        Central differences.
    decimation : int
        One sample in `decimation` is kept.
    passes : int
        Zero-phase passes over a signal that is to be differentiated, 1 or 2. What is kept as it
        is (position, torque, a measured velocity) always gets 1.
    margin : int
        Samples on either side that differences and mask need.
    """

    window: Window
    low_pass: ZeroPhaseFilter
    stencil: Stencil
    decimation: int
    passes: int
    margin: int

    def kept(self, signal: NDArray[Any]) -> Any:
        """Return the kept samples of a period that has margins of equal length at both ends."""
        margin = (signal.size - self.window.length) // 2
        return signal[margin : margin + self.window.length : self.decimation]

    def parts(self, size: int) -> Iterator[Chain]:
        """Yield the chain for consecutive parts of the window of about `size` samples.

        A periodic window is one part, since its periods are averaged.
        """
        window = self.window
        if window.circular:
            yield self
            return
        size = max(1, size // self.decimation) * self.decimation
        for first in range(0, window.length, size):
            length = min(size, window.length - first)
            yield replace(self, window=replace(window, first=window.first + first, length=length))

    def period(self, column: Array, p: int) -> Array:
        """Return one period with its margins, filtered once."""
        pad = self.low_pass.reach
        signal = self.window.read(column, p, pad + self.margin)
        return self.low_pass.apply(signal)[pad : signal.size - pad]

    def mean(self, column: Array) -> tuple[Array, Array, float]:
        """Return the averages after one and after `passes` passes, and the periods' spread.

        The averages still have their margins; with one pass they are the same array. Averaging
        commutes with the filter, so only averages are filtered. The spread is the rms deviation of
        the unfiltered periods from their mean: at least as large as that of the filtered ones,
        which `spread` returns.
        """
        window, pad = self.window, self.low_pass.reach
        size = window.length + 2 * (pad + self.margin)
        inner = slice(pad + self.margin, size - pad - self.margin)
        signal, squares = np.zeros(size), 0.0
        for p in range(window.periods):
            period = self.window.read(column, p, pad + self.margin)
            change = np.subtract(period, signal, out=_writable(period))
            if p:
                squares += p / (p + 1) * float(np.dot(change[inner], change[inner]))
                change /= p + 1
            signal += change
        once = signal = self.low_pass.apply(signal)
        for _ in range(self.passes - 1):
            signal = self.low_pass.apply(signal)
        keep = slice(pad, size - pad)
        return once[keep], signal[keep], math.sqrt(squares / (window.periods * window.length))

    def spread(self, column: Array) -> float:
        """Return the rms deviation of the kept samples, filtered, from their mean over periods."""
        window = self.window
        kept = np.array([self.kept(self.period(column, p)) for p in range(window.periods)])
        kept -= kept.mean(axis=0)
        return float(np.sqrt(np.mean(kept**2)))


def _writable(signal: Array) -> Array | None:
    """Return the array if it may be overwritten, being a copy of the recording; else None."""
    return signal if signal.flags.writeable else None


def near_standstill(
    velocity: Array, speed: float, reach: int, *, circular: bool
) -> NDArray[np.bool_]:
    """Return which samples are near a reversal or a standstill.

    Parameters
    ----------
    velocity : (N,) ndarray
        Velocity of one joint.
    speed : float
        Below this speed a sample is slow.
    reach : int
        Samples at most this far from a slow one are near it.
    circular : bool
        The last sample is followed by the first.

    Returns
    -------
    (N,) ndarray of bool
    """
    slow = np.abs(velocity) < speed
    # A fast reversal may pass the slow band between two samples: both are then slow.
    negative = np.signbit(velocity)
    turns = negative[1:] != negative[:-1]
    slow[1:] |= turns
    slow[:-1] |= turns
    if circular and negative[0] != negative[-1]:
        slow[0] = slow[-1] = True
    reach = min(reach, velocity.size)
    around = np.pad(slow, reach, mode="wrap") if circular else np.pad(slow, reach)
    counts = np.concatenate(([0], np.cumsum(around)))
    near: NDArray[np.bool_] = counts[2 * reach + 1 :] != counts[: -2 * reach - 1]
    return near
