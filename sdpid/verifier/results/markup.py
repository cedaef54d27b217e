"""XML of robots, parsed safely: no document type, no entity of its own, bounded depth and size."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from xml.parsers import expat

from ..reading import MalformedError, shown

# The largest description seen has below 1 MB and 20 levels.
_LARGEST, _DEEPEST = 64 * 2**20, 1000

# The links or joints of a robot; of each the exact body costs some milliseconds.
_MOST_NAMES = 2000

# The numbers that readers of robots understand; Python's own are more.
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,4})?", re.ASCII)

# No length, mass or inertia of a robot is larger.
_MOST = 1e12


def number(text: str) -> float:
    """Return the double that a decimal number denotes."""
    if not _NUMBER.fullmatch(text):
        raise MalformedError(f"{shown(text)} is no number")
    if not abs(value := float(text)) <= _MOST:
        raise MalformedError(f"{shown(text)} is above {_MOST:g}")
    return value


@dataclass
class Node:
    """An element: its tag, its attributes, and the elements in it."""

    tag: str
    attributes: dict[str, str]
    children: list[Node] = field(default_factory=list)

    @property
    def name(self) -> str:
        """The attribute ``name``."""
        return self.attributes.get("name", "")

    def all(self, tag: str) -> list[Node]:
        """Return the children of a tag."""
        return [child for child in self.children if child.tag == tag]

    def only(self, tag: str) -> Node | None:
        """Return the child of a tag, None without one; of two, readers might take either."""
        found = self.all(tag)
        if len(found) > 1:
            raise MalformedError(f"<{shown(self.tag)}> {shown(self.name)} has several <{tag}>")
        return found[0] if found else None

    def numbers(self, key: str) -> list[float]:
        """Return the doubles that the numbers of an attribute denote."""
        text = self.attributes.get(key)
        try:
            # What else Python takes for spaces separates nothing for other readers.
            return [number(word) for word in re.split("[ \t\r\n]+", (text or "").strip(" \t\r\n"))]
        except MalformedError as cause:
            raise MalformedError(f"{key} of <{shown(self.tag)}>: {cause}") from None

    def number(self, key: str) -> float:
        """Return the double of an attribute that holds one number."""
        values = self.numbers(key)
        if len(values) != 1:
            raise MalformedError(f"{key} of <{shown(self.tag)}> has {len(values)} numbers, not 1")
        return values[0]


def by_name(nodes: list[Node], what: str) -> dict[str, Node]:
    """Return elements by name; of two with one name, readers might take either."""
    found = {node.name: node for node in nodes}
    if len(nodes) > _MOST_NAMES:
        raise MalformedError(f"it has {len(nodes)} {what}, at most {_MOST_NAMES} are read")
    if len(found) != len(nodes):
        raise MalformedError(f"several of its {what} have the same name")
    return found


def parse(source: str | bytes) -> Node:
    """Return the root element of an XML text, or of a file's bytes; MalformedError where none."""
    data = source.encode("utf-8") if isinstance(source, str) else source
    if len(data) > _LARGEST:
        raise MalformedError(f"it has {len(data)} bytes, at most {_LARGEST} are read")
    parser = expat.ParserCreate("utf-8" if isinstance(source, str) else None)
    top = Node("", {})
    stack = [top]

    def start(tag: str, attributes: dict[str, str]) -> None:
        if len(stack) > _DEEPEST:
            raise MalformedError(f"its elements are nested more than {_DEEPEST} deep")
        stack.append(Node(tag, attributes))
        stack[-2].children.append(stack[-1])

    def refuse(*_: object) -> None:
        raise MalformedError("it has a document type, which may define entities")

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: stack.pop()
    parser.StartDoctypeDeclHandler = refuse
    try:
        # White space before the declaration is tolerated by readers, not by this parser.
        parser.Parse(data.lstrip() if data[:1].isspace() else data, True)
    except (expat.ExpatError, LookupError) as cause:
        raise MalformedError(f"it is no well-formed XML ({shown(str(cause))})") from None
    return top.children[0]
