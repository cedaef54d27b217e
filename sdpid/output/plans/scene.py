"""The moving arm on the page of a plan: what was checked, and where it is over time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.geometry.collision import CollisionModel
from sdpid.excitation.geometry.obstacles import Mesh, Plane
from sdpid.excitation.geometry.solids import Solid
from sdpid.experiment.trajectory.trajectory import Played
from sdpid.output.scene.scene import Group, Line, Scene, ShownMotion, grid, robot_scene
from sdpid.output.scene.surfaces import Surface, described_surfaces, surface_of
from sdpid.robot.model.model import RobotModel

# Half width of what is drawn of a plane, in reaches of the arm.
_WIDE = 1.5

# Digits of a distance after the point, m.
_DIGITS = 4

# Colors of links in turn: the base is gray.
_COLORS = ("#8d99a6", "#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00")

_GROUPS = (
    Group("obstacles", "", "#b8a888"),
    Group("links", "", _COLORS[0]),
    Group("planes", "", "#a08c6e", 0.2),
)


def scene_of(
    robot: RobotModel, motion: Played, collision: CollisionModel | None, clearance: float
) -> Scene:
    """Return the arm that moves through a plan.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    motion : Played
        At about the rate at which it is shown.
    collision : CollisionModel or None
        The shapes that were checked; without them those of the description are drawn.
    clearance : float
        Least distance that is asked, m.
    """
    shown, lines, distances = ShownMotion(motion.rate_hz, motion.position), [], None
    if collision is None:
        surfaces, notes = described_surfaces(robot)
        notes = (*notes, "Shapes are those of the description: no collisions were checked.")
    else:
        half, surfaces = _WIDE * max(robot.reach, 0.1), []
        names = {each.name for each in collision.obstacles}
        planes = [each.shape for each in collision.solids if isinstance(each.shape, Plane)]
        for each in collision.solids:
            if not isinstance(each.shape, Plane):
                surfaces.append(_surface(each, "obstacles" if each.body in names else "links"))
        surfaces += [_sheet(plane, half) for plane in planes]
        lines = [grid(*_sides(plane, half)) for plane in planes]
        notes = ("Shapes are those that were checked for collisions.",)
        distances = _nearest(collision, motion, clearance)
    return robot_scene(
        robot,
        shown,
        _GROUPS,
        [_colored(each) for each in surfaces],
        label=f"The arm of {robot.name} along the motion, and what is around it",
        lines=[*lines, *_traces(robot, shown)],
        distances=distances,
        notes=notes,
    )


def _surface(solid: Solid, group: str) -> Surface:
    """Return what is drawn of a solid that is no plane."""
    link = solid.joint - 1
    assert not isinstance(solid.shape, Plane)
    if isinstance(solid.shape, Mesh):
        points = solid.shape.triangles().reshape(-1, 3)
        return Surface(link, points, np.arange(len(points)).reshape(-1, 3), group)
    return replace(surface_of(solid.shape, link), group=group)


def _colored(surface: Surface) -> Surface:
    """Return a link's surface in the link's color."""
    own = _COLORS[(surface.link + 1) % len(_COLORS)]
    return replace(surface, color=own) if surface.group == "links" else surface


def _traces(robot: RobotModel, motion: ShownMotion) -> Iterator[Line]:
    """Yield where the links without followers go."""
    followed = {int(parent) - 1 for parent in list(robot.pin_model.parents)[1:]}
    origins = motion.placements(robot)[:, :, :3, 3]
    for link in sorted(set(range(robot.n_links)) - followed):
        yield Line(origins[:, link])


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


def _sides(plane: Plane, half: float) -> tuple[Array, Array]:
    """Return the middle of a square part of a plane, and its half sides as rows (2, 3)."""
    n = np.asarray(plane.normal) / np.linalg.norm(plane.normal)
    across = np.cross(n, np.eye(3)[np.abs(n).argmin()])
    across /= np.linalg.norm(across)
    return n * float(np.asarray(plane.point) @ n), half * np.stack([across, np.cross(n, across)])


def _sheet(plane: Plane, half: float) -> Surface:
    """Return a square part of a plane, below or beside the robot's base."""
    middle, sides = _sides(plane, half)
    corners = middle + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ sides
    return Surface(-1, corners, np.array([[0, 1, 2], [0, 2, 3]]), "planes")
