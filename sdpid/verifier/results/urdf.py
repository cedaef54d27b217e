"""Compare a URDF with certified parameters: links with what is fixed to them, joints' friction.

What moves with a joint is a link and the links fixed to it. A URDF holds the certified parameters
where the link that the joint moves has, to the last digit, what they give less the links fixed to
it (`sdpid.verifier.results.inertials`). The writer computes its numbers by the same functions.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction

from ..reading import MalformedError, shown
from ..result import Result
from .inertials import MOMENTS, Inertial, at_most, body_of, exists, inside, less, moved, rounded
from .joint_friction import Friction, compared
from .manifest import listed
from .markup import Node, by_name, parse
from .placements import HERE, Placement, from_rpy

# The attributes of <dynamics> and the parameters that they hold.
PLACES = {"friction": "Fs", "damping": "Fv"}

_PLAIN = ("link", "joint", "material", "transmission")

# All that an <inertial> has. Others, such as quat_xyzw, turn or scale it for some readers only.
_KNOWN: dict[str, set[str]] = {
    "inertial": set(),
    "origin": {"xyz", "rpy"},
    "mass": {"value"},
    "inertia": {*MOMENTS},
}

# URDF reads the upper triangle of a tensor; some files write the lower one, too.
_LOWER = {"iyx": "ixy", "izx": "ixz", "izy": "iyz"}

# Versions that mean the same by these elements; an empty one is that of a file without.
_VERSIONS = ("", "1.0", "1.1", "1.2")


# What nothing in the folder speaks for.
DESCRIBED = "that joints (places, axes, limits), shapes and gravity are the description's"


class Urdf:
    """Links and joints of a URDF; MalformedError where readers might see different ones."""

    def __init__(self, source: str | bytes) -> None:
        root = parse(source)
        if root.tag != "robot":
            raise MalformedError(f"its root is <{shown(root.tag)}>, not <robot>")
        self.version = root.attributes.get("version", "")
        self.links, self.joints = (by_name(root.all(tag), f"{tag}s") for tag in ("link", "joint"))
        self.others = sorted({child.tag for child in root.children} - set(_PLAIN))
        self.movers: dict[str, Node] = {}
        self._fixed: dict[str, list[tuple[str, Placement]]] = {}
        self._fixing: dict[str, Node] = {}
        carried: dict[str, list[str]] = {link: [] for link in self.links}
        for joint in self.joints.values():
            parent, child = (_end(joint, end) for end in ("parent", "child"))
            if not {parent, child} <= self.links.keys():
                raise MalformedError(f"joint {shown(joint.name)} is of no links")
            carried[parent].append(child)
            if joint.attributes.get("type") == "fixed":
                self._fixed.setdefault(parent, []).append((child, _origin(joint)))
                self._fixing[child] = joint
            else:
                self.movers[child] = joint
        self.root = _root(carried)

    def attached(self, link: str) -> list[tuple[str, Placement]]:
        """Return the links that are fixed to a link, directly or through others.

        They are finitely many, since links make a tree.
        """
        found, waiting = [], [(link, HERE)]
        while waiting:
            name, place = waiting.pop()
            for child, own in self._fixed.get(name, ()):
                there = own if place is HERE else place.then(own)
                found.append((child, there))
                waiting.append((child, there))
        return found

    def parts(self, link: str) -> list[Node]:
        """Return the inertials of a link and of those fixed to it, and where these are."""
        fixed = [child for child, _ in self.attached(link)]
        found = [self.links[name].only("inertial") for name in (link, *fixed)]
        found += [self._fixing[child].only("origin") for child in fixed]
        return [node for node in found if node is not None]

    def inertial(self, link: str) -> tuple[Inertial, Placement] | None:
        """Return the inertial of a link and the axes of its moments; None without one."""
        node = self.links[link].only("inertial")
        if node is None:
            return None
        mass, inertia, place = node.only("mass"), node.only("inertia"), _origin(node)
        if mass is None or inertia is None:
            raise MalformedError(f"link {shown(link)} has an <inertial> without mass or inertia")
        com = tuple(map(float, place.translation))
        moments = tuple(inertia.number(key) for key in MOMENTS)
        return Inertial(mass.number("value"), com, moments), place

    def rest(self, link: str, body: Sequence[float]) -> list[Fraction]:
        """Return the body of a link without those of the links that are fixed to it."""
        parts = []
        for child, place in self.attached(link):
            if (found := self.inertial(child)) is not None:
                parts.append(moved(body_of(*found), place))
        return less([Fraction(x) for x in body], parts)


def _root(carried: Mapping[str, Sequence[str]]) -> str:
    """Return the link that carries all others, directly or not, each in one way."""
    children = [child for several in carried.values() for child in several]
    reached = [link for link in carried if link not in children][:1]
    for link in reached:
        reached += carried[link]
        if len(reached) > len(carried):
            break
    if sorted(reached) != sorted(carried):
        raise MalformedError("its joints make no tree of its links")
    return reached[0]


def _end(joint: Node, end: str) -> str:
    node = joint.only(end)
    return "" if node is None else node.attributes.get("link", "")


def _origin(node: Node) -> Placement:
    """Return the placement that an element's <origin> gives it."""
    origin = node.only("origin")
    return HERE if origin is None else from_rpy(origin.triple("rpy"), origin.triple("xyz"))


def check(
    source: bytes,
    bodies: Mapping[str, Sequence[float]],
    consistency: str,
    friction: Friction,
) -> Result:
    """Check a URDF against the ten parameters of every moving link, and against friction.

    Parameters
    ----------
    source : bytes
        The file.
    bodies : mapping of str to sequence of float
        The certified parameters of the links.
    consistency : str
        What every link must have.
    friction : Friction
        The certified parameters of the joints.
    """
    urdf = Urdf(source)
    problems, raised = [], Fraction(0)
    if urdf.version not in _VERSIONS:
        problems.append(f"its version is {shown(urdf.version)}, which readers may take differently")
    floating = {urdf.root} & bodies.keys()
    for link in (urdf.movers.keys() | floating) ^ bodies.keys():
        where = "the file" if link in bodies else "the certificate"
        problems.append(f"link {shown(link)}: {where} has no such moving link")
    for link in (name for name in bodies if name in urdf.links):
        problems += [
            f"link {shown(link)}: {odd}, which readers may take differently"
            for node in urdf.parts(link)
            for odd in _odd(node)
        ]
        rest = urdf.rest(link, bodies[link])
        expected, found = inside(rest, consistency), urdf.inertial(link)
        if expected is None:
            fixed = [child for child, _ in urdf.attached(link)]
            problems.append(f"link {shown(link)}: {leftover(rest, fixed)}")
            continue
        problems += _differences(link, expected, found)
        raised = max(raised, expected[4] - rest[4])
        if found is not None and not exists(found[0].mass, found[0].moments, consistency):
            problems.append(f"link {shown(link)} is no body: {consistency} does not hold")
    said = () if problems else (agreement(len(bodies), raised, consistency),)
    result = Result(said, tuple(problems), _unchecked(urdf, bodies, consistency))
    return result + compared(_values(urdf), friction, PLACES)


def leftover(rest: Sequence[Fraction], fixed: Sequence[str]) -> str:
    """Return that what is fixed to a link leaves no body of it, in words."""
    return (
        f"no body is what the links fixed to it ({listed(fixed)}) leave of its certified "
        f"parameters, {float(rest[0])!r} kg"
    )


def _odd(node: Node) -> Iterator[str]:
    """Yield what in an <inertial> or <origin> is not what every reader takes the same way."""
    for element in (node, *node.children):
        if (known := _KNOWN.get(element.tag)) is None:
            yield f"<{shown(element.tag)}>"
            continue
        for key in sorted(element.attributes.keys() - known):
            upper = _LOWER.get(key) if element.tag == "inertia" else None
            if upper is None or element.number(key) != element.number(upper):
                yield f"{shown(key)} of <{element.tag}>"


def agreement(count: int, raised: Fraction, consistency: str) -> str:
    """Return that a file has the certified bodies, in words."""
    off = f" (inertias raised by at most {at_most(raised)} kg.m2, off the edge)" if raised else ""
    return (
        f"{count} moving links, with what is fixed to them, have the certified parameters, "
        f"rounded to doubles{off}, and each is a body: {consistency} holds exactly."
    )


def _differences(
    link: str, expected: list[Fraction], found: tuple[Inertial, Placement] | None
) -> list[str]:
    """Return the numbers of a link that are not those of its parameters."""
    if found is None:
        return [f"link {shown(link)} has no inertial"]
    inertial, axes = found
    wrong = [] if axes.rotation == HERE.rotation else ["its axes are turned"]
    for (name, value), wanted in zip(
        inertial.named().items(), rounded(expected).named().values(), strict=True
    ):
        if value != wanted:
            wrong.append(f"{name} is {value!r}, the certified parameters give {wanted!r}")
    return [f"link {shown(link)}: {each}" for each in wrong]


def _values(urdf: Urdf) -> dict[str, dict[str, float]]:
    """Return the friction of every joint that moves by attribute."""
    found = {}
    for joint in urdf.movers.values():
        node = joint.only("dynamics") or Node("dynamics", {})
        found[joint.name] = {k: node.number(k) for k in PLACES if k in node.attributes}
    return found


def _unchecked(
    urdf: Urdf, bodies: Mapping[str, Sequence[float]], consistency: str
) -> tuple[str, ...]:
    """Return what a URDF says beside the certified parameters."""
    carried = {child for link in bodies if link in urdf.links for child, _ in urdf.attached(link)}
    still = urdf.links.keys() - carried - bodies.keys()
    said = [DESCRIBED]
    for link in sorted(carried):
        found = urdf.inertial(link)
        if found is None or not any(found[0].named().values()):
            continue
        if not exists(found[0].mass, found[0].moments, consistency):
            said.append(f"link {shown(link)}, fixed to another: it is no body, and not estimated")
    if still:
        said.append(f"that {len(still)} links which do not move have the description's inertials")
    if urdf.others:
        said.append(f"that its elements {listed(urdf.others)} are the description's")
    return tuple(said)
