"""What is checked, as points to be drawn."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from sdpid._common.arrays import Array, frozen
from sdpid.excitation.geometry.obstacles import Mesh, Plane
from sdpid.excitation.geometry.solids import Solid


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnShape:
    """A shape of a link or an obstacle.

    Attributes
    ----------
    name : str
        The link, the base or the obstacle.
    link : int
        Index into `RobotModel.link_names` of the link that the shape moves with; −1 if it stands
        still.
    obstacle : bool
        Whether it is an obstacle.
    points : ndarray, shape (N, 3), or None
        Points in the link's joint frame, or in the base frame, m: the shape is their convex hull,
        but for round shapes, which are within by up to 7 %, and for meshes with hollows. None for
        a plane.
    plane : tuple of two ndarrays (3,), or None
        A point and the normal towards the free side.
    """

    name: str
    link: int
    obstacle: bool
    points: Array | None = None
    plane: tuple[Array, Array] | None = None


def drawn_shapes(solids: Iterable[Solid], obstacles: Iterable[str]) -> tuple[DrawnShape, ...]:
    """Return the shapes of solids; `obstacles` are the names of those that are."""
    names, out = set(obstacles), []
    for solid in solids:
        shape, points, plane = solid.shape, None, None
        if isinstance(shape, Plane):
            plane = frozen(shape.point), frozen(shape.normal)
        elif isinstance(shape, Mesh):
            vertices = shape.load()[1]
            points = frozen(vertices @ shape.placement[:3, :3].T + shape.placement[:3, 3])
        else:
            points = frozen(shape.points())
        out.append(
            DrawnShape(
                name=solid.body,
                link=solid.joint - 1,
                obstacle=solid.body in names,
                points=points,
                plane=plane,
            )
        )
    return tuple(out)
