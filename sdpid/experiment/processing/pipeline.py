"""From the channels of a record without gaps to states and efforts: the filter of `process`."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array, Mask, frozen_view
from sdpid.errors import DataError
from sdpid.experiment.processing.filters import (
    BAND_OVER_RATE,
    Weights,
    ZeroPhaseFilter,
    low_pass,
    reflected,
)
from sdpid.experiment.processing.samples import WideVelocity
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.gaps import Grid, make_grid
from sdpid.experiment.recording.plausible import AT_REST
from sdpid.experiment.recording.recording import Recording

# Without periods the signals beyond the ends are guessed; the guess decays exponentially.
# On real logs (UR10, Gen3; orders 1, 2, 4 at 4, 10, 15 Hz) 5 time constants left at most 2 % of
# the rms acceleration and 0.7 % of the rms torque, on the outermost samples only and below what
# any model of these robots misses; 10 left 2e-4 and 5e-5 and would cost a third of a record of
# two seconds at 10 Hz.
_TRIM_TIME_CONSTANTS = 5.0
# Periods of a settled periodic motion repeat to a per cent or so; with a wrong period they
# differ by as much as the joint moves. Below a hundredth of a radian it does not matter.
_PERIOD_SPREAD = 0.2
_PERIOD_SPREAD_FLOOR = 0.01
# decimation=None: the paper keeps ten samples per period of the cut-off frequency.
_RATE_OVER_CUTOFF = 10.0
# The band of the velocity of friction columns, in cut-offs of the efforts' filter, and the least
# rate at which it is sampled: 20 samples a period of its own cut-off. Four times the band leaves a
# reversal at its time and an encoder's noise out.
_WIDE_BAND = 4.0
_WIDE_RATE_OVER_CUTOFF = 80.0
# Records without periods are filtered in pieces of this many samples, to save memory.
CHUNK = 1 << 18
# Decoding and filtering let other threads run, but each holds some copies of a period.
_MOST_THREADS = 4
# The efforts of all periods are kept up to this many bytes, for a bootstrap over periods; more
# would make the memory grow with the length of the record.
_MOST_KEPT = 1 << 27


@dataclass(frozen=True, kw_only=True, eq=False)
class Pipeline:
    """How each channel of a record without gaps is read, filtered, averaged and decimated.

    Kept are `periods` stretches of `length` grid points from `first` on, one after the other.

    Attributes
    ----------
    processing : Processing
        The settings that it is made of.
    grid : Grid
        The uniform grid of the record.
    first, length, periods : int
        Where the first stretch begins, how long each is, and how many there are.
    circular : bool
        True for a periodic record, which continues at either end of the stretches with its other
        end; False for one that is continued by point reflection at the ends of the record.
    low_pass : ZeroPhaseFilter
        The filter; a pass is forward and backward.
    decimation : int
        One sample in `decimation` is kept.
    passes : int
        Zero-phase passes over a signal that is to be differentiated, 1 or 2. What is kept as it
        is (position, torque, a measured velocity) always gets 1.
    masked : int
        How many samples around a slow one are masked.
    margin : int
        Samples on either side that differences and mask need.
    """

    processing: Processing
    grid: Grid
    first: int
    length: int
    periods: int
    circular: bool
    low_pass: ZeroPhaseFilter
    decimation: int
    passes: int
    masked: int
    margin: int

    @staticmethod
    def of(log: Recording, processing: Processing) -> Pipeline | str:
        """Return how settings process a record without gaps, or why it is too short.

        Raises
        ------
        DataError
            When time stamps cannot be made regular, or periods lack samples.
        """
        grid = make_grid(log, processing.timing)
        rate, cutoff = 1.0 / grid.step, processing.cutoff_hz
        low_pass = processing.low_pass(rate)
        circular = log.period_layout is not None
        if log.period_layout is not None:
            first, length, periods = log.period_layout
            if first + length * periods > grid.count:
                raise DataError(
                    f"periods: {periods} periods of {length} samples from sample {first} on need "
                    f"{first + length * periods} samples, there are {grid.count}: samples were "
                    "lost; use timing='resample'."
                )
        else:
            first, periods = math.ceil(_TRIM_TIME_CONSTANTS * low_pass.time_constant), 1
            if processing.trim_s is not None:
                first = round(processing.trim_s / grid.step)
            length = grid.count - 2 * first
        if length < 1:
            return (
                f"time: the record lasts {log.duration:.4g} s, and {first * grid.step:.4g} s are "
                f"cut off at either end (memory of the filter at {cutoff:g} Hz: "
                f"{low_pass.time_constant * grid.step:.3g} s); record longer, raise cutoff_hz, or "
                "set trim_s."
            )
        fitting = math.floor(1.0 / (grid.step * _RATE_OVER_CUTOFF * cutoff) + 1e-9)
        masked = math.floor((processing.reversal_time or 0.0) / grid.step + 1e-9)
        return Pipeline(
            processing=processing,
            grid=grid,
            first=first,
            length=length,
            periods=periods,
            circular=circular,
            low_pass=low_pass,
            decimation=processing.decimation or max(1, fitting),
            passes=1 if processing.filter_alike else 2,
            masked=masked,
            # A reversal just outside masks rows inside (a change of sign shows one sample further
            # out); a periodic record has no outside.
            margin=processing.stencil().margin + (0 if circular else masked + 1),
        )

    @property
    def differences(self) -> Weights:
        """Central differences."""
        return self.processing.stencil()

    @property
    def count(self) -> int:
        """Number of samples that are kept."""
        return len(range(0, self.length, self.decimation))

    def kept(self, signal: NDArray[Any]) -> Any:
        """Return the kept samples of a signal (M, ...) with margins of equal length at its ends."""
        margin = (len(signal) - self.length) // 2
        return np.ascontiguousarray(signal[margin : margin + self.length : self.decimation])

    def whole(self, table: Array) -> Array:
        """Return channels (N, ...) at all grid points, (M, ...)."""
        flat = np.asarray(table, dtype=np.float64).reshape(len(table), -1)
        columns = [self.grid.read(np.ascontiguousarray(c), 0, self.grid.count) for c in flat.T]
        return np.stack(columns, axis=1).reshape(-1, *table.shape[1:])

    def parts(self) -> Iterator[Pipeline]:
        """Yield what keeps consecutive parts of `CHUNK` samples or more; periods are not parted.

        The last part is no shorter than others: what lies beyond the end of a record is a
        reflection of what is before it.
        """
        size = max(1, CHUNK // self.decimation) * self.decimation
        count = 1 if self.circular else max(1, self.length // size)
        for begin, end in pairwise([*range(0, count * size, size), self.length]):
            yield replace(self, first=self.first + begin, length=end - begin)

    def read(self, column: Array, period: int) -> Array:
        """Return a stretch of a channel (N,), with what filter and margin need on either side.

        Points of the neighborhood are those recorded, where all of them were; else the record is
        continued as `circular` says.
        """
        pad, count = self.low_pass.reach + self.margin, self.grid.count
        start = self.first + period * self.length
        low, high = start - pad, start + self.length + pad
        if not self.circular or (low >= 0 and high <= count):
            inner = self.grid.read(column, max(low, 0), min(high, count))
            return reflected(inner, max(0, -low), max(0, high - count))
        beside = -(-pad // self.length)
        turns = np.arange(period - beside, period + beside + 1) % self.periods
        starts = (self.first + turns * self.length).tolist()
        whole = [self.grid.read(column, each, each + self.length) for each in starts]
        surplus = beside * self.length - pad
        return np.concatenate(whole)[surplus : len(whole) * self.length - surplus]

    def once(self, column: Array, period: int) -> Array:
        """Return a stretch of a channel at the kept samples, filtered once."""
        return np.asarray(self.kept(self.low_pass.apply(self.read(column, period))))

    def mean(self, column: Array) -> tuple[list[Array], float]:
        """Return the average after each of `passes` passes, and the spread of the periods.

        The averages still have their margins. Averaging commutes with the filter, so only averages
        are filtered. The spread is the rms deviation of the unfiltered periods from their mean: at
        least as large as that of the filtered ones.
        """
        signal, squares, reach = self.read(column, 0), 0.0, self.low_pass.reach
        inner = slice(reach + self.margin, reach + self.margin + self.length)
        for p in range(1, self.periods):
            change = self.read(column, p) - signal
            squares += p / (p + 1) * float(np.dot(change[inner], change[inner]))
            change /= p + 1
            signal = signal + change
        passed = []
        for _ in range(self.passes):
            signal = self.low_pass.apply(signal)
            passed.append(signal[reach : len(signal) - reach])
        return passed, math.sqrt(squares / (self.periods * self.length))

    def means(self, table: Array) -> Array:
        """Return channels (N, n) filtered once, as averages over the periods, (K, n)."""
        alone = replace(self, passes=1)

        def mean(part: Pipeline, j: int) -> tuple[Array]:
            return (part.kept(part.mean(table[:, j])[0][0]),)

        return np.asarray(alone.tables(table.shape[1], mean)[0])

    def tables(
        self,
        n: int,
        made: Callable[[Pipeline, int], tuple[NDArray[Any], ...]],
        advance: Callable[[int], object] = lambda _: None,
    ) -> tuple[Any, ...]:
        """Return what is made of n channels, part by part, as tables (K, n).

        Parameters
        ----------
        n : int
            How many channels there are.
        made : callable
            Of one of the `parts` and the number of a channel; returns one (k,) array a table.
        advance : callable, optional
            Told the number of channels that are done.
        """

        def columns(j: int) -> list[NDArray[Any]]:
            parts = [made(part, j) for part in self.parts()]
            advance(1)
            return [np.concatenate(column) for column in zip(*parts, strict=True)]

        with ThreadPoolExecutor(min(_MOST_THREADS, n, os.cpu_count() or 1)) as pool:
            found = list(pool.map(columns, range(n)))
        return tuple(np.stack(table, axis=1) for table in zip(*found, strict=True))


def states_of(
    log: Recording,
    pipeline: Pipeline,
    *,
    repeats: bool = True,
    advance: Callable[[int], object] = lambda _: None,
) -> dict[str, Any]:
    """Filter and differentiate the positions of a record without gaps.

    Filtering a derivative is differentiating what was filtered, and averaging commutes with
    both. So no derivative is filtered: only averages are differentiated, of the position after
    as many passes as its derivatives are to have.

    Parameters
    ----------
    log : Recording
        The record.
    pipeline : Pipeline
        Of this record or of another one with the same time stamps.
    repeats : bool, optional
        Whether periods that do not look alike are refused.
    advance : callable, optional
        Told the number of joints that are done.

    Returns
    -------
    dict
        Fields of `Samples`: position, velocity, acceleration, mask and wide.

    Raises
    ------
    DataError
        When periods do not look alike.
    """
    processing, differences, step = pipeline.processing, pipeline.differences, pipeline.grid.step
    measured = log.velocity if processing.velocity == "measured" else None

    def states(part: Pipeline, j: int) -> tuple[NDArray[Any], ...]:
        positions, spread = part.mean(log.position[:, j])
        if repeats:
            _check_repeats(log, part, j, positions[-1], spread)
        if measured is None:
            velocity = differences.velocity(positions[-1], step)
            acceleration = differences.acceleration(positions[-1], step)
        else:
            velocities, _ = part.mean(measured[:, j])
            velocity = velocities[0][differences.margin : len(velocities[0]) - differences.margin]
            acceleration = differences.velocity(velocities[-1], step)
        slow = _slow(velocity, processing.reversal_speed, part.circular)
        moves = ~near(slow, part.masked, circular=part.circular)
        return tuple(part.kept(each) for each in (positions[0], velocity, acceleration, moves))

    position, velocity, acceleration, mask = pipeline.tables(log.n, states, advance)
    # Noise of a joint at rest would be scaled up like any other motion.
    resting = np.ptp(position, axis=0) <= AT_REST
    velocity[:, resting] = acceleration[:, resting] = 0.0
    wide = None
    if processing.filter_friction:
        wide = (_wide_velocity(log, measured, pipeline, resting),)
    return {
        "position": position,
        "velocity": velocity,
        "acceleration": acceleration,
        "mask": None if processing.reversal_time is None else mask,
        "wide": wide,
    }


def _check_repeats(log: Recording, part: Pipeline, j: int, last: Array, spread: float) -> None:
    """Raise when the periods of a joint do not look alike."""
    motion = float(np.std(last))
    limit = max(_PERIOD_SPREAD * motion, _PERIOD_SPREAD_FLOOR)
    if spread > limit:
        # What the filter removes does not count, but that is only looked at where it matters.
        periods = [part.once(log.position[:, j], p) for p in range(part.periods)]
        spread = float(np.sqrt(np.mean(np.var(periods, axis=0))))
    if spread > limit:
        raise DataError(
            f"period: the periods of joint {log.names[j]} do not repeat: their positions spread "
            f"by {spread:.3g} rad (rms) where the mean period moves by {motion:.3g} rad (rms), "
            f"limit {100 * _PERIOD_SPREAD:g} %. Check period ({log.period:g} s) and start, and "
            "leave out periods before the motion has settled."
        )


def _wide_velocity(
    log: Recording, measured: Array | None, pipeline: Pipeline, resting: Mask
) -> WideVelocity:
    """Return the wide velocity of a record, zero for joints at rest: their noise has no sign."""
    processing, differences = pipeline.processing, pipeline.differences
    rate, cutoff, decimation = 1.0 / pipeline.grid.step, processing.cutoff_hz, pipeline.decimation
    band = min(_WIDE_BAND * cutoff, max(BAND_OVER_RATE * rate, cutoff))
    most = max(rate / (_WIDE_RATE_OVER_CUTOFF * cutoff), 1.0)
    stride = max(d for d in range(1, decimation + 1) if decimation % d == 0 and d <= most)
    filter_of_efforts = processing.low_pass(rate / stride)
    lead = filter_of_efforts.lead
    more = 0 if pipeline.circular else lead * stride
    wide = replace(
        pipeline,
        first=pipeline.first - more,
        length=pipeline.length + 2 * more,
        low_pass=low_pass(processing.filter, band, processing.order, rate),
        decimation=stride,
        passes=1,
        margin=differences.margin,
    )

    def speed(part: Pipeline, j: int) -> tuple[Array]:
        smooth = part.mean((log.position if measured is None else measured)[:, j])[0][0]
        if measured is None:
            smooth = differences.velocity(smooth, part.grid.step)
        return (part.kept(smooth),)

    (velocity,) = wide.tables(log.n, speed)
    velocity[:, resting] = 0.0
    if pipeline.circular:
        velocity = np.pad(velocity, ((lead, lead), (0, 0)), mode="wrap")
    return WideVelocity(
        velocity=frozen_view(velocity),
        step=pipeline.grid.step * stride,
        low_pass=filter_of_efforts,
        first=lead,
        stride=decimation // stride,
        count=pipeline.count,
    )


def efforts_of(
    log: Recording, pipeline: Pipeline, *, covariance: bool = False
) -> tuple[Array, Array | None, Array | None, list[str]]:
    """Filter the efforts of a recording, and add up mean and covariance by Welford's recurrence.

    Returns
    -------
    (K, n) ndarray
        Their mean over the periods, in N·m.
    (K, n, n) ndarray or None
        Sigma_k of the paper's (11) [denso]_, of a rank of at most P - 1, if it is wanted.
    (P, K, n) ndarray or None
        All periods, where there are several and they take no more than 128 MiB.
    list of str
        Why they are not kept.
    """
    P, K, n = pipeline.periods, pipeline.count, log.n
    size = 8 * P * K * n
    periods = np.empty((P, K, n)) if P > 1 and size <= _MOST_KEPT else None
    mean, squares = np.zeros((K, n)), np.zeros((K, n, n) if covariance else 0)
    for p in range(P):

        def effort(part: Pipeline, j: int, p: int = p) -> tuple[Array]:
            return (part.once(log.effort[:, j], p),)

        (values,) = pipeline.tables(n, effort)
        change = values - mean
        mean = mean + change / (p + 1) if p else values
        if covariance and p:
            squares += change[:, :, None] * change[:, None, :] * (p / (p + 1))
        if periods is not None:
            periods[p] = values
    notes = []
    if P > 1 and periods is None:
        notes = [
            f"efforts of the single periods not kept: they take {size / 1e6:.4g} MB, more than "
            f"{_MOST_KEPT / 1e6:.4g} MB"
        ]
    return mean, squares / (P - 1) if covariance else None, periods, notes


def _slow(velocity: Array, speed: float, circular: bool) -> Mask:
    """Return which samples of a velocity (N,) are below a speed, or beside a change of sign."""
    slow = np.abs(velocity) < speed
    # A fast reversal may pass the slow band between two samples: both are then slow.
    negative = np.signbit(velocity)
    turns = negative[1:] != negative[:-1]
    slow[1:] |= turns
    slow[:-1] |= turns
    if circular and negative[0] != negative[-1]:
        slow[0] = slow[-1] = True
    return np.asarray(slow)


def near(flags: Mask, reach: int, *, circular: bool = False) -> Mask:
    """Return whether flags (M,) or (M, c) are set at most `reach` samples away.

    With `circular` the last sample is followed by the first.
    """
    reach = min(reach, len(flags))
    rest = [(0, 0)] * (flags.ndim - 1)
    around = np.pad(flags, [(reach, reach), *rest], mode="wrap" if circular else "constant")
    count = np.pad(np.cumsum(around, axis=0), [(1, 0), *rest])
    return np.asarray(count[2 * reach + 1 :] != count[: -2 * reach - 1])
