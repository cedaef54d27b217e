"""Filter and differentiate the positions of a record: the motion half of processing."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.processing.efforts import in_threads
from sdpid.experiment.processing.filters import ZeroPhaseFilter
from sdpid.experiment.processing.period_mean import Chain, Window, near_standstill
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.processing.wide_velocity import WideVelocity, wide_velocity
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.recording.rest import AT_REST
from sdpid.experiment.recording.uniform_grid import Grid, make_grid

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
# Records without periods are filtered in pieces of this many samples, to save memory.
CHUNK = 1 << 18
# decimation=None: the paper keeps ten samples per period of the cut-off frequency.
_RATE_OVER_CUTOFF = 10.0


class TooShortError(DataError):
    """Raised when a record is too short to be filtered."""


@dataclass(frozen=True, kw_only=True, eq=False)
class States:
    """Filtered states of the kept samples of a record without gaps.

    Attributes
    ----------
    position, velocity, acceleration : (K, n) ndarray
        In rad, rad/s and rad/s².
    mask : (K, n) ndarray of bool or None
        Rows clear of standstill, where the processing masks.
    wide : WideVelocity or None
        What friction columns need to pass the filter of the efforts, where they do.
    """

    position: Array
    velocity: Array
    acceleration: Array
    mask: NDArray[np.bool_] | None
    wide: WideVelocity | None


def chain_of(log: Recording, processing: Processing) -> Chain:
    """Return the filter, the window and the decimation of a record without gaps.

    Raises
    ------
    TooShortError
        When nothing is left between the trimmed ends.
    DataError
        When time stamps cannot be made regular, or periods lack samples.
    """
    grid = make_grid(log, processing.timing)
    low_pass = processing.low_pass(1.0 / grid.step)
    stencil = processing.stencil(1.0 / grid.step)
    window = _window(log, grid, low_pass, processing)
    decimation = processing.decimation or max(
        1, math.floor(1.0 / (grid.step * _RATE_OVER_CUTOFF * processing.cutoff_hz) + 1e-9)
    )
    reach = _reach(processing, grid)
    return Chain(
        window=window,
        low_pass=low_pass,
        stencil=stencil,
        decimation=decimation,
        passes=1 if processing.filter_alike else 2,
        # A reversal just outside the window masks rows inside it (a change of sign shows one sample
        # further out); a periodic window has no outside.
        margin=stencil.margin + (0 if window.circular else reach + 1),
    )


def states_of(
    log: Recording,
    chain: Chain,
    processing: Processing,
    *,
    repeats: bool = True,
    advance: Callable[[int], object] = lambda _: None,
) -> States:
    """Filter and differentiate the positions of a record without gaps.

    Parameters
    ----------
    log : Recording
        The record.
    chain : Chain
        From `chain_of`, of this record or of another one with the same time stamps.
    processing : Processing
        The settings.
    repeats : bool, optional
        Whether periods that do not look alike are refused.
    advance : callable, optional
        Told the number of joints that are done.

    Raises
    ------
    DataError
        When periods do not look alike.
    """
    window, decimation = chain.window, chain.decimation
    reach = _reach(processing, window.grid)
    K, n = len(range(0, window.length, decimation)), log.n
    position, velocity, acceleration = (np.empty((K, n)) for _ in range(3))
    mask = None if processing.reversal_time is None else np.empty((K, n), dtype=np.bool_)

    def motion(j: int) -> None:
        columns = log.position[:, j], None if log.velocity is None else log.velocity[:, j]
        first = 0
        for part in chain.parts(CHUNK):
            q, fine, a = _motion(log, j, columns, part, processing, repeats)
            rows = slice(first, first + q.size)
            position[rows, j], acceleration[rows, j] = q, a
            velocity[rows, j] = part.kept(fine)
            if mask is not None:
                speed = processing.reversal_speed
                slow = near_standstill(fine, speed, reach, circular=window.circular)
                mask[rows, j] = ~part.kept(slow)
            first = rows.stop
        # Noise of a joint at rest would be scaled up like any other motion.
        if np.ptp(position[:, j]) <= AT_REST:
            velocity[:, j] = acceleration[:, j] = 0.0
        advance(1)

    in_threads(motion, range(n))
    wide = None
    if processing.filter_friction:
        resting = np.asarray(~velocity.any(axis=0))
        wide = wide_velocity(log, chain, processing, resting, chunk=CHUNK)
    return States(
        position=position, velocity=velocity, acceleration=acceleration, mask=mask, wide=wide
    )


def _reach(processing: Processing, grid: Grid) -> int:
    """Return how many samples around a slow one are masked."""
    return math.floor((processing.reversal_time or 0.0) / grid.step + 1e-9)


def _motion(
    log: Recording,
    j: int,
    columns: tuple[Array, Array | None],
    chain: Chain,
    processing: Processing,
    repeats: bool,
) -> tuple[Array, Array, Array]:
    """Return position (K,), velocity at the full rate and acceleration (K,) of one joint.

    The velocity keeps the rest of its margins, for the mask.

    Filtering a derivative is differentiating what was filtered, and averaging commutes with
    both. So no derivative is filtered: only averages are differentiated, of the position after
    as many passes as its derivatives are to have.
    """
    step = chain.window.grid.step
    column, measured = columns
    signal, last, spread = chain.mean(column)
    motion = float(np.std(last))
    limit = max(_PERIOD_SPREAD * motion, _PERIOD_SPREAD_FLOOR)
    # What the filter removes does not count, but that is only looked at where it matters.
    if repeats and spread > limit and (spread := chain.spread(column)) > limit:
        raise DataError(
            f"period: the periods of joint {log.names[j]} do not repeat: their positions spread "
            f"by {spread:.3g} rad (rms) where the mean period moves by {motion:.3g} rad (rms), "
            f"limit {100 * _PERIOD_SPREAD:g} %. Check period ({log.period:g} s) and start, and "
            "leave out periods before the motion has settled."
        )
    position = chain.kept(signal)
    differences = chain.stencil
    if processing.velocity == "differentiated":
        velocity = differences.velocity(last, step)
        return position, velocity, chain.kept(differences.acceleration(last, step))
    assert measured is not None
    signal, last, _ = chain.mean(measured)
    velocity = differences.inner(signal)
    return position, velocity, chain.kept(differences.velocity(last, step))


def _window(
    log: Recording, grid: Grid, low_pass: ZeroPhaseFilter, processing: Processing
) -> Window:
    """Return the part of the grid to keep: the whole periods, or all but the ends."""
    layout = log.period_layout
    if layout is not None:
        first, length, periods = layout
        if first + length * periods > grid.count:
            raise DataError(
                f"periods: {periods} periods of {length} samples from sample {first} on need "
                f"{first + length * periods} samples, there are {grid.count}: samples were lost; "
                "use timing='resample'."
            )
        return Window(grid=grid, first=first, length=length, periods=periods, circular=True)
    if processing.trim_s is None:
        trim = math.ceil(_TRIM_TIME_CONSTANTS * low_pass.time_constant)
    else:
        trim = round(processing.trim_s / grid.step)
    length = grid.count - 2 * trim
    if length < 1:
        raise TooShortError(
            f"time: the record lasts {log.duration:.4g} s, and {trim * grid.step:.4g} s are cut "
            f"off at either end (memory of the filter at {processing.cutoff_hz:g} Hz: "
            f"{low_pass.time_constant * grid.step:.3g} s); record longer, raise cutoff_hz, or "
            "set trim_s."
        )
    return Window(grid=grid, first=trim, length=length, periods=1, circular=False)
