"""`Standing`: the motion of a robot on legs, filtered, while its feet stand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.experiment.processing.base import angle_noise, body_rate, into_body, unit
from sdpid.experiment.processing.filters import BAND_OVER_RATE, low_pass, stencil
from sdpid.experiment.processing.motion import white_noise
from sdpid.experiment.processing.pipeline import near
from sdpid.experiment.recording.floating import BaseMotion, Contacts
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.jacobians import contact_jacobians
from sdpid.robot.model.model import RobotModel

# A filter for signals (N, ...), and samples.
Smoother: TypeAlias = tuple[Callable[[Array], Array], slice]

# Weights of derivatives of what has passed a filter.
SLOPES = stencil("central4")
# Cut-off (Hz) of the motion of feet that stand for some 0.2 s, and least number of memories of the
# filter.
_STANCE_HZ, MEMORIES = 20.0, 8.0
# Feet that have just landed, or are about to lift, roll and slip (s).
_AT_REST = 0.05
# Samples at which feet are looked at.
_ROWS = 1500


def smoother(log: Recording, cutoff_hz: float, least: float) -> Smoother | None:
    """Return a low-pass filter for a recording without gaps, and what its ends do not reach.

    None of a recording that is shorter than `least` times the memory of the filter. Ends reach two
    memories far.
    """
    found = low_pass("finite", min(cutoff_hz, BAND_OVER_RATE / log.step), 2, 1.0 / log.step)
    if log.n_samples < least * found.reach:
        return None
    return found.whole, slice(2 * found.reach, log.n_samples - 2 * found.reach)


def turning(base: BaseMotion, step: float) -> Array:
    """Return the angular velocity of a base by its orientation, in its axes, (N, 3)."""
    return body_rate(base.orientation, SLOPES.first, step)


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
    step: float
    noise: float

    @classmethod
    def of(cls, robot: RobotModel, log: Recording) -> Standing | None:
        """Return the motion of a recording without gaps; None without pose, flags, or time."""
        base, contacts, step = log.base, log.contacts, log.step
        if base is None or base.position is None or contacts is None or contacts.down is None:
            return None
        smooth = smoother(log, _STANCE_HZ, MEMORIES)
        if smooth is None:
            return None
        (low, inner), joints = smooth, np.asarray(log.position)
        reach = inner.start // 2
        moving = into_body(base.orientation, np.gradient(base.position, step, axis=0))
        rows = np.unique(np.linspace(inner.start, inner.stop - 1, _ROWS).astype(np.intp))
        stands = ~near(~contacts.down, reach + round(_AT_REST / step))[rows]
        impulse = np.eye(8 * reach + 1)[:, [4 * reach]]
        gain = np.linalg.norm(low(np.gradient(impulse, step, axis=0)))
        angles = np.hypot(angle_noise(base.orientation), white_noise(joints))
        pose = [low(base.position), unit(low(base.orientation)), low(joints)]
        return cls(
            robot=robot,
            contacts=contacts,
            rows=rows,
            position=np.hstack(pose)[rows],
            base=low(np.hstack([moving, turning(base, step)])),
            speeds=low(np.gradient(joints, step, axis=0))[rows],
            # What holds a base stands still, whatever joints do.
            stands=stands & on_legs(robot, log),
            step=step,
            noise=float(gain * np.hypot(white_noise(base.position), robot.reach * angles)),
        )


def on_legs(robot: RobotModel, log: Recording) -> Mask:
    """Return which contacts joints move, (c,)."""
    contacts = log.contacts
    assert contacts is not None
    middle = robot.at_rest(log.position[[log.n_samples // 2]])
    J = contact_jacobians(robot, middle, contacts.frames, contacts.offset)
    return np.asarray(J[0, :, :, robot.n_base :].any(axis=(1, 2)))
