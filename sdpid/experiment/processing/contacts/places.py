"""Whether contacts are where a robot has frames, before anything is computed."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.processing.contacts.contact_samples import ContactSamples
from sdpid.robot.model.contacts.jacobians import contact_jacobians, frame_gaps
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
