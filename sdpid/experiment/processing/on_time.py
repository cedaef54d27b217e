"""Shift channels of a recording that are late, or early, against the joints' positions."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.floating.base import BaseMotion
from sdpid.experiment.recording.floating.contacts import Contacts
from sdpid.experiment.recording.recording import Recording, rows_of

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
    shift = _Shift(log)
    if "effort" in delays:
        changes["effort"] = shift.values(log.effort, delays["effort"])
    if log.base is not None and delays.keys() & {"base", "imu"}:
        changes["base"] = _base(log.base, shift, delays)
    if log.contacts is not None and "contacts" in delays:
        changes["contacts"] = _contacts(log.contacts, shift, delays["contacts"])
    shifted = replace(log, **changes)
    if log.period is not None:
        return shifted
    time = np.asarray(log.time)
    early, late = min(0.0, *delays.values()), max(0.0, *delays.values())
    # Half a step, so that whole steps are not lost to rounding.
    slack = 0.5 * log.step
    kept = np.flatnonzero((time + early > time[0] - slack) & (time + late < time[-1] + slack))
    return rows_of(shifted, slice(int(kept[0]), int(kept[-1]) + 1))


class _Shift:
    """Reads channels of a recording at later times."""

    def __init__(self, log: Recording) -> None:
        self._time, self._period = np.asarray(log.time), log.period

    def _wanted(self, delay: float) -> Array:
        first, last = float(self._time[0]), float(self._time[-1])
        wanted = self._time + delay
        if self._period is not None:
            wanted = np.where(wanted > last, wanted - self._period, wanted)
            wanted = np.where(wanted < first, wanted + self._period, wanted)
        return np.asarray(np.clip(wanted, first, last))

    def values(self, table: Array, delay: float) -> Array:
        """Return a table (N, ...), each value from `delay` later."""
        from scipy.interpolate import CubicSpline

        # Times relative to the first: stamps since 1970 lose digits in the cubes.
        spline = CubicSpline(self._time - self._time[0], np.asarray(table), axis=0)
        return np.asarray(spline(self._wanted(delay) - self._time[0]))

    def nearest(self, table: Any, delay: float) -> Any:
        """Return flags (N, c), each the nearest to `delay` later."""
        wanted = self._wanted(delay)
        after = np.clip(np.searchsorted(self._time, wanted), 1, len(self._time) - 1)
        nearer = wanted - self._time[after - 1] < self._time[after] - wanted
        return table[after - nearer]


def _base(base: BaseMotion, shift: _Shift, delays: dict[str, float]) -> BaseMotion:
    """Return the motion of a base on time."""
    changes: dict[str, Any] = {}
    if "base" in delays:
        changes = {name: shift.values(t, delays["base"]) for name, t in base.channels.items()}
        turned = changes["orientation"]
        changes["orientation"] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    if base.imu is not None and "imu" in delays:
        sensed = {name: shift.values(t, delays["imu"]) for name, t in base.imu.channels.items()}
        changes["imu"] = replace(base.imu, **sensed)
    return replace(base, **changes)


def _contacts(contacts: Contacts, shift: _Shift, delay: float) -> Contacts:
    """Return contacts on time."""
    given = contacts.channels.items()
    ways = {"down": shift.nearest}
    return replace(contacts, **{name: ways.get(name, shift.values)(t, delay) for name, t in given})
