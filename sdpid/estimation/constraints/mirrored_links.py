"""Find the links of a robot that are mirror images of each other: left and right legs."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array
from sdpid.errors import DataError, ModelError
from sdpid.estimation.constraints.equalities import MirrorPair, unit_normal
from sdpid.robot.model.geometry import link_placements
from sdpid.robot.model.model import RobotModel

# Descriptions are written with four digits or more; another joint's zero is off by much more.
_OFF_PLACE = 2e-3
# Words of two letters that name a leg: front, fore, hind, rear, back, middle, and a side.
_LEGS = "fhrbm"


def mirror_pairs(
    robot: RobotModel,
    pairs: Iterable[Sequence[str]] | None = None,
    *,
    normal: ArrayLike = (0.0, 1.0, 0.0),
    position: ArrayLike | None = None,
) -> tuple[MirrorPair, ...]:
    """Return the conditions that a robot's right links are mirror images of its left ones.

    A gait on level ground shows little of each leg; legs that were built alike say more together.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    pairs : iterable of (str, str), optional
        Names of links, left and right. By default those whose names differ in one word that names
        a side: ``left`` and ``right``, ``l`` and ``r``, ``FL`` and ``FR``, ``LF`` and ``RF``, and
        so with H, R, B and M for F.
    normal : (3,) array_like, optional
        Normal of the plane in the base link's frame.
    position : (n,) or (nq,) array_like, optional
        Joint positions at which left and right are mirror images; by default all zero.

    Returns
    -------
    tuple of MirrorPair
        For ``sdpid.Constraints(others=...)``.

    Raises
    ------
    DataError
        When no names differ by a side, pairs are none or given twice, or the normal is no
        direction.
    ModelError
        When joints of a pair do not lie as mirror images of each other.

    Examples
    --------
    >>> floating = sdpid.load_robot("solo12", root="free_flyer")
    >>> legs = sdpid.constraints.mirror_pairs(floating)
    >>> len(legs), (legs[0].first, legs[0].second)
    (6, ('FL_SHOULDER', 'FR_SHOULDER'))
    >>> limits = sdpid.Constraints.of_size(floating, others=legs)
    """
    found = pairs_of_names("mirror_pairs", robot.name, "link", robot.link_names, pairs)
    plane = unit_normal(normal, "mirror_pairs")
    placements = link_placements(robot, None if position is None else np.asarray(position))
    for first, second in found:
        check_places("mirror_pairs", robot, placements, plane, first, second)
    return tuple(
        MirrorPair(first, second, normal=normal, position=position) for first, second in found
    )


def pairs_of_names(
    asked: str,
    robot: str,
    kind: str,
    names: Sequence[str],
    pairs: Iterable[Sequence[str]] | None,
) -> tuple[tuple[str, str], ...]:
    """Return pairs of links or joints, left first: those that are given, or by their names.

    Parameters
    ----------
    asked, robot, kind : str
        Who asks, the robot's name, and what the names are of, for messages.
    names : sequence of str
        What there is.
    pairs : iterable of (str, str), optional
        What is given.

    Raises
    ------
    DataError
        When no names differ by a side, or what is given are no pairs, none, or one twice.
    ModelError
        When a name is unknown.
    """
    if pairs is None:
        found = tuple(_by_names(names))
        if not found:
            raise DataError(
                f"{asked}: no two {kind}s of '{robot}' ({', '.join(names)}) differ in a word for "
                "a side, such as left and right or FL and FR; give pairs=[(left, right)]."
            )
        return found
    given = tuple(_pairs(asked, kind, pairs))
    unknown = [name for pair in given for name in pair if name not in names]
    if unknown:
        raise ModelError(
            f"{asked}: '{robot}' has no {kind} {', '.join(unknown)}; it has {', '.join(names)}."
        )
    return given


def _pairs(asked: str, kind: str, pairs: object) -> Iterator[tuple[str, str]]:
    """Yield pairs of different names, each once, whichever comes first in it."""
    remedy = f"give pairs=[(left, right), ...] with names of {kind}s, or leave it out"
    if isinstance(pairs, str) or not isinstance(pairs, Iterable):
        raise DataError(f"{asked}: pairs is {pairs!r:.80}; {remedy}.")
    seen: set[frozenset[str]] = set()
    for pair in pairs:
        names = tuple(pair) if isinstance(pair, Iterable) and not isinstance(pair, str) else ()
        if len(names) != 2 or not all(isinstance(name, str) for name in names):
            raise DataError(f"{asked}: pairs holds {pair!r:.80}; {remedy}.")
        if names[0] == names[1]:
            raise DataError(f"{asked}: pairs holds '{names[0]}' twice in a pair; {remedy}.")
        if frozenset(names) in seen:
            raise DataError(
                f"{asked}: the pair of '{names[0]}' and '{names[1]}' is given twice; give each "
                "pair once."
            )
        seen.add(frozenset(names))
        yield names[0], names[1]
    if not seen:
        raise DataError(f"{asked}: pairs is empty; {remedy}.")


def _by_names(names: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield pairs of names that differ in one word for a side, left first."""
    for name in names:
        words = re.split(r"([_\-./ ]|(?<=[a-z])(?=[A-Z]))", name)
        for i, word in enumerate(words):
            for other in _other_side(word):
                image = "".join([*words[:i], other, *words[i + 1 :]])
                if image in names:
                    yield name, image


def _other_side(word: str) -> Iterator[str]:
    """Yield what a word for the left would be on the right, in its letters."""
    small = word.lower()
    if small == "left":
        other = "right"
    elif small == "l":
        other = "r"
    elif len(small) == 2 and small[1] == "l" and small[0] in _LEGS:
        other = small[0] + "r"
    elif len(small) == 2 and small[0] == "l" and small[1] in _LEGS:
        other = "r" + small[1]
    else:
        return
    if word.isupper():
        yield other.upper()
    elif word[0].isupper():
        yield other.capitalize()
    else:
        yield other


def check_places(
    asked: str, robot: RobotModel, placements: Array, plane: Array, first: str, second: str
) -> None:
    """Raise when the joint of one link does not lie where that of the other is mirrored to."""
    one, two = (placements[robot.link_names.index(name)][:3, 3] for name in (first, second))
    image = one - 2.0 * (plane @ one) * plane
    off = float(np.linalg.norm(image - two))
    if off > _OFF_PLACE:
        raise ModelError(
            f"{asked}: the mirror image of the joint of '{first}' is {off:.3g} m away from "
            f"that of '{second}', limit {_OFF_PLACE:g} m; give the joint positions at which the "
            "two sides are mirror images (position=), other pairs, or another normal."
        )
