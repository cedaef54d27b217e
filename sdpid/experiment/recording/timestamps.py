"""Check time stamps, count lost samples, and guess the unit of stamps without one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError

# A step longer than this many median steps may hold a lost sample, or end with a late stamp.
_LONG = 1.5
# To tell the two apart, stamps on either side are averaged: a lost sample shifts them all.
_NEIGHBORS = 8
# No robot's controller steps faster, in s.
_SHORTEST = 1e-9
# Steps of whole numbers, in the unit that makes a rate between 20 Hz and 20 kHz of them: each unit
# has three decades of its own. Longer steps are counts of nanoseconds all the same.
_LARGEST_STEPS = {"ms": 5e1, "us": 5e4}
# Seconds since 1970 in the years 2001 to 2096: first stamps in that range tell their unit.
_EPOCH = (1e9, 4e9)
_EPOCH_UNITS = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}


@dataclass(frozen=True)
class Stamps:
    """First and last time stamp, and nominal, shortest and longest step of a record.

    Attributes
    ----------
    first, last : float
        The first and the last one, in s.
    step : float
        The duration over the number of steps, samples counted that are missing between regular
        ones, in s.
    least, most : float
        The shortest and the longest step, in s.
    row : int
        The row that ends the (first) longest step.
    """

    first: float
    last: float
    step: float
    least: float
    most: float
    row: int

    @staticmethod
    def of(time: Any) -> Stamps:
        """Check all stamps.

        Where steps differ by half or more, lost samples are looked for.

        Parameters
        ----------
        time : (N,) ndarray
            The stamps, finite.

        Raises
        ------
        DataError
            When they do not increase, naming the first row that does not.
        """
        steps = np.diff(time)
        wrong = np.flatnonzero(steps <= 0.0)
        if wrong.size:
            row = int(wrong[0]) + 1
            how = "repeats" if time[row] == time[row - 1] else "runs backwards"
            raise DataError(
                f"time {how} at row {row + 1}: {time[row]:.9g} s after {time[row - 1]:.9g} s "
                f"({wrong.size} such rows); sort the rows or remove the duplicates."
            )
        first, last, row = float(time[0]), float(time[-1]), int(np.argmax(steps)) + 1
        if last - first < _SHORTEST * steps.size:
            raise DataError(
                f"time: {len(time)} samples within {last - first:.3g} s; say their unit."
            )
        least, most = float(steps.min()), float(steps.max())
        lost = 0 if most < _LONG * least else _lost_samples(np.asarray(time))
        step = (last - first) / (steps.size + lost)
        return Stamps(first, last, step, least, most, row)


def guess_time_unit(time: Any) -> str:
    """Return the unit of stamps that come without one: s, ms, us or ns.

    Stamps that count from 1970 are recognized by their size, other whole numbers by their median
    step: as seconds they would be a log at 1 Hz or less.

    Parameters
    ----------
    time : (N,) ndarray
        The stamps as they stand in the file.
    """
    values = np.asarray(time, dtype=np.float64)
    values = values[np.isfinite(values)]
    if values.size <= 1:
        return "s"
    for unit, factor in _EPOCH_UNITS.items():
        if _EPOCH[0] * factor <= values[0] < _EPOCH[1] * factor:
            return unit
    step = float(np.median(np.diff(values)))
    if step < 1.0 or np.any(values != np.rint(values)):
        return "s"
    return next((unit for unit, most in _LARGEST_STEPS.items() if step <= most), "ns")


def _lost_samples(time: Array) -> int:
    """Count the samples that are missing between regular ones."""
    steps = np.diff(time)
    median = float(np.median(steps))
    lost = 0
    for i in np.flatnonzero(steps > _LONG * median):
        # Late samples catch up within as many as the gap held.
        around = max(_NEIGHBORS, 2 * round(float(steps[i]) / median))
        width = min(around, int(i) + 1, time.size - 1 - int(i))
        before, after = time[i + 1 - width : i + 1], time[i + 1 : i + 1 + width]
        shift = float(np.median(after - before)) / median - width
        lost += max(0, min(round(shift), round(float(steps[i]) / median) - 1))
    return lost
