"""How far two costs are from each other, for all parameters at once."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from sdpid._common.arrays import Array

# A, rhs and floor of a cost ‖A·base − rhs‖² + floor.
Cost: TypeAlias = tuple[Array, Array, float]

# Directions that the rows show less than this, in columns of size one, count as if they were shown
# that well: rounding alone would be larger than they are.
_WEAK = 1e-7

# No weighted row is larger, and squares of what is are no doubles.
_HUGE = 1e100


def distance(given: Cost, made: Cost) -> float:
    """Return by which share a cost differs from one that was made again, at most.

    Both are quadratic in (base, 1). The one that was made again is the squared length of some
    coordinates of these; in the same coordinates the difference is a symmetric matrix, whose
    spectral norm this is. It is scaled by what was made again: a forged cost has no say in it.

    Returns
    -------
    float
        Infinite where a number of the given cost is none, or no row's.
    """
    own, R = _triangle(given), _triangle(made)
    if own.shape != R.shape or not np.all(np.abs(own) < _HUGE):
        return np.inf
    size = np.linalg.norm(R, axis=0)
    size[size == 0.0] = 1.0
    _, values, axes = np.linalg.svd(R / size)
    values = np.maximum(values, max(_WEAK * values[0], np.finfo(float).tiny))
    coordinates = axes.T / values / size[:, None]
    one, two = own @ coordinates, R @ coordinates
    return float(np.linalg.norm(one.T @ one - two.T @ two, 2))


def _triangle(cost: Cost) -> Array:
    """Return the rows (b + 1, b + 1) whose product with (base, −1) has the cost as its square."""
    A, rhs, floor = cost
    rows = np.zeros((len(rhs) + 1, A.shape[1] + 1))
    rows[:-1, :-1], rows[:-1, -1], rows[-1, -1] = A, rhs, np.sqrt(floor)
    return rows
