"""Proofs that two bodies never come near each other within the limits of the joints."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sdpid._common.arrays import Array


def proven_apart(
    distance: Callable[[Array], Array],
    reach: Array,
    lower: Array,
    upper: Array,
    wanted: float,
    *,
    most: int,
) -> int | None:
    """Return how many distances prove that a distance is never below a wanted one.

    The box of positions is cut in half, where the joint moves the bodies most, until the distance
    in the middle of every part exceeds the wanted one by what the reach allows within the part.

    Parameters
    ----------
    distance : callable
        Distances (K,) at positions (K, n), m; less than they are by their error.
    reach : ndarray, shape (n,)
        Bounds on the derivatives of the distance, m/rad or m/m.
    lower, upper : ndarray, shape (n,)
        Limits of the positions.
    wanted : float
        m.
    most : int
        Give up after this many distances.

    Returns
    -------
    int or None
        None where it is not so, or not found to be so.
    """
    moved = (reach > 0.0) & (upper > lower)
    if not np.isfinite([reach[moved], lower[moved], upper[moved]]).all():
        return None
    still = np.where(np.isfinite(lower), lower, 0.0)
    lower, upper = (np.where(moved, bound, still) for bound in (lower, upper))
    middle, half = 0.5 * (lower + upper)[None], 0.5 * (upper - lower)[None]
    count = 0
    while len(middle):
        count += len(middle)
        if count > most:
            return None
        slack = distance(middle) - wanted
        if (slack < 0.0).any():
            return None
        open_ = slack < half @ np.where(moved, reach, 0.0)
        middle, half = middle[open_], half[open_].copy()
        if not len(middle):
            break
        rows, joint = np.arange(len(middle)), np.argmax(half * reach, axis=1)
        half[rows, joint] *= 0.5
        step = np.zeros_like(half)
        step[rows, joint] = half[rows, joint]
        middle, half = np.concatenate([middle - step, middle + step]), np.tile(half, (2, 1))
    return count
