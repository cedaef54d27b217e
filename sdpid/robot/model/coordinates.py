"""Coordinates of a Pinocchio model: names of joints and links."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sdpid._common.arrays import Mask
from sdpid.errors import ModelError


def coordinate_names(model: Any) -> list[str]:
    """Return the names of a model's nv velocity coordinates, joints that follow others included.

    Raises
    ------
    ModelError
        When a joint is of a kind that is not supported.
    """
    names: list[str] = []
    for i in range(1, model.njoints):
        joint, name = model.joints[i], str(model.names[i])
        if joint.nv == 1 and joint.nq in (1, 2) and joint.shortname() != "JointModelMimic":
            names.append(name)
        elif i == 1 and joint.nv == 6 and joint.nq == 7:
            names += [f"{name}/{axis}" for axis in ("vx", "vy", "vz", "wx", "wy", "wz")]
        else:
            raise ModelError(
                f"joint '{name}' is a {joint.shortname()}, which is not supported; "
                "supported are revolute, continuous and prismatic joints."
            )
    return names


def sliding(model: Any, names: Sequence[str]) -> Mask:
    """Return which coordinates are lengths, (n,): of sliding joints, and a base's position."""

    def slides(name: str) -> bool:
        if not model.existJointName(name):
            return name.rpartition("/")[2] in ("vx", "vy", "vz")
        return str(model.joints[model.getJointId(name)].shortname()).startswith("JointModelP")

    return np.array([slides(name) for name in names], dtype=np.bool_)


def link_names(model: Any) -> tuple[str, ...]:
    """Return the first body of each joint: the URDF link that the joint moves."""
    import pinocchio as pin

    bodies: dict[int, str] = {}
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            bodies.setdefault(frame.parentJoint, frame.name)
    return tuple(bodies.get(i, model.names[i]) for i in range(1, model.njoints))
