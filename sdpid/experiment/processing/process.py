"""Turn a recording into samples: filter, differentiate, cut, average, decimate.

The chain is that of section III-C of the paper [denso]_. Its steps are linear and do not
depend on time, so they may be carried out in any order. Here each channel is filtered period by
period, together with its neighbors on either side, and added at once to the average. Up to
rounding, that equals filtering the whole record first, and it needs the memory of one period.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common import progress as _progress
from sdpid._common.arrays import Array, Mask
from sdpid._common.threads import one_thread
from sdpid.errors import DataError
from sdpid.experiment.processing.base import GRAVITY, require_finite, with_base
from sdpid.experiment.processing.choose import default_processing, with_changes
from sdpid.experiment.processing.pipeline import Pipeline, efforts_of, states_of
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.readers.scaled import require_torques
from sdpid.experiment.recording.floating import T
from sdpid.experiment.recording.gaps import continuous
from sdpid.experiment.recording.plausible import require_no_outliers, require_plausible_units
from sdpid.experiment.recording.recording import Recording

# A block must be clearly longer than the memory of the filter, which is run twice: forward and
# backward (four times over the derivatives with filter_alike=False).
_BLOCK_TIME_CONSTANTS = 20.0
_BLOCK_SECONDS = 1.0
# A repeated effort that varies by less than this part of its rms is noise-free: rounding.
_NOISE_FREE = 1e-9


@one_thread
def process(
    log: Recording,
    processing: Processing | Mapping[str, Any] | None = None,
    *,
    position_limits: ArrayLike | None = None,
    gravity: Sequence[float] | None = None,
    progress: bool | None = None,
) -> Samples:
    """Turn a recording into samples for a regression: filter, differentiate, average, decimate.

    Angles that wrap are continued. A record without periods is split where samples are missing
    (more than four in a row, and more than 10 ms), and each piece is processed separately; pieces
    that are too short are dropped. No transient of the filter is left: records without periods are
    trimmed at their ends (`Processing.trim_s`), and periods are filtered with their neighborhood.
    The steps in order: docs/guides/processing.md.

    Parameters
    ----------
    log : Recording
        What was measured.
    processing : Processing or mapping, optional
        How to process it; by default what `identify` chooses for this recording. A mapping
        changes some of these settings, such as ``{"cutoff_hz": 10.0}``. ``Processing.paper()``
        is section III-C of the paper to the letter.
    position_limits : (n, 2) array_like, optional
        The robot's limits in rad, infinite where there are none. They tell degrees from radians
        more surely than the positions alone.
    gravity : sequence of 3 floats, optional
        Of a robot with a floating base, in world axes, m/s²; by default (0, 0, -9.81).
    progress : bool, optional
        Show a progress bar or not; by default on a terminal.

    Returns
    -------
    Samples
        With `notes` that say what was done and noticed. Those of a recording with a base hold its
        turn, angular velocity and accelerations before those of the joints, and its contacts.

    Raises
    ------
    DataError
        When positions look like degrees or jump by more than two turns in a step, the cut-off is
        not below half the sample rate, time stamps of a record with periods
        have a gap, the record (or every piece of it) is too short, periods are too few for a
        covariance or do not look alike, or a joint has no row left after masking.

    Examples
    --------
    >>> samples = sdpid.process(log, {"cutoff_hz": 10.0})
    >>> samples
    Samples(1000 samples, 6 joints, 5222 rows used, mean of 2 periods)
    >>> samples.notes[1]
    'zero-phase Butterworth filter of order 2 at 10 Hz: all signals once'
    """
    if not isinstance(log, Recording):
        raise DataError(
            f"log: is {log!r:.80}; give a Recording, such as sdpid.read_recording(path) returns."
        )
    require_torques(log)
    require_no_outliers(log)
    require_plausible_units(log, position_limits)
    if not isinstance(processing, Processing):
        processing = with_changes(default_processing(log, processing), processing or {})
    if processing.velocity == "measured" and log.velocity is None:
        raise DataError(
            "velocity: the recording has none, but velocity is 'measured'; use "
            "velocity='differentiated'."
        )
    if log.base is not None:
        require_finite(log, processing)
    _check_period_count(log, processing)
    pieces, notes = continuous(log)
    pieces = tuple(on_time(piece, processing) for piece in pieces)
    notes = [*notes, *delay_notes(log, processing)]
    gravity = GRAVITY if gravity is None else gravity
    with _progress.progress(log.n * len(pieces), "processing", enabled=progress) as advance:
        samples = _joined(
            [(each, _processed(each, processing, advance, gravity)) for each in pieces]
        )
    if samples.mask is not None:
        samples = _unmasked(samples, processing)
    return replace(samples, notes=(*processing.why, *notes, *samples.notes))


def _joined(pieces: list[tuple[Recording, Samples | str]]) -> Samples:
    """Join the samples of the pieces of a record, but for those that are too short, and why."""
    short = [(piece, found) for piece, found in pieces if isinstance(found, str)]
    if len(short) == len(pieces):
        longest, why = max(short, key=lambda each: each[0].duration)
        if len(pieces) == 1:
            raise DataError(why)
        raise DataError(
            f"time: gaps split the record into {len(short)} pieces, each too short; of the "
            f"longest, with {longest.n_samples} samples: {why}"
        )
    samples = Samples.join([found for _, found in pieces if isinstance(found, Samples)])
    if not short:
        return samples
    dropped = (
        f"{len(short)} of {len(pieces)} pieces dropped, too short to be filtered: "
        f"{sum(piece.n_samples for piece, _ in short)} samples, "
        f"{sum(piece.duration for piece, _ in short):.6g} s"
    )
    return replace(samples, notes=(dropped, *samples.notes))


def _processed(
    log: Recording,
    processing: Processing,
    advance: Callable[[int], object],
    gravity: Sequence[float],
) -> Samples | str:
    """Process a record without gaps and wrapped angles; return why, where it is too short."""
    pipeline = Pipeline.of(log, processing)
    if isinstance(pipeline, str):
        advance(log.n)
        return pipeline
    step, decimation = pipeline.grid.step, pipeline.decimation
    states = states_of(log, pipeline, advance=advance)
    wanted = log.period is not None and processing.covariance is not None
    effort, covariance, effort_periods, lost = efforts_of(log, pipeline, covariance=wanted)
    notes = [*_notes(log, pipeline, states["mask"]), *lost]
    if covariance is not None:
        # Pooled over the samples, or shrunk towards that.
        pooled, share = np.asarray(covariance.mean(axis=0)), processing.shrinkage
        own = processing.covariance != "pooled"
        covariance = (1.0 - share) * covariance + share * pooled if own else pooled
        notes += _noise_free(log, covariance, effort)
    memory_s = pipeline.low_pass.time_constant * step
    block_s = max(_BLOCK_TIME_CONSTANTS * memory_s, _BLOCK_SECONDS)
    kept = np.arange(0, pipeline.length, decimation, dtype=np.float64)
    samples = Samples(
        **states,
        effort=effort,
        covariance=covariance,
        time=pipeline.grid.origin + step * (pipeline.first + kept),
        joint_names=log.joint_names,
        periods=None if log.period is None else pipeline.periods,
        block=min(math.ceil(block_s * (1.0 / (step * decimation))), kept.size),
        notes=tuple(notes),
        effort_periods=effort_periods,
        gains=log.gains,
    )
    return samples if log.base is None else with_base(samples, log, pipeline, gravity)


def _noise_free(log: Recording, covariance: Array, effort: Array) -> list[str]:
    """Return a note on the joints whose efforts repeat without noise, if there are any."""
    variance = np.diagonal(covariance, axis1=-2, axis2=-1).reshape(-1, log.n)
    noise, size = np.sqrt(variance.mean(axis=0)), np.sqrt(np.mean(effort**2, axis=0))
    exact = [name for j, name in enumerate(log.names) if noise[j] <= _NOISE_FREE * size[j]]
    if not exact:
        return []
    return [
        f"the effort of joint {', '.join(exact)} repeats exactly: its covariance is rounding "
        "error, use covariance=None"
    ]


def _check_period_count(log: Recording, processing: Processing) -> None:
    """Raise when the periods are too few for the covariance, before any work is done."""
    layout = log.period_layout
    if layout is None or processing.covariance is None:
        return
    P, n = layout[2], log.n
    if P < 2:
        raise DataError(
            "periods: the record has 1, a covariance needs at least 2; record more, or use "
            "covariance=None."
        )
    if processing.covariance == "period" and processing.shrinkage == 0.0 and n >= P:
        raise DataError(
            f"periods: {P} periods for {n} joints: Sigma_k has a rank of at most {P - 1}, so it "
            f"has no inverse; at least {n + 1} periods are needed. Record more, or use "
            "covariance='pooled', shrinkage between 0 and 1, or covariance=None."
        )


def _unmasked(samples: Samples, processing: Processing) -> Samples:
    """Return the samples with all rows of each joint that the mask leaves next to none of.

    Raises
    ------
    DataError
        When all rows of a joint are masked: a joint at rest cannot be identified.
    """
    share = samples.used.mean(axis=0)
    few, limit = share < processing.kept_share, 100.0 * processing.kept_share
    if few.any():
        names = [f"{samples.names[j]} {100.0 * share[j]:.3g} %" for j in np.flatnonzero(few)]
        note = (
            f"not masked, since less than {limit:.3g} % of the rows would stay: {', '.join(names)}"
        )
        samples = replace(samples, mask=samples.used | few, notes=(*samples.notes, note))
    empty = [samples.names[j] for j in np.flatnonzero(~samples.used.any(axis=0))]
    if empty:
        raise DataError(
            f"mask: leaves no row of joint {', '.join(empty)}: it never moves clear of standstill, "
            f"{processing.reversal_time:g} s away from any speed below "
            f"{processing.reversal_speed:g} rad/s. Use a motion that moves it, a shorter "
            "reversal_time, or reversal_time=None to keep all rows."
        )
    return samples


def _notes(log: Recording, pipeline: Pipeline, mask: Mask | None) -> list[str]:
    """Return notes on what was done, in order."""
    processing, grid, low_pass = pipeline.processing, pipeline.grid, pipeline.low_pass
    notes = [] if grid.note is None else [grid.note]
    alike = "all signals once"
    if pipeline.passes == 2:
        alike = "position and torque once, velocity and acceleration twice"
        if processing.velocity == "measured":
            alike = "position, velocity and torque once, acceleration twice"
    memory = ""
    if processing.filter == "finite":
        memory = f", which sees {1e3 * low_pass.reach * grid.step:.3g} ms to either side"
    notes.append(
        f"zero-phase {processing.filter.capitalize()} filter of order {processing.order} at "
        f"{processing.cutoff_hz:g} Hz{memory}: {alike}"
    )
    if pipeline.circular:
        notes.append(
            f"mean of {pipeline.periods} periods of {pipeline.length} samples ({log.period:g} s)"
        )
    else:
        notes.append(
            f"{pipeline.first * grid.step:.4g} s trimmed at either end, "
            f"{pipeline.first / low_pass.time_constant:.3g} time constants of the filter"
        )
    if pipeline.decimation > 1:
        notes.append(f"one sample in {pipeline.decimation} kept")
    if mask is not None:
        shares = ", ".join(
            f"{name} {100.0 * (1.0 - share):.3g} %"
            for name, share in zip(log.names, mask.mean(axis=0), strict=True)
        )
        notes.append(
            f"rows masked within {processing.reversal_time:g} s of a speed below "
            f"{processing.reversal_speed:g} rad/s: {shares}"
        )
    return notes


# Groups of channels that share a clock, as words; joint positions are what all are compared with.
CHANNELS = {
    "effort": "efforts",
    "imu": "the IMU",
    "base": "pose and velocities of the base",
    "contacts": "contacts",
}
# What a note on a channel that was moved ends with.
ON_TIME = ": taken on time"

# A piece must be this many times as long as its longest shift.
_LEAST_LENGTH = 4.0


def delayed_channels(log: Recording, processing: Processing) -> dict[str, float]:
    """Return the delays, in s, of channels that were recorded (see `CHANNELS`), but for zeros."""
    imu = None if log.base is None else log.base.imu
    has = {"effort": log.effort, "imu": imu, "base": log.base, "contacts": log.contacts}
    given = {name: float(getattr(processing, f"{name}_delay_s")) for name in CHANNELS}
    return {name: x for name, x in given.items() if x != 0.0 and has[name] is not None}


def delay_notes(log: Recording, processing: Processing) -> list[str]:
    """Return what is shifted, in words."""
    return [
        f"{CHANNELS[name]} recorded {1e3 * abs(delay):.3g} ms too "
        f"{'late' if delay > 0.0 else 'early'}{ON_TIME}"
        for name, delay in delayed_channels(log, processing).items()
    ]


def on_time(log: Recording, processing: Processing) -> Recording:
    """Return a piece of a recording with every channel at the time of the joints' positions.

    Channels are interpolated by cubic splines, flags are those of the nearest sample. Of a record
    with periods the end continues with the beginning; others lose the samples at an end that one
    of their channels does not have. Delays of channels that were not recorded do nothing.

    Parameters
    ----------
    log : Recording
        Without gaps.
    processing : Processing
        The delays of its channels (`Processing.effort_delay_s` and others).

    Raises
    ------
    DataError
        When the recording is shorter than four times a delay.
    """
    delays = delayed_channels(log, processing)
    if not delays:
        return log
    longest = max(abs(delay) for delay in delays.values())
    if log.duration < _LEAST_LENGTH * longest:
        raise DataError(
            f"delays: {longest:g} s in a piece of {log.duration:g} s, the limit is a quarter of it."
        )
    changes: dict[str, Any] = {}
    if "effort" in delays:
        changes["effort"] = _later(log, log.effort, delays["effort"])
    if log.contacts is not None:
        changes["contacts"] = _shifted(log, log.contacts, delays.get("contacts"))
    if log.base is not None:
        base = _shifted(log, log.base, delays.get("base"))
        imu = base.imu and _shifted(log, base.imu, delays.get("imu"))
        changes["base"] = replace(base, imu=imu)
    shifted = replace(log, **changes)
    if log.period is not None:
        return shifted
    time = np.asarray(log.time)
    early, late = min(0.0, *delays.values()), max(0.0, *delays.values())
    # Half a step, so that whole steps are not lost to rounding.
    slack = 0.5 * log.step
    kept = np.flatnonzero((time + early > time[0] - slack) & (time + late < time[-1] + slack))
    return shifted.rows(slice(int(kept[0]), int(kept[-1]) + 1))


def _later(log: Recording, table: Any, delay: float) -> Any:
    """Return a table (N, ...) of a recording, each value from `delay` later."""
    from scipy.interpolate import CubicSpline

    time = np.asarray(log.time)
    first, last, wanted = float(time[0]), float(time[-1]), time + delay
    if log.period is not None:
        wanted = np.where(wanted > last, wanted - log.period, wanted)
        wanted = np.where(wanted < first, wanted + log.period, wanted)
    wanted = np.clip(wanted, first, last)
    if table.dtype == np.bool_:
        after = np.clip(np.searchsorted(time, wanted), 1, len(time) - 1)
        nearer = wanted - time[after - 1] < time[after] - wanted
        return table[after - nearer]
    # Times relative to the first: stamps since 1970 lose digits in the cubes.
    spline = CubicSpline(time - time[0], np.asarray(table), axis=0)
    return np.asarray(spline(wanted - time[0]))


def _shifted(log: Recording, owner: T, delay: float | None) -> T:
    """Return a base, an IMU or contacts with all channels from `delay` later."""
    if delay is None:
        return owner
    later = {name: _later(log, table, delay) for name, table in owner.channels.items()}
    if "orientation" in later:
        norms = np.linalg.norm(later["orientation"], axis=1, keepdims=True)
        later["orientation"] = later["orientation"] / norms
    return replace(owner, **later)
