"""Shift channels of a recording that are late, or early, against the joints' positions."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from sdpid.errors import DataError
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.floating import T
from sdpid.experiment.recording.recording import Recording

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
    has = {
        "effort": True,
        "imu": log.base is not None and log.base.imu is not None,
        "base": log.base is not None,
        "contacts": log.contacts is not None,
    }
    given = {name: float(getattr(processing, f"{name}_delay_s")) for name in CHANNELS if has[name]}
    return {name: delay for name, delay in given.items() if delay != 0.0}


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
