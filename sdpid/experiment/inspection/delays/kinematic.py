"""Delays that motion alone shows: an IMU against a pose, a pose against legs that stand."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.experiment.inspection.delays.lag import Delay, block_error, filtered, lag
from sdpid.experiment.processing.derivatives import BAND_OVER_RATE, stencil
from sdpid.experiment.processing.filters import low_pass
from sdpid.experiment.processing.floating.feet import near
from sdpid.experiment.processing.floating.rotations import body_rate, into_body, unit
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.contacts.jacobians import contact_jacobians
from sdpid.robot.model.model import RobotModel

__all__ = ["imu_against_pose", "on_legs", "pose_against_joints"]

# Cut-offs (Hz): of poses, whose differences are noisy, and of feet that stand for some 0.2 s.
_POSE_HZ, _STANCE_HZ = 15.0, 20.0
_ORDER = 2
# Feet that have just landed, or are about to lift, roll and slip (s).
_SETTLED = 0.05
# Samples at which feet are looked at, and least number of a foot that stands.
_ROWS, _LEAST = 1500, 200
_STEPS = 3
# A base that moves less than this (rad/s, rms) shows nothing.
_LEAST_RATE = 0.05


def imu_against_pose(log: Recording) -> Delay | None:
    """Return by how much the gyroscope is later than the orientation; None where none turns."""
    base, step = log.base, log.step
    if base is None or base.imu is None or base.imu.gyroscope is None:
        return None
    cutoff = min(_POSE_HZ, BAND_OVER_RATE / step)
    smooth = low_pass("finite", cutoff, _ORDER, 1.0 / step)
    edge = 2 * smooth.reach
    if log.n_samples < 4 * edge:
        return None
    weights = stencil("central4", cutoff_over_rate=cutoff * step).first
    turned = filtered(body_rate(unit(base.orientation), weights, step), smooth)[edge:-edge]
    sensed = filtered(base.imu.gyroscope @ base.imu.rotation.T, smooth)[edge:-edge]
    if min(np.sqrt(np.mean(each**2)) for each in (turned, sensed)) < _LEAST_RATE:
        return None
    return lag(sensed, turned, step)


def pose_against_joints(robot: RobotModel, log: Recording) -> Delay | None:
    """Return by how much the pose is later than the joints.

    A foot that stands does not move, so that the base's motion follows from that of its leg.

    Returns
    -------
    Delay or None
        None where no foot stands long enough, or the base does not move.
    """
    from scipy.interpolate import CubicSpline

    base, contacts, step = log.base, log.contacts, log.step
    if base is None or base.position is None or contacts is None or contacts.down is None:
        return None
    cutoff = min(_STANCE_HZ, BAND_OVER_RATE / step)
    smooth = low_pass("finite", cutoff, _ORDER, 1.0 / step)
    edge = 2 * smooth.reach
    if log.n_samples < 4 * edge:
        return None
    orientation = unit(np.asarray(base.orientation))
    weights = stencil("central4", cutoff_over_rate=cutoff * step).first
    turning = body_rate(orientation, weights, step)
    moving = into_body(orientation, np.gradient(np.asarray(base.position), step, axis=0))
    velocity = filtered(np.hstack([moving, turning]), smooth)
    joints = np.asarray(log.position)
    speeds = filtered(np.gradient(joints, step, axis=0), smooth)
    rows = np.unique(np.linspace(edge, log.n_samples - 1 - edge, _ROWS).astype(np.intp))
    stands = ~near(~np.asarray(contacts.down), smooth.reach + round(_SETTLED / step))[rows]
    # What holds a base stands still, whatever joints do.
    stands &= on_legs(robot, log)
    if np.count_nonzero(stands) < _LEAST or np.sqrt(np.mean(turning**2)) < _LEAST_RATE:
        return None
    q = np.hstack(
        [filtered(np.asarray(base.position), smooth), unit(filtered(orientation, smooth))]
    )
    q = np.hstack([q, filtered(joints, smooth)])[rows]
    J = contact_jacobians(robot, q, contacts.frames, contacts.offset)[:, :, :3]
    legs = np.einsum("kcij,kj->kci", J[..., 6:], speeds[rows])
    spline = CubicSpline(np.arange(len(velocity)), velocity, axis=0)
    delay, error = 0.0, 0.0
    for _ in range(_STEPS):
        at = np.clip(rows + delay / step, 0.0, len(velocity) - 1.0)
        left = np.einsum("kcij,kj->kci", J[..., :6], spline(at)) + legs
        rate = np.einsum("kcij,kj->kci", J[..., :6], spline(at, 1) / step)
        change, error = _step(left, rate, stands)
        delay += change
    return Delay(value=delay, error=error)


def on_legs(robot: RobotModel, log: Recording) -> Mask:
    """Return which contacts joints move, (c,)."""
    contacts = log.contacts
    assert contacts is not None
    middle = np.zeros((1, robot.pin_model.nq))
    middle[0, 6], middle[0, 7:] = 1.0, log.position[log.n_samples // 2]
    J = contact_jacobians(robot, middle, contacts.frames, contacts.offset)
    return np.asarray(np.abs(J[0, :, :, robot.n_base :]).max(axis=(1, 2)) > 0.0)


def _step(left: Array, rate: Array, stands: Mask) -> tuple[float, float]:
    """Return the change of the delay that leaves the feet slowest, and its error."""
    weight = stands[..., None] / np.maximum(np.mean(left[stands] ** 2, axis=0), 1e-30)
    power = float(np.sum(rate**2 * weight))
    change = -float(np.sum(left * rate * weight)) / power
    scores = np.sum((left + change * rate) * rate * weight, axis=(1, 2))
    return change, block_error(scores, power)
