"""Limits that are linear in the coefficients of a motion, and hold at every instant."""

from __future__ import annotations

from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.limits.joint_limits import JointLimits
from sdpid.excitation.search.space import Space

# What a search keeps of a limit: the rest is for rounding in the check that follows.
_KEPT = 1.0 - 1e-7
# A row with entries below this is of a derivative that vanishes at an end.
_EMPTY = 1e-9


def linear_limits(
    space: Space, limits: JointLimits, start: Array | None = None
) -> tuple[Any, Array, Array]:
    """Return rows A (R, N) and limits with which ``lower <= A @ x <= upper`` is sufficient.

    Positions, speeds, accelerations and jerks of the motion are then within their limits at every
    instant, and the motion begins at `start` (n,), where that is given.

    Returns
    -------
    scipy.sparse.csr_array, shape (R, N)
    lower, upper : ndarray, shape (R,)
    """
    from scipy.sparse import block_diag, csr_array

    symmetric = [limits.velocity, limits.acceleration, limits.jerk]
    ranges = [np.stack([limits.lower, limits.upper])] + [np.stack([-r, r]) for r in symmetric]
    bounds = [space.bounds(order) for order in range(len(ranges))]
    blocks, lower, upper = [], [], []
    for j, E in enumerate(space.expansions):
        own = []
        for (rows, share), (low, high) in zip(bounds, ranges, strict=True):
            if not (np.isfinite(low[j]) or np.isfinite(high[j])):
                continue
            matrix = rows @ E
            matrix = matrix[np.abs(matrix).max(axis=1) > _EMPTY]
            own.append(np.where(np.abs(matrix) > _EMPTY * np.abs(matrix).max(), matrix, 0.0))
            mean, half = _middle(low[j], high[j])
            lower.append(np.full(len(matrix), mean - _KEPT * share * half))
            upper.append(np.full(len(matrix), mean + _KEPT * share * half))
        if start is not None:
            own.append(space.basis(np.zeros(1), 0) @ E)
            lower.append(start[j : j + 1])
            upper.append(start[j : j + 1])
        blocks.append(csr_array(np.vstack([np.zeros((0, E.shape[1])), *own])))
    return csr_array(block_diag(blocks)), np.concatenate(lower), np.concatenate(upper)


def _middle(low: float, high: float) -> tuple[float, float]:
    """Return the middle of a range and half its width, about the finite end of a half-open one."""
    if np.isfinite(low) and np.isfinite(high):
        return 0.5 * (low + high), 0.5 * (high - low)
    return (float(low), np.inf) if np.isfinite(low) else (float(high), np.inf)


def largest_step(linear: tuple[Any, Array, Array], x: Array, direction: Array) -> float:
    """Return the longest way along a direction that keeps the limits, from x within them."""
    A, lower, upper = linear
    at, along = A @ x, A @ direction
    moved = np.abs(along) > _EMPTY * np.abs(along).max(initial=0.0)
    at, along, lower, upper = at[moved], along[moved], lower[moved], upper[moved]
    room = np.where(along > 0.0, upper - at, lower - at) / along
    return float(np.min(room, initial=np.inf))
