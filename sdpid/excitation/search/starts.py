"""Motions within all limits from which a search begins."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.limits.joint_limits import JointLimits
from sdpid.excitation.search.linear import largest_step, linear_limits
from sdpid.excitation.search.space import Space

# A start uses this share of the way to the first limit: searches that begin at a limit are slow.
_SHARE = 0.6
# Shares of it that are tried until the other limits hold too.
_SHRINKS = 0.7 ** np.arange(40)
# Neighboring coefficients are averaged this often: accelerations would leave little room else.
_SMOOTHED = 2


def random_start(
    space: Space,
    linear: tuple[Any, Array, Array],
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
