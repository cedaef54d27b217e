"""Bodies in robot files: read exactly as written, before links are merged, and written exactly.

Loaders merge links that are fixed together and turn tensors into principal moments, which hides
impossible bodies or refuses them without a reason. Here every number is read as written, tensors
also as exact fractions, and nothing is refused: `DescribedBody.problems` lists what cannot be
read.

A body is (m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) about a joint's frame. A file has the mass,
the center of mass and the inertia about it, each number the double nearest to what the parameters
give in exact arithmetic. On the edge of consistency, where rounding could make a body that readers
refuse, moments about the center of mass are raised first (`inside`).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from graphlib import CycleError, TopologicalSorter
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen
from sdpid.errors import ModelError
from sdpid.robot.description.urdf import TENSOR, parse_urdf
from sdpid.robot.description.xml import LARGEST, numbers, read_origin
from sdpid.robot.inertia import TENSOR_INDEX, theta_from_physical
from sdpid.verifier.bodies import has_margin
from sdpid.verifier.exact import positive_semidefinite

# Readers reject a body that rounding has put on the edge (MuJoCo: principal moments below 1e-14
# kg·m², or a triangle inequality missed by one bit). Written bodies are this far inside, kg·m²,
# and by this share of their largest moment; it changes efforts by some 1e-13 N·m.
_INSIDE, _SHARE = Fraction(1e-13), Fraction(1e-14)

# Parameters may be outside by a solver's rounding, which so many doublings outgrow.
_DOUBLINGS = 20

# Names of the six moments, in the order of their places `TENSOR_INDEX`.
TENSOR_NAMES = ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")

Body = Sequence[Fraction]
Number = TypeVar("Number", float, Fraction)

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
        return (
            None if self.entries is None else np.array(tensor_rows(self.entries), dtype=np.float64)
        )

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
    fixed = {link: joint for link, joint in parents.items() if joint.get("type") == "fixed"}
    above = TopologicalSorter({link: (_end(joint, "parent"),) for link, joint in fixed.items()})
    places: dict[str, dict[str, Any]] = {}
    try:
        for name in (*above.static_order(), *names):
            if name not in places:
                places[name] = _place(name, parents.get(name), places)
    except CycleError as cause:
        name = cause.args[1][0]
        raise ModelError(f"{what}: the joints above link '{name}' go in a circle.") from None
    return root, tuple(_body(link, places[link.get("name", "")]) for link in links)


def _place(name: str, joint: Any, places: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """Return where a link is, by fields of `DescribedBody`, from where the one above it is."""
    if joint is None:
        return {"name": name, "carrier": name}
    parent = _end(joint, "parent")
    if joint.get("type") != "fixed":
        moved = {"moving": True, "joint": joint.get("name", "?"), "parent": parent}
        return {"name": name, "carrier": name, **moved}
    before = places[parent]
    problems: list[str] = []
    own = _placement(joint, f"joint '{joint.get('name')}'", problems)
    placement = before.get("placement", np.eye(4)) @ own
    problems = [*before.get("problems", ()), *problems]
    return {**before, "name": name, "placement": frozen(placement), "problems": tuple(problems)}


def _end(joint: Any, which: str) -> str:
    element = joint.find(which)
    return "" if element is None else str(element.get("link", ""))


def _body(link: Any, place: Mapping[str, Any]) -> DescribedBody:
    """Return the body of a ``<link>`` that is somewhere."""
    inertial, problems = link.find("inertial"), [*place.get("problems", ())]
    if inertial is None:
        return DescribedBody(described=False, **place)
    mass = _number(inertial.find("mass"), "value", "mass", problems)
    frame = _placement(inertial, "the inertial", problems)
    element = inertial.find("inertia")
    tensor = [_number(element, key, key, problems) for key in TENSOR_NAMES]
    entries, half_digit = tuple(value for value in tensor if value is not None), 0.0
    if len(entries) == len(tensor):
        half_digit = max(_half_digit(element.get(key)) for key in TENSOR_NAMES)
        problems += _asymmetries(element, dict(zip(TENSOR_NAMES, entries, strict=True)))
    own: dict[str, Any] = {
        "mass": None if mass is None else float(mass),
        "com": frozen(frame[:3, 3]) if np.isfinite(frame).all() else None,
        "rotation": frozen(frame[:3, :3]),
        "entries": entries if len(entries) == len(tensor) else None,
        "half_digit": half_digit,
        "problems": tuple(problems),
    }
    return DescribedBody(described=True, **{**place, **own})


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


def _asymmetries(element: Any, values: Mapping[str, Fraction]) -> Iterator[str]:
    """Yield in words which entries below the diagonal are not those above it."""
    for lower, upper in _TRANSPOSED.items():
        text = element.get(lower)
        if text is not None and _number(element, lower, lower, []) != values[upper]:
            yield (
                f"the tensor is not symmetric: {lower} is '{text}', {upper} is "
                f"'{element.get(upper)}'"
            )


def _placement(element: Any, what: str, problems: list[str]) -> Array:
    """Return the frame of an element's ``<origin>``; not finite where it cannot be read."""
    try:
        return read_origin(element, f"the origin of {what}")
    except ModelError as cause:
        problems.append(str(cause).removesuffix("."))
        return np.full((4, 4), np.nan)


class Inertial(NamedTuple):
    """Mass in kg, center of mass in m, inertia about it in kg·m², along the frame's axes."""

    mass: float
    com: tuple[float, ...]
    moments: tuple[float, ...]

    def named(self) -> dict[str, float]:
        """Return every number by name."""
        names = ("mass", "x", "y", "z", *TENSOR_NAMES)
        return dict(zip(names, (self.mass, *self.com, *self.moments), strict=True))


NOTHING = Inertial(0.0, (0.0,) * 3, (0.0,) * 6)


def tensor_rows(moments: Sequence[Number]) -> list[list[Number]]:
    """Return the rows of the tensor with six moments."""
    xx, xy, yy, xz, yz, zz = moments
    return [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]


def second_moment(moments: Sequence[Fraction]) -> list[list[Fraction]]:
    """Return the rows of ``½·tr(I)·E − I`` exactly."""
    rows = tensor_rows(moments)
    half = (rows[0][0] + rows[1][1] + rows[2][2]) / 2
    return [[half * (i == j) - rows[i][j] for j in range(3)] for i in range(3)]


def central(body: Sequence[float | Fraction]) -> tuple[Fraction, list[Fraction], list[Fraction]]:
    """Return mass, center of mass and moments about it, exactly; the mass must not be zero."""
    mass, *others = (Fraction(x) for x in body)
    com = [h / mass for h in others[:3]]
    square = sum(c * c for c in com)
    moments = [
        value - mass * ((square if i == j else 0) - com[i] * com[j])
        for value, (i, j) in zip(others[3:], TENSOR_INDEX, strict=True)
    ]
    return mass, com, moments


def inside(body: Body, consistency: str) -> list[Fraction] | None:
    """Return the body with its moments raised where it lies on the edge; None where it is none."""
    least = _INSIDE + _SHARE * max(map(abs, body[4:]))
    for step in (0, *(2**k for k in range(_DOUBLINGS))):
        trial = list(body)
        # Second moments of t in all directions are a rotational inertia of 2·t.
        for k in (4, 6, 9):
            trial[k] += step * least * (2 if consistency == "pseudo_inertia" else 1)
        if trial[0] > 0 and has_margin(trial, least, consistency):
            return trial
    return None


def rounded(body: Sequence[float | Fraction]) -> Inertial:
    """Return the doubles nearest to mass, center of mass and moments about it."""
    if not any(body):
        return NOTHING
    mass, com, moments = central(body)
    return Inertial(float(mass), tuple(map(float, com)), tuple(map(float, moments)))


def exists(mass: float, moments: Sequence[float | Fraction], consistency: str) -> bool:
    """Return whether a mass with moments about its center is consistent, exactly."""
    exact = [Fraction(x) for x in moments]
    rows = second_moment(exact) if consistency == "pseudo_inertia" else tensor_rows(exact)
    return mass > 0 and positive_semidefinite(rows)


def written_values(inertial: Inertial) -> dict[str, dict[str, str]]:
    """Return the attributes of origin, mass and inertia of an ``<inertial>``, in full precision.

    The inertia is about the center of mass, along the axes of the link.
    """
    named = inertial.named()
    return {
        "origin": {"xyz": numbers(inertial.com), "rpy": "0 0 0"},
        "mass": {"value": numbers(inertial.mass)},
        "inertia": {key: numbers(named[key]) for key in TENSOR},
    }


def inertial_element(body: ArrayLike) -> Any:
    """Return the ``<inertial>`` element of a body given by its ten parameters.

    Raises
    ------
    ModelError
        When the mass is not positive: there is no center of mass then.
    """
    from lxml import etree

    body = np.asarray(body, dtype=np.float64)
    if not body[0] > 0.0:
        raise ModelError(f"inertial: the mass is {body[0]} kg, a URDF needs a positive one.")
    element = etree.Element("inertial")
    for tag, attributes in written_values(rounded(body.tolist())).items():
        etree.SubElement(element, tag, attributes)
    return element
