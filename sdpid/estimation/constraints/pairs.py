"""Links and drives of a robot's left and right that were built alike."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen, is_number
from sdpid.errors import DataError, ModelError
from sdpid.estimation.constraints.condition import Condition, Layout, Row
from sdpid.estimation.constraints.equalities import MirrorPair, unit_normal
from sdpid.robot.model.geometry import link_placements, neutral
from sdpid.robot.model.jacobians import link_jacobians
from sdpid.robot.model.model import RobotModel

# Descriptions are written with four digits or more; another joint's zero is off by much more.
_OFF_PLACE = 2e-3

# Words for the left, and for the right: sides, and legs by two letters (front, fore, hind, rear,
# back, middle, and a side).
_SIDES = {"left": "right", "l": "r"}
_SIDES |= {f"{leg}l": f"{leg}r" for leg in "fhrbm"} | {f"l{leg}": f"r{leg}" for leg in "fhrbm"}

# What friction forward of one joint is of its mirror image where that turns the other way.
_TURNED = {"Fsp": "Fsn", "Fsn": "Fsp"}


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
    return tuple(
        MirrorPair(first, second, normal=normal, position=position)
        for first, second in _placed_pairs("mirror_pairs", robot, pairs, normal, position)
    )


@dataclass(frozen=True)
class EqualFriction(Condition):
    """Two joints have the same friction and rotor inertia, or the same within a share.

    It is about parameters that cannot be negative: Coulomb friction, viscous friction, rotor
    inertia and the like. Offsets are those of sensors and are left alone.

    Attributes
    ----------
    first, second : str
        The joints.
    within : float
        By how much each parameter of the two may differ, as a share of their mean; 0 for equal
        ones, less than 2.
    opposite : bool
        Whether forward of one joint is backward of the other, so that friction forward of one is
        that backward of the other.

    Examples
    --------
    >>> alike = sdpid.constraints.EqualFriction("joint_5", "joint_6")
    >>> limits = sdpid.Constraints(others=(alike,))
    >>> found = sdpid.solve_sdp(problem.constrained(constraints=limits)).named_theta()
    >>> bool(np.isclose(found["Fv5"], found["Fv6"], atol=1e-6))
    True
    """

    first: str
    second: str
    _: KW_ONLY
    within: float = 0.0
    opposite: bool = False

    def __post_init__(self) -> None:
        what = f"EqualFriction of '{self.first}' and '{self.second}'"
        if self.first == self.second:
            raise DataError(f"{what}: name two joints.")
        if not (is_number(self.within) and 0.0 <= self.within < 2.0):
            raise DataError(
                f"{what}: within is {self.within!r}; give a share of the mean from 0 to less than "
                "2."
            )

    def compile(self, layout: Layout) -> Iterator[Row]:
        """Return an equation a parameter, or two inequalities where they may differ."""
        own = _of_joint(layout, self.first)
        for name, index in _of_joint(layout, self.second).items():
            other = own.get(_TURNED.get(name, name) if self.opposite else name)
            if other is None:
                continue
            pair = np.zeros(layout.count)
            pair[index], pair[other] = 1.0, -1.0
            says = f"{layout.names[index]} of {self.second}"
            if self.within == 0.0:
                yield Row(f"{says} equal to that of {self.first}", frozen(pair), 0.0, 0.0)
                continue
            # |a − b| ≤ within·(a + b)/2 is a condition on parameters that are not negative.
            mean = 0.5 * self.within * np.abs(pair)
            share = f"{100.0 * self.within:g} % of that of {self.first}"
            yield Row(f"{says} below by at most {share}", frozen(mean + pair), 0.0, np.inf)
            yield Row(f"{says} above by at most {share}", frozen(mean - pair), 0.0, np.inf)


def equal_friction(
    robot: RobotModel,
    pairs: Iterable[Sequence[str]] | None = None,
    *,
    within: float = 0.0,
    normal: ArrayLike = (0.0, 1.0, 0.0),
    position: ArrayLike | None = None,
) -> tuple[EqualFriction, ...]:
    """Return the conditions that joints on a robot's right have the friction of those on its left.

    Drives of one kind are alike within some ten per cent; a motion that shows one joint well and
    another hardly then says something of both.

    Parameters
    ----------
    robot : RobotModel
        The robot.
    pairs : iterable of (str, str), optional
        Names of joints, left and right. By default those whose names differ in one word that names
        a side, as links do for `mirror_pairs`.
    within : float, optional
        By how much parameters of a pair may differ, as a share of their mean; 0 for equal ones.
    normal : (3,) array_like, optional
        Normal of the plane between left and right in the base link's frame.
    position : (n,) or (nq,) array_like, optional
        Joint positions at which left and right are mirror images; by default all zero.

    Returns
    -------
    tuple of EqualFriction
        For ``sdpid.Constraints(others=...)``.

    Raises
    ------
    DataError
        When no names differ by a side, pairs are none or given twice, the normal is no direction,
        or the share is none.
    ModelError
        When a joint is unknown, or joints of a pair do not lie as mirror images of each other.

    Examples
    --------
    >>> floating = sdpid.load_robot("solo12", root="free_flyer")
    >>> drives = sdpid.constraints.equal_friction(floating, within=0.2)
    >>> len(drives), (drives[0].first, drives[0].second)
    (6, ('FL_HAA', 'FR_HAA'))
    >>> limits = sdpid.Constraints.of_size(floating, others=drives)
    """
    joints = robot.joint_names[robot.n_base :]
    found = _placed_pairs("equal_friction", robot, pairs, normal, position, joints)
    plane, placements = unit_normal(normal, "equal_friction"), link_placements(robot, position)
    mirror = np.eye(3) - 2.0 * np.outer(plane, plane)
    out = []
    for pair in found:
        (turn, slide), (own_turn, own_slide) = (
            _rates(robot, placements, position, joint) for joint in pair
        )
        # A mirror turns the sense of rotations about what it keeps, not of translations.
        way = float(own_slide @ mirror @ slide) - float(own_turn @ mirror @ turn)
        out.append(EqualFriction(*pair, within=within, opposite=way < 0.0))
    return tuple(out)


def _placed_pairs(
    asked: str,
    robot: RobotModel,
    pairs: Iterable[Sequence[str]] | None,
    normal: ArrayLike,
    position: ArrayLike | None,
    joints: Sequence[str] | None = None,
) -> tuple[tuple[str, str], ...]:
    """Return pairs of links, or of joints where these are given, whose places are mirror images.

    Left first: those that are given, or by their names.
    """
    kind, names = ("link", robot.link_names) if joints is None else ("joint", joints)
    found = tuple(_by_names(names) if pairs is None else _pairs(asked, kind, pairs))
    if not found:
        raise DataError(
            f"{asked}: no two {kind}s of '{robot.name}' ({', '.join(names)}) differ in a word for "
            "a side, such as left and right or FL and FR; give pairs=[(left, right)]."
        )
    unknown = [name for pair in found for name in pair if name not in names]
    if unknown:
        raise ModelError(
            f"{asked}: '{robot.name}' has no {kind} {', '.join(unknown)}; it has "
            f"{', '.join(names)}."
        )
    plane, places = unit_normal(normal, asked), link_placements(robot, position)[:, :3, 3]
    for pair in found:
        links = [names.index(x) if joints is None else _link(robot, x) for x in pair]
        first, second = (robot.link_names[link] for link in links)
        one, two = places[links]
        off = float(np.linalg.norm(one - 2.0 * (plane @ one) * plane - two))
        if off > _OFF_PLACE:
            raise ModelError(
                f"{asked}: the mirror image of the joint of '{first}' is {off:.3g} m away from "
                f"that of '{second}', limit {_OFF_PLACE:g} m; give the joint positions at which "
                "the two sides are mirror images (position=), other pairs, or another normal."
            )
    return found


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
            other = _SIDES.get(word.lower(), "")
            other = other.upper() if word.isupper() else other
            other = other.capitalize() if word[:1].isupper() and not word.isupper() else other
            image = "".join([*words[:i], other, *words[i + 1 :]])
            if other and image in names:
                yield name, image


def _of_joint(layout: Layout, joint: str) -> dict[str, int]:
    """Return where a joint's own parameters that are not negative are in theta, by their letters.

    Raises
    ------
    ModelError
        When the robot has no such joint.
    """
    names = layout.friction.joint_names
    if joint not in names:
        raise ModelError(
            f"EqualFriction: '{layout.robot.name}' has no joint '{joint}'; it has "
            f"{', '.join(names)}."
        )
    j, first = names.index(joint), 10 * layout.robot.n_links
    found = {}
    for k, parameter in enumerate(layout.friction.parameters, first):
        # Those of couplings have the numbers of two joints.
        own = re.fullmatch(rf"([A-Za-z]+){j + 1}", parameter.name)
        if own is not None and parameter.nonnegative:
            found[own[1]] = k
    return found


def _link(robot: RobotModel, joint: str) -> int:
    """Return the link that a joint moves, or the one that a motor moves most."""
    seat, moved = robot.seat(joint)[0], robot.expansion[:, robot.joint_names.index(joint)]
    row = robot.tree_joints.index(seat) if seat else int(np.argmax(np.abs(moved)))
    return row - 5 * int(robot.free_flyer)


def _rates(
    robot: RobotModel, placements: Array, position: ArrayLike | None, joint: str
) -> tuple[Array, Array]:
    """Return how a joint turns and how it moves its link, (3,) each in the base frame."""
    link, j = _link(robot, joint), robot.joint_names.index(joint)
    beside = neutral(robot) if position is None else np.asarray(position, dtype=np.float64)
    rates = link_jacobians(robot, beside[None, len(beside) - robot.n + robot.n_base :])
    turn, slide = rates[0, link, :, j].reshape(2, 3) @ placements[link, :3, :3].T
    return turn, slide
