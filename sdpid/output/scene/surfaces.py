"""Surfaces of a robot's links: visual shapes, else collision shapes, else capsules."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.excitation.geometry.solids import assumed_radius, assumed_shapes
from sdpid.robot.model.geometry import described_links, described_shapes
from sdpid.robot.model.model import RobotModel
from sdpid.robot.model.shapes import Shape, hull_faces, mesh_faces

# Cells of the finest grid along the robot: what is nearer than a cell becomes one corner.
_FINEST = 2000.0

# Corners farther away than this are no robot's, m.
_FARTHEST = 1e3

# Radius of capsules where a robot is too short to tell one, m.
_LEAST_RADIUS = 0.01

# Factors by which cells grow until few enough triangles are left.
_LEAST_STEP, _LARGEST_STEP = 1.15, 2.0


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles that move with a link.

    Attributes
    ----------
    link : int
        The moving link, -1 for what stands still.
    points : ndarray, shape (N, 3)
        Corners in the link's joint frame, m.
    faces : ndarray of int, shape (M, 3)
        Corners of the triangles.
    group : str
        The key of the group that it is shown and hidden with.
    color : str
        ``#rrggbb``; empty for that of the group.
    """

    link: int
    points: Array
    faces: Indices
    group: str = "links"
    color: str = ""


def described_surfaces(robot: RobotModel) -> tuple[list[Surface], tuple[str, ...]]:
    """Return the surfaces of a robot's links as its description has them, and what was assumed.

    Visual shapes are taken where a link has some that can be read, else collision shapes. Links
    whose shapes cannot be read, and all links of a robot without any, become capsules.

    Parameters
    ----------
    robot : RobotModel
        The robot; meshes are looked up as `load_robot` found its description.

    Returns
    -------
    surfaces : list of Surface
    notes : tuple of str
        Sentences.
    """
    links = described_links(robot)
    folders = [] if robot.folder is None else [robot.folder]
    surfaces: list[Surface] = []
    missing: list[str] = []
    for each in links:
        kinds = ("visual", "collision")
        shapes, _, lacks = described_shapes([each], kinds, robot.name, folders)
        drawn = [surface_of(shape, each.joint - 1) for shape in shapes]
        surfaces += (fit := [surface for surface in drawn if _drawable(surface)])
        if lacks or len(fit) < len(drawn):
            missing.append(each.name)
            surfaces += _capsules(robot, each.joint)
    if not surfaces:
        for joint in range(robot.n_links + 1):
            surfaces += _capsules(robot, joint)
        why = "is no URDF, so its shapes are not read" if robot.urdf is None else "has no shapes"
        return surfaces, (f"The description {why}: links are drawn as capsules between joints.",)
    if not missing:
        return surfaces, ()
    return surfaces, (
        f"Shapes were not found, or make no picture, of {', '.join(dict.fromkeys(missing))}: "
        "capsules stand for them.",
    )


def surface_of(shape: Shape, link: int) -> Surface:
    """Return the surface of a shape: a mesh's triangles, the convex hull of anything else."""
    if shape.mesh is None:
        return Surface(link, *hull(shape.points()))
    return Surface(link, shape.points(), mesh_faces(shape.mesh))


def hull(points: Array) -> tuple[Array, Indices]:
    """Return corners and outward triangles of the convex hull of points; none of a single one."""
    from scipy.spatial import QhullError

    nothing = np.empty((0, 3), dtype=np.intp)
    if not np.ptp(points, axis=0).any():
        return points, nothing
    try:
        used, faces = np.unique(hull_faces(points), return_inverse=True)
    except (QhullError, ValueError):
        return points, nothing
    return points[used], faces.reshape(-1, 3)


def thinned(surfaces: Sequence[Surface], most: int) -> list[Surface]:
    """Return surfaces of at most so many triangles together, coarse alike.

    Corners within a cell of a grid become their mean [rossignac1993]_; the cells grow until few
    enough triangles are left.
    """
    if not surfaces:
        return []
    spans = [np.ptp(each.points, axis=0).max(initial=0.0) for each in surfaces]
    cell = max(float(np.max(spans)), 1e-6) / _FINEST
    found = [_clustered(each, cell) for each in surfaces]
    while (count := sum(len(each.faces) for each in found)) > most:
        cell *= float(np.clip(np.sqrt(count / most), _LEAST_STEP, _LARGEST_STEP))
        found = [_clustered(each, cell) for each in surfaces]
    return [each for each in found if len(each.faces)]


def _clustered(surface: Surface, cell: float) -> Surface:
    """Return a surface with one corner a cell, without triangles that this leaves flat or twice."""
    places = np.floor((surface.points - surface.points.min(axis=0)) / cell).astype(np.int64)
    sizes = places.max(axis=0) + 1
    keys = (places[:, 0] * sizes[1] + places[:, 1]) * sizes[2] + places[:, 2]
    cells, owner, counts = np.unique(keys, return_inverse=True, return_counts=True)
    owner = owner.reshape(-1)
    points = np.stack(
        [np.bincount(owner, column, len(cells)) / counts for column in surface.points.T], axis=-1
    )
    faces = owner[surface.faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    # One number of three indices below `count`, of at most two million.
    count = len(cells)
    numbers = np.sort(faces, axis=1) @ np.array([count * count, count, 1])
    _, kept = np.unique(numbers, return_index=True)
    used, faces = np.unique(faces[np.sort(kept)], return_inverse=True)
    return replace(surface, points=points[used], faces=faces.reshape(-1, 3))


def _drawable(surface: Surface) -> bool:
    """Return whether a surface has triangles, and those near the robot."""
    return len(surface.faces) > 0 and bool(np.abs(surface.points).max() < _FARTHEST)


def _capsules(robot: RobotModel, joint: int) -> list[Surface]:
    """Return what stands for the link that a joint moves, or for the base at 0."""
    radius = max(assumed_radius(robot), _LEAST_RADIUS)
    return [surface_of(shape, joint - 1) for shape in assumed_shapes(robot, joint, radius)]
