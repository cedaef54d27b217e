"""The convex hull of a link's geometry, and whether a mass distribution fits into it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sdpid._common.arrays import Array

# Weight of the sum of shares beside distances: it misses 1 by the square of its inverse.
_HEAVY = 1e6


@dataclass(frozen=True, eq=False)
class Shape:
    """The convex hull of a link's geometry.

    Attributes
    ----------
    corners : ndarray, shape (V, 3)
        m, in the link's frame.
    normals, offsets : ndarray, shapes (F, 3) and (F,)
        ``normals @ x ≤ offsets`` inside.
    volume : float
        m³.
    """

    corners: Array
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
            normals=normals,
            offsets=-size * hull.equations[:, 3] + normals @ middle,
            volume=float(hull.volume) * size**3,
        )

    def distance(self, point: Array) -> float:
        """Return how far a point is outside, m; minus its depth where it is inside."""
        from scipy.optimize import nnls

        depth = float(np.max(self.normals @ point - self.offsets))
        if depth <= 0.0:
            return depth
        # The nearest convex combination of the corners; a heavy row makes their shares add up to 1.
        away = self.corners - point
        heavy = _HEAVY * float(np.linalg.norm(away, axis=1).max())
        shares, _ = nnls(np.vstack([away.T, np.full(len(away), heavy)]), np.array([0, 0, 0, heavy]))
        return float(np.linalg.norm(away.T @ shares / shares.sum()))

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


class Shapes(NamedTuple):
    """Hulls of a link's collision geometry (of all where it has none) and of all its geometry."""

    collision: Shape
    whole: Shape
