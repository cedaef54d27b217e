"""Limits that are linear in the coefficients of a motion, and random motions within all limits."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, TypeAlias

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.limits.joint_limits import JointLimits
from sdpid.excitation.search.space import Space

# What a search keeps of a limit: the rest is for rounding in the check that follows.
_KEPT = 1.0 - 1e-7
# A row with entries below this is of a derivative that vanishes at an end.
_EMPTY = 1e-9
# A start uses this share of the way to the first limit: searches that begin at a limit are slow.
_SHARE = 0.6
# Shares of it that are tried until the other limits hold too.
_SHRINKS = 0.7 ** np.arange(40)
# Neighboring coefficients are averaged this often: accelerations would leave little room else.
_SMOOTHED = 2

# A sparse matrix A (R, N) and limits (R,) of the products ``A @ x`` with free numbers x.
Linear: TypeAlias = "tuple[Any, Array, Array]"


def linear_limits(space: Space, limits: JointLimits, start: Array | None = None) -> Linear:
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


def largest_step(linear: Linear, x: Array, direction: Array) -> float:
    """Return the longest way along a direction that keeps the limits, from x within them."""
    A, lower, upper = linear
    at, along = A @ x, A @ direction
    moved = np.abs(along) > _EMPTY * np.abs(along).max(initial=0.0)
    at, along, lower, upper = at[moved], along[moved], lower[moved], upper[moved]
    room = np.where(along > 0.0, upper - at, lower - at) / along
    return float(np.min(room, initial=np.inf))


def random_start(
    space: Space,
    linear: Linear,
    home: Array,
    rng: np.random.Generator,
    holds: Callable[[Array], bool],
) -> Array:
    """Return a random motion (N,) about a position at which the arm may stand still.

    Parameters
    ----------
    space : Space
        The motions.
    linear : tuple
        Matrix, lower and upper limits, as `linear_limits` returns them.
    home : ndarray, shape (n,)
        A position within all limits, at which the motion begins.
    rng : numpy.random.Generator
        The only source of randomness.
    holds : callable
        Whether a motion keeps all other limits.

    Returns
    -------
    ndarray, shape (N,)
        Standing still at home where nothing else holds.
    """
    still = space.standing(home)
    x = still.copy()
    for j in range(space.n):
        own = slice(space.splits[j], space.splits[j + 1])
        direction = np.zeros(space.size)
        drawn = rng.standard_normal(space.splits[j + 1] - space.splits[j])
        for _ in range(_SMOOTHED):
            drawn = 0.5 * (drawn + np.roll(drawn, 1))
        direction[own] = drawn
        # The start stays where it is: positions at the ends are those of home.
        ends = space.first @ space.expansions[j]
        direction[own] -= ends * (ends @ drawn) / (ends @ ends)
        x += _SHARE * min(largest_step(linear, still, direction), 1e3) * direction
    for shrink in _SHRINKS:
        candidate = still + shrink * (x - still)
        if holds(candidate):
            return np.asarray(candidate)
    return still


def usual_states(
    space: Space,
    limits: JointLimits,
    homes: Iterable[Array],
    rng: np.random.Generator,
    holds: Callable[[Array], bool] = lambda x: True,
    start: Array | None = None,
) -> tuple[Array, Array, Array]:
    """Return positions, rates and accelerations (K, n) of random motions within the limits."""
    linear = linear_limits(space, limits, start)
    drawn = [space.coefficients(random_start(space, linear, home, rng, holds)) for home in homes]
    bases = (space.basis(space.grid(), order) for order in range(3))
    q, v, a = (np.concatenate([basis @ c for c in drawn]) for basis in bases)
    return q, v, a
