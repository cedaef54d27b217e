"""Rows of a recording with a floating base, as efforts are compared at them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from sdpid.errors import SdpidError
from sdpid.experiment.inspection.floating.floating_log import FloatingLog
from sdpid.experiment.inspection.rows import Rows
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.recording.rest import moving
from sdpid.robot.model.model import RobotModel

# Rows that are compared: with 4 feet down 6 equations each.
_ROWS = 120
# A joint whose bodies ask for less than this share of what they ask for at the strongest is not
# compared: noise of its torque is larger. Fingers are at 0.003, the least joint of a quadruped that
# stands at 0.017.
_ASKS = 0.005
# Width of the smooth sign of the velocity, rad/s.
_WIDTH = 0.02


def floating_samples(robot: RobotModel, pieces: Sequence[Recording]) -> Samples | None:
    """Return samples of the longest piece by the default processing; None where it has none."""
    log = max(pieces, key=lambda piece: piece.n_samples, default=None)
    if log is None or log.n != robot.n - robot.n_base:
        return None
    contacts = log.contacts
    forces = contacts is not None and (contacts.forces is not None or contacts.wrenches is not None)
    changes = {"contact_force_std": 1.0} if forces else {}
    try:
        return process(log, changes, gravity=robot.gravity.tolist(), progress=False)
    except SdpidError:
        return None


def floating_log(
    robot: RobotModel, samples: Samples, without: Collection[str] = ()
) -> FloatingLog | None:
    """Return rows of samples; None where nothing can be compared.

    Parameters
    ----------
    robot : RobotModel
        On a floating base.
    samples : Samples
        Of one recording.
    without : collection of str
        Joints whose effort says nothing.
    """
    contacts = samples.contacts
    if contacts is None or not robot.prior[:, 0].sum() > 0.0:
        return None
    some = np.unique(np.linspace(0, samples.n_samples - 1, _ROWS).astype(np.intp))
    base = robot.n_base
    position, effort = samples.position[some, base + 1 :], samples.effort[some, base:]
    velocity = samples.velocity[some, base:]
    known = np.array([name not in without for name in robot.joint_names[base:]])
    moves = moving(samples.position[:, base + 1 :].min(0), samples.position[:, base + 1 :].max(0))
    usable = moves & known & (np.ptp(effort, axis=0) > 0.0)
    if not usable.any():
        return None
    rows = Rows(
        position=position,
        velocity=velocity,
        acceleration=samples.acceleration[some, base:],
        sign=np.tanh(velocity / _WIDTH),
        effort=effort,
        effort_rate=np.zeros_like(effort),
        recorded_velocity=None,
        usable=usable,
        motion_hz=0.0,
        step=0.0,
    )
    log = FloatingLog(
        robot=robot,
        rows=rows,
        gravity=robot.gravity,
        base_position=samples.position[some, : base + 1],
        base_velocity=samples.velocity[some, :base],
        base_acceleration=samples.acceleration[some, :base],
        contacts=contacts.picked(some),
    )
    asked = np.sqrt(np.mean(log.equations[1][:, base:] ** 2, axis=0))
    usable = usable & (asked > _ASKS * asked.max())
    return replace(log, rows=replace(rows, usable=usable)) if usable.any() else None
