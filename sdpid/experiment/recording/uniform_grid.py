"""From time stamps to a uniform grid: taken as it is, by sample index, or by interpolation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.recording.recording import Recording

Timing = Literal["auto", "nominal", "resample"]

# Stamps are uniform when no step is off by more than this part of the nominal one. A stamp in
# seconds since 1970 has a resolution of 2.4e-7 s, which is 2.4e-4 of a step at 1 kHz.
_JITTER = 1e-3
# Gaps up to this many steps, or this long (s: a tenth of a period of the fastest motion of an arm),
# are bridged by the spline; in a longer one motion is unknown, and records without periods
# are split there.
MAX_GAP_STEPS = 5.0
_MAX_GAP_S = 0.01
# Stamps that stay this close (in steps) to a straight line can be late stamps of regular samples.
_MAX_WANDER_STEPS = 0.5
# Interpolate only if the stamps predict left-out positions at least this much better than the
# sample index does. On the Panda's log they tie (0.999), on the LWR4+'s the stamps are 10^4
# times worse; interpolation costs bandwidth, so ties go to the index.
_CLEARLY_BETTER = 0.95
# Samples used for that comparison: enough to tell, cheap on long records.
_COMPARED = 20_000
# A cubic spline forgets a knot by a factor of 3.7 a knot: 30 knots away 1e-17 is left.
_SPLINE_REACH = 30


@dataclass(frozen=True, kw_only=True, eq=False)
class Grid:
    """A uniform time grid over a recording, read channel by channel.

    Attributes
    ----------
    origin, step : float
        Time of the first grid point and the distance of two, in s.
    count : int
        Number of grid points.
    stamps : (N,) ndarray or None
        Time stamps to interpolate from; None where samples are taken by index.
    note : str or None
        What was done to the time stamps, if anything.
    """

    origin: float
    step: float
    count: int
    stamps: Array | None = None
    note: str | None = None

    def read(self, column: Array, start: int, stop: int) -> Array:
        """Return grid points `start` to `stop` of one channel, given its recorded samples."""
        if self.stamps is None:
            return np.ascontiguousarray(column[start:stop])
        from scipy.interpolate import CubicSpline

        wanted = self.origin + self.step * np.arange(start, stop)
        begin, end = np.searchsorted(self.stamps, (wanted[0], wanted[-1]))
        knots = slice(max(0, int(begin) - _SPLINE_REACH), int(end) + _SPLINE_REACH)
        # Times are taken relative to the chunk: stamps since 1970 lose digits in the cubes.
        spline = CubicSpline(self.stamps[knots] - wanted[0], column[knots])
        values: Array = spline(wanted - wanted[0])
        return values


def longest_gap(step: float) -> float:
    """Return the longest distance of two samples that is bridged, in s."""
    return max(MAX_GAP_STEPS * step, _MAX_GAP_S)


def make_grid(recording: Recording, timing: Timing = "auto") -> Grid:
    """Choose a uniform grid for a recording.

    Parameters
    ----------
    recording : Recording
        The log.
    timing : {"auto", "nominal", "resample"}
        ``"nominal"`` trusts the sample index: sample k was taken at k nominal steps, whatever its
        stamp says. ``"resample"`` trusts the stamps and interpolates every channel by a cubic
        spline. ``"auto"`` takes uniform stamps as they are; otherwise it compares how well every
        second position is predicted from the others, by index and by stamp, and interpolates only
        if the stamps are clearly better or wander off a straight line by more than half a step.

    Returns
    -------
    Grid

    Raises
    ------
    DataError
        When a gap of more than five steps and 10 ms would have to be bridged; `process` splits
        records without periods there beforehand.
    """
    time, stamps, step = recording.time, recording.stamps, recording.step
    if recording.period_layout is not None and recording.period is not None:
        # A whole number of steps to the period, to the last bit.
        step = recording.period / recording.period_layout[1]
    late, early = stamps.most - recording.step, stamps.least - recording.step
    jitter = max(late, -early) / recording.step
    nominal = Grid(origin=stamps.first, step=step, count=time.size)
    if jitter <= _JITTER and timing != "resample":
        return nominal
    # The same arithmetic as in `split_at_gaps`, which leaves no such gap.
    if late > longest_gap(recording.step) - recording.step:
        row = stamps.row
        raise DataError(
            f"time: gap of {late + recording.step:.6g} s before row {row + 1} (from "
            f"{time[row - 1]:.9g} s to {time[row]:.9g} s), {late / recording.step + 1.0:.1f} "
            f"steps of {recording.step:.6g} s, more than "
            f"{longest_gap(recording.step) / recording.step:.3g}; without its period the record is "
            "split there."
        )
    wander = _wander(recording) / recording.step
    seen = f"time stamps jitter by {100.0 * jitter:.3g} % of a step of {recording.step:.6g} s"
    if timing == "auto":
        if wander > _MAX_WANDER_STEPS:
            timing, why = "resample", f"they wander off a regular clock by {wander:.3g} steps"
        else:
            ratio = _stamps_against_index(recording)
            timing = "resample" if ratio < _CLEARLY_BETTER else "nominal"
            why = (
                f"positions left out are predicted from the stamps with {ratio:.4g} times the "
                "error from the sample index"
            )
    else:
        why = "as given"
    if timing == "nominal":
        note = f"{seen}; samples taken as regular, {1.0 / step:.6g} Hz ({why})"
        return Grid(origin=nominal.origin, step=step, count=time.size, note=note)
    # Rounded, not cut: an early last stamp must not cost a sample of the last period.
    count = round(recording.duration / step) + 1
    note = f"{seen}; channels resampled to {1.0 / step:.6g} Hz by cubic splines ({why})"
    stamps_read = np.asarray(time)
    return Grid(origin=nominal.origin, step=step, count=count, stamps=stamps_read, note=note)


def _wander(recording: Recording) -> float:
    """Return by how much the stamps stray to either side of a regular clock, in s."""
    deviation = np.arange(recording.n_samples) * -recording.step + recording.time
    return float(np.ptp(deviation)) / 2.0


def _stamps_against_index(recording: Recording) -> float:
    """Return the error of left-out positions predicted by stamp, over that by index."""
    from scipy.interpolate import CubicSpline

    begin = max(0, (recording.n_samples - _COMPARED) // 2)
    part = slice(begin, begin + _COMPARED)
    time = recording.time[part] - recording.time[begin]
    index = np.arange(time.size) * recording.step
    position = recording.position[part]
    errors = []
    for knots in (time, index):
        if time.size < 2 * _SPLINE_REACH:
            return 1.0
        guess = CubicSpline(knots[::2], position[::2])(knots[1::2])
        # The ends of a spline are worse than its middle for either choice.
        errors.append(float(np.sqrt(np.mean((guess - position[1::2])[2:-2] ** 2))))
    if errors[1] == 0.0:
        return 1.0 if errors[0] == 0.0 else float("inf")
    return errors[0] / errors[1]
