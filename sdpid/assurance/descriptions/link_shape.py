"""The convex hull of a link's geometry, and whether a mass distribution fits into it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array


@dataclass(frozen=True, eq=False)
class Shape:
    """The convex hull of a link's geometry.

    Attributes
    ----------
    corners : ndarray, shape (V, 3)
        m, in the link's frame.
    triangles : ndarray, shape (F, 3, 3)
        Its surface.
    normals, offsets : ndarray, shapes (F, 3) and (F,)
        ``normals @ x ≤ offsets`` inside.
    volume : float
        m³.
    """

    corners: Array
    triangles: Array
    normals: Array
    offsets: Array
    volume: float

    @classmethod
    def around(cls, points: Array) -> Shape | None:
        """Return the hull of points (N, 3), None where it has no volume."""
        from scipy.spatial import ConvexHull, QhullError

        if len(points) < 4:
            return None
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        size = float(np.abs(points - middle).max())
        if not size > 0.0:
            return None
        # Qhull works near the origin and at unit size, where its absolute tolerances are right.
        scaled = (points - middle) / size
        try:
            hull = ConvexHull(scaled)
        except (QhullError, ValueError):
            return None
        normals = hull.equations[:, :3]
        return cls(
            corners=points[hull.vertices],
            triangles=points[hull.simplices],
            normals=normals,
            offsets=-size * hull.equations[:, 3] + normals @ middle,
            volume=float(hull.volume) * size**3,
        )

    def distance(self, point: Array) -> float:
        """Return how far a point is outside, m; minus its depth where it is inside."""
        depth = float(np.max(self.normals @ point - self.offsets))
        return depth if depth <= 0.0 else _distance_to_triangles(point, self.triangles)

    def radius(self, point: Array) -> float:
        """Return the largest distance of the shape from a point, m."""
        return float(np.linalg.norm(self.corners - point, axis=1).max())

    def spread(self, com: Array, covariance: Array, *, slack: float = 0.0) -> float | None:
        """Return by how much mass is too spread out for the shape: above 1 it cannot fit.

        Mass between a and b (along any direction) whose mean is c has a variance of at most
        (b − c)·(c − a), reached by two points at the ends [bhatia2000]_; a uniform rod reaches a
        third of it. Returned is the largest ratio of standard deviation and limit over the
        principal directions.

        Parameters
        ----------
        com : ndarray, shape (3,)
            Center of mass, m.
        covariance : ndarray, shape (3, 3)
            Second moments about it over the mass, m².
        slack : float, optional
            By how much the shape is taken to be wider on every side, m.

        Returns
        -------
        float or None
            None where the center is not inside.
        """
        values, vectors = np.linalg.eigh(covariance)
        along = (self.corners - com) @ vectors
        above, below = along.max(axis=0) + slack, slack - along.min(axis=0)
        if not (np.minimum(above, below) > 0.0).all():
            return None
        limits = above * below
        return float(np.sqrt(np.max(np.maximum(values, 0.0) / limits)))


def _distance_to_triangles(point: Array, triangles: Array) -> float:
    """Return the distance of a point from the nearest of the triangles (F, 3, 3)."""
    edges = np.roll(triangles, -1, axis=1) - triangles
    away = point - triangles
    length2 = np.einsum("fkd,fkd->fk", edges, edges)
    share = np.einsum("fkd,fkd->fk", away, edges) / np.where(length2 > 0.0, length2, 1.0)
    rest = away - np.clip(share, 0.0, 1.0)[..., None] * edges
    nearest = np.min(np.linalg.norm(rest, axis=2), axis=1)
    normal = np.cross(edges[:, 0], edges[:, 1])
    norm = np.linalg.norm(normal, axis=1)
    inside = norm > 0.0
    for k in range(3):
        side = np.einsum("fd,fd->f", np.cross(edges[:, k], away[:, k]), normal)
        inside &= side >= 0.0
    height = np.abs(np.einsum("fd,fd->f", away[:, 0], normal)) / np.where(norm > 0.0, norm, 1.0)
    return float(np.min(np.where(inside, height, nearest)))
