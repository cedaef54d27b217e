"""MJCF as sdpid writes it: bodies with what is fixed to them, and nothing else."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction

from ..reading import MalformedError, shown
from .inertials import Inertial, body_of, less, moved
from .markup import Node, by_name, parse
from .placements import HERE, Placement, from_quaternion

# The attributes of <joint> for friction and rotor inertia.
_FRICTION = {"frictionloss", "damping", "armature"}

# Rounding the four entries of a unit quaternion changes the square of its length by less.
_UNIT = Fraction(1, 2**50)

# All that such a file holds: the children and the attributes of its elements. Others could change
# what the numbers mean.
_CHILDREN = {
    "mujoco": {"compiler", "option", "worldbody", "equality", "tendon"},
    "worldbody": {"body", "site"},
    "body": {"inertial", "joint", "freejoint", "body", "site"},
    "equality": {"joint", "connect", "weld"},
    "tendon": {"fixed"},
    "fixed": {"joint"},
}
_ATTRIBUTES = {
    "mujoco": {"model"},
    "option": {"gravity"},
    "body": {"name", "pos", "quat"},
    "inertial": {"pos", "quat", "mass", "diaginertia"},
    "freejoint": {"name"},
    # Where loops close.
    "site": {"name", "pos", "quat"},
    "connect": {"name", "site1", "site2"},
    "weld": {"name", "site1", "site2"},
    "joint": {"name", "type", "axis", "range", "actuatorfrcrange", *_FRICTION}
    | {"joint1", "joint2", "polycoef"}
    | {"joint", "coef"},
    "fixed": {"name", *_FRICTION},
}
_COMPILER = {"angle": "radian", "autolimits": "true", "inertiafromgeom": "false"}

# MuJoCo keeps this name for itself.
RENAMED = {"world": "world_link"}


class Mjcf:
    """Bodies of an MJCF; MalformedError where it holds what sdpid does not write."""

    def __init__(self, source: str | bytes) -> None:
        self.root = parse(source)
        if self.root.tag != "mujoco":
            raise MalformedError(f"its root is <{shown(self.root.tag)}>, not <mujoco>")
        _require_known(self.root)
        world = self.root.only("worldbody")
        self.bodies = by_name([] if world is None else list(_bodies(world)), "bodies")

        self.moving = {name: body for name, body in self.bodies.items() if _joint(body)}

    def rest(self, name: str, body: Sequence[float]) -> list[Fraction]:
        """Return the parameters of a moving body without those of what is fixed to it."""
        parts = []
        for child, place in _attached(self.moving[name], HERE):
            if (found := inertial(child)) is not None:
                parts.append(moved(body_of(*found), place))
        return less([Fraction(x) for x in body], parts)


def _require_known(root: Node) -> None:
    waiting = [root]
    while waiting:
        node = waiting.pop()
        known = _ATTRIBUTES.get(node.tag, set())
        if node.tag == "compiler":
            known = {key for key, value in node.attributes.items() if _COMPILER.get(key) == value}
        for key in node.attributes.keys() - known:
            raise MalformedError(
                f"<{shown(node.tag)}> has {shown(key)}, which sdpid does not write"
            )
        for child in node.children:
            if child.tag not in _CHILDREN.get(node.tag, set()):
                raise MalformedError(f"it has <{shown(child.tag)}>, which sdpid does not write")
            waiting.append(child)
    compiler = root.only("compiler")
    if compiler is None or compiler.attributes != _COMPILER:
        raise MalformedError("its <compiler> is not the one that sdpid writes")


def _bodies(node: Node) -> Iterator[Node]:
    for body in node.all("body"):
        yield body
        yield from _bodies(body)


def _joint(body: Node) -> Node | None:
    """Return the joint that moves a body; it has one at most."""
    joint, free = body.only("joint"), body.only("freejoint")
    if joint is not None and free is not None:
        raise MalformedError(f"body {shown(body.name)} has several joints")
    return joint or free


def _attached(body: Node, place: Placement) -> Iterator[tuple[Node, Placement]]:
    """Yield the bodies that are fixed to a body, directly or through others."""
    for child in body.all("body"):
        if _joint(child) is None:
            own = _place(child)
            there = own if place is HERE else place.then(own)
            yield child, there
            yield from _attached(child, there)


def _place(node: Node) -> Placement:
    quaternion = node.numbers("quat", "1 0 0 0")
    square = sum((Fraction(entry) ** 2 for entry in quaternion), Fraction(0))
    if len(quaternion) != 4 or abs(square - 1) > _UNIT:
        raise MalformedError(f"quat of <{shown(node.tag)}> is no quaternion of length 1")
    return from_quaternion(quaternion, node.triple("pos"))


def inertial(body: Node) -> tuple[Inertial, Placement] | None:
    """Return the inertial of a body and the axes of its moments; None without one."""
    node = body.only("inertial")
    if node is None:
        return None
    xx, yy, zz = node.triple("diaginertia")
    moments = (xx, 0.0, yy, 0.0, 0.0, zz)
    return Inertial(node.number("mass"), tuple(node.triple("pos")), moments), _place(node)
