"""Compare recorded velocities with the derivative of the recorded positions."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sdpid.experiment.recording.recording import Recording

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


@dataclass(frozen=True, kw_only=True)
class VelocityFit:
    """A recorded velocity as scale × the rate of the position, later by a lag.

    Attributes
    ----------
    scale : float
        Negative for opposite signs.
    lag : float
        In s.
    correlation : float
        Of the two, once they are shifted by the lag.
    """

    scale: float
    lag: float
    correlation: float


def velocity_fit(log: Recording, joint: int) -> VelocityFit | None:
    """Compare a joint's recorded velocity with the rate of its position.

    Parameters
    ----------
    log : Recording
        With velocities, without gaps and wrapped angles.
    joint : int
        Index of the joint.

    Returns
    -------
    VelocityFit or None
        None where the joint stands still or there are too few samples.
    """
    assert log.velocity is not None
    begin = max(0, (log.n_samples - _COMPARED) // 2)
    part = slice(begin, begin + _COMPARED)
    time, position = log.time[part], log.position[part, joint]
    measured = log.velocity[part, joint]
    stride = max(1, time.size // _INTERVALS)
    step = stride * log.step
    if time.size < 4 * stride + 4:
        return None
    span = time[stride:] - time[:-stride]
    rate = (position[stride:] - position[:-stride]) / span
    traveled = np.cumsum((measured[1:] + measured[:-1]) / 2.0 * np.diff(time))
    mean = np.diff(np.concatenate([[0.0], traveled])[::stride]) / np.diff(time[::stride])
    rate = rate[::stride][: mean.size]
    # A signal that is late by a little is itself less its derivative times the lag.
    slope = (rate[2:] - rate[:-2]) / (2.0 * step)
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
    return VelocityFit(
        scale=scale / correlation if correlation > 0.0 else 0.0, lag=lag, correlation=correlation
    )


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
    for joint, name in enumerate(log.names):
        fit = velocity_fit(log, joint)
        if fit is None:
            continue
        if fit.correlation < _CORRELATED:
            return (
                f"that of joint {name} does not follow d/dt of its position (correlation "
                f"{fit.correlation:.2f}, limit {_CORRELATED:g})"
            )
        if abs(fit.scale - 1.0) > _TOLERATED:
            return (
                f"that of joint {name} is {fit.scale:.3g} times d/dt of its position, limit "
                f"{1.0 - _TOLERATED:g} to {1.0 + _TOLERATED:g}"
            )
        limit = _TOLERATED / (2.0 * math.pi * motion_hz)
        if abs(fit.lag) > limit:
            return (
                f"that of joint {name} is {'late' if fit.lag > 0 else 'early'} by "
                f"{abs(fit.lag):.3g} s against d/dt of its position, limit {limit:.3g} s"
            )
    return None
