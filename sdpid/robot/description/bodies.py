"""Read the inertials of a URDF link by link, exactly as written and before links are merged.

Loaders merge links that are fixed together and turn tensors into principal moments, which hides
impossible bodies or refuses them without a reason. Here every number is read as written, tensors
also as exact fractions, and nothing is refused: `DescribedBody.problems` lists what cannot be
read.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.errors import ModelError
from sdpid.robot.description.inertials import TENSOR_NAMES
from sdpid.robot.description.inertials import tensor as rows_of
from sdpid.robot.description.origin import LARGEST, read_origin
from sdpid.robot.description.urdf import parse_urdf
from sdpid.robot.inertia import theta_from_physical

# URDF defines the upper triangle only; some files write the lower one too.
_TRANSPOSED = {"iyx": "ixy", "izx": "ixz", "izy": "iyz"}


@dataclass(frozen=True, kw_only=True, eq=False)
class DescribedBody:
    """The inertial of one link as described.

    Attributes
    ----------
    name : str
        The link.
    described : bool
        Whether it has an ``<inertial>`` at all.
    moving : bool
        Whether some joint that is not fixed lies between it and the root.
    carrier : str
        The link that it is fixed to, through any number of fixed joints: the child of the last
        joint that moves, or the root; itself if nothing is in between.
    mass : float or None
        kg; None where it is missing or no number.
    com : ndarray, shape (3,), or None
        Center of mass in the link's frame, m.
    rotation : ndarray, shape (3, 3)
        Axes of the tensor in the link's frame.
    entries : tuple of Fraction, or None
        The tensor about the center of mass in the order of `TENSOR_NAMES`, exactly as written,
        kg·m².
    half_digit : float
        Half a unit in the last digit of the entry that is written most coarsely, kg·m²: by so
        much rounding may have changed an entry.
    placement : ndarray, shape (4, 4)
        The link's frame in the carrier's.
    problems : tuple of str
        What cannot be read, in words.
    joint : str or None
        The joint that moves the carrier.
    parent : str or None
        The link on that joint's other side.
    inferred : bool
        Whether the loader makes its inertia from its shapes.
    """

    name: str
    described: bool
    moving: bool = False
    carrier: str = ""
    mass: float | None = None
    com: Array | None = None
    rotation: Array = field(default_factory=lambda: frozen(np.eye(3)))
    entries: tuple[Fraction, ...] | None = None
    half_digit: float = 0.0
    placement: Array = field(default_factory=lambda: frozen(np.eye(4)))
    problems: tuple[str, ...] = ()
    joint: str | None = None
    parent: str | None = None
    inferred: bool = False

    @property
    def tensor(self) -> Array | None:
        """The inertia about the center of mass along its own axes, shape (3, 3), kg·m²."""
        return None if self.entries is None else np.array(rows_of(self.entries), dtype=np.float64)

    @property
    def theta(self) -> Array | None:
        """The ten parameters in the link's frame; None where a number is missing."""
        tensor = self.tensor
        if self.mass is None or self.com is None or tensor is None:
            return None
        return theta_from_physical(self.mass, self.com, self.rotation @ tensor @ self.rotation.T)


def exact_decimal(text: str) -> Fraction:
    """Return the exact value of a decimal number.

    Raises
    ------
    ValueError
        When the text is not a finite number of a size that a double can hold.
    """
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(text)
    # An exponent of minus millions would be expanded into as many digits.
    if value == 0.0:
        return Fraction(0)
    return Fraction(text.strip().replace("_", "x"))


def read_urdf_bodies(text: str | bytes, what: str) -> tuple[Any, tuple[DescribedBody, ...]]:
    """Return the root element of a URDF and its bodies, one a ``<link>``, in document order.

    Raises
    ------
    ModelError
        When it is not a URDF, or its joints make no tree.
    """
    root = parse_urdf(text, what)
    links = root.findall("link")
    names = Counter(link.get("name", "") for link in links)
    if not links:
        raise ModelError(f"{what}: has no <link>; give the URDF itself, not a xacro file.")
    twice = sorted(name for name, count in names.items() if count > 1)
    if twice:
        raise ModelError(f"{what}: link names must differ; given twice: {', '.join(twice)}.")
    parents: dict[str, Any] = {}
    for joint in root.findall("joint"):
        ends = [_end(joint, which) for which in ("parent", "child")]
        for end in ends:
            if end not in names:
                raise ModelError(
                    f"{what}: joint '{joint.get('name', '?')}' names the link '{end}', which "
                    "does not exist."
                )
        if ends[1] in parents:
            raise ModelError(f"{what}: link '{ends[1]}' is the child of two joints.")
        parents[ends[1]] = joint
    places: dict[str, _Place] = {}
    for name in names:
        _find_place(name, parents, places, what)
    return root, tuple(_body(link, parents, places) for link in links)


@dataclass(frozen=True)
class _Place:
    """The link that carries a link through fixed joints, and the placement in it."""

    carrier: str
    placement: Array
    problems: tuple[str, ...] = ()


def _find_place(
    name: str, parents: Mapping[str, Any], places: dict[str, _Place], what: str
) -> None:
    """Store the places of a link and of the links between it and its carrier."""
    chain: list[str] = []
    while name not in places:
        joint = parents.get(name)
        if joint is None or joint.get("type") != "fixed":
            places[name] = _Place(name, np.eye(4))
            break
        if name in chain:
            raise ModelError(f"{what}: the joints above link '{name}' go in a circle.")
        chain.append(name)
        name = _end(joint, "parent")
    for link in reversed(chain):
        joint = parents[link]
        problems: list[str] = []
        own = _placement(joint, f"joint '{joint.get('name')}'", problems)
        above = places[_end(joint, "parent")]
        places[link] = _Place(above.carrier, above.placement @ own, (*above.problems, *problems))


def _end(joint: Any, which: str) -> str:
    element = joint.find(which)
    return "" if element is None else str(element.get("link", ""))


def _body(link: Any, parents: Mapping[str, Any], places: Mapping[str, _Place]) -> DescribedBody:
    name = link.get("name", "")
    found = places[name]
    problems, carrier = list(found.problems), found.carrier
    mover = parents.get(carrier)
    place: dict[str, Any] = {
        "name": name,
        "moving": mover is not None,
        "carrier": carrier,
        "joint": None if mover is None else mover.get("name", "?"),
        "parent": None if mover is None else _end(mover, "parent"),
        "placement": frozen(found.placement),
    }
    inertial = link.find("inertial")
    if inertial is None:
        return DescribedBody(described=False, problems=tuple(problems), **place)
    mass = _number(inertial.find("mass"), "value", "mass", problems)
    frame = _placement(inertial, "the inertial", problems)
    element = inertial.find("inertia")
    tensor = [_number(element, key, key, problems) for key in TENSOR_NAMES]
    entries = None
    half_digit = 0.0
    numbers = [value for value in tensor if value is not None]
    if len(numbers) == len(tensor):
        entries = tuple(numbers)
        half_digit = max(_half_digit(element.get(key)) for key in TENSOR_NAMES)
        _check_symmetry(element, dict(zip(TENSOR_NAMES, numbers, strict=True)), problems)
    return DescribedBody(
        described=True,
        mass=None if mass is None else float(mass),
        com=frozen(frame[:3, 3]) if np.isfinite(frame).all() else None,
        rotation=frozen(frame[:3, :3]),
        entries=entries,
        half_digit=half_digit,
        problems=tuple(problems),
        **place,
    )


def _number(element: Any, key: str, what: str, problems: list[str]) -> Fraction | None:
    text = None if element is None else element.get(key)
    if text is None:
        problems.append(f"{what} is missing")
        return None
    try:
        number = exact_decimal(text)
    except ValueError:
        problems.append(f"{what} is '{text}', which is no finite number")
        return None
    if abs(number) > LARGEST:
        problems.append(f"{what} is '{text}', more than {LARGEST:g}, which no robot has")
        return None
    return number


def _half_digit(text: str) -> float:
    """Return half a unit in the last digit of a number as written."""
    mantissa, _, exponent = text.strip().lower().partition("e")
    decimals = len(mantissa.partition(".")[2])
    if not float(mantissa):
        return 0.0  # an entry that is zero is so by symmetry, not by rounding
    return 0.5 * 10.0 ** (int(exponent or 0) - decimals)


def _check_symmetry(element: Any, values: Mapping[str, Fraction], problems: list[str]) -> None:
    for lower, upper in _TRANSPOSED.items():
        text = element.get(lower)
        if text is None:
            continue
        try:
            same = exact_decimal(text) == values[upper]
        except ValueError:
            same = False
        if not same:
            problems.append(
                f"the tensor is not symmetric: {lower} is '{text}', {upper} is "
                f"'{element.get(upper)}'"
            )


def _placement(element: Any, what: str, problems: list[str]) -> Array:
    """Return the frame of an element's ``<origin>``; not finite where it cannot be read."""
    try:
        return read_origin(element)
    except ValueError as cause:
        problems.append(f"the origin of {what}: {cause}")
        return np.full((4, 4), np.nan)
