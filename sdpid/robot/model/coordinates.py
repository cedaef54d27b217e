"""Coordinates of a Pinocchio model: names of joints and links, expansion of mimic joints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.errors import ModelError
from sdpid.robot.description.urdf import Mimic


def coordinate_names(model: Any) -> list[str]:
    """Return the names of a model's nv velocity coordinates, mimic joints included.

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


def expand_mimics(
    coordinates: Sequence[str], mimics: Sequence[Mimic]
) -> tuple[Array, Array, tuple[str, ...]]:
    """Return expansion (nv, n), offset (nv,) and the names of the n coordinates without mimics.

    Raises
    ------
    ModelError
        When a mimic joint follows itself, or a joint that does not move.
    """
    rules = {mimic.joint: mimic for mimic in mimics}
    names = tuple(name for name in coordinates if name not in rules)
    expansion = np.zeros((len(coordinates), len(names)))
    offset = np.zeros(len(coordinates))
    for row, name in enumerate(coordinates):
        multiplier, shift, source, seen = 1.0, 0.0, name, {name}
        while source in rules:
            rule = rules[source]
            shift += multiplier * rule.offset
            multiplier *= rule.multiplier
            source = rule.source
            if source in seen:
                raise ModelError(f"mimic joints repeat each other in a circle at '{source}'.")
            seen.add(source)
        if source not in names:
            raise ModelError(f"joint '{name}' mimics '{source}', which is no moving joint.")
        expansion[row, names.index(source)] = multiplier
        offset[row] = shift
    return expansion, offset, names


def link_names(model: Any) -> tuple[str, ...]:
    """Return the first body of each joint: the URDF link that the joint moves."""
    import pinocchio as pin

    bodies: dict[int, str] = {}
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            bodies.setdefault(frame.parentJoint, frame.name)
    return tuple(bodies.get(i, model.names[i]) for i in range(1, model.njoints))
