"""What is wrong with a sensor on a base: found one mistake after another, with its turn.

Sums of a sensor's columns depend on how it is turned; a turn is found by linearizing them anew.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.inspection.places.block_fit import BlockFit, BlockSums, sure_part

# What explains this share of what the best does is named beside it: a level base does not tell an
# axis that is tilted from a bias.
_RIVAL = 0.5
# Turns are linearized anew so often.
_ROUNDS = 5
# A turn far from what was stated has to leave less than this of what one nearby leaves.
_CLEARLY = 0.8
# Of what explains as much, the first is taken.
_ORDER_OF_BLAME = ("place", "bias", "scale", "axes")


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """Something that is wrong with a sensor.

    Attributes
    ----------
    value : ndarray, shape (3,) or (1,)
        The change from what was stated to what the data show, in the base's axes: m of a place,
        m/s² or rad/s of a bias (what is sensed too much), 1 of a scale (likewise), rad of a turn.
    error : float
        Standard error of it, that of its least certain direction.
    rivals : tuple of str
        What would explain as much in place of it.
    """

    value: Array
    error: float
    rivals: tuple[str, ...] = ()


def searched(
    sums: Callable[[Array], BlockSums],
    groups: Mapping[str, tuple[int, ...]],
    sizes: Mapping[str, float],
    reference: Array,
    start: Array,
) -> tuple[dict[str, Found], Array, float]:
    """Return what is wrong, one after another, the sensor's turn, and what is left.

    What explains most comes first: one mistake leaks into all others until it is known.
    """
    turn, now = reference, sums(reference)
    rivals: dict[str, tuple[str, ...]] = {}

    def fit(names: Iterable[str], own: BlockSums) -> BlockFit:
        return own.fit([i for name in ("late", *names) for i in groups[name]])

    while True:
        before = fit(rivals, now).left
        drops = {}
        for name in _ORDER_OF_BLAME:
            if name in groups and name not in rivals:
                tried = fit((*rivals, name), now)
                if sure_part(*tried.of(groups[name]), sizes[name]) is not None:
                    drops[name] = before**2 - tried.left**2
        if not drops:
            break
        likely = [name for name in drops if drops[name] >= _RIVAL * max(drops.values())]
        rivals[likely[0]] = tuple(likely[1:])
        if "axes" in rivals:
            # Anew with whatever came later: all of them are found together.
            first = likely[0] == "axes"
            starts = (reference, start) if first else (turn, turn)
            turn, now = _turned(sums, groups, tuple(rivals), starts)
    last = fit(rivals, now)
    found = {}
    for name, others in rivals.items():
        value, covariance = last.of(groups[name])
        if name == "axes":
            value = value + _rotation_vector(turn @ reference.T)
        sure = sure_part(value, covariance, sizes[name])
        if sure is not None:
            found[name] = Found(value=sure[0], error=sure[1], rivals=others)
    return found, turn if "axes" in found else reference, last.left


def _turned(
    sums: Callable[[Array], BlockSums],
    groups: Mapping[str, tuple[int, ...]],
    chosen: tuple[str, ...],
    starts: tuple[Array, ...],
) -> tuple[Array, BlockSums]:
    """Return the turn that fits best, linearized anew until it stays."""
    columns = [i for name in ("late", *chosen) for i in groups[name]]
    ends = []
    for turn in starts:
        for _ in range(_ROUNDS):
            own = sums(turn)
            turn = _rotation(own.fit(columns).of(groups["axes"])[0]) @ turn
        own = sums(turn)
        ends.append((own.fit(columns).left, turn, own))
    # Where few axes turn, others fit as well that are far from what was stated.
    near, far = ends
    return far[1:] if far[0] < _CLEARLY * near[0] else near[1:]


def nearest_turn(wanted: Array, given: Array, *, proper: bool) -> Array:
    """Return the orthogonal matrix that turns vectors (K, 3) best into others [schonemann1966]_.

    Of determinant 1 where it shall be `proper`: a rotation.
    """
    left, _, right = np.linalg.svd(wanted.T @ given)
    if proper and np.linalg.det(left @ right) < 0.0:
        left[:, 2] *= -1.0
    return np.asarray(left @ right)


def _rotation(vector: Array) -> Array:
    """Return the matrix of a rotation vector."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def _rotation_vector(matrix: Array) -> Array:
    """Return the rotation vector of a matrix."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(matrix).as_rotvec())
