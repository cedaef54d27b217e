"""The digest of a robot's kinematics: everything that its regressor is made of."""

from __future__ import annotations

import hashlib

import numpy as np

from sdpid.robot.model.model import RobotModel
from sdpid.robot.model.regressor_kernel import flatten


def kinematics_digest(robot: RobotModel) -> str | None:
    """Return the SHA-256 of a robot's joints, placements, axes, mimic joints, loops and gravity.

    Inertias, limits and shapes do not count. Robots of equal digest have the same regressor. None
    for joints that have no plain form (see `flatten`).
    """
    tree = flatten(robot.pin_model, robot.expansion)
    if tree is None:
        return None
    digest = hashlib.sha256("\n".join(robot.joint_names).encode("utf-8", "surrogatepass"))
    for values in (*tree.arrays, robot.expansion, robot.offset):
        # Adding zero makes one of the two zeros.
        array = np.ascontiguousarray(np.asarray(values, dtype="<f8") + 0.0)
        digest.update(f"\n{array.shape}\n".encode())
        digest.update(array.data)
    for loop in robot.loops:
        digest.update(f"\n{loop.kind}".encode())
        for name in (loop.frame, loop.against):
            frame = robot.pin_model.frames[robot.frame_numbers[name]]
            place = np.ascontiguousarray(np.asarray(frame.placement.homogeneous, "<f8") + 0.0)
            digest.update(f"\n{name} {frame.parentJoint}\n".encode("utf-8", "surrogatepass"))
            digest.update(place.data)
    if robot.passive:
        digest.update("\n".join(("", *robot.passive)).encode("utf-8", "surrogatepass"))
        digest.update(np.array(robot.assembled, dtype="<f8").data)
    return digest.hexdigest()
