"""Inertia ellipsoids: uniform solids with a body's mass, center of mass and inertia.

A uniform solid ellipsoid of mass m has the second-moment matrix ``m/5·A·A^T`` about its center,
where the columns of A are its semi-axes. So the semi-axes of the ellipsoid of a body are the
eigenvectors of its second-moment matrix, of lengths ``sqrt(5·λ/m)``; it exists exactly for bodies
that are physically consistent. Of a plate or a rod one or two lengths are zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen
from sdpid.robot.inertia import physical_parameters, second_moment_from_inertia

# Second moments negative by less than this share of the body's largest about its frame's origin
# are zero: the shift to the center of mass cancels, and solvers end as near to a boundary.
_ZERO = 1e-9


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """A solid ellipsoid.

    Attributes
    ----------
    center : ndarray, shape (3,)
        In the body's frame, m.
    rotation : ndarray, shape (3, 3)
        Directions of the semi-axes as columns.
    lengths : ndarray, shape (3,)
        Of the semi-axes, m, from the shortest.
    """

    center: Array
    rotation: Array
    lengths: Array

    @property
    def axes(self) -> Array:
        """The semi-axes as columns, shape (3, 3), m."""
        return np.asarray(self.rotation * self.lengths)


def inertia_ellipsoid(body: ArrayLike) -> Ellipsoid | None:
    """Return the uniform ellipsoid of a body's inertia; None for one that cannot exist.

    Parameters
    ----------
    body : array_like, shape (10,)
        Inertial parameters in the order of `sdpid.robot.inertia`.
    """
    theta = np.asarray(body, dtype=np.float64)
    if not np.isfinite(theta).all() or theta[0] <= 0.0:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        mass, center, inertia = physical_parameters(theta)
        moments = second_moment_from_inertia(inertia)
        largest = float(np.abs(moments).max() + mass * center @ center)
    if not np.isfinite(largest):
        return None
    values, axes = np.linalg.eigh(moments)
    if values[0] < -_ZERO * largest:
        return None
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    with np.errstate(over="ignore"):
        lengths = np.sqrt(5.0 * (np.maximum(values, 0.0) / mass))
    if not np.isfinite(lengths).all():
        return None
    return Ellipsoid(frozen(center), frozen(axes), frozen(lengths))
