"""Whether positions and velocities can be what they say: rest, degrees, outliers, velocities."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Mask, shaped
from sdpid.errors import DataError
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.recording.stored import middle

_TURN = 2.0 * math.pi
# A joint whose position stays within this (rad, or m) does not move: that is a hand's width of
# encoder counts, and no motion that shows an inertia. Held joints of a UR10e whose other joints
# move stay within 5e-4 rad.
AT_REST = 1e-3
# A joint that moves by less than this share of the joint that moves most is dragged along by it.
_DRAGGED = 0.01
# Joints of arms are limited to about one turn either way, and no such joint passes two turns.
_LIMIT_OF_ARMS = _TURN * (1.0 + 1e-6)
_TWO_TURNS = 2.0 * _TURN
# In degrees no joint of an arm passes this; wheels in radians do.
_ARMS_IN_DEGREES = 720.0
# A log may pass the limits of a URDF that are a little too tight, but not by half their span.
_SPAN_FACTOR = 1.5
# The same slack once the positions are read as degrees: they must then fit the limits.
_FIT_FACTOR = 1.25
# No joint turns by two turns (or slides by 12 m) from one sample to the next. Wrapped angles jump
# by whole turns, a counter that is reset by at most a hundred.
_LARGEST_STEP = 2.0 * _TURN
_MOST_TURNS = 100.0
_OFF_WHOLE_TURNS = 1.0
# Where more than this share of all steps is too large, positions are in another unit.
_FEW = 0.01
# Compared on this many samples from the middle of a record, as means over about 1000 intervals,
# so that the quantum of an encoder does not drown a slow motion.
_COMPARED = 20_000
_INTERVALS = 1000
# A joint below this speed (rad/s, or m/s; rms) stands still, and its velocity is not compared.
_LEAST_SPEED = 0.02
# A velocity is used while it is wrong by no more than this share: a tenth of it is a tenth
# of viscous friction and a fifth of the centrifugal torques.
_TOLERATED = 0.1
# Less correlated signals do not belong together.
_CORRELATED = 0.9


def moving(low: Array, high: Array) -> Mask:
    """Return which joints move on their own, (n,).

    Parameters
    ----------
    low, high : (n,) ndarray
        Least and largest position of each joint, rad (m).
    """
    reach = high - low
    return np.asarray(reach > max(AT_REST, _DRAGGED * float(reach.max(initial=0.0))))


def turning_limits(robot: Any) -> Array:
    """Return limits of a robot's positions, (n, 2); motors without turn as far as their joints."""
    reach = np.where(robot.gears > 1.0, _TWO_TURNS * robot.gears, np.inf)
    limits, none = robot.position_limits, np.stack([-reach, reach], axis=1)
    return np.asarray(np.where(np.isfinite(limits), limits, none)[robot.n_base :])


def suspect_units(recording: Recording, position_limits: Any = None) -> tuple[str, ...]:
    """Name the joints whose positions look like degrees.

    A joint with finite limits is named when its positions are far beyond them (more than two
    turns where the limits are within one turn, or twice the limits with a span of more than 1.5
    times theirs) and would fit if they were degrees. A joint without limits may turn many times,
    so it is named only together with one that has limits. Where no joint is known to have limits,
    those beyond two turns, and not beyond 720, are named when they are more than half of at least
    two.

    Parameters
    ----------
    recording : Recording
        The log to look at.
    position_limits : (n, 2) array_like, optional
        Lower and upper limits in rad, infinite where there are none.

    Returns
    -------
    tuple of str
        Joint names (numbers from 1 where the recording has no names); empty when all is well.

    Raises
    ------
    DataError
        When the limits are of another shape.
    """
    low, high = recording.position_range
    peak = np.maximum(np.abs(low), np.abs(high))
    beyond = peak > _TWO_TURNS
    limits = _limits(recording, position_limits)
    limited = np.asarray(np.isfinite(limits).all(axis=1))
    if limited.any():
        ends = np.where(limited[:, None], limits, 0.0)
        reach, span = np.abs(ends).max(axis=1), ends[:, 1] - ends[:, 0]
        # A narrow range may honestly be overstepped, but not to twice its farthest end.
        wide = (high - low > _SPAN_FACTOR * span) & (peak > 2.0 * reach)
        named = limited & (np.radians(peak) <= _FIT_FACTOR * reach)
        named &= wide | ((reach <= _LIMIT_OF_ARMS) & beyond)
        named |= named.any() & beyond & ~limited
    else:
        named = beyond & (peak <= _ARMS_IN_DEGREES)
        named &= recording.n > 1 and 2 * np.count_nonzero(named) > recording.n
    return tuple(name for name, bad in zip(recording.names, named.tolist(), strict=True) if bad)


def _limits(recording: Recording, given: Any) -> Array:
    """Return limits as an (n, 2) array of floats, infinite where there are none."""
    given = np.tile([-np.inf, np.inf], (recording.n, 1)) if given is None else given
    what = ": a lower and an upper limit for each joint, infinite where there is none"
    return shaped(given, "position_limits", (recording.n, 2), what, infinite=True)


def require_plausible_units(recording: Recording, position_limits: Any = None) -> None:
    """Raise when positions look like degrees.

    Parameters
    ----------
    recording : Recording
        The log to look at.
    position_limits : (n, 2) array_like, optional
        Lower and upper limits in rad, infinite where there are none.

    Raises
    ------
    DataError
        Naming the joints with their ranges, as decided by `suspect_units`.
    """
    ranges = []
    for name in suspect_units(recording, position_limits):
        j = recording.names.index(name)
        column = recording.position[:, j]
        text = f"{name} from {column.min():.4g} to {column.max():.4g}"
        if position_limits is not None:
            low, high = _limits(recording, position_limits)[j]
            text += f" (limits {low:.4g} to {high:.4g} rad)"
        ranges.append(text)
    if ranges:
        raise DataError(
            f"position: looks like degrees, not radians: {'; '.join(ranges)}. Convert it, or read "
            "the file with units={'position': 'deg'}; angles in radians of joints that do turn "
            "that far may be wrapped to ±pi."
        )


def require_no_outliers(log: Recording) -> None:
    """Raise when a position jumps by more than any joint turns in one step.

    Raises
    ------
    DataError
        Naming the joint, the row and the jump, and how many there are.
    """
    low, high = log.position_range
    for j in np.flatnonzero(high - low > _LARGEST_STEP).tolist():
        steps = np.diff(log.position[:, j])
        turns = np.rint(steps / _TURN)
        wraps = np.abs(steps - _TURN * turns) <= _OFF_WHOLE_TURNS
        wraps &= np.abs(turns) <= _MOST_TURNS
        wrong = np.flatnonzero((np.abs(steps) > _LARGEST_STEP) & ~wraps)
        if wrong.size and wrong.size <= max(_FEW * log.n_samples, 2.0):
            row, jump, count = int(wrong[0]) + 1, float(steps[wrong[0]]), wrong.size
            raise DataError(
                f"position: that of joint {log.names[j]} jumps by {jump:.4g} rad at sample "
                f"{row + 1} of {log.n_samples} ({count} such {'jump' if count == 1 else 'jumps'}), "
                f"more than the {_LARGEST_STEP:.4g} rad that any joint turns in one step: an "
                "outlier. Remove that sample (a gap of a few samples is interpolated), or cut "
                "the recording there."
            )


def velocity_fit(log: Recording, joint: int) -> tuple[float, float, float] | None:
    """Compare a joint's recorded velocity with the rate of its position.

    Parameters
    ----------
    log : Recording
        With velocities, without gaps and wrapped angles.
    joint : int
        Index of the joint.

    Returns
    -------
    scale, lag, correlation : float
        The velocity as scale × the rate of the position, later by a lag in s, and how the two
        agree then. The scale of opposite signs is negative. None where the joint stands still or
        there are too few samples.
    """
    assert log.velocity is not None
    part = middle(log.n_samples, _COMPARED)
    time, position, measured = log.time[part], log.position[part, joint], log.velocity[part, joint]
    stride = max(1, time.size // _INTERVALS)
    if time.size < 4 * stride + 4:
        return None
    spans = np.diff(time[::stride])
    rate = np.diff(position[::stride]) / spans
    traveled = np.cumsum((measured[1:] + measured[:-1]) / 2.0 * np.diff(time))
    mean = np.diff(np.insert(traveled, 0, 0.0)[::stride]) / spans
    # A signal that is late by a little is itself less its derivative times the lag.
    slope = (rate[2:] - rate[:-2]) / (2.0 * stride * log.step)
    rate, mean = rate[1:-1], mean[1:-1]
    if np.sqrt(np.mean(rate**2)) < _LEAST_SPEED:
        return None
    columns = np.column_stack([rate, slope])
    weights = np.linalg.lstsq(columns, mean)[0]
    fitted = columns @ weights
    size = math.sqrt(float(fitted @ fitted) * float(mean @ mean))
    correlation = float(fitted @ mean) / size if size > 0.0 else 0.0
    scale = float(weights[0])
    # Noise in the rate makes the slope over it too small, by the correlation.
    lag = -float(weights[1]) / scale if scale != 0.0 else 0.0
    return scale / correlation if correlation > 0.0 else 0.0, lag, correlation


def disagreement(log: Recording, motion_hz: float) -> str | None:
    """Return why recorded velocities are not the rates of the positions, or None.

    Parameters
    ----------
    log : Recording
        With velocities, without gaps and wrapped angles.
    motion_hz : float
        Frequency below which the motion lies: it makes a lag an error of the velocity.

    Returns
    -------
    str or None
        The first joint whose velocity is wrong by more than 10 %: by its scale, its sign, its
        lag, or because it follows another motion.
    """
    latest = _TOLERATED / (2.0 * math.pi * motion_hz)
    for joint, name in enumerate(log.names):
        fit = velocity_fit(log, joint)
        if fit is None:
            continue
        said, (scale, lag, correlation) = None, fit
        if correlation < _CORRELATED:
            said = (
                f"does not follow d/dt of its position (correlation {correlation:.2f}, limit "
                f"{_CORRELATED:g})"
            )
        elif abs(scale - 1.0) > _TOLERATED:
            said = (
                f"is {scale:.3g} times d/dt of its position, limit {1.0 - _TOLERATED:g} to "
                f"{1.0 + _TOLERATED:g}"
            )
        elif abs(lag) > latest:
            said = (
                f"is {'late' if lag > 0 else 'early'} by {abs(lag):.3g} s against d/dt of "
                f"its position, limit {latest:.3g} s"
            )
        if said is not None:
            return f"that of joint {name} {said}"
    return None
