"""Checks of the time stamps: units, gaps, jitter, and rows that repeat the row before."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdpid.errors import DataError
from sdpid.experiment.inspection.kinds import KINDS, Finding, found, note, refuse, warning
from sdpid.experiment.inspection.subject import Subject, check
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.recording.uniform_grid import MAX_GAP_STEPS

KINDS.update(
    time_stamps=refuse("{why}", final=True),
    continued=note("{note}"),
    units=note("{note}"),
    recording=note("{note}"),
    time_unit=refuse("{seen}", "{remedy}", hides=("speed",), spoils=True),
    jitter=note(
        "time stamps jitter by {jitter:.3g %} of a step of {step:.4g} s (rms), limit {limit:g %}",
        "stamp samples where they are measured",
    ),
    lost_samples=warning(
        "{lost} of {all} samples ({share:.3g %}) are missing between the others, limit {limit:g %}",
        "log with a larger buffer, or at a lower rate",
    ),
    repeated_rows=warning(
        "{rows} of {all} rows ({share:.3g %}) repeat the row before in every position and effort, "
        "limit {limit:g %}: the log is written faster than the robot measures",
        "remove the repeated rows, or log at the robot's rate",
    ),
)

# A row is repeated where no position and no effort changes. More repeats than these in a row are
# rest; a logger that runs faster than the robot makes fewer, many times.
_MOST_REPEATS = 20
_SHARE = 0.02
# Looked for among this many rows from the middle of the recording.
_COMPARED = 100_000
# Slower or faster, in Hz, no controller logs; stamps in ms that are read as seconds do, and stamps
# in seconds that are read as ms. The fastest logs of drives have 20 kHz.
_LEAST_RATE, _FASTEST_RATE = 2.0, 25e3
# Logs of 5 kHz, too, whose stamps in ms are read as seconds: below this rate some joint must be
# faster than this (rad/s, or m/s). Excitations reach fifty times as much.
_SLOW_RATE, _LEAST_SPEED = 25.0, 0.02
# Stamps that are off a regular clock by this part of a step jitter.
_JITTER = 0.05
# More than this share of lost samples is no accident.
_LOST = 0.05
# Seconds in the units of stamps that may be read as seconds.
_UNITS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_GIVE_UNIT = "give the unit: units={'time': 's'} (--unit time=s), or ms, us, ns"


@check
def gaps_and_wraps(subject: Subject) -> Iterator[Finding]:
    """Find gaps and stamps that came late, and angles that wrap."""
    continued = subject.view.continued
    if isinstance(continued, DataError):
        yield found("time_stamps", why=str(continued))
        return
    for text in continued[1]:
        yield found("continued", note=text)


@check
def units_of_time(subject: Subject) -> Iterator[Finding]:
    """Say where the unit of time was inferred, and find rates of no robot's logger."""
    log, rate = subject.log, subject.log.rate_hz
    for text in log.notes:
        if text.startswith("time:"):
            remedy = f"where that is wrong, {_GIVE_UNIT}"
            yield found("time_unit", None, "note", seen=text, remedy=remedy, rate=rate)
        else:
            # Else of who made the recording, such as a simulator.
            yield found("units" if text.startswith("units:") else "recording", note=text)
    rows = subject.low_passed if _LEAST_RATE <= rate < _SLOW_RATE else None
    if rows is not None and (fastest := float(np.abs(rows.velocity).max())) < _LEAST_SPEED:
        cause, remedy = _read_as_seconds(rate)
        seen = (
            f"time: at {rate:.3g} Hz no joint is faster than {fastest:.2g} rad/s, limit "
            f"{_LEAST_SPEED:g} rad/s: {cause}"
        )
        numbers = {"rate": rate, "speed": fastest, "limit": _LEAST_SPEED}
        yield found("time_unit", seen=seen, remedy=remedy, **numbers)
    if not _LEAST_RATE <= rate <= _FASTEST_RATE:
        slow = rate < _LEAST_RATE
        cause, remedy = "the stamps may be in s, and were read as ms, us or ns", _GIVE_UNIT
        if slow:
            cause, remedy = _read_as_seconds(rate)
        seen = (
            f"time: a sample every {log.step:.6g} s is a rate of {rate:.3g} Hz, limit "
            f"{_LEAST_RATE:g} to {_FASTEST_RATE:g} Hz: {cause}"
        )
        limit = _LEAST_RATE if slow else _FASTEST_RATE
        yield found("time_unit", seen=seen, remedy=remedy, rate=rate, limit=limit)


def _read_as_seconds(rate: float) -> tuple[str, str]:
    """Return in which unit stamps are that make so low a rate as seconds, and how to give it."""
    rates = {unit: rate / seconds for unit, seconds in _UNITS.items()}
    likely = {unit: hz for unit, hz in rates.items() if _LEAST_RATE <= hz <= _FASTEST_RATE}
    if not likely:
        return "in no unit do the stamps make a rate of a robot", "give time stamps in s"
    words = " or ".join(f"{unit} ({hz:.4g} Hz)" for unit, hz in likely.items())
    units = [f"units={{'time': '{unit}'}} (--unit time={unit})" for unit in likely]
    certain = "must be" if len(likely) == 1 else "may be"
    return f"the stamps {certain} in {words}", f"give the unit: {' or '.join(units)}"


@check
def jitter_and_losses(subject: Subject) -> Iterator[Finding]:
    """Find stamps off a regular clock, and samples that were lost."""
    log = subject.log
    steps = np.diff(np.asarray(log.time[_middle(log)])) / log.step
    jitter = float(np.sqrt(np.mean((steps - np.rint(steps)) ** 2)))
    if jitter > _JITTER:
        yield found("jitter", jitter=jitter, step=log.step, limit=_JITTER)
    # Longer steps are gaps, at which the recording is split.
    few = np.rint(steps[steps < MAX_GAP_STEPS])
    lost = int(np.maximum(few - 1.0, 0.0).sum())
    every = steps.size + lost
    if lost / every > _LOST:
        yield found("lost_samples", lost=lost, all=every, share=lost / every, limit=_LOST)


@check
def repeated_rows(subject: Subject) -> Iterator[Finding]:
    """Find rows that repeat the row before, as loggers write that run faster than the robot."""
    log, part = subject.log, _middle(subject.log)
    values = np.hstack([np.asarray(log.position[part]), np.asarray(log.effort[part])])
    changed = np.flatnonzero((values[1:] != values[:-1]).any(axis=1))
    runs = np.diff(changed, prepend=-1, append=len(values) - 1) - 1
    repeats = int(runs[runs <= _MOST_REPEATS].sum())
    share = repeats / len(values)
    if share > _SHARE:
        yield found("repeated_rows", rows=repeats, all=len(values), share=share, limit=_SHARE)


def _middle(log: Recording) -> slice:
    """Return the rows that are looked at."""
    begin = max(0, (log.n_samples - _COMPARED) // 2)
    return slice(begin, begin + _COMPARED)
