"""URDFs as strictly as their readers differ: links with what is fixed to them, joints."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from ..reading import MalformedError, shown
from .inertials import MOMENTS, exists
from .markup import Node, by_name, parse

# All that an <inertial> has. Others, such as quat_xyzw, turn or scale it for some readers only.
_KNOWN: dict[str, set[str]] = {
    "inertial": set(),
    "origin": {"xyz", "rpy"},
    "mass": {"value"},
    "inertia": {*MOMENTS},
}

# What a joint has once; of two, readers might take either.
_OF_JOINTS = ("origin", "axis", "limit", "dynamics", "mimic")

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
        self._fixed: dict[str, list[str]] = {}
        self._fixing: dict[str, Node] = {}
        carried: dict[str, list[str]] = {link: [] for link in self.links}
        for joint in self.joints.values():
            for tag in _OF_JOINTS:
                joint.only(tag)
            parent, child = (_end(joint, end) for end in ("parent", "child"))
            if not {parent, child} <= self.links.keys():
                raise MalformedError(f"joint {shown(joint.name)} is of no links")
            carried[parent].append(child)
            if joint.attributes.get("type") == "fixed":
                self._fixed.setdefault(parent, []).append(child)
                self._fixing[child] = joint
        self.root = _root(carried)

    def _parts(self, link: str) -> list[Node]:
        """Return the inertials of a link and of those fixed to it, and where these are."""
        family = [link]
        for each in family:  # finitely many, since links make a tree
            family += self._fixed.get(each, ())
        found = [self.links[name].only("inertial") for name in family]
        found += [self._fixing[child].only("origin") for child in family[1:]]
        return [node for node in found if node is not None]

    def odd(self, links: Iterable[str]) -> Iterator[str]:
        """Yield what readers may take differently of links and of those fixed to them."""
        if self.version not in _VERSIONS:
            yield f"its version is {shown(self.version)}"
        for link in links:
            for node in self._parts(link):
                yield from (f"link {shown(link)}: {each}" for each in _odd(node))

    def is_body(self, link: str, consistency: str) -> bool:
        """Return whether a link has an inertial of a body that can exist."""
        node = self.links[link].only("inertial")
        mass, inertia = (None,) * 2 if node is None else (node.only("mass"), node.only("inertia"))
        if mass is None or inertia is None:
            return False
        return exists(mass.number("value"), [inertia.number(key) for key in MOMENTS], consistency)


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


def _odd(node: Node) -> Iterator[str]:
    """Yield what in an <inertial> or <origin> is not what every reader takes the same way."""
    for element in (node, *filter(None, (node.only(child.tag) for child in node.children))):
        if (known := _KNOWN.get(element.tag)) is None:
            yield f"<{shown(element.tag)}>"
            continue
        for key in sorted(element.attributes.keys() - known):
            upper = _LOWER.get(key) if element.tag == "inertia" else None
            if upper is None or element.number(key) != element.number(upper):
                yield f"{shown(key)} of <{element.tag}>"
