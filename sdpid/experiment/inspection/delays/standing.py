"""`Standing`: motion of the feet of a robot on legs, and when they surely stand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.experiment.inspection.delays.lag import Smooth
from sdpid.experiment.processing.floating.feet import near
from sdpid.experiment.processing.floating.quieter import angle_noise, white_noise
from sdpid.experiment.processing.floating.rotations import into_body, unit
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.contacts.jacobians import contact_jacobians
from sdpid.robot.model.model import RobotModel

# Cut-off (Hz) of the motion of feet that stand for some 0.2 s, and least number of memories of the
# filter.
_STANCE_HZ, _MEMORIES = 20.0, 8.0
# Feet that have just landed, or are about to lift, roll and slip (s).
_SETTLED = 0.05
# Samples at which feet are looked at.
_ROWS = 1500


@dataclass(frozen=True, kw_only=True, eq=False)
class Standing:
    """A robot on legs at some samples, its motion filtered.

    Attributes
    ----------
    robot : RobotModel
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
        smooth = Smooth.of(log, _STANCE_HZ, _MEMORIES)
        if base is None or base.position is None or contacts is None or contacts.down is None:
            return None
        if smooth is None:
            return None
        low, reach, inner = smooth.low, smooth.low_pass.reach, smooth.inner
        turning, orientation = smooth.turning(base), unit(np.asarray(base.orientation))
        moving = into_body(orientation, np.gradient(np.asarray(base.position), step, axis=0))
        joints = np.asarray(log.position)
        speeds = low(np.gradient(joints, step, axis=0))
        rows = np.unique(np.linspace(inner.start, inner.stop - 1, _ROWS).astype(np.intp))
        stands = ~near(~np.asarray(contacts.down), reach + round(_SETTLED / step))[rows]
        impulse = np.eye(8 * reach + 1)[:, 4 * reach :][:, :1]
        gain = np.linalg.norm(low(np.gradient(impulse, step, axis=0)))
        angles = np.hypot(angle_noise(orientation), white_noise(joints))
        q = np.hstack([low(np.asarray(base.position)), unit(low(orientation)), low(joints)])
        return cls(
            robot=robot,
            rows=rows,
            position=q[rows],
            base=low(np.hstack([moving, turning])),
            speeds=speeds[rows],
            # What holds a base stands still, whatever joints do.
            stands=stands & on_legs(robot, log),
            turning=float(np.sqrt(np.mean(turning**2))),
            step=step,
            noise=float(gain * np.hypot(white_noise(base.position), robot.reach * angles)),
        )


def on_legs(robot: RobotModel, log: Recording) -> Mask:
    """Return which contacts joints move, (c,)."""
    contacts = log.contacts
    assert contacts is not None
    middle = np.zeros((1, robot.pin_model.nq))
    middle[0, 6], middle[0, 7:] = 1.0, log.position[log.n_samples // 2]
    J = contact_jacobians(robot, middle, contacts.frames, contacts.offset)
    return np.asarray(np.abs(J[0, :, :, robot.n_base :]).max(axis=(1, 2)) > 0.0)
