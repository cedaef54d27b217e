"""Changes of a body in the log-Cholesky form of the pseudo-inertia [rucker2022]_.

A change moves every point x of a body to ``A·x + t``, A upper triangular, and scales its density:

    J' = U·J·U^T,   U = exp(alpha)·[[exp(d1), s12, s13, t1],
                                    [0, exp(d2), s23, t2],
                                    [0, 0, exp(d3), t3],
                                    [0, 0, 0, 1]].

The mass is scaled by exp(2·alpha), and where A is the identity the center of mass moves by t. Any
ten numbers make a consistent body of a consistent one, and between two bodies of positive
definite pseudo-inertia there is one change. mjlab's ``dr.pseudo_inertia`` randomizes these numbers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array
from sdpid.robot.inertia import from_pseudo_inertia, pseudo_inertia

# In the order of every array here; t in m, the others without unit.
NAMES = ("alpha", "d1", "d2", "d3", "s12", "s13", "s23", "t1", "t2", "t3")

# Places in U of all but alpha, in that order.
_ROWS, _COLUMNS = np.array([0, 1, 2, 0, 0, 1, 0, 1, 2]), np.array([0, 1, 2, 1, 2, 2, 3, 3, 3])


def changes(bodies: ArrayLike, reference: ArrayLike) -> Array:
    """Return the change from a reference to each body, (..., 10) in the order of `NAMES`.

    Parameters
    ----------
    bodies, reference : array_like, shape (..., 10)
        Parameters about the same frame, which the change is relative to.

    Raises
    ------
    numpy.linalg.LinAlgError
        When one of them has no positive definite pseudo-inertia.
    """
    U = _upper(pseudo_inertia(bodies)) @ np.linalg.inv(_upper(pseudo_inertia(reference)))
    scale = U[..., 3, 3]
    entries = U[..., _ROWS, _COLUMNS] / scale[..., None]
    diagonal = np.log(np.concatenate([scale[..., None], entries[..., :3]], axis=-1))
    return np.concatenate([diagonal, entries[..., 3:]], axis=-1)


def changed(reference: ArrayLike, change: ArrayLike) -> Array:
    """Return the body that a change (..., 10) makes of a reference (..., 10)."""
    change = np.asarray(change, dtype=np.float64)
    U = np.zeros((*change.shape[:-1], 4, 4))
    U[..., _ROWS, _COLUMNS] = np.concatenate([np.exp(change[..., 1:4]), change[..., 4:]], axis=-1)
    U[..., 3, 3] = 1.0
    U *= np.exp(change[..., 0])[..., None, None]
    return from_pseudo_inertia(U @ pseudo_inertia(reference) @ np.swapaxes(U, -1, -2))


def _upper(matrix: Array) -> Array:
    """Return the upper triangular V, its diagonal positive, with V·V^T = matrix."""
    # The lower factor seen from the other corner.
    flipped = np.linalg.cholesky(matrix[..., ::-1, ::-1])
    return np.asarray(flipped[..., ::-1, ::-1])
