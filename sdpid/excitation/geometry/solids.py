"""Solids that stand for the links: convex shapes of the description, or assumed capsules."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.geometry.obstacles import Box, Mesh, Obstacle, Plane
from sdpid.robot.model.geometry import described_links, described_shapes
from sdpid.robot.model.model import RobotModel
from sdpid.robot.model.shapes import Shape, collision_library, hull_faces

# Radius of assumed links as a share of the way to the farthest joint, and its largest value in m:
# industrial and collaborative arms of 0.5 to 1.3 m have links of 5 to 8 cm.
_RADIUS_SHARE, _LARGEST_RADIUS = 0.1, 0.07
# Their radius where all joints lie in one place, which tells no size, m.
_RADIUS_OF_NO_WAY = 0.01

# Thickness of the box around a mesh without volume, as a share of its size.
_THIN = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Solid:
    """A shape that moves with a joint, or stands still.

    Attributes
    ----------
    body : str
        The moving link, the base or the obstacle that it belongs to.
    joint : int
        Pinocchio's index of the joint that moves it; 0 if it stands still.
    shape : Shape or Plane or Mesh
        A convex shape in the frame of the joint, or an obstacle that is no such shape.
    """

    body: str
    joint: int
    shape: Shape | Plane | Mesh

    @property
    def core(self) -> tuple[Array, float]:
        """Points (N, 3) and a radius: the convex hull of balls about the points has the solid.

        A plane has no points.
        """
        if isinstance(self.shape, Plane):
            return np.empty((0, 3)), np.inf
        if isinstance(self.shape, Mesh):
            place = self.shape.placement
            return self.shape.load()[1] @ place[:3, :3].T + place[:3, 3], 0.0
        if self.shape.kind not in ("sphere", "capsule"):
            return self.shape.points(), 0.0
        radius, *length = self.shape.sizes
        ends = np.array([[0.0, 0.0, 0.5 * s * sum(length)] for s in (-1.0, 1.0)])
        placement = self.shape.placement
        return ends @ placement[:3, :3].T + placement[:3, 3], float(radius)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without Coal's object, which cannot be pickled."""
        return {key: value for key, value in vars(self).items() if key != "geometry"}

    @cached_property
    def geometry(self) -> tuple[Any, Array]:
        """Coal's geometry, and its placement (4, 4) in the frame of the joint.

        Raises
        ------
        ModelError
            When a mesh cannot be read.
        """
        coal, shape = collision_library(), self.shape
        if isinstance(shape, Plane):
            normal = np.array(shape.normal)
            return coal.Halfspace(normal, float(normal @ shape.point)), np.eye(4)
        if isinstance(shape, Mesh):
            return shape.load()[0], shape.placement
        if shape.kind == "mesh":
            return _convex(shape.vertices), shape.placement
        # Coal has classes Box, Sphere, Cylinder and Capsule.
        made = getattr(coal, shape.kind.capitalize())
        return made(*(float(size) for size in shape.sizes)), shape.placement


def obstacle_solid(obstacle: Obstacle) -> Solid:
    """Return the solid of an obstacle."""
    shape: Shape | Plane | Mesh
    if isinstance(obstacle, Box):
        shape = Shape("box", np.array(obstacle.size), placement=obstacle.placement)
    elif isinstance(obstacle, Mesh) and obstacle.convex:
        shape = _hull(obstacle.load()[1], obstacle.placement)
    else:
        shape = obstacle
    return Solid(body=obstacle.name, joint=0, shape=shape)


def robot_solids(
    robot: RobotModel,
    *,
    package_dirs: Iterable[str | os.PathLike[str]] = (),
    radius: float | None = None,
) -> tuple[tuple[Solid, ...], tuple[str, ...]]:
    """Return the solids of the base and of the moving links, and what was assumed.

    Collision geometry is taken where a link has it, visual geometry where it has only that.
    Meshes become convex hulls. Links whose meshes are missing, and all links of a robot without
    any geometry, become capsules from their joint to the next ones.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    package_dirs : iterable of paths, optional
        Folders in which meshes are looked up.
    radius : float, optional
        Radius of assumed capsules, m; by default a tenth of the way to the farthest joint, at
        most 70 mm.

    Returns
    -------
    solids : tuple of Solid
    assumed : tuple of str
        Sentences.
    """
    folders = [Path(folder) for folder in package_dirs]
    if radius is None:
        radius = assumed_radius(robot)
    links = described_links(robot)
    shapes: dict[int, list[Shape]] = {}
    hulls, visuals, missing, bare = [], [], [], []
    for joint in range(robot.n_links + 1):
        body = body_name(robot, joint)
        own = [each for each in links if each.joint == joint]
        found, kind, lacks = described_shapes(own, ("collision", "visual"), robot.name, folders)
        # Meshes as the corners of their convex hulls.
        shapes[joint] = [_hull(x.vertices, x.placement) if x.kind == "mesh" else x for x in found]
        if kind == "visual":
            visuals.append(body)
        if any(shape.kind == "mesh" for shape in shapes[joint]):
            hulls.append(body)
        if lacks:
            missing.append(lacks)
            shapes[joint] = assumed_shapes(robot, joint, radius)
        elif not found:
            bare.append(body)
    capsules = f"capsules of {1e3 * radius:.0f} mm radius from joint to joint"
    if not any(shapes.values()):
        shapes = {joint: assumed_shapes(robot, joint, radius) for joint in shapes}
        described = any(each.element is not None for each in links)
        lacks = "has no shapes" if described else "is no URDF, so its shapes are not read"
        told = {f"The description of '{robot.name}' {lacks}: links are taken as {capsules}.": bare}
    else:
        told = {
            f"Meshes are taken as their convex hulls: {', '.join(hulls)}.": hulls,
            f"Visual shapes stand for missing collision shapes: {', '.join(visuals)}.": visuals,
            f"{capsules.capitalize()} stand for links whose shapes cannot be read (package_dirs "
            f"names the folders of meshes): {'; '.join(missing)}": missing,
            f"Without any shape in the description, not checked: {', '.join(bare)}.": bare,
        }
    solids = (
        Solid(body=body_name(robot, joint), joint=joint, shape=shape)
        for joint, own_shapes in shapes.items()
        for shape in own_shapes
    )
    return tuple(solids), tuple(text for text, names in told.items() if names)


def body_name(robot: RobotModel, joint: int) -> str:
    """Return the name of a moving link by Pinocchio's index of its joint, or of the base at 0."""
    if joint > 0:
        return robot.link_names[joint - 1]
    return next((each.name for each in described_links(robot) if each.joint == 0), "base")


def assumed_radius(robot: RobotModel) -> float:
    """Return the radius of capsules that stand for links, m."""
    return min(_RADIUS_SHARE * robot.reach, _LARGEST_RADIUS) or _RADIUS_OF_NO_WAY


def assumed_shapes(robot: RobotModel, joint: int, radius: float) -> list[Shape]:
    """Return capsules from a joint's origin to the next joints, or to the end of the last link."""
    model = robot.pin_model
    ends = [
        np.array(model.jointPlacements[i].translation)
        for i in range(1, model.njoints)
        if model.parents[i] == joint
    ]
    if not ends:
        fixed = [
            np.array(frame.placement.translation)
            for frame in model.frames
            if frame.parentJoint == joint
        ]
        ends = [max(fixed, key=np.linalg.norm)] if fixed else [np.zeros(3)]
    return [_capsule(end, radius) for end in ends]


def _capsule(end: Array, radius: float) -> Shape:
    """Return the capsule from the origin to an end."""
    length = float(np.linalg.norm(end))
    if length < radius * _THIN:
        return Shape("sphere", np.array([radius]))
    # Two axes orthogonal to the third, which points to the end.
    across = np.linalg.svd(end[None])[2][1:]
    across[1] *= np.sign(np.linalg.det(np.vstack([across, end])))
    placement = np.eye(4)
    placement[:3, :3] = np.vstack([across, end / length]).T
    placement[:3, 3] = 0.5 * end
    return Shape("capsule", np.array([radius, length]), placement=placement)


def _hull(vertices: Array, placement: Array) -> Shape:
    """Return the corners of the convex hull of points, or a thin box around a flat mesh."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return Shape("mesh", vertices=vertices[ConvexHull(vertices).vertices], placement=placement)
    except QhullError:
        lower, upper = vertices.min(axis=0), vertices.max(axis=0)
        size = np.maximum(upper - lower, _THIN * np.max(upper - lower, initial=0.0))
        middle = np.eye(4)
        middle[:3, 3] = 0.5 * (lower + upper)
        return Shape("box", size, placement=placement @ middle)


def _convex(vertices: Array) -> Any:
    """Return Coal's convex polyhedron of the corners of a convex hull."""
    coal = collision_library()
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    points.extend(np.array(vertices))
    faces = hull_faces(vertices)
    triangles.extend([coal.Triangle(int(a), int(b), int(c)) for a, b, c in faces])
    return coal.Convex(points, triangles)
