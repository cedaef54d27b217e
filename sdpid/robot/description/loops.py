"""Loops that close, as descriptions tell them beside their trees, and joints without motors.

A URDF has no place for a loop. Simulators add one that other readers pass over: the element
``<loop_joint>`` with a frame on either of two links, which are at one place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import ModelError
from sdpid.robot.description.xml import LARGEST, read_triple, rpy_matrix

LoopKind = Literal["point", "line", "plane"]
# What the kinds of loop joints in a URDF transmit, as contacts call it: all forces; and all moments
# but that about the axis; and all moments.
KINDS: dict[str, LoopKind] = {
    "spherical": "point",
    "revolute": "line",
    "continuous": "line",
    "fixed": "plane",
}
# Axes of joints in a URDF, unless it says another.
_AXIS = "1 0 0"


@dataclass(frozen=True)
class Loop:
    """Where a loop of a robot closes.

    Attributes
    ----------
    name : str
        Its name.
    frame, against : str
        The two frames of the robot that are at one place.
    kind : {"point", "line", "plane"}
        A ball (or a pin of a linkage in a plane), a pin along the frames' y axes, or a weld.

    Examples
    --------
    >>> from sdpid.robot.description.loops import Loop
    >>> Loop("pin", "pin/coupler", "pin/rocker", "point")
    Loop(name='pin', frame='pin/coupler', against='pin/rocker', kind='point')
    """

    name: str
    frame: str
    against: str
    kind: LoopKind


@dataclass(frozen=True, eq=False)
class Closure:
    """What closes a loop in a description.

    Attributes
    ----------
    name : str
        Its name.
    kind : {"point", "line", "plane"}
        What it transmits.
    ends : tuple of (str, ndarray)
        The two bodies, and the place on each, (4, 4); the axis of a line is y.
    """

    name: str
    kind: LoopKind
    ends: tuple[tuple[str, Array], tuple[str, Array]]


def urdf_closures(root: Any, what: str) -> tuple[Closure, ...]:
    """Return the closures of a URDF: its elements ``<loop_joint>``.

    Raises
    ------
    ModelError
        When one is of a kind that is not known, or lacks an end or a number.
    """
    found = []
    for number, element in enumerate(root.findall("loop_joint"), 1):
        name = element.get("name", f"loop_{number}")
        where = f"{what}: loop joint '{name}'"
        kind = element.get("type", "?")
        if kind not in KINDS:
            raise ModelError(f"{where} is of kind '{kind}'; supported are {', '.join(KINDS)}.")
        axis = read_triple(element.find("axis"), "xyz", where, _AXIS)
        if not np.linalg.norm(axis) > 0.0:
            raise ModelError(f"{where}: the axis is zero; give a direction.")
        one, two = (_end(element, tag, axis, where) for tag in ("link1", "link2"))
        found.append(Closure(name, KINDS[kind], (one, two)))
    return tuple(found)


def urdf_passive(root: Any, what: str) -> dict[str, float]:
    """Return the joints without motors of a URDF: its elements ``<passive_joint>``, as in an SRDF.

    Returns
    -------
    dict of str to float
        Their names, and about where they are while those with motors are at zero (rad, m): the
        attribute ``position``, of which an SRDF knows nothing; zero without it.

    Raises
    ------
    ModelError
        When one has no name, or its position is no number.
    """
    found = {}
    for element in root.findall("passive_joint"):
        name, text = element.get("name", ""), element.get("position", "0")
        try:
            found[name] = float(text)
        except ValueError:
            found[name] = np.inf
        if not name or not abs(found[name]) <= LARGEST:
            raise ModelError(
                f"{what}: <passive_joint name='{name}' position='{text[:60]}'>: expected the name "
                "of a joint, and about where it is, in rad or m."
            )
    return found


def add_loops(model: Any, closures: Sequence[Closure], what: str) -> tuple[Loop, ...]:
    """Add a frame at either end of each closure to a Pinocchio model; return the loops.

    Raises
    ------
    ModelError
        When a body does not exist, both ends move together, or a name is there twice.
    """
    import pinocchio as pin

    loops: list[Loop] = []
    for closure in closures:
        where = f"{what}: loop joint '{closure.name}'"
        if closure.name in {loop.name for loop in loops}:
            raise ModelError(f"{where} is there twice; give every loop another name.")
        names, joints = [], []
        for body, place in closure.ends:
            if not model.existBodyName(body) and body != "universe":
                raise ModelError(f"{where}: there is no link '{body}'.")
            at = model.getBodyId(body) if body != "universe" else 0
            owner, own = model.frames[at], pin.SE3(place)
            name = f"{closure.name}/{body}"
            joints.append(owner.parentJoint)
            names.append(name)
            model.addFrame(
                pin.Frame(
                    name, owner.parentJoint, at, owner.placement * own, pin.FrameType.OP_FRAME
                )
            )
        if joints[0] == joints[1]:
            raise ModelError(
                f"{where}: {closure.ends[0][0]} and {closure.ends[1][0]} do not move against each "
                "other; a loop has moving joints between its ends."
            )
        loops.append(Loop(closure.name, names[0], names[1], closure.kind))
    return tuple(loops)


def pointing(axis: Array) -> Array:
    """Return a rotation (3, 3) that turns y to an axis."""
    y = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    # The unit vector that is farthest from the axis makes the frame.
    x = np.eye(3)[int(np.argmin(np.abs(y)))]
    x = x - (x @ y) * y
    x = x / np.linalg.norm(x)
    return np.column_stack([x, y, np.cross(x, y)])


def _end(element: Any, tag: str, axis: Array, where: str) -> tuple[str, Array]:
    """Return the link of one end, and the place on it."""
    end = element.find(tag)
    link = None if end is None else end.get("link")
    if not link:
        raise ModelError(f"{where} has no <{tag} link=...>; it joins two links.")
    place = np.eye(4)
    place[:3, 3] = read_triple(end, "xyz", where)
    place[:3, :3] = rpy_matrix(read_triple(end, "rpy", where)) @ pointing(axis)
    return link, place
