"""Checks of the efforts: channels without a signal, spikes, and the gravity that they must bear."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.inspection.finding import Finding, Subject, check
from sdpid.experiment.recording.stored import blocks, extremes

# Gravity below this (N.m, rms about its mean) says nothing about the efforts.
_LEAST_GRAVITY = 1.0
# Effort and gravity belong together when they correlate like this. Beyond this ratio either way
# they differ in their units: payloads and drives explain less.
_CORRELATED = 0.9
_GRAVITY_SCALE = 5.0
# A value this many times the 99th percentile of all deviations from the median stands alone.
_SPIKE = 30.0
_PERCENTILE = 99.0


@check
def signals(subject: Subject) -> Iterator[Finding]:
    """Find efforts that never change, and single values far beyond all others."""
    log = subject.log
    low, high = extremes(log.effort)
    for j, name in enumerate(log.names):
        if not high[j] > low[j]:
            yield Finding(
                severity="warning",
                kind="effort_constant",
                joint=name,
                message=f"effort of {name} never changes: it is {low[j]:.4g} in every row",
                remedy="if it was not measured, leave it out (without_effort)",
                numbers={"value": low[j]},
            )
            continue
        sample = np.asarray(log.effort[subject.rows])[:, j]
        middle = float(np.median(sample))
        usual = float(np.percentile(np.abs(sample - middle), _PERCENTILE))
        largest = max(high[j] - middle, middle - low[j])
        if largest > _SPIKE * usual > 0.0:
            row = _row_of(log.effort[:, j], high[j] if high[j] - middle == largest else low[j])
            yield Finding(
                severity="warning",
                kind="effort_spike",
                joint=name,
                message=(
                    f"effort of {name} is {largest / usual:.3g} times as far from its median at "
                    f"row {row} as in {_PERCENTILE:g} % of all rows (limit {_SPIKE:g}): an outlier"
                ),
                remedy="remove that sample",
                numbers={"row": row, "ratio": largest / usual, "limit": _SPIKE},
            )


@check
def gravity(subject: Subject) -> Iterator[Finding]:
    """Find efforts of the wrong sign or size, by the gravity of the description's masses."""
    if subject.gravity is None:
        return
    for j, name in enumerate(subject.log.names):
        expected = subject.gravity[:, j]
        if expected.std() < _LEAST_GRAVITY:
            continue
        scale, correlation = _scale(expected, subject.torque[:, j])
        if abs(correlation) < _CORRELATED:
            continue
        numbers = {"scale": scale, "correlation": correlation}
        if scale < 0.0:
            yield Finding(
                severity="error",
                kind="effort_sign",
                joint=name,
                message=f"effort of {name} has the sign opposite to the gravity it should bear",
                remedy="flip the sign of this joint's position or effort",
                numbers=numbers,
            )
        elif not 1.0 / _GRAVITY_SCALE < scale < _GRAVITY_SCALE:
            yield Finding(
                severity="warning",
                kind="effort_scale",
                joint=name,
                message=(
                    f"effort of {name} is {scale:.3g} times the gravity it should bear, limit "
                    f"{1.0 / _GRAVITY_SCALE:g} to {_GRAVITY_SCALE:g}: currents, motor side, or "
                    "another unit"
                ),
                remedy="give the unit or the scale of the efforts",
                numbers=numbers,
            )


def _row_of(column: Array, value: float) -> int:
    """Return the first row of a column that has a value, counted from 1."""
    for begin, values in blocks(column):
        rows = np.flatnonzero(values == value)
        if rows.size:
            return begin + int(rows[0]) + 1
    return 1


def _scale(x: Array, y: Array) -> tuple[float, float]:
    """Return how many times x is y, and their correlation; zeros where either is constant."""
    x, y = x - x.mean(), y - y.mean()
    xx, yy, xy = float(x @ x), float(y @ y), float(x @ y)
    if not xx * yy > 0.0:
        return 0.0, 0.0
    # The size from both, since noise in x alone would make the slope of y over x too small.
    return math.copysign(math.sqrt(yy / xx), xy), xy / math.sqrt(xx * yy)
