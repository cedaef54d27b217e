"""The digest of a robot's kinematics, and what of them another robot does not have."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator

import numpy as np

from sdpid._common.arrays import Array
from sdpid.robot.model.model import RobotModel
from sdpid.verifier.reading import shown


def kinematics_digest(robot: RobotModel) -> str:
    """Return the SHA-256 of a robot's joints, placements, axes, mimic joints, loops and gravity.

    Inertias, limits and shapes do not count. Robots of equal digest have the same regressor.
    """
    digest = hashlib.sha256("\n".join(robot.joint_names).encode("utf-8", "surrogatepass"))
    for values in (*robot.tree.arrays, robot.expansion, robot.offset):
        # Adding zero makes one of the two zeros.
        array = np.ascontiguousarray(np.asarray(values, dtype="<f8") + 0.0)
        digest.update(f"\n{array.shape}\n".encode())
        digest.update(array.data)
    for label, values in _loops(robot):
        digest.update(label.encode("utf-8", "surrogatepass"))
        digest.update(np.ascontiguousarray(values).data)
    return digest.hexdigest()


def other_kinematics(
    robot: RobotModel, other: RobotModel, within: float, *, loops: bool = True
) -> Iterator[str]:
    """Yield what of a robot's kinematics another has otherwise, by the names of joints.

    Parameters
    ----------
    robot, other : RobotModel
        Robots whose joints may come in another order.
    within : float
        By how much numbers may differ, relative to their size, at least one.
    loops : bool, optional
        Whether loops and joints without motors are compared, too.
    """
    first, second = _joints(robot), _joints(other)
    for name in sorted(first.keys() ^ second.keys()):
        yield f"joint {shown(name)} is of one of them alone"
    for name in sorted(first.keys() & second.keys()):
        for what, wanted in first[name].items():
            if not _same(second[name][what], wanted, within):
                yield f"joint {shown(name)} has another {what}"
    if not close(other.gravity, robot.gravity, within):
        yield f"gravity is {other.gravity.tolist()}, not {robot.gravity.tolist()}"
    pairs = [[each for part in _loops(one) for each in part] for one in (robot, other)]
    if loops and (
        len(pairs[0]) != len(pairs[1])
        or not all(_same(found, wanted, within) for wanted, found in zip(*pairs, strict=True))
    ):
        yield "loops or joints without motors are others"


def close(found: Array, wanted: Array, within: float) -> bool:
    """Return whether arrays are the same to a share of their size, at least one."""
    if found.shape != wanted.shape:
        return False
    off = np.abs(found - wanted) <= within * np.maximum(np.abs(wanted), 1.0)
    return bool(np.all(off | (found == wanted)))


def _same(found: Array | str, wanted: Array | str, within: float) -> bool:
    """Return whether texts are the same, or numbers to a share of their size."""
    if isinstance(found, str) or isinstance(wanted, str):
        return bool(found == wanted)
    return close(found, wanted, within)


def _loops(robot: RobotModel) -> Iterator[tuple[str, Array]]:
    """Yield the ends of loops and the joints without motors in words, and where they are."""
    for loop in robot.loops:
        for kind, name in ((f"\n{loop.kind}", loop.frame), ("", loop.against)):
            frame = robot.pin_model.frames[robot.frame_numbers[name]]
            place = np.asarray(frame.placement.homogeneous, "<f8") + 0.0
            yield f"{kind}\n{name} {frame.parentJoint}\n", place
    if robot.passive:
        yield "\n".join(("", *robot.passive)), np.array(robot.assembled, dtype="<f8")


def _joints(robot: RobotModel) -> dict[str, dict[str, Array | str]]:
    """Return type, parent, place, axis and gear of every joint.

    A joint's row of the gear is its velocity's share in each coordinate, by name, and its offset.
    """
    model, tree = robot.pin_model, robot.tree
    order, found = np.argsort(robot.joint_names), {}
    for i in range(model.njoints - 1):
        joint = model.joints[i + 1]
        rows = slice(joint.idx_v, joint.idx_v + joint.nv)
        found[str(model.names[i + 1])] = {
            "type": np.array([tree.kind[i]]),
            "parent": str(model.names[model.parents[i + 1]]),
            "place": np.concatenate([tree.turn[i].ravel(), tree.place[i].ravel()]),
            "axis": tree.axis[i],
            "gear": np.column_stack([robot.expansion[rows][:, order], robot.offset[rows]]),
        }
    return found
