"""A URDF as the tree that an export needs: moving links, what is fixed to them, and inertials."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array
from sdpid.errors import ExportError, ModelError
from sdpid.robot.description.urdf import check_urdf
from sdpid.robot.description.xml_edits import Document, Element
from sdpid.robot.inertia import physical_parameters, theta_from_physical
from sdpid.robot.model.model import RobotModel

_TENSOR = {
    "ixx": (0, 0),
    "ixy": (0, 1),
    "ixz": (0, 2),
    "iyy": (1, 1),
    "iyz": (1, 2),
    "izz": (2, 2),
}


@dataclass(frozen=True, eq=False)
class FixedChild:
    """A link that is fixed to a moving one, directly or through others.

    Attributes
    ----------
    name : str
        The link.
    body : ndarray, shape (10,), or None
        Its inertial in its own frame; None where it has none.
    rotation, translation : ndarray, shapes (3, 3) and (3,)
        Placement of its frame in that of the moving link.
    """

    name: str
    body: Array | None
    rotation: Array
    translation: Array


class UrdfTree:
    """Links and joints of a URDF, with their places in its text.

    Parameters
    ----------
    text : str
        The URDF.

    Raises
    ------
    ModelError
        When it is not a URDF.
    """

    def __init__(self, text: str) -> None:
        # Also refuses document types, so that nothing is expanded below.
        _, mimics = check_urdf(text, "URDF", floating=True)
        self.document = Document(text)
        root = self.document.root
        self.links = {e.attributes.get("name", ""): e for e in root.find_all("link")}
        self.joints = {e.attributes.get("name", ""): e for e in root.find_all("joint")}
        self._child = {name: _end(joint, "child") for name, joint in self.joints.items()}
        self._fixed: dict[str, list[str]] = {}
        for name, joint in self.joints.items():
            if joint.attributes.get("type") == "fixed":
                self._fixed.setdefault(_end(joint, "parent"), []).append(name)
        sources = {mimic.joint: mimic.source for mimic in mimics}
        self.mimics = {name: _last(sources, name) for name in sources}

    def root_link(self) -> str:
        """Return the link that is no joint's child."""
        children = set(self._child.values())
        roots = [name for name in self.links if name not in children]
        if len(roots) != 1:
            raise ModelError(f"URDF: {len(roots)} links have no parent, there must be one.")
        return roots[0]

    def moving_links(self, robot: RobotModel) -> list[str]:
        """Return the link that each joint of the robot moves, in Pinocchio's order.

        Raises
        ------
        ExportError
            When this URDF lacks a joint of the robot.
        """
        model = robot.pin_model
        names = []
        for i in range(1, model.njoints):
            if i == 1 and robot.free_flyer:
                names.append(self.root_link())
            elif model.names[i] in self.joints:
                names.append(self._child[model.names[i]])
            else:
                raise ExportError(
                    f"URDF of '{robot.name}': the source has no joint '{model.names[i]}'; give "
                    "the URDF of the same robot."
                )
        for name in names:
            if name not in self.links:
                raise ModelError(f"URDF: a joint's child is '{name}', which is no link.")
        return names

    def fixed_children(self, link: str) -> list[FixedChild]:
        """Return the links fixed to a link, near ones first."""
        return list(self._walk(link, np.eye(3), np.zeros(3)))

    def _walk(self, link: str, rotation: Array, translation: Array) -> Iterator[FixedChild]:
        for name in self._fixed.get(link, ()):
            child = self._child[name]
            if child not in self.links:
                raise ModelError(f"URDF: joint '{name}' has the child '{child}', which is no link.")
            R, t = _origin(self.joints[name], f"joint '{name}'")
            R, t = rotation @ R, rotation @ t + translation
            yield FixedChild(child, read_inertial(self.links[child], child), R, t)
            yield from self._walk(child, R, t)


def _end(joint: Element, which: str) -> str:
    element = joint.find(which)
    return element.attributes.get("link", "") if element is not None else ""


def _last(sources: dict[str, str], name: str) -> str:
    """Return the joint that is followed in the end."""
    seen = {name}
    while name in sources and sources[name] not in seen:
        name = sources[name]
        seen.add(name)
    return name


def _numbers(text: str, count: int, what: str) -> Array:
    try:
        values = np.array([float(x) for x in text.split()])
    except ValueError:
        values = np.array([])
    if values.shape != (count,) or not np.isfinite(values).all():
        raise ModelError(f"URDF: {what} is '{text}'; expected {count} finite numbers.")
    return values


def _origin(element: Element, what: str) -> tuple[Array, Array]:
    """Return rotation and translation of an element's <origin>."""
    origin = element.find("origin")
    attributes = origin.attributes if origin is not None else {}
    xyz = _numbers(attributes.get("xyz", "0 0 0"), 3, f"xyz of {what}")
    rpy = _numbers(attributes.get("rpy", "0 0 0"), 3, f"rpy of {what}")
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    rotation = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    return rotation, xyz


def read_inertial(link: Element, name: str) -> Array | None:
    """Return the ten parameters of a link's <inertial> in the link's frame, None without one.

    Raises
    ------
    ModelError
        When mass or inertia are missing or are not numbers.
    """
    inertial = link.find("inertial")
    if inertial is None:
        return None
    mass, tensor = inertial.find("mass"), inertial.find("inertia")
    if mass is None or tensor is None:
        raise ModelError(f"URDF: the inertial of link '{name}' lacks its mass or its inertia.")
    value = _numbers(mass.attributes.get("value", ""), 1, f"the mass of link '{name}'")[0]
    inertia = np.empty((3, 3))
    for key, (i, j) in _TENSOR.items():
        entry = _numbers(tensor.attributes.get(key, ""), 1, f"{key} of link '{name}'")[0]
        inertia[i, j] = inertia[j, i] = entry
    R, t = _origin(inertial, f"the inertial of link '{name}'")
    return theta_from_physical(value, t, R @ inertia @ R.T)


def inertial_values(body: ArrayLike) -> dict[str, dict[str, str]]:
    """Return the attributes of origin, mass and inertia, as shortest round-trip numbers.

    The inertia is about the centre of mass, along the axes of the link; a body of zeros stands
    for a link without mass.
    """
    body = np.asarray(body, dtype=np.float64)
    if np.any(body):
        mass, com, inertia = physical_parameters(body)
    else:
        mass, com, inertia = np.zeros(()), np.zeros(3), np.zeros((3, 3))
    return {
        "origin": {"xyz": " ".join(_number(x) for x in com), "rpy": "0 0 0"},
        "mass": {"value": _number(mass)},
        "inertia": {key: _number(inertia[ij]) for key, ij in _TENSOR.items()},
    }


def _number(value: ArrayLike) -> str:
    # Adding zero turns -0.0 into 0.0.
    return repr(float(np.asarray(value)) + 0.0)
