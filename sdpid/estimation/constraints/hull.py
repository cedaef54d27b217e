"""Convex hulls: as linear inequalities, and whether a mass distribution fits into one."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError

# Facets whose unit normals differ by less are one: Qhull cuts flat faces into triangles whose
# normals agree to rounding, divided by the triangles' slenderness.
_SAME_NORMAL = 1e-7

# Points flatter than this share of their extent have no volume that rounding leaves meaningful.
_FLAT = 1e-6

# Weight of the sum of shares beside distances: it misses 1 by the square of its inverse.
_HEAVY = 1e6


@dataclass(frozen=True, eq=False)
class Hull:
    """The convex hull of points.

    Attributes
    ----------
    corners : ndarray, shape (V, 3)
        m.
    normals, offsets : ndarray, shapes (F, 3) and (F,)
        ``normals @ x ≤ offsets`` inside; of a flat face that has more corners than three, several.
    volume : float
        m³.
    """

    corners: Array
    normals: Array
    offsets: Array
    volume: float

    @classmethod
    def of(cls, points: Array, what: str) -> Hull:
        """Return the hull of points (N, 3), which messages call `what`.

        Raises
        ------
        DataError
            When there are fewer than four points, or they lie in a plane.
        """
        from scipy.spatial import ConvexHull, QhullError

        if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4:
            raise DataError(f"{what}: points of shape {points.shape}; give (N, 3) with at least 4.")
        # Qhull works near the origin and at unit size, where its absolute tolerances are right.
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        size = float(np.max(np.abs(points - middle)))
        scaled = (points - middle) / size if size > 0.0 else points - middle
        extents = np.linalg.svd(scaled - scaled.mean(axis=0), compute_uv=False)
        if not extents[2] > _FLAT * extents[0]:
            raise DataError(
                f"{what}: the {len(points)} points lie in a plane or on a line (they extend by "
                f"{size * extents[2]:.2g} m across, at least {_FLAT:g} of {size * extents[0]:.2g} "
                "m is needed), so their hull has no volume; give points with a volume."
            )
        try:
            hull = ConvexHull(scaled)
        except (QhullError, ValueError) as cause:
            reason = str(cause).strip().splitlines()[0]
            raise DataError(f"{what}: the points have no convex hull ({reason}).") from None
        normals = hull.equations[:, :3]
        offsets = -size * hull.equations[:, 3] + normals @ middle
        return cls(points[hull.vertices], normals, offsets, float(hull.volume) * size**3)

    def radius(self, point: Array) -> float:
        """Return the largest distance of the hull from a point, m."""
        return float(np.linalg.norm(self.corners - point, axis=1).max())

    def distance(self, point: Array) -> float:
        """Return how far a point is outside, m; minus its depth where it is inside."""
        from scipy.optimize import nnls

        depth = float(np.max(self.normals @ point - self.offsets))
        if depth <= 0.0:
            return depth
        # The nearest convex combination of the corners; a heavy row makes their shares add up to 1.
        away, heavy = self.corners - point, _HEAVY * self.radius(point)
        shares, _ = nnls(np.vstack([away.T, np.full(len(away), heavy)]), np.array([0, 0, 0, heavy]))
        return float(np.linalg.norm(away.T @ shares / shares.sum()))

    def spread(self, com: Array, covariance: Array, *, slack: float = 0.0) -> float | None:
        """Return by how much mass is too spread out for the hull: above 1 it cannot fit.

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
            By how much the hull is taken to be wider on every side, m.

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
        return float(np.sqrt(np.max(np.maximum(values, 0.0) / (above * below))))


def hull_facets(points: Array, what: str, *, tolerance: float = 0.0) -> tuple[Array, Array]:
    """Return the convex hull of points as ``normals @ x ≤ offsets``.

    Parameters
    ----------
    points : ndarray, shape (N, 3)
        The points.
    what : str
        What they are called in messages.
    tolerance : float, optional
        With a positive one, facets are left out as long as no point that satisfies the rest is
        farther from a facet left out than this. What remains contains the hull.

    Returns
    -------
    normals : ndarray, shape (F, 3)
        Of unit length, all different.
    offsets : ndarray, shape (F,)

    Raises
    ------
    DataError
        When there are fewer than four points, or they lie in a plane.
    """
    from scipy.spatial import QhullError

    hull = Hull.of(points, what)
    middle = hull.corners.mean(axis=0)
    size = hull.radius(middle)
    corners, normals = (hull.corners - middle) / size, _different(hull.normals)
    # The farthest corner decides, so that whatever was merged, no point is cut off.
    offsets = np.max(corners @ normals.T, axis=0)
    if tolerance > 0.0:
        # A hull so thin that Qhull cannot cut it from planes keeps all its facets.
        with suppress(QhullError):
            normals, offsets = _fewer(normals, offsets, corners, tolerance / size)
    return normals, size * offsets + normals @ middle


def _different(normals: Array) -> Array:
    kept = np.empty_like(normals)
    count = 0
    for normal in normals:
        distances = np.max(np.abs(kept[:count] - normal), axis=1, initial=0.0)
        if not (distances < _SAME_NORMAL).any():
            kept[count] = normal
            count += 1
    return kept[:count]


def _fewer(normals: Array, offsets: Array, corners: Array, tolerance: float) -> tuple[Array, Array]:
    """Return planes of a polytope around the hull that no facet stands inside by the tolerance.

    Starts from the bounding box and adds the facet that each corner of the polytope violates
    most, until none is violated by more.
    """
    from scipy.spatial import HalfspaceIntersection

    inside = corners.mean(axis=0)
    chosen = np.concatenate([np.eye(3), -np.eye(3)])
    limits = np.max(corners @ chosen.T, axis=0)
    left = np.ones(len(normals), dtype=bool)
    while left.any():
        planes = np.column_stack([chosen, -limits])
        outer = HalfspaceIntersection(planes, inside).intersections
        excess = outer @ normals[left].T - offsets[left]
        worst = np.argmax(excess, axis=1)
        added = np.unique(worst[excess.max(axis=1) > tolerance])
        if not len(added):
            return chosen, limits
        added = np.flatnonzero(left)[added]
        chosen = np.concatenate([chosen, normals[added]])
        limits = np.concatenate([limits, offsets[added]])
        left[added] = False
    return normals, offsets
