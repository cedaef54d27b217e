"""How late channels are, and what motion alone shows of it: an IMU, a pose, two signals.

Every delay is found in the same way. A channel that is late by d leaves residuals that are, to
first order, d times what a longer delay takes off them (`delay_step`), until that changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.experiment.inspection.block_fit import block_error
from sdpid.experiment.processing.base import angle_noise, body_rate, into_body, unit
from sdpid.experiment.processing.filters import (
    BAND_OVER_RATE,
    Weights,
    ZeroPhaseFilter,
    correlated,
    low_pass,
    stencil,
)
from sdpid.experiment.processing.motion import white_noise
from sdpid.experiment.processing.pipeline import near
from sdpid.experiment.recording.floating import BaseMotion, Contacts
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.contacts.jacobians import contact_jacobians
from sdpid.robot.model.model import RobotModel

# Gauss-Newton steps of a lag end when one is this share of its error. Of motions three are enough
# from 20 ms away; of forces, which jump, ten and more.
_SETTLED, _STEPS = 0.02, 50


@dataclass(frozen=True, kw_only=True)
class Delay:
    """By how much a channel is late, and its standard error.

    Attributes
    ----------
    value, error : float
        s; negative values are early.
    """

    value: float
    error: float

    def sure(self, least: float, deviations: float) -> bool:
        """Tell whether it is longer than a limit and so many of its errors."""
        return abs(self.value) > max(least, deviations * self.error)

    def wider(self, error: float) -> Delay:
        """Return the delay with an error that is independent of its own added."""
        return Delay(value=self.value, error=float(np.hypot(self.error, error)))


def delay_step(left: Array, rates: Array) -> tuple[Array, Array, Array] | None:
    """Return how much longer k delays are, (k,), their errors, and the residuals then.

    Parameters
    ----------
    left : (N, c) ndarray
        Residuals, in the order of time.
    rates : (N, c, k) ndarray
        What longer delays take off them a second.

    Returns
    -------
    tuple or None
        None where the residuals do not depend on a delay.
    """
    power = np.einsum("nci,ncj->ij", rates, rates)
    if not np.linalg.cond(power) < 1.0 / np.finfo(float).eps:
        return None
    inverse = np.linalg.inv(power)
    change = inverse @ np.einsum("nci,nc->i", rates, left)
    left = left - rates @ change
    return change, block_error(np.einsum("nci,nc->ni", rates, left) @ inverse), left


def least_delay(at: Callable[[float], tuple[Array, Array]]) -> Delay | None:
    """Return the delay at which residuals are least, None where they do not depend on it.

    `at` returns the residuals (N, c) at a delay, in the order of time, and what a longer one takes
    off them a second, (N, c).
    """
    delay = 0.0
    for _ in range(_STEPS):
        left, rate = at(delay)
        weight = 1.0 / np.sqrt(np.maximum(np.mean(left**2, axis=0), 1e-30))
        step = delay_step(left * weight, (rate * weight)[..., None])
        if step is None:
            return None
        change, error = step[0].item(), step[1].item()
        delay += change
        if abs(change) <= _SETTLED * error:
            break
    return Delay(value=delay, error=error)


def moved(signal: Array, step: float, rows: Indices) -> Callable[[float], tuple[Array, Array]]:
    """Return a function that reads a signal at some rows, so much later, and its derivative."""
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(step * np.arange(len(signal)), signal, axis=0)

    def at(delay: float) -> tuple[Array, Array]:
        times = np.clip(step * rows + delay, 0.0, spline.x[-1])
        return np.asarray(spline(times)), np.asarray(spline(times, 1))

    return at


def lag(signal: Array, other: Array, step: float, *, gain: bool = False) -> Delay | None:
    """Return by how much a signal is later than another one of the same quantity.

    Parameters
    ----------
    signal, other : (N, c) ndarray
        Filtered alike; `signal` should be the one with less noise.
    step : float
        Sampling step, s.
    gain : bool, optional
        Whether they differ in scale, channel by channel.

    Returns
    -------
    Delay or None
        None where the signal does not change.
    """
    read, target = moved(signal, step, np.arange(len(signal))), other - other.mean(axis=0)

    def at(delay: float) -> tuple[Array, Array]:
        values, rate = (each - each.mean(axis=0) for each in read(delay))
        if gain:
            scale = np.sum(values * target, axis=0) / np.sum(values**2, axis=0)
            values, rate = scale * values, scale * rate
        return target - values, rate

    return least_delay(at)


@dataclass(frozen=True, kw_only=True, eq=False)
class Smooth:
    """A low-pass filter for a recording without gaps, with derivatives.

    Attributes
    ----------
    low_pass : ZeroPhaseFilter
    weights : Weights
        Of derivatives of what has passed it.
    step : float
        Of the recording, s.
    inner : slice
        The samples that its ends do not reach.
    """

    low_pass: ZeroPhaseFilter
    weights: Weights
    step: float
    inner: slice

    @classmethod
    def of(cls, log: Recording, cutoff_hz: float, least: float) -> Smooth | None:
        """Return the filter; None of a recording shorter than `least` times its memory."""
        cutoff = min(cutoff_hz, BAND_OVER_RATE / log.step)
        found = low_pass("finite", cutoff, 2, 1.0 / log.step)
        if log.n_samples < least * found.reach:
            return None
        return cls(
            low_pass=found,
            weights=stencil("central4"),
            step=log.step,
            inner=slice(2 * found.reach, log.n_samples - 2 * found.reach),
        )

    def low(self, values: Array) -> Array:
        """Return signals (N, ...) filtered, their ends continued by point reflection."""
        flat = np.reshape(values, (len(values), -1))
        reach = min(self.low_pass.reach, len(flat) - 1)
        padded = np.pad(flat, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
        passed = self.low_pass.apply(padded)[reach : reach + len(flat)]
        return np.asarray(passed.reshape(np.shape(values)))

    def second(self, values: Array) -> Array:
        """Return the second derivative of signals (N, ...)."""
        return correlated(values, self.weights.second) / self.step**2

    def turning(self, base: BaseMotion) -> Array:
        """Return the angular velocity of a base by its orientation, in its axes, (N, 3)."""
        return body_rate(unit(base.orientation), self.weights.first, self.step)


# Cut-off (Hz) of the motion of feet that stand for some 0.2 s, and least number of memories of the
# filter.
_STANCE_HZ, _MEMORIES = 20.0, 8.0
# Feet that have just landed, or are about to lift, roll and slip (s).
_AT_REST = 0.05
# Samples at which feet are looked at.
_ROWS = 1500


@dataclass(frozen=True, kw_only=True, eq=False)
class Standing:
    """A robot on legs at some samples, its motion filtered.

    Attributes
    ----------
    robot : RobotModel
    contacts : Contacts
        c in all.
    rows : ndarray of int, shape (K,)
    position : ndarray, shape (K, nq)
    base : ndarray, shape (N, 6)
        Velocity of the base at all samples, in its axes.
    speeds : ndarray, shape (K, joints)
    stands : ndarray of bool, shape (K, c)
        Feet that are down as far as the filter sees, and settled; never what holds a base.
    turning : float
        How fast the base turns, rad/s rms.
    step : float
        Of the recording, s.
    noise : float
        What noise of pose and joints makes of the speed of a foot that stands, along an axis, m/s
        rms.
    """

    robot: RobotModel
    contacts: Contacts
    rows: Indices
    position: Array
    base: Array
    speeds: Array
    stands: Mask
    turning: float
    step: float
    noise: float

    @classmethod
    def of(cls, robot: RobotModel, log: Recording) -> Standing | None:
        """Return the motion of a recording without gaps; None without pose, flags, or time."""
        base, contacts, step = log.base, log.contacts, log.step
        if base is None or base.position is None or contacts is None or contacts.down is None:
            return None
        smooth = Smooth.of(log, _STANCE_HZ, _MEMORIES)
        if smooth is None:
            return None
        low, reach, inner = smooth.low, smooth.low_pass.reach, smooth.inner
        turning, orientation = smooth.turning(base), unit(np.asarray(base.orientation))
        place, joints = np.asarray(base.position), np.asarray(log.position)
        moving = into_body(orientation, np.gradient(place, step, axis=0))
        rows = np.unique(np.linspace(inner.start, inner.stop - 1, _ROWS).astype(np.intp))
        stands = ~near(~np.asarray(contacts.down), reach + round(_AT_REST / step))[rows]
        impulse = np.eye(8 * reach + 1)[:, 4 * reach :][:, :1]
        gain = np.linalg.norm(low(np.gradient(impulse, step, axis=0)))
        angles = np.hypot(angle_noise(orientation), white_noise(joints))
        return cls(
            robot=robot,
            contacts=contacts,
            rows=rows,
            position=np.hstack([low(place), unit(low(orientation)), low(joints)])[rows],
            base=low(np.hstack([moving, turning])),
            speeds=low(np.gradient(joints, step, axis=0))[rows],
            # What holds a base stands still, whatever joints do.
            stands=stands & on_legs(robot, log),
            turning=float(np.sqrt(np.mean(turning**2))),
            step=step,
            noise=float(gain * np.hypot(white_noise(place), robot.reach * angles)),
        )


def on_legs(robot: RobotModel, log: Recording) -> Mask:
    """Return which contacts joints move, (c,)."""
    contacts = log.contacts
    assert contacts is not None
    middle = np.zeros((1, robot.pin_model.nq))
    middle[0, 6], middle[0, 7:] = 1.0, log.position[log.n_samples // 2]
    J = contact_jacobians(robot, middle, contacts.frames, contacts.offset)
    return np.asarray(np.abs(J[0, :, :, robot.n_base :]).max(axis=(1, 2)) > 0.0)


# Cut-off (Hz) of poses, whose differences are noisy.
_POSE_HZ = 15.0
# Least number of samples of a foot that stands.
_LEAST = 200
# A base that moves less than this (rad/s, rms) shows nothing.
_LEAST_RATE = 0.05


def imu_against_pose(log: Recording) -> Delay | None:
    """Return by how much the gyroscope is later than the orientation; None where none turns."""
    smooth = Smooth.of(log, _POSE_HZ, _MEMORIES)
    sensed = None if log.base is None else log.base.sensed("gyroscope")
    if log.base is None or sensed is None or smooth is None:
        return None
    turned, sensed = (smooth.low(x)[smooth.inner] for x in (smooth.turning(log.base), sensed))
    if min(np.sqrt(np.mean(each**2)) for each in (turned, sensed)) < _LEAST_RATE:
        return None
    return lag(sensed, turned, log.step)


def pose_against_joints(robot: RobotModel, log: Recording) -> Delay | None:
    """Return by how much the pose is later than the joints.

    A foot that stands does not move, so that the base's motion follows from that of its leg.

    Returns
    -------
    Delay or None
        None where no foot stands long enough, or the base does not move.
    """
    feet = Standing.of(robot, log)
    if feet is None or np.count_nonzero(feet.stands) < _LEAST or feet.turning < _LEAST_RATE:
        return None
    frames, offset = feet.contacts.frames, feet.contacts.offset
    J = contact_jacobians(robot, feet.position, frames, offset)[:, :, :3]
    legs = np.einsum("kcij,kj->kci", J[..., 6:], feet.speeds)
    read = moved(feet.base, feet.step, feet.rows)

    def at(delay: float) -> tuple[Array, Array]:
        base, rate = (np.einsum("kcij,kj->kci", J[..., :6], each) for each in read(delay))
        return (base + legs)[feet.stands], -rate[feet.stands]

    return least_delay(at)
