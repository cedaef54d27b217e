"""Convex hulls as linear inequalities."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError

# Facets whose unit normals differ by less are one: Qhull cuts flat faces into triangles whose
# normals agree to rounding, divided by the triangles' slenderness.
_SAME_NORMAL = 1e-7

# Points flatter than this share of their extent have no volume that rounding leaves meaningful.
_FLAT = 1e-6


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
            f"{size * extents[2]:.2g} m across, at least {_FLAT:g} of {size * extents[0]:.2g} m is "
            "needed), so their hull has no volume; give points with a volume."
        )
    try:
        hull = ConvexHull(scaled)
    except QhullError as cause:
        reason = str(cause).strip().splitlines()[0]
        raise DataError(f"{what}: the points have no convex hull ({reason}).") from None
    corners = scaled[hull.vertices]
    normals = _different(hull.equations[:, :3])
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
