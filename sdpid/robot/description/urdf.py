"""Check a URDF, convert it by Pinocchio, read its loops, and stand it on level ground.

A URDF has no place for a loop. Simulators add one that other readers pass over: the element
``<loop_joint>`` with a frame on either of two links, which are at one place.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import ModelError
from sdpid.robot.description.xml import (
    LARGEST,
    add_child,
    matrix_rpy,
    numbers,
    parse_xml,
    read_numbers,
    read_placement,
    undeclared,
    xml_text,
)
from sdpid.robot.inertia import least_turn

# Parsers recurse into the tree of links: tens of thousands overflow the stack and end the process.
MOST_LINKS = 2000

# Entries of the tensor, in the order in which a URDF lists them.
TENSOR = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")

# The numbers of a URDF that are checked: owner, path of the element, attributes, count of numbers
# in each, and whether the attribute may be missing.
_PLACES = (
    ("link", "inertial/origin", ("xyz", "rpy"), 3, True),
    ("link", "inertial/mass", ("value",), 1, False),
    ("link", "inertial/inertia", TENSOR, 1, False),
    ("joint", "origin", ("xyz", "rpy"), 3, True),
    ("joint", "axis", ("xyz",), 3, True),
    ("joint", "dynamics", ("damping", "friction"), 1, True),
    ("joint", "mimic", ("multiplier", "offset"), 1, True),
)
# Those of them that are not negative, and what is said of a negative one.
_NOT_NEGATIVE = {
    "value": "the mass is {} kg, the least is 0; give the true mass.",
    "damping": "damping is {}, the least is 0; correct the description.",
    "friction": "friction is {}, the least is 0; correct the description.",
}
# The numbers that Pinocchio's parser accepts; Python accepts more.
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


_ONE_VARIABLE = ("revolute", "continuous", "prismatic")


class Kept(NamedTuple):
    """Joints that hold each other: the sum of their positions times factors is a value.

    One of them may be said to follow the others.
    """

    factors: dict[str, float]
    value: float
    follower: str | None = None

    @classmethod
    def mimic(cls, joint: str, source: str, multiplier: float, offset: float) -> Kept:
        """Return what holds for a joint that repeats another: ``multiplier·q_source + offset``."""
        own = 1.0 - multiplier if source == joint else 1.0
        return cls({source: -multiplier, joint: own}, offset, joint)


def parse_urdf(text: str | bytes, what: str) -> Any:
    """Return the root element of a URDF.

    Raises
    ------
    ModelError
        When it is not one, or has more than 2000 links.
    """
    root = parse_xml(text, what)
    if root.tag != "robot":
        raise ModelError(f"{what}: the root element is <{root.tag}>, a URDF has <robot>.")
    count = len(root.findall("link"))
    if count > MOST_LINKS:
        raise ModelError(f"{what}: {count} links, at most {MOST_LINKS} are read.")
    return root


def check_urdf(text: str, what: str, *, floating: bool = False) -> tuple[Any, tuple[Kept, ...]]:
    """Check the joints of a URDF and return its root element and what its mimic joints hold to.

    With a `floating` base the base itself moves, so that no joint needs to.

    Raises
    ------
    ModelError
        When it is not a URDF, has no moving joint, or has a joint of a kind that has more than
        one variable.
    """
    root = parse_urdf(text, what)
    _check_numbers(root, what)
    moving = [joint for joint in root.findall("joint") if joint.get("type") != "fixed"]
    kept = []
    for joint in moving:
        name, kind = joint.get("name", "?"), joint.get("type", "?")
        if kind not in _ONE_VARIABLE:
            raise ModelError(
                f"{what}: joint '{name}' is of kind '{kind}'; supported are "
                f"{', '.join(_ONE_VARIABLE)} and fixed (a floating base: root='free_flyer')."
            )
        for mimic in joint.findall("mimic")[:1]:
            multiplier, offset = float(mimic.get("multiplier", 1)), float(mimic.get("offset", 0))
            kept.append(Kept.mimic(name, mimic.get("joint", ""), multiplier, offset))
    if not moving and not floating:
        raise ModelError(f"{what}: no moving joint; nothing can be identified.")
    return root, tuple(kept)


def pinocchio_from_urdf(
    text: str, what: str, *, floating: bool = False
) -> tuple[Any, tuple[Kept, ...], Any]:
    """Return the Pinocchio model of a URDF, what its joints hold to, and its root element.

    Raises
    ------
    ModelError
        When it is not a URDF of supported joints, or Pinocchio cannot read it.
    """
    import pinocchio as pin

    root, kept = check_urdf(text, what, floating=floating)
    free = (pin.JointModelFreeFlyer(),) if floating else ()
    try:
        model = pin.buildModelFromXML(undeclared(text), *free)
    except (RuntimeError, ValueError) as cause:
        # The reason is what its parser prints on standard error.
        raise ModelError(
            f"{what}: Pinocchio cannot read it ({cause}); its parser says why on standard error."
        ) from None
    model.name = root.get("name", "robot")
    return model, kept, root


def _check_numbers(root: Any, what: str) -> None:
    """Refuse numbers that cannot be read, are missing or are absurdly large.

    Pinocchio's parser only warns on standard error, and drops the whole inertia of such a link.
    """
    for kind, path, keys, count, optional in _PLACES:
        for element in root.iterfind(f"{kind}/{path}"):
            where = f"{what}: {kind} '{next(element.iterancestors(kind)).get('name', '?')}'"
            for key in keys:
                text = element.get(key)
                if text is None and optional:
                    continue
                words = [] if text is None else text.split()
                wrong = len(words) != count or not all(map(_NUMBER.fullmatch, words))
                if wrong or not all(abs(float(word)) <= LARGEST for word in words):
                    given = "missing" if text is None else f"'{text[:60]}'"
                    raise ModelError(
                        f"{where}: {key} of <{element.tag}> is {given}, expected {count} number"
                        f"{'s' if count > 1 else ''} of at most {LARGEST:g}."
                    )
                if key in _NOT_NEGATIVE and float(words[0]) < 0.0:
                    raise ModelError(f"{where}: {_NOT_NEGATIVE[key].format(text)}")
    for inertial in root.iterfind("link/inertial"):
        for name in ("mass", "inertia"):
            if inertial.find(name) is None:
                raise ModelError(
                    f"{what}: link '{inertial.getparent().get('name', '?')}': its <inertial> has "
                    f"no <{name}>; add it, or leave out the whole <inertial>."
                )


# Names of a level root and of the joint on it; of others, no file is taken to be ours.
LINK, JOINT = "level_ground", "level_ground_to_base"


def base_turn(gravity: Array, found: Array) -> Array:
    """Return how a base stands (3, 3) in which gravity is `found` in place of `gravity`."""
    if np.array_equal(gravity, found):
        return np.eye(3)
    return least_turn(found, gravity)


def stand_on_level(robot: Any, root: str, turn: Array) -> None:
    """Put the root link of a ``<robot>``, as it is turned, on a new one that is level."""
    from lxml import etree

    joint = etree.Element("joint", name=JOINT, type="fixed")
    etree.SubElement(joint, "origin", xyz="0 0 0", rpy=numbers(matrix_rpy(turn)))
    etree.SubElement(joint, "parent", link=LINK)
    etree.SubElement(joint, "child", link=root)
    for element in (etree.Element("link", name=LINK), joint):
        add_child(robot, element, last=True)


def without_level(text: str) -> str:
    """Return a URDF without the link and the joint of `stand_on_level`, where it has them."""
    root = parse_xml(text, "URDF")
    names = {"link": LINK, "joint": JOINT}
    ours = [e for e in root.iterchildren("link", "joint") if e.get("name") == names[e.tag]]
    if [each.tag for each in ours] != ["link", "joint"]:
        return text
    for each in ours:
        if (before := each.getprevious()) is not None:
            before.tail = each.tail
        root.remove(each)
    return xml_text(root, text)


LoopKind = Literal["point", "line", "plane"]
# What the kinds of loop joints in a URDF transmit, as contacts call it: all forces; and all moments
# but that about the axis; and all moments.
KINDS: dict[str, LoopKind] = {
    "spherical": "point",
    "revolute": "line",
    "continuous": "line",
    "fixed": "plane",
}
# Axes of joints in a URDF, unless it says another.
_AXIS = "1 0 0"


@dataclass(frozen=True)
class Loop:
    """Where a loop of a robot closes.

    Attributes
    ----------
    name : str
        Its name.
    frame, against : str
        The two frames of the robot that are at one place.
    kind : {"point", "line", "plane"}
        A ball (or a pin of a linkage in a plane), a pin along the frames' y axes, or a weld.

    Examples
    --------
    >>> from sdpid.robot.description.urdf import Loop
    >>> Loop("pin", "pin/coupler", "pin/rocker", "point")
    Loop(name='pin', frame='pin/coupler', against='pin/rocker', kind='point')
    """

    name: str
    frame: str
    against: str
    kind: LoopKind


@dataclass(frozen=True, eq=False)
class Closure:
    """What closes a loop in a description.

    Attributes
    ----------
    name : str
        Its name.
    kind : {"point", "line", "plane"}
        What it transmits.
    ends : tuple of (str, ndarray)
        The two bodies, and the place on each, (4, 4); the axis of a line is y.
    """

    name: str
    kind: LoopKind
    ends: tuple[tuple[str, Array], tuple[str, Array]]


def urdf_closures(root: Any, what: str) -> tuple[Closure, ...]:
    """Return the closures of a URDF: its elements ``<loop_joint>``.

    Raises
    ------
    ModelError
        When one is of a kind that is not known, or lacks an end or a number.
    """
    found = []
    for number, element in enumerate(root.findall("loop_joint"), 1):
        name = element.get("name", f"loop_{number}")
        where = f"{what}: loop joint '{name}'"
        kind = element.get("type", "?")
        if kind not in KINDS:
            raise ModelError(f"{where} is of kind '{kind}'; supported are {', '.join(KINDS)}.")
        axis = read_numbers(element.find("axis"), "xyz", where, _AXIS)
        if not np.linalg.norm(axis) > 0.0:
            raise ModelError(f"{where}: the axis is zero; give a direction.")
        one, two = (_end(element, tag, axis, where) for tag in ("link1", "link2"))
        found.append(Closure(name, KINDS[kind], (one, two)))
    return tuple(found)


def urdf_passive(root: Any, what: str) -> dict[str, float]:
    """Return the joints without motors of a URDF: its elements ``<passive_joint>``, as in an SRDF.

    Returns
    -------
    dict of str to float
        Their names, and about where they are while those with motors are at zero (rad, m): the
        attribute ``position``, of which an SRDF knows nothing; zero without it.

    Raises
    ------
    ModelError
        When one has no name, or its position is no number.
    """
    found = {}
    for element in root.findall("passive_joint"):
        if not (name := element.get("name", "")):
            raise ModelError(f"{what}: a <passive_joint> has no name; give that of a joint.")
        where = f"{what}: <passive_joint name='{name}'>, about where it is in rad or m"
        found[name] = float(read_numbers(element, "position", where, "0", 1)[0])
    return found


def add_loops(model: Any, closures: Sequence[Closure], what: str) -> tuple[Loop, ...]:
    """Add a frame at either end of each closure to a Pinocchio model; return the loops.

    Raises
    ------
    ModelError
        When a body does not exist, both ends move together, or a name is there twice.
    """
    import pinocchio as pin

    loops: list[Loop] = []
    for closure in closures:
        where = f"{what}: loop joint '{closure.name}'"
        if closure.name in {loop.name for loop in loops}:
            raise ModelError(f"{where} is there twice; give every loop another name.")
        names, joints = [], []
        for body, place in closure.ends:
            if not model.existBodyName(body) and body != "universe":
                raise ModelError(f"{where}: there is no link '{body}'.")
            at = model.getBodyId(body) if body != "universe" else 0
            owner, own = model.frames[at], pin.SE3(place)
            name = f"{closure.name}/{body}"
            joints.append(owner.parentJoint)
            names.append(name)
            model.addFrame(
                pin.Frame(
                    name, owner.parentJoint, at, owner.placement * own, pin.FrameType.OP_FRAME
                )
            )
        if joints[0] == joints[1]:
            raise ModelError(
                f"{where}: {closure.ends[0][0]} and {closure.ends[1][0]} do not move against each "
                "other; a loop has moving joints between its ends."
            )
        loops.append(Loop(closure.name, names[0], names[1], closure.kind))
    return tuple(loops)


def pointing(axis: Array) -> Array:
    """Return a rotation (3, 3) that turns y to an axis."""
    y = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    # The unit vector that is farthest from the axis makes the frame.
    x = np.eye(3)[int(np.argmin(np.abs(y)))]
    x = x - (x @ y) * y
    x = x / np.linalg.norm(x)
    return np.column_stack([x, y, np.cross(x, y)])


def _end(element: Any, tag: str, axis: Array, where: str) -> tuple[str, Array]:
    """Return the link of one end, and the place on it."""
    end = element.find(tag)
    link = None if end is None else end.get("link")
    if not link:
        raise ModelError(f"{where} has no <{tag} link=...>; it joins two links.")
    place = read_placement(end, where)
    place[:3, :3] = place[:3, :3] @ pointing(axis)
    return link, place
