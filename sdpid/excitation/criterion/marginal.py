"""Information of some parameters where others are unknown."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array, Mask

# Directions whose information is this small, beside the largest, have none: rounding.
_OPEN = 1e-12


def marginal(information: Array, kept: Mask) -> Array:
    """Return the information (k, k) of some parameters where the others are unknown.

    Parameters
    ----------
    information : ndarray, shape (c, c)
        Of all, positive semidefinite.
    kept : ndarray of bool, shape (c,)
        Which k of them.
    """
    if kept.all():
        return information
    cross = information[np.ix_(kept, ~kept)]
    other = information[np.ix_(~kept, ~kept)]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(other), np.finfo(float).tiny))
    solved = (cross * scale) @ inverse(other * np.outer(scale, scale)) @ (cross * scale).T
    out = information[np.ix_(kept, kept)] - solved
    return np.asarray(0.5 * (out + out.T))


def inverse(matrix: Array) -> Array:
    """Return the inverse of a symmetric matrix, its diagonal of order one, where it is not zero."""
    values, vectors = np.linalg.eigh(matrix)
    kept = values > _OPEN * max(float(values[-1]), 0.0)
    return np.asarray((vectors[:, kept] / values[kept]) @ vectors[:, kept].T)
