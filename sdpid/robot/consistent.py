"""The one way to make a body physically consistent: raise its moments about the center of mass."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array
from sdpid.robot.inertia import (
    Consistency,
    central_moments,
    margin,
    theta_from_central_moments,
)

_EPS = float(np.finfo(np.float64).eps)

# Rounding is lifted by one bit of the largest entry, then by twice that, and so on: after this
# many doublings by 1e-7 of it, which is not rounding.
_DOUBLINGS = 30

# A second moment of t in all directions is a rotational inertia of 2·t.
_INERTIA_PER_MOMENT = {"pseudo_inertia": 2.0, "spatial_inertia": 1.0, "none": 1.0}


def raise_eigenvalues(
    matrices: ArrayLike, least: ArrayLike, most: ArrayLike | None = None
) -> Array:
    """Return the nearest symmetric matrices whose eigenvalues are between `least` and `most`.

    Nearest is meant in the Frobenius norm; the proof stands in
    `sdpid.assurance.descriptions.nearest_body`. Matrices that satisfy the limits are returned to
    the bit.

    Parameters
    ----------
    matrices : array_like, shape (..., s, s)
        Symmetric and finite.
    least : array_like, shape (...,)
        Least eigenvalue of each matrix.
    most : array_like, shape (...,), optional
        Largest eigenvalue of each matrix.

    Returns
    -------
    ndarray, shape (..., s, s)
    """
    matrices = np.asarray(matrices, dtype=np.float64)
    values, vectors = np.linalg.eigh(matrices)
    limits = np.asarray(least, dtype=np.float64)[..., None]
    raised = np.maximum(values, limits)
    if most is not None:
        raised = np.minimum(raised, np.asarray(most, dtype=np.float64)[..., None])
    nearest = (vectors * raised[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    nearest = 0.5 * (nearest + np.swapaxes(nearest, -1, -2))
    changed = np.any(raised != values, axis=-1)
    return np.where(changed[..., None, None], nearest, matrices)


def raise_second_moments(
    bodies: ArrayLike,
    least: ArrayLike = 0.0,
    *,
    most: ArrayLike | None = None,
    consistency: Consistency = "pseudo_inertia",
    holds: Callable[[Array], bool] | None = None,
) -> Array:
    """Return the nearest bodies whose moments about the center of mass are at least `least`.

    Masses and centers of mass stay. Nearest is meant in the Frobenius norm of those moments.
    Where rounding leaves a margin short, the moments are lifted in all directions by the few bits
    that are missing. Bodies that satisfy the limits are returned to the bit, and so are bodies
    without a positive mass, which no moments make consistent.

    Parameters
    ----------
    bodies : array_like, shape (..., 10)
        Inertial parameters, finite.
    least : array_like, shape (...,), optional
        The margin that each body gets at least, kg·m² (see `sdpid.robot.inertia.margin`).
    most : array_like, shape (...,), optional
        Largest eigenvalue of the moments, kg·m².
    consistency : {"pseudo_inertia", "spatial_inertia", "none"}, optional
        Which moments: second moments, or (the others) the rotational inertia.
    holds : callable, optional
        Decides for a body (10,) whether its margin is sufficient; by default its margin in
        floating-point arithmetic. An exact test makes the result exact.

    Returns
    -------
    ndarray, shape (..., 10)
    """
    bodies = np.array(bodies, dtype=np.float64)
    least = np.broadcast_to(np.asarray(least, dtype=np.float64), bodies.shape[:-1])
    mass, com, moments = central_moments(bodies, consistency)
    positive = mass > 0.0
    moments = np.where(positive[..., None, None], moments, np.eye(3))
    raised = raise_eigenvalues(moments, least, most)
    changed = positive & np.any(raised != moments, axis=(-1, -2))
    moved = theta_from_central_moments(mass, com, raised, consistency)
    moved[..., :4] = bodies[..., :4]  # to the bit
    out = np.where(changed[..., None], moved, bodies)
    unsure = positive if holds is not None else positive & (margin(out, consistency) < least)
    for index in zip(*np.nonzero(np.atleast_1d(unsure)), strict=True):
        at = index if bodies.ndim > 1 else ()
        out[at] = _lifted(out[at], float(least[at]), consistency, holds)
    return out


def _lifted(
    body: Array, least: float, consistency: Consistency, holds: Callable[[Array], bool] | None
) -> Array:
    """Return a body with the margin that rounding took, or as it is where more is missing."""
    bit = _INERTIA_PER_MOMENT[consistency] * _EPS * float(np.max(np.abs(body)))
    for step in (0.0, *(bit * 2.0**doubling for doubling in range(_DOUBLINGS))):
        trial = body.copy()
        trial[[4, 6, 9]] += step
        if holds(trial) if holds is not None else bool(margin(trial, consistency) >= least):
            return trial
    return body
