"""The digest of a robot's kinematics."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator

import numpy as np

from sdpid._common.arrays import Array
from sdpid.robot.model.model import RobotModel


def kinematics_digest(robot: RobotModel) -> str:
    """Return the SHA-256 of a robot's joints, placements, axes, mimic joints, loops and gravity.

    Inertias, limits and shapes do not count. Robots of equal digest have the same regressor.
    """
    digest = hashlib.sha256("\n".join(robot.joint_names).encode("utf-8", "surrogatepass"))
    for values in (*robot.tree, robot.expansion, robot.offset):
        # Adding zero makes one of the two zeros.
        array = np.ascontiguousarray(np.asarray(values, dtype="<f8") + 0.0)
        digest.update(f"\n{array.shape}\n".encode())
        digest.update(array.data)
    for label, values in _loops(robot):
        digest.update(label.encode("utf-8", "surrogatepass"))
        digest.update(np.ascontiguousarray(values).data)
    return digest.hexdigest()


def close(found: Array, wanted: Array, within: float) -> bool:
    """Return whether arrays are the same to a share of their size, at least one."""
    if found.shape != wanted.shape:
        return False
    off = np.abs(found - wanted) <= within * np.maximum(np.abs(wanted), 1.0)
    return bool(np.all(off | (found == wanted)))


def _loops(robot: RobotModel) -> Iterator[tuple[str, Array]]:
    """Yield the ends of loops and the joints without motors in words, and where they are."""
    for loop in robot.loops:
        for kind, name in ((f"\n{loop.kind}", loop.frame), ("", loop.against)):
            frame = robot.pin_model.frames[robot.frame_numbers[name]]
            place = np.asarray(frame.placement.homogeneous, "<f8") + 0.0
            yield f"{kind}\n{name} {frame.parentJoint}\n", place
    if robot.passive:
        yield "\n".join(("", *robot.passive)), np.array(robot.assembled, dtype="<f8")
