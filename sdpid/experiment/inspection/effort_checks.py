"""Checks of single efforts: channels without a signal, and clipped values."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.inspection.kinds import Finding, found
from sdpid.experiment.inspection.subject import Subject, check
from sdpid.experiment.recording.rest import moving
from sdpid.experiment.recording.stored import extremes

# A joint whose effort is exactly zero in more than this share of the rows in which it moves has no
# signal there; of 30 real recordings at most 0.1 %. Of so many rows, those count whose step is
# more than this share of its 90th percentile.
_ZERO, _SOME, _FAST, _MOST_STEPS = 0.5, 2000, 0.1, 90.0
# Steps are taken from the row before to the row behind.
_FEWEST = 3
# A channel is clipped where it stays at its very largest value for this many samples in a row,
# this many times or once for so many samples, and in this share of all rows.
_PLATEAU, _PLATEAUS, _LONG, _CLIPPED = 5, 2, 20, 0.002
# A clipped velocity is passed by the rate of the position by this factor; a robot that runs at one
# speed is not clipped.
_PASSED = 1.02
# Of a signal in coarse steps the step below the largest is as long: clipped ones are this many
# times as long there as on it.
_LONGER = 3.0
# Looked for among this many rows from the middle of the recording.
_COMPARED = 200_000


def silent(subject: Subject) -> list[Finding]:
    """Find joints whose effort is zero while they move; not where that is so of all that move."""
    log, told = subject.log, []
    low, high = subject.position_range
    if log.n_samples < _FEWEST:
        return []
    rows = np.unique(np.linspace(1, log.n_samples - 2, _SOME).astype(np.intp))
    steps = np.abs(log.position[rows + 1] - log.position[rows - 1])
    moves = moving(low, high) & [name not in subject.passive for name in log.names]
    for j in np.flatnonzero(moves):
        fast = steps[:, j] > _FAST * np.percentile(steps[:, j], _MOST_STEPS)
        share = float(np.mean(log.effort[rows[fast], j] == 0.0)) if fast.any() else 0.0
        if share > _ZERO:
            told.append(found("effort_silent", log.names[j], share=share, limit=_ZERO))
    return told if len(told) < np.count_nonzero(moves) else []


@check
def signals(subject: Subject) -> Iterator[Finding]:
    """Find efforts that never change."""
    low, high = extremes(subject.log.effort)
    for j, name in enumerate(subject.log.names):
        # Without a motor a joint has none.
        if name not in subject.passive and not high[j] > low[j]:
            yield found("effort_constant", name, value=low[j])


@check
def clipped(subject: Subject) -> Iterator[Finding]:
    """Find efforts and velocities that stop at a largest value while the joint moves."""
    log = subject.log
    low, high = subject.position_range
    begin = max(0, (log.n_samples - _COMPARED) // 2)
    part = slice(begin, begin + _COMPARED)
    for quantity, severity in (("effort", None), ("velocity", subject.about_velocity)):
        table = getattr(log, quantity)
        if table is None:
            continue
        for j in np.flatnonzero(moving(low, high)).tolist():
            values = np.asarray(table[part, j])
            ends = {}
            for limit in (float(values.max()), float(values.min())):
                rows = _plateaus(values, limit)
                if limit == 0.0 or rows < _CLIPPED * values.size:
                    continue
                if quantity == "effort" or _passed(subject, j, limit):
                    ends[limit] = rows
            if ends:
                rows = sum(ends.values())
                yield found(
                    f"{quantity}_clipped",
                    log.names[j],
                    severity,
                    at=" and at ".join(f"{limit:.5g}" for limit in ends),
                    value=max(ends, key=abs),
                    rows=rows,
                    all=values.size,
                    share=rows / values.size,
                    limit=_CLIPPED,
                )


def _passed(subject: Subject, j: int, limit: float) -> bool:
    """Return whether the rate of a joint's position goes beyond a largest or least velocity."""
    rows = subject.low_passed
    if rows is None:
        return False
    speeds = rows.velocity[:, j]
    return bool(speeds.max() > limit * _PASSED or speeds.min() < limit * _PASSED)


def _plateaus(values: Array, limit: float) -> int:
    """Return the number of rows in plateaus at the largest or least value, 0 if not clipped."""
    edges = np.flatnonzero(np.diff((values == limit).astype(np.int8), prepend=0, append=0))
    lengths = edges[1::2] - edges[::2]
    lengths = lengths[lengths >= _PLATEAU]
    if lengths.size < _PLATEAUS and lengths.max(initial=0) < _LONG:
        return 0
    others = values[values != limit]
    if others.size:
        nearest = others.max() if limit >= others.max() else others.min()
        # A coarse signal holds its last but one value as long as its last.
        if lengths.sum() < _LONGER * np.count_nonzero(values == nearest):
            return 0
    return int(lengths.sum())
