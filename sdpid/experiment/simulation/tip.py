"""Where the tip of an arm is."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array
from sdpid.robot.model.model import RobotModel


def tip_frame(robot: RobotModel) -> tuple[int, Array]:
    """Return Pinocchio's index of the last joint, and the tip (3,) in that joint's frame, m.

    The last joint has the most joints before it; of the frames that it carries the farthest is
    the tip, or else its own origin.
    """
    model = robot.pin_model
    depth = [0] * model.njoints
    for i in range(1, model.njoints):
        depth[i] = depth[model.parents[i]] + 1
    last = int(np.argmax(depth))
    places = [np.zeros(3)]
    places += [
        np.array(frame.placement.translation) for frame in model.frames if frame.parentJoint == last
    ]
    return last, max(places, key=lambda place: float(np.linalg.norm(place)))


def tip_positions(robot: RobotModel, q: Array) -> Array:
    """Return where the tip is (K, 3), m, at positions (K, n); not a number where they are not."""
    import pinocchio as pin

    last, place = tip_frame(robot)
    sound = np.asarray(np.isfinite(q).all(axis=1))
    out = np.full((len(q), 3), np.nan)
    configurations = robot.configuration(np.where(sound[:, None], q, 0.0))
    model, data = robot.pin_model, robot.pin_model.createData()
    for k in np.flatnonzero(sound):
        pin.forwardKinematics(model, data, configurations[k])
        out[k] = data.oMi[last].act(place)
    return out
