"""What the signals of a log say about themselves: noise, spectrum, gaps, and slips of units."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sdpid._arrays import Array
from sdpid.experiment.recording import Recording
from sdpid.robot.model import RobotModel

__all__ = ["bandwidth", "gaps", "noise", "signal_warnings"]

# A difference of order k multiplies the variance of white noise by binomial(2 k, k), and the
# fourth all but removes a motion that is ten times slower than the samples.
_ORDER = 4
# This share of the power of the motion lies below its bandwidth.
_SHARE = 0.95
# A step longer than this many nominal ones is a gap; less is jitter.
_GAP = 1.5
# Velocities and slopes are compared on this many samples, gravity on this many rows.
_COMPARED = 20_000
_ROWS = 400
# Two signals belong together when they correlate like this, and differ in their units when the
# slope between them is off by this factor: filters and payloads explain less.
_CORRELATED = 0.9
_SLOPE = 1.3
_GRAVITY_SLOPE = 5.0
# No joint of an arm turns faster (rad/s); the fastest reach some 15.
_FASTEST = 40.0
# A jump between neighbours this close to a whole turn (rad) is a wrapped angle.
_NEAR_TURN = 1.0
# Gravity below this (N.m, rms about its mean) says nothing about the efforts.
_LEAST_GRAVITY = 1.0
# Factors that one meets: what was written over what was meant.
_FACTORS = {
    180.0 / math.pi: "deg instead of rad",
    math.pi / 180.0: "rad instead of deg",
    30.0 / math.pi: "rpm instead of rad/s",
    1000.0: "a factor of 1000: time or velocity in thousandths",
    0.001: "a factor of 1/1000: time or velocity in thousandths",
    1.0 / (2.0 * math.pi): "turns instead of rad",
}
_FACTOR_SLACK = 0.1


def noise(column: Array) -> float:
    """Return the standard deviation of the white noise of a channel.

    From its differences of fourth order, in which a motion well below the sampling rate does not
    show; for a motion that is not, it is an upper bound.
    """
    if column.size <= _ORDER:
        return 0.0
    differences = np.diff(column, n=_ORDER)
    scale = math.comb(2 * _ORDER, _ORDER)
    return float(np.sqrt(np.mean(differences * differences) / scale))


def bandwidth(column: Array, rate_hz: float) -> tuple[float, float] | None:
    """Return the dominant frequency and the one below which 95 % of the power lies, in Hz.

    The mean is removed and a Hann window applied. None for a channel that does not change.
    """
    centred = column - column.mean()
    if not np.any(centred):
        return None
    power = np.abs(np.fft.rfft(np.hanning(column.size) * centred)) ** 2
    power[0] = 0.0
    total = float(power.sum())
    if not total > 0.0 or not math.isfinite(total):
        return None
    below = int(np.searchsorted(np.cumsum(power), _SHARE * total))
    per_bin = rate_hz / column.size
    return float(np.argmax(power)) * per_bin, below * per_bin


def gaps(recording: Recording) -> dict[str, Any]:
    """Return how many steps are longer than 1.5 nominal ones, and the longest of all.

    Returns
    -------
    dict
        ``gaps``, ``longest_step_s`` and ``longest_step_row``: the row that ends it.
    """
    steps = np.diff(recording.time)
    row = int(np.argmax(steps))
    return {
        "gaps": int(np.count_nonzero(steps > _GAP * recording.step)),
        "longest_step_s": float(steps[row]),
        "longest_step_row": row + 1,
    }


def signal_warnings(recording: Recording, robot: RobotModel | None = None) -> list[str]:
    """Return what looks wrong with the signals, in words.

    Angles that wrap, speeds that no joint has, channels that never change, measured velocities
    that are not the rate of the positions, and efforts that are not of the size, or the sign, of
    the gravity that they should bear.

    Parameters
    ----------
    recording : Recording
        With its joints in the robot's order.
    robot : RobotModel, optional
        Whose prior masses give the gravity.
    """
    found: list[str] = []
    rate = recording.rate_hz
    for j, name in enumerate(recording.names):
        position = recording.position[:, j]
        jumps = np.diff(position)
        row = int(np.argmax(np.abs(jumps)))
        largest = float(abs(jumps[row]))
        if largest == 0.0:
            found.append(f"{name} never moves")
        elif abs(largest - 2.0 * math.pi) < _NEAR_TURN and largest > 10.0 * np.median(
            np.abs(jumps)
        ):
            found.append(
                f"position of {name} jumps by {largest:.4g} rad at row {row + 1}: the angle wraps"
            )
        elif largest * rate > _FASTEST:
            found.append(
                f"position of {name} changes by {largest:.4g} rad in one step at row {row + 1}, "
                f"that is {largest * rate:.4g} rad/s: an outlier, or wrong units"
            )
        if not np.ptp(recording.effort[:, j]) > 0.0:
            found.append(f"effort of {name} never changes")
        if recording.velocity is not None:
            found += _velocity_warning(recording, j)
    if robot is not None and robot.n == recording.n and robot.n_base == 0:
        found += _gravity_warnings(recording, robot)
    return found


def _velocity_warning(recording: Recording, j: int) -> list[str]:
    """Compare a measured velocity with the rate of the position."""
    assert recording.velocity is not None
    part = _middle(recording.n_samples, _COMPARED)
    time, position = recording.time[part], recording.position[part, j]
    measured = recording.velocity[part, j]
    if time.size < _ORDER:
        return []
    # Over some steps, so that the quantum of an encoder does not drown a slow motion.
    stride = max(1, time.size // 1000)
    rate = (position[stride:] - position[:-stride]) / (time[stride:] - time[:-stride])
    total = np.concatenate([[0.0], np.cumsum((measured[1:] + measured[:-1]) / 2 * np.diff(time))])
    mean = (total[stride:] - total[:-stride]) / (time[stride:] - time[:-stride])
    slope, correlation = _slope(rate, mean)
    if abs(correlation) < _CORRELATED or 1.0 / _SLOPE < slope < _SLOPE:
        return []
    name = recording.names[j]
    if slope < 0.0:
        return [f"velocity of {name} has the sign opposite to the rate of its position"]
    return [f"velocity of {name} is {slope:.4g} times the rate of its position{_factor(slope)}"]


def _gravity_warnings(recording: Recording, robot: RobotModel) -> list[str]:
    """Compare efforts with the gravity of the description's masses."""
    rows = np.unique(np.linspace(0, recording.n_samples - 1, _ROWS).astype(np.intp))
    position = recording.position[rows]
    rest = np.zeros_like(position)
    gravity = robot.inverse_dynamics(robot.prior, position, rest, rest)
    effort = recording.effort[rows]
    if recording.effort_scale is not None:
        effort = effort * recording.effort_scale
    found = []
    for j, name in enumerate(recording.names):
        if gravity[:, j].std() < _LEAST_GRAVITY:
            continue
        slope, correlation = _slope(gravity[:, j], effort[:, j])
        if abs(correlation) < _CORRELATED:
            continue
        if slope < 0.0:
            found.append(
                f"effort of {name} has the sign opposite to the gravity it should bear: a flipped "
                "sign of position or effort"
            )
        elif not 1.0 / _GRAVITY_SLOPE < slope < _GRAVITY_SLOPE:
            found.append(
                f"effort of {name} is {slope:.3g} times the gravity it should bear: currents, "
                "motor side, or another unit"
            )
    return found


def _slope(x: Array, y: Array) -> tuple[float, float]:
    """Return the slope of y over x and their correlation; zeros where either is constant."""
    x, y = x - x.mean(), y - y.mean()
    xx, yy, xy = float(x @ x), float(y @ y), float(x @ y)
    if not xx * yy > 0.0:
        return 0.0, 0.0
    # The size from both, since noise in x alone would make the slope of y over x too small.
    return math.copysign(math.sqrt(yy / xx), xy), xy / math.sqrt(xx * yy)


def _factor(slope: float) -> str:
    """Name a factor that one meets."""
    for factor, words in _FACTORS.items():
        if abs(slope / factor - 1.0) < _FACTOR_SLACK:
            return f" ({words})"
    return ""


def _middle(count: int, most: int) -> slice:
    """Return the middle part of a record."""
    begin = max(0, (count - most) // 2)
    return slice(begin, begin + most)
