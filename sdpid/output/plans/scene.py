"""The moving arm as the page's player draws it: convex shapes and where they are over time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.geometry.collision import CollisionModel
from sdpid.excitation.geometry.obstacles import Mesh, Plane
from sdpid.experiment.trajectory.played import Played
from sdpid.robot.model.geometry import link_placements
from sdpid.robot.model.model import RobotModel
from sdpid.robot.model.shapes import Shape

# Frames a second: the player blends between them.
FRAME_RATE = 25.0

# Corners of a drawn shape: a picture of some hundred pixels shows no more of a hull.
_CORNERS = 48

# Triangles of a mesh that is drawn as it is, and not by its hull.
_TRIANGLES = 3000

# Lines of a plane's grid on either side of its middle, and its half width in sizes of the arm.
_GRID, _WIDE = 5, 1.2

# Digits after the point: tenths of a millimeter, and of the quaternions alike.
_DIGITS = 4


def scene_of(
    robot: RobotModel, motion: Played, collision: CollisionModel | None, clearance: float
) -> dict[str, Any]:
    """Return what the player needs, as plain values.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    motion : Played
        At about `FRAME_RATE`.
    collision : CollisionModel or None
        The shapes that were checked; without them joints are joined by lines.
    clearance : float
        Least distance that is asked, m.
    """
    placements = np.stack([link_placements(robot, q) for q in motion.position])
    origins = placements[:, :, :3, 3]
    solids = () if collision is None else collision.solids
    names = set() if collision is None else {each.name for each in collision.obstacles}
    bones = list(_bones(robot))
    seen = [np.zeros((1, 3)), origins.reshape(-1, 3)]
    for each in solids:
        if each.joint == 0 and each.body not in names and isinstance(each.shape, Shape):
            seen.append(each.shape.points())
    low, high = (extreme(np.concatenate(seen), axis=0) for extreme in (np.min, np.max))
    size = max(float(np.linalg.norm(high - low)) / 2.0, 0.1)
    return {
        "center": (0.5 * (low + high)).tolist(),
        "size": size,
        "duration": float(motion.time[-1]),
        "shapes": [
            {"link": each.joint - 1, "obstacle": each.body in names, **_surface(each.shape)}
            for each in solids
            if not isinstance(each.shape, Plane)
        ],
        "planes": [
            _grid(each.shape, _WIDE * size) for each in solids if isinstance(each.shape, Plane)
        ],
        "bones": bones,
        "traces": [
            origins[:, link].round(_DIGITS).tolist()
            for link in sorted(set(range(robot.n_links)) - {parent for parent, _ in bones})
        ],
        "frames": {
            "rate": motion.rate_hz,
            "count": len(motion.time),
            "poses": _poses(placements).round(_DIGITS).tolist(),
            "q": motion.position.round(_DIGITS).tolist(),
        },
        "distances": None if collision is None else _nearest(collision, motion, clearance),
    }


def _surface(shape: Shape | Mesh) -> dict[str, Any]:
    """Return corners and triangles of a shape; those of a large mesh are its hull's."""
    hollow = isinstance(shape, Mesh)
    points = shape.triangles().reshape(-1, 3) if isinstance(shape, Mesh) else shape.points()
    if hollow and len(points) <= 3 * _TRIANGLES:
        corners, faces = points, np.arange(len(points)).reshape(-1, 3).tolist()
    else:
        corners, faces = hull(points)
    return {"points": corners.round(_DIGITS).tolist(), "faces": faces, "hollow": hollow}


def hull(points: Array) -> tuple[Array, list[list[int]]]:
    """Return corners and outward triangles of the convex hull of points, with few corners.

    Of many points those that are farthest in evenly spread directions are kept.
    """
    from scipy.spatial import ConvexHull

    k = np.arange(_CORNERS) + 0.5
    height, turn = 1.0 - 2.0 * k / _CORNERS, np.pi * (1.0 + np.sqrt(5.0)) * k
    ring = np.sqrt(1.0 - height**2)
    directions = np.stack([ring * np.cos(turn), ring * np.sin(turn), height])
    if len(points) > _CORNERS:
        points = points[np.unique((points @ directions).argmax(axis=0))]
    found = ConvexHull(points, qhull_options="QJ")
    faces = []
    for corners, plane in zip(found.simplices.tolist(), found.equations, strict=True):
        a, b, c = points[corners]
        outward = float(np.cross(b - a, c - a) @ plane[:3]) > 0.0
        faces.append(corners if outward else corners[::-1])
    return points, faces


def _poses(placements: Array) -> Array:
    """Return position and quaternion (x, y, z, w) of each link, shape (K, links, 7)."""
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_matrix(placements[..., :3, :3].reshape(-1, 3, 3)).as_quat()
    shape = placements.shape[:2]
    return np.concatenate([placements[..., :3, 3], turns.reshape(*shape, 4)], axis=-1)


def _bones(robot: RobotModel) -> Iterator[tuple[int, int]]:
    """Yield the links that follow each other, -1 for the base."""
    for link, parent in enumerate(list(robot.pin_model.parents)[1:]):
        yield int(parent) - 1, link


def _nearest(collision: CollisionModel, motion: Played, clearance: float) -> dict[str, Any] | None:
    """Return which pair has the least room at each time, and its distance, but for close ones."""
    if not collision.pairs:
        return None
    distances = collision.distances(motion.position)
    asked = collision.clearances(clearance)
    # Pairs that are always close are asked for less, and would be the nearest most of the time.
    usual = asked >= clearance if np.any(asked >= clearance) else np.ones_like(asked, dtype=bool)
    nearest = np.where(usual, distances - asked, np.inf).argmin(axis=1)
    values = distances[np.arange(len(nearest)), nearest].round(_DIGITS)
    names = [f"{pair.first} – {pair.second}" for pair in collision.pairs]
    used, index = np.unique(nearest, return_inverse=True)
    frames = list(zip(index.tolist(), values.tolist(), strict=True))
    return {"pairs": [names[k] for k in used], "frames": frames}


def _grid(plane: Plane, half: float) -> dict[str, Any]:
    """Return outline and lines of a square part of a plane, below or beside the robot's base."""
    n = np.asarray(plane.normal) / np.linalg.norm(plane.normal)
    middle = n * float(np.asarray(plane.point) @ n)
    across = np.cross(n, np.eye(3)[np.abs(n).argmin()])
    across /= np.linalg.norm(across)
    sides = np.stack([across, np.cross(n, across)])

    def at(a: float, b: float) -> list[float]:
        return [float(x) for x in (middle + half * (a * sides[0] + b * sides[1])).round(_DIGITS)]

    steps = np.linspace(-1.0, 1.0, 2 * _GRID + 1).tolist()
    lines = [[at(s, -1.0), at(s, 1.0)] for s in steps] + [[at(-1.0, s), at(1.0, s)] for s in steps]
    return {"outline": [at(-1, -1), at(1, -1), at(1, 1), at(-1, 1)], "lines": lines}
