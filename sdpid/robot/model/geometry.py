"""Geometry of a robot: points around each link's collision shapes, and placements of links."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen, real_array
from sdpid.errors import ModelError
from sdpid.robot.description.xml import parse_xml
from sdpid.robot.model.model import RobotModel
from sdpid.robot.model.shapes import Shape, link_shapes


def collision_points(
    robot: RobotModel, link: str, *, package_dirs: Iterable[str | os.PathLike[str]] = ()
) -> Array:
    """Return points whose convex hull contains the collision geometry of a link.

    Links that are fixed to a moving link belong to it, and so does their geometry. Boxes give
    their corners and meshes their vertices, so that the hull is exact. Cylinders give a
    circumscribed prism of 16 sides (2 % wider), spheres and the ends of capsules a circumscribed
    polyhedron of 42 corners (7 % wider at its corners).

    Parameters
    ----------
    robot : RobotModel
        A robot that was loaded from a URDF.
    link : str
        One of its moving links.
    package_dirs : iterable of paths, optional
        Folders in which ``package://`` names and relative file names are looked up: the folder
        that holds the package, the package itself, or the URDF's own folder. Meshes of
        example-robot-data are found without.

    Returns
    -------
    ndarray, shape (N, 3)
        Points in the link's joint frame, m.

    Raises
    ------
    ModelError
        When the robot has no such link or no URDF, the link has no collision geometry, a number
        or a kind of shape is not understood, or a mesh cannot be found or read.
    """
    if link not in robot.link_names:
        raise ModelError(
            f"'{robot.name}' has no moving link '{link}'; it has {', '.join(robot.link_names)}."
        )
    if robot.urdf is None:
        raise ModelError(
            f"'{robot.name}' was not loaded from a URDF, so the shape of '{link}' is not known; "
            "give the points."
        )
    folders, joint = [Path(folder) for folder in package_dirs], robot.link_names.index(link) + 1
    own = (each for each in described_links(robot) if each.joint == joint)
    shapes, _, lacks = described_shapes(own, ("collision",), robot.name, folders)
    if lacks:
        raise ModelError(lacks)
    if not shapes:
        raise ModelError(
            f"'{robot.name}': link '{link}' and what is fixed to it have no collision geometry; "
            "give the points, or leave this link out."
        )
    return np.concatenate([shape.points() for shape in shapes])


class DescribedLink(NamedTuple):
    """A link of a description, and where it is.

    Attributes
    ----------
    joint : int
        Pinocchio's index of the joint that moves it, 0 where none does.
    name : str
        Its name.
    placement : ndarray, shape (4, 4)
        Its frame in that of the joint.
    element : element or None
        Its ``<link>`` in a URDF.
    """

    joint: int
    name: str
    placement: Array
    element: Any


def described_links(robot: RobotModel) -> list[DescribedLink]:
    """Return the links of a robot's description."""
    import pinocchio as pin

    elements: dict[str, Any] = {}
    if robot.urdf is not None:
        root = parse_xml(robot.urdf, robot.name)
        elements = {element.get("name"): element for element in root.findall("link")}
    return [
        DescribedLink(
            int(frame.parentJoint),
            frame.name,
            np.array(frame.placement.homogeneous),
            elements.get(frame.name),
        )
        for frame in robot.pin_model.frames
        if frame.type == pin.FrameType.BODY
    ]


def described_shapes(
    links: Iterable[DescribedLink], kinds: Sequence[str], robot: str, folders: Sequence[Path]
) -> tuple[list[Shape], str, str]:
    """Return the shapes of links that one joint moves, in its frame.

    Parameters
    ----------
    links : iterable of DescribedLink
        The links.
    kinds : sequence of {"collision", "visual"}
        Of these the first is taken that they have and that can be read.
    robot : str
        What the robot is called in messages.
    folders : sequence of Path
        Folders in which the names of meshes are looked up.

    Returns
    -------
    shapes : list of Shape
    kind : str
        Their kind; empty where there are none.
    lacks : str
        Why there are none, although the links have some.
    """
    own, lacks = [each for each in links if each.element is not None], ""
    for kind in kinds:
        try:
            shapes = [
                replace(shape, placement=frozen(each.placement @ shape.placement))
                for each in own
                for shape in link_shapes(each.element, kind, robot, folders)
            ]
        except ModelError as cause:
            lacks = lacks or str(cause)
        else:
            if shapes:
                return shapes, kind, ""
    return [], "", lacks


def neutral(robot: RobotModel) -> Array:
    """Return the position at which all joints are at zero and a floating base at the origin."""
    base = np.eye(7)[6] if robot.free_flyer else np.zeros(0)
    return np.concatenate([base, np.zeros(robot.n - robot.n_base)])


def link_placements(robot: RobotModel, position: ArrayLike | None = None) -> Array:
    """Return the placements of the links' joint frames in the base frame, shape (links, 4, 4).

    Parameters
    ----------
    robot : RobotModel
        The robot.
    position : array_like, shape (n,), optional
        Joint positions in rad or m, behind the seven of a floating base; by default all zero, with
        the base at the origin.

    Raises
    ------
    DataError
        When the position has another shape.
    """
    import pinocchio as pin

    model = robot.pin_model
    if position is None:
        position = neutral(robot)
    q = robot.configuration(real_array(position, "position", ndim=1)[None])[0]
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    return np.stack([data.oMi[i + 1].homogeneous for i in range(robot.n_links)])


def carrying_frame(
    robot: RobotModel, link: str | None, frame: str | None, *, what: str
) -> tuple[int, Array, Array, str]:
    """Return the link that carries a load, and the placement of the load's frame on it.

    Parameters
    ----------
    robot : RobotModel
        The arm.
    link : str or None
        Name of the link; by default the last one.
    frame : str or None
        A frame fixed to it; by default its joint frame.
    what : str
        What messages begin with.

    Returns
    -------
    link : int
    rotation, translation : ndarray, shapes (3, 3) and (3,)
        Of the frame in the link's joint frame.
    name : str
        What to call the frame.

    Raises
    ------
    ModelError
        When there is no such link, several are last ones, or no such frame is fixed to the link.
    """
    names, model = robot.link_names, robot.pin_model
    parents = set(list(model.parents)[1:])
    last = [name for i, name in enumerate(names, 1) if i not in parents]
    if link is None and len(last) > 1:
        raise ModelError(
            f"{what}: '{robot.name}' has {len(last)} last links, {', '.join(last)}; say which "
            "carries it (link=...)."
        )
    wanted = last[0] if link is None else link
    if wanted not in names:
        raise ModelError(
            f"{what}: '{robot.name}' has no link '{link}'; its links are {', '.join(names)}."
        )
    # Of frames with one name the first counts.
    number, frames = names.index(wanted), reversed(list(model.frames))
    if frame is None:
        return number, np.eye(3), np.zeros(3), f"of joint {model.names[number + 1]}"
    fixed = {str(f.name): f.placement for f in frames if f.parentJoint == number + 1}
    if frame not in fixed:
        raise ModelError(
            f"{what}: no frame '{frame}' is fixed to link '{names[number]}'; there are "
            f"{', '.join(sorted(fixed))}."
        )
    return number, np.array(fixed[frame].rotation), np.array(fixed[frame].translation), frame
