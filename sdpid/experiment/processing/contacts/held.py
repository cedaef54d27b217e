"""Where a robot's base is held: nothing is to be said of the forces on it."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Mask
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.model.model import RobotModel


def base_held(robot: RobotModel, samples: Samples) -> Mask:
    """Return whether what holds the base takes any force and moment that nobody measured, (K,).

    The base's six equations then hold for any parameters: their errors are rounding alone.
    """
    held: Mask = np.zeros(len(samples.effort), dtype=np.bool_)
    contacts, model = samples.judged.contacts, robot.pin_model
    if contacts is None or not robot.free_flyer:
        return held
    known = contacts.force_covariance
    for i, (frame, other) in enumerate(zip(contacts.frames, contacts.against, strict=True)):
        base = other is None and model.frames[model.getFrameId(frame)].parentJoint == 1
        measured = known is not None and np.isfinite(np.diagonal(known[i])).any()
        if base and contacts.kind[i] == "plane" and not measured:
            held |= contacts.down[:, i]
    return held
