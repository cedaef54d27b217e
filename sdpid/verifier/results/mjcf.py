"""Compare an MJCF that sdpid wrote with certified parameters, as `urdf` does a URDF.

Inertias are principal moments with a quaternion of their axes. If d and q are the exact ones, the
file has doubles d' and q' within a unit u of their last digits. Rotations by q' and by q differ
by an angle of at most 2·‖q' − q‖ (both of length 1), and so the tensors in norm by at most

    2·Σ u(q_k)·(max d − min d) + max u(d_i).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from fractions import Fraction

from ..reading import MalformedError, shown
from ..result import Result
from .inertials import (
    MOMENTS,
    Inertial,
    body_of,
    central,
    exists,
    inside,
    less,
    moved,
    rounded,
)
from .joint_friction import Friction, compared
from .markup import Node, by_name, parse
from .placements import HERE, Placement, from_quaternion
from .urdf import DESCRIBED, agreement, leftover

# The attributes of <joint> and the parameters that they hold.
PLACES = {"frictionloss": "Fs", "damping": "Fv", "armature": "Ia"}

# MuJoCo has no other bodies.
CONSISTENCY = "pseudo_inertia"

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
    "joint": {"name", "type", "axis", "range", "actuatorfrcrange", *PLACES}
    | {"joint1", "joint2", "polycoef"}
    | {"joint", "coef"},
    "fixed": {"name", *PLACES},
}
_COMPILER = {"angle": "radian", "autolimits": "true", "inertiafromgeom": "false"}

# MuJoCo keeps this name for itself.
_RENAMED = {"world": "world_link"}


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


def check(source: bytes, bodies: Mapping[str, Sequence[float]], friction: Friction) -> Result:
    """Check an MJCF against the ten parameters of every link, and against friction."""
    mjcf = Mjcf(source)
    problems, raised = [], Fraction(0)
    moving = mjcf.moving
    bodies = {_RENAMED.get(link, link): body for link, body in bodies.items()}
    for link in moving.keys() ^ bodies.keys():
        where = "the file" if link in bodies else "the certificate"
        problems.append(f"link {shown(link)}: {where} has no such moving link")
    for link in (name for name in bodies if name in moving):
        rest = mjcf.rest(link, bodies[link])
        expected = inside(rest, CONSISTENCY)
        if expected is None:
            wrong = [leftover(rest, [child.name for child, _ in _attached(moving[link], HERE)])]
        else:
            wrong = _differences(moving[link], expected)
            raised = max(raised, expected[4] - rest[4])
        problems += [f"link {shown(link)}: {each}" for each in wrong]
    for name, body in mjcf.bodies.items():
        found = inertial(body)
        if found is None or not (_joint(body) or any(found[0].named().values())):
            continue
        if not exists(found[0].mass, found[0].moments, CONSISTENCY):
            problems.append(f"body {shown(name)} is none: {CONSISTENCY} does not hold")
    if mjcf.root.only("tendon") is not None and not friction.fitted:
        problems.append("it has tendons, and result.json says that its friction is as certified")
    said = () if problems else (agreement(len(bodies), raised, CONSISTENCY),)
    result = Result(said, tuple(problems), (DESCRIBED,))
    return result + compared(_values(moving.values()), friction, PLACES)


def _values(bodies: Iterable[Node]) -> dict[str, dict[str, float]]:
    """Return the friction of every joint by attribute; what is not written is zero."""
    found = {}
    for body in bodies:
        if (joint := body.only("joint")) is not None:
            given = {key: joint.number(key) for key in PLACES if key in joint.attributes}
            found[joint.name] = {**dict.fromkeys(PLACES, 0.0), **given}
    return found


def _differences(body: Node, expected: list[Fraction]) -> list[str]:
    """Return the numbers of a body that are not those of its parameters."""
    found = inertial(body)
    if found is None:
        return ["it has no inertial"]
    named, wanted = found[0].named(), rounded(expected).named()
    wrong = [
        f"{name} is {named[name]!r}, the certified parameters give {wanted[name]!r}"
        for name in ("mass", "x", "y", "z")
        if named[name] != wanted[name]
    ]
    turned = central(body_of(*found))[2]
    limit = digits(found[0], body)
    return wrong + [
        f"{name} is {float(value)!r}, the certified parameters give {float(exact)!r}"
        for name, value, exact in zip(MOMENTS, turned, central(expected)[2], strict=True)
        if abs(value - exact) > limit
    ]


def digits(found: Inertial, body: Node) -> Fraction:
    """Return by how much a tensor may differ from what its moments and axes were rounded from."""
    node = body.only("inertial")
    quaternion = node.numbers("quat", "1 0 0 0") if node is not None else []
    moments = [found.moments[k] for k in (0, 2, 5)]
    unit = max(Fraction(math.ulp(d)) for d in moments)
    spread = Fraction(max(moments)) - Fraction(min(moments)) + 2 * unit
    return 2 * sum((Fraction(math.ulp(q)) for q in quaternion), Fraction(0)) * spread + unit
