"""URDFs as strictly as their readers differ: links with what is fixed to them, joints."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from fractions import Fraction

from ..reading import MalformedError, shown
from .inertials import MOMENTS, Inertial, body_of, less, moved
from .markup import Node, by_name, parse
from .placements import HERE, Placement, from_rpy

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


class Urdf:
    """Links and joints of a URDF; MalformedError where readers might see different ones."""

    def __init__(self, source: str | bytes) -> None:
        root = parse(source)
        if root.tag != "robot":
            raise MalformedError(f"its root is <{shown(root.tag)}>, not <robot>")
        self.version = root.attributes.get("version", "")
        self.links, self.joints = (by_name(root.all(tag), f"{tag}s") for tag in ("link", "joint"))
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

    def odd(self, links: Iterable[str]) -> Iterator[str]:
        """Yield what readers may take differently of links and of those fixed to them."""
        if self.version not in _VERSIONS:
            yield f"its version is {shown(self.version)}"
        for link in links:
            for node in self.parts(link):
                yield from (f"link {shown(link)}: {each}" for each in _odd(node))

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
