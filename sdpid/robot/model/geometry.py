"""Geometry of a robot: points around each link's collision shapes, and placements of links."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, real_array
from sdpid.errors import ModelError
from sdpid.robot.description.xml import parse_xml
from sdpid.robot.model.model import RobotModel
from sdpid.robot.model.shapes import link_shapes


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
    folders = [Path(folder) for folder in package_dirs]
    own = robot.link_names.index(link) + 1
    bodies = {name: place for joint, name, place in described_bodies(robot) if joint == own}
    points = []
    for element in parse_xml(robot.urdf, robot.name).findall("link"):
        name = element.get("name")
        if name in bodies:
            found = link_points(element, "collision", robot.name, folders)
            points.append(found @ bodies[name][:3, :3].T + bodies[name][:3, 3])
    if not any(len(found) for found in points):
        raise ModelError(
            f"'{robot.name}': link '{link}' and what is fixed to it have no collision geometry; "
            "give the points, or leave this link out."
        )
    return np.concatenate(points)


def link_points(element: Any, kind: str, robot: str, folders: Sequence[Path]) -> Array:
    """Return points whose convex hull contains the shapes of a URDF's ``<link>``, in its frame.

    Parameters
    ----------
    element : element
        The ``<link>``.
    kind : {"collision", "visual"}
        Which shapes.
    robot : str
        What the robot is called in messages.
    folders : sequence of Path
        Folders in which the names of meshes are looked up.

    Returns
    -------
    ndarray, shape (N, 3)
        m; N is zero where the link has no such shape.

    Raises
    ------
    ModelError
        When a shape is not understood, or a mesh cannot be found or read.
    """
    shapes = link_shapes(element, kind, robot, folders)
    return np.concatenate([np.empty((0, 3)), *(shape.points() for shape in shapes)])


def described_bodies(robot: RobotModel) -> list[tuple[int, str, Array]]:
    """Return the links of the description: joint, name and placement in the joint's frame.

    The joint is Pinocchio's index of the one that moves the link, 0 where none does.
    """
    import pinocchio as pin

    return [
        (int(frame.parentJoint), frame.name, np.array(frame.placement.homogeneous))
        for frame in robot.pin_model.frames
        if frame.type == pin.FrameType.BODY
    ]


def neutral(robot: RobotModel) -> Array:
    """Return the position at which all joints are at zero and a floating base at the origin."""
    if not robot.free_flyer:
        return np.zeros(robot.n)
    import pinocchio as pin

    return np.asarray(pin.neutral(robot.pin_model))


def link_placements(robot: RobotModel, position: ArrayLike | None = None) -> Array:
    """Return the placements of the links' joint frames in the base frame, shape (links, 4, 4).

    Parameters
    ----------
    robot : RobotModel
        The robot.
    position : array_like, shape (n,), optional
        Joint positions in rad or m, a configuration (nq,) with a floating base; by default all
        zero, with the base at the origin.

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
