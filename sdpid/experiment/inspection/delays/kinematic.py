"""Delays that motion alone shows: an IMU against a pose, a pose against legs that stand."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.experiment.inspection.delays.lag import Delay, Smooth, block_error, lag
from sdpid.experiment.inspection.delays.standing import Standing
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.contacts.jacobians import contact_jacobians
from sdpid.robot.model.model import RobotModel

# Cut-off (Hz) of poses, whose differences are noisy, and least number of memories of the filter.
_POSE_HZ, _MEMORIES = 15.0, 8.0
# Least number of samples of a foot that stands.
_LEAST = 200
_STEPS = 3
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
    from scipy.interpolate import CubicSpline

    feet, contacts = Standing.of(robot, log), log.contacts
    if feet is None or contacts is None:
        return None
    stands, velocity, rows, step = feet.stands, feet.base, feet.rows, feet.step
    if np.count_nonzero(stands) < _LEAST or feet.turning < _LEAST_RATE:
        return None
    J = contact_jacobians(robot, feet.position, contacts.frames, contacts.offset)[:, :, :3]
    legs = np.einsum("kcij,kj->kci", J[..., 6:], feet.speeds)
    spline = CubicSpline(np.arange(len(velocity)), velocity, axis=0)
    delay, error = 0.0, 0.0
    for _ in range(_STEPS):
        at = np.clip(rows + delay / step, 0.0, len(velocity) - 1.0)
        left = np.einsum("kcij,kj->kci", J[..., :6], spline(at)) + legs
        rate = np.einsum("kcij,kj->kci", J[..., :6], spline(at, 1) / step)
        change, error = _step(left, rate, stands)
        delay += change
    return Delay(value=delay, error=error)


def _step(left: Array, rate: Array, stands: Mask) -> tuple[float, float]:
    """Return the change of the delay that leaves the feet slowest, and its error."""
    weight = stands[..., None] / np.maximum(np.mean(left[stands] ** 2, axis=0), 1e-30)
    power = float(np.sum(rate**2 * weight))
    change = -float(np.sum(left * rate * weight)) / power
    scores = np.sum((left + change * rate) * rate * weight, axis=(1, 2))
    return change, block_error(scores, power)
