"""The belief that links are nearly mirror images of each other: legs that were built alike."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.errors import DataError
from sdpid.estimation.constraints.condition import Layout
from sdpid.estimation.constraints.equalities import MirrorPair
from sdpid.estimation.prior.cost_terms import pullback_rows
from sdpid.robot.inertia import pseudo_inertia

# More pairs are not listed by name.
_MOST_NAMES = 4


def pairs_of(given: object) -> tuple[MirrorPair, ...]:
    """Return the pairs that are given: several, or one.

    Raises
    ------
    DataError
        For anything else, and for pairs that are given twice.
    """
    pairs = (given,) if isinstance(given, MirrorPair) or not isinstance(given, Iterable) else given
    found: list[MirrorPair] = []
    for each in pairs:
        if not isinstance(each, MirrorPair):
            raise DataError(
                f"Prior: alike holds {each!r:.80}; give MirrorPair objects, such as "
                "sdpid.constraints.mirror_pairs(robot)."
            )
        if any(_same(each, other) for other in found):
            raise DataError(
                f"Prior: alike holds '{each.first}' and '{each.second}' twice; give each pair once."
            )
        found.append(each)
    return tuple(found)


def _same(one: MirrorPair, other: MirrorPair) -> bool:
    """Whether two pairs say the same: of a plane's mirror either link may come first."""
    turned = (
        other if other.normal is None else replace(other, first=other.second, second=other.first)
    )
    return key_of_pairs([one]) in (key_of_pairs([other]), key_of_pairs([turned]))


def key_of_pairs(pairs: Sequence[MirrorPair]) -> str:
    """Return what is equal for pairs that say the same in the same words."""
    every = [
        [None if x is None else np.asarray(x).tolist() for x in vars(p).values()] for p in pairs
    ]
    return repr(every)


@dataclass(frozen=True, eq=False)
class Alike:
    """A link that is believed to be nearly the mirror image of another, in numbers.

    Attributes
    ----------
    first, second : int
        The links.
    rows : ndarray, shape (10, p)
        Their squared norm is ``‖L^(-1)·(P_2 − M·P_1·M^T)·L^(-T)‖²/within²``, twice the nats: M maps
        the first link's joint frame to the second's, L·L^T is the mean believed pseudo-inertia
        there, within the standard deviation of the difference, as a share of the body.
    """

    first: int
    second: int
    rows: Array

    @classmethod
    def of(cls, pair: MirrorPair, within: float, bodies: Array, layout: Layout) -> Alike:
        """Return the belief in a pair.

        Parameters
        ----------
        pair : MirrorPair
            The links.
        within : float
            Standard deviation of a difference.
        bodies : ndarray, shape (links, 10)
            The believed bodies.
        layout : Layout
            Where parameters are in theta.

        Raises
        ------
        ModelError
            When the robot has no such link.
        """
        difference = np.stack([row.coefficients for row in pair.compile(layout)])
        two = layout.link(pair.second)
        theta = np.zeros(layout.count)
        theta[: bodies.size] = bodies.ravel()
        # The image of the first is the second less the difference: their mean is a body, too.
        mean = pseudo_inertia(bodies[two] - 0.5 * (difference @ theta))
        rows = frozen(pullback_rows(mean) / within @ difference)
        return cls(first=layout.link(pair.first), second=two, rows=rows)


def described_pairs(pairs: Sequence[MirrorPair], within: float) -> str:
    """Return the belief in words."""
    named = [f"{pair.first} and {pair.second}" for pair in pairs[:_MOST_NAMES]]
    rest = len(pairs) - len(named)
    listed = ", ".join(named) + (f" and {rest} more pairs" if rest else "")
    return f"mirror images of each other within {100.0 * within:g} %: {listed}"
