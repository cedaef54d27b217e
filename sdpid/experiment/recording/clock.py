"""When samples were read whose stamps are regular, told by speeds that were read with them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.experiment.recording.recording import Recording, channels
from sdpid.experiment.recording.stored import ROWS

# Positions follow a speed that is their rate by steps of this correlation, over so many rows, in
# which errors of the clock average out, and as far as this share.
_FOLLOWS, _ROWS, _CLOSE = 0.99, 100, 0.03
# Joints that must agree on the clock, and the share of rows that repeat others exactly.
_LEAST_JOINTS, _LEAST_REPEATS = 2, 0.01
# Steps that regular stamps explain worse than this are of another clock, if one that the other
# joints tell explains them better by this factor.
_MISSED, _BETTER = 0.1, 2.0
# How far the clock is from regular stamps, and how well speeds tell a step, in steps.
_WANDER, _NOISE = 2.0, 0.05
# Stamps whose longest step is longer than this are their own clock, or have gaps.
_REGULAR = 1.5
# No row is read sooner after another one, in steps.
_LEAST_STEP = 0.05


class Clock(NamedTuple):
    """When rows were read.

    Attributes
    ----------
    rows : ndarray of int, shape (K,)
        Those that do not repeat the row before.
    time : ndarray, shape (K,)
        When they were read, s.
    repeats : float
        Share of rows that repeat others.
    jitter : float
        How far times are from regular stamps, s, rms.
    missed, left : float
        What steps of positions are off speeds times steps of the stamps, and of these times, as a
        share of the steps, rms.
    joints : ndarray of int
        Those whose speeds tell it.
    """

    rows: Indices
    time: Array
    repeats: float
    jitter: float
    missed: float
    left: float
    joints: Indices


def told_clock(log: Recording) -> Clock | None:
    """Return when rows were read; None where stamps are as good, or speeds do not tell.

    A driver that is read at times of its own repeats rows, and gives others earlier or later than
    their stamps say: steps of all joints are then longer or shorter than their speeds by the same
    share. Each joint's steps are explained by the clock that the others tell.
    """
    if log.velocity is None or log.period is not None or log.base is not None:
        return None
    if log.stamps.most > _REGULAR * log.step:
        return None
    # Block by block: comparing all of a recording that is larger than the memory takes an eighth.
    repeated = np.zeros(log.n_samples, dtype=bool)
    for begin in range(1, log.n_samples, ROWS):
        part = np.asarray(log.position[begin - 1 : begin + ROWS])
        repeated[begin : begin + ROWS] = (part[1:] == part[:-1]).all(axis=1)
    repeats = float(repeated.mean())
    if not _LEAST_REPEATS <= repeats < 0.5:
        return None
    position, velocity = np.asarray(log.position), np.asarray(log.velocity)
    rows = np.flatnonzero(~repeated)
    steps = np.diff(position[rows], axis=0)
    speeds = 0.5 * (velocity[rows[1:]] + velocity[rows[:-1]])
    regular = log.step * np.diff(rows)
    joints = np.flatnonzero(
        [_is_rate(d, v * regular) for d, v in zip(steps.T, speeds.T, strict=True)]
    )
    if len(joints) < _LEAST_JOINTS:
        return None
    missed, left = [], []
    for j in joints.tolist():
        others = joints[joints != j]
        ways, size = speeds[:, j], np.std(speeds[:, j] * regular)
        missed.append(np.std(steps[:, j] - ways * regular) / size)
        times = _times(steps[:, others], speeds[:, others], rows, log.step)
        left.append(np.std(steps[:, j] - ways * np.diff(times)) / size)
    if not float(np.median(missed)) > max(_MISSED, _BETTER * float(np.median(left))):
        return None
    times = _times(steps[:, joints], speeds[:, joints], rows, log.step)
    later = np.r_[True, np.diff(np.maximum.accumulate(times)) > _LEAST_STEP * log.step]
    return Clock(
        rows=rows[later],
        time=log.stamps.first + times[later],
        repeats=repeats,
        jitter=float(np.std(times - log.step * rows)),
        missed=float(np.median(missed)),
        left=float(np.median(left)),
        joints=joints,
    )


def retimed(log: Recording, clock: Clock) -> Recording:
    """Return a recording at regular times, interpolated from those at which rows were read.

    Positions pass a cubic spline; between efforts, speeds and commands lines are drawn.
    """
    from scipy.interpolate import CubicSpline

    begin, end = clock.time[0], clock.time[-1]
    time = begin + log.step * np.arange(int((end - begin) / log.step) + 1)
    tables = {name: np.asarray(table)[clock.rows] for name, table in channels(log).items()}
    found: dict[str, Any] = {
        name: CubicSpline(clock.time - begin, table)(time - begin)
        if name in ("position", "link_position")
        else np.stack([np.interp(time, clock.time, column) for column in table.T], axis=1)
        for name, table in tables.items()
    }
    return replace(log, time=time, **found)


def _is_rate(steps: Array, ways: Array) -> bool:
    """Tell whether ways, speeds times steps of the time, are a joint's steps over many rows."""
    count = len(steps) // _ROWS
    if count < 4:
        return False
    long, expected = (
        each[: count * _ROWS].reshape(count, _ROWS).sum(axis=1) for each in (steps, ways)
    )
    if not (power := float(expected @ expected)) or not long.any():
        return False
    slope = float(long @ expected) / power
    correlation = slope * np.sqrt(power / float(long @ long))
    return abs(slope - 1.0) < _CLOSE and correlation > _FOLLOWS


def _times(steps: Array, speeds: Array, rows: Indices, step: float) -> Array:
    """Return times (K,) whose steps explain positions by speeds, near to regular ones."""
    from scipy.linalg import solveh_banded

    weights = 1.0 / np.mean(speeds**2, axis=0) / speeds.shape[1]
    power = (speeds**2 @ weights) / (_NOISE * step) ** 2
    ways = ((speeds * steps) @ weights) / (_NOISE * step) ** 2
    near = 1.0 / (_WANDER * step) ** 2
    bands = np.zeros((2, len(rows)))
    bands[1] = near
    bands[1, :-1] += power
    bands[1, 1:] += power
    bands[0, 1:] = -power
    right = near * step * rows.astype(np.float64)
    right[:-1] -= ways
    right[1:] += ways
    return np.asarray(solveh_banded(bands, right))
