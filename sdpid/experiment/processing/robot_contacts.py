"""Contacts of a robot's frames: its loops, whether places fit, and whether its base is held."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.errors import DataError
from sdpid.experiment.processing.contact_samples import ContactSamples
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.model.jacobians import contact_jacobians, frame_gaps
from sdpid.robot.model.model import RobotModel

# Frames that a loop joins may be this share of the robot's reach apart. Positions and descriptions
# are good to a tenth of it; another frame, another zero of a joint or another unit is far beyond.
GAP_SHARE = 0.01

# Samples that are looked at, evenly spread.
_MOST_SAMPLES = 256


def require_places(robot: RobotModel, position: Array, contacts: ContactSamples) -> None:
    """Refuse contacts of other robots, and loops that do not close.

    Raises
    ------
    DataError
        When a frame is not one of the robot's, or two that a loop joins are apart.
    """
    contact_jacobians(robot, position[:1], contacts.frames)
    pairs = zip(contacts.frames, contacts.against, strict=True)
    loops = [(own, other) for own, other in pairs if other is not None]
    if not loops:
        return
    seen = position[:: -(-len(position) // _MOST_SAMPLES)]
    own, others = zip(*loops, strict=True)
    gaps = frame_gaps(robot, seen, own, others).max(axis=0)
    worst, limit = int(np.argmax(gaps)), GAP_SHARE * robot.reach
    if gaps[worst] > limit:
        raise DataError(
            f"contacts: {own[worst]} and {others[worst]} are up to {1e3 * gaps[worst]:.3g} mm "
            f"apart, the limit is {1e3 * limit:.3g} mm ({100.0 * GAP_SHARE:g} % of the robot's "
            "reach): where a loop closes, both are at one place. Check the frames, and positions "
            "of all joints of the loop, those without motors too."
        )


def with_loops(robot: RobotModel, samples: Samples) -> Samples:
    """Return samples with the loops of a robot beside other contacts.

    The forces in loops are eliminated: no sensor is there. They are closed all the time, so that
    the filter's memory does not matter.
    """
    if not robot.loops:
        return samples
    closed = ContactSamples(
        frames=tuple(loop.frame for loop in robot.loops),
        against=tuple(loop.against for loop in robot.loops),
        kind=tuple(loop.kind for loop in robot.loops),
        down=np.ones((samples.n_samples, len(robot.loops)), dtype=np.bool_),
    )
    both = [samples.contacts, closed]
    return replace(samples, contacts=ContactSamples.join(both, [slice(0, samples.n_samples)] * 2))


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
