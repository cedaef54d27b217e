"""Edit an XML text in place: all bytes that are not edited stay as they are.

A serializer would change quotes, spaces and line breaks; a comparison with the original should
show the changed numbers and nothing else.
"""

from __future__ import annotations

import codecs
import copy
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from sdpid.errors import ModelError

# A start tag with its attributes; quoted values may hold '>' (and '/' just before it).
_TAG = re.compile(rb"<[^\s/>]+(?:\s+[^\s=>]+\s*=\s*(?:\"[^\"]*\"|'[^']*'))*\s*(/?)>")
_ATTRIBUTE = re.compile(r"(\s)([^\s=>]+)(\s*=\s*)(\"[^\"]*\"|'[^']*')")


@dataclass
class Element:
    """An element and its position in the bytes of a document.

    Attributes
    ----------
    name : str
        The tag.
    attributes : dict
        Its attributes.
    start, tag_end : int
        The start tag's first byte and the byte after its end.
    empty : bool
        Whether the start tag ends in ``/>``.
    end : int
        The byte after the whole element.
    children : list of Element
        In document order.
    """

    name: str
    attributes: dict[str, str]
    start: int
    tag_end: int
    empty: bool
    end: int = 0
    children: list[Element] = field(default_factory=list)

    def find(self, name: str) -> Element | None:
        """Return the first child of that tag."""
        return next((child for child in self.children if child.name == name), None)

    def find_all(self, name: str) -> list[Element]:
        """Return the children of that tag."""
        return [child for child in self.children if child.name == name]


class Document:
    """An XML text and its pending edits.

    Parameters
    ----------
    text : str
        The document. It must have been found well-formed and free of a document type before
        (`sdpid.robot.description.xml.parse_xml`), so that no entity is ever expanded.
    """

    def __init__(self, text: str) -> None:
        self._data = text.encode("utf-8")
        self._edits: list[tuple[int, int, bytes]] = []
        self.root = self._parse()

    def branch(self) -> Document:
        """Return a document with the same edits, to which others are added apart from this one."""
        other = copy.copy(self)
        other._edits = list(self._edits)
        return other

    def _parse(self) -> Element:
        # White space before the declaration is tolerated by the reader, not by the parser.
        mark = len(codecs.BOM_UTF8) * self._data.startswith(codecs.BOM_UTF8)
        shift = len(self._data) - len(self._data[mark:].lstrip())
        data = self._data
        top = Element("", {}, 0, 0, False)
        stack = [top]
        parser = expat.ParserCreate(encoding="utf-8")

        def start(name: str, attributes: dict[str, str]) -> None:
            at = parser.CurrentByteIndex + shift
            match = _TAG.match(data, at)
            if match is None:  # the parser accepted it, so this is a form we do not know
                raise ModelError(f"XML: cannot locate the tag <{name}> at byte {at}.")
            element = Element(name, attributes, at, match.end(), bool(match.group(1)))
            stack[-1].children.append(element)
            stack.append(element)

        def end(_: str) -> None:
            element = stack.pop()
            if element.empty:
                element.end = element.tag_end
            else:
                element.end = data.index(b">", parser.CurrentByteIndex + shift) + 1

        parser.StartElementHandler = start
        parser.EndElementHandler = end
        try:
            parser.Parse(data[shift:], True)
        except expat.ExpatError as cause:
            raise ModelError(f"not well-formed XML ({cause}).") from None
        return top.children[0]

    def indentation(self, element: Element) -> str:
        """Return the white space before an element, if nothing else stands on its line."""
        line = self._data.rfind(b"\n", 0, element.start) + 1
        before = self._data[line : element.start].decode("utf-8")
        return before if not before.strip() else ""

    @property
    def newline(self) -> str:
        """The document's line ending."""
        return "\r\n" if b"\r\n" in self._data else "\n"

    def set_attributes(self, element: Element, values: Mapping[str, str]) -> None:
        """Replace values of attributes where they stand; missing ones are added at the end."""
        tag = self._data[element.start : element.tag_end].decode("utf-8")
        missing = dict(values)

        def replace(match: re.Match[str]) -> str:
            space, name, equals, old = match.groups()
            if name not in missing:
                return match.group(0)
            return f"{space}{name}{equals}{_quoted(missing.pop(name), old[0])}"

        tag = _ATTRIBUTE.sub(replace, tag)
        close = "/>" if element.empty else ">"
        body = tag[: -len(close)]
        for name, value in missing.items():
            stripped = body.rstrip()
            body = f"{stripped} {name}={quoteattr(value)}{body[len(stripped) :]}"
        self._edit(element.start, element.tag_end, body + close)

    def insert_child(self, parent: Element, text: str, *, last: bool = False) -> None:
        """Insert lines of markup as the first or the last child of an element.

        Parameters
        ----------
        parent : Element
            The parent.
        text : str
            Markup; its lines are indented relative to the child itself.
        last : bool, optional
            Whether it goes behind the other children.
        """
        outer = self.indentation(parent)
        inner = self.indentation(parent.children[0]) if parent.children else ""
        if len(inner) <= len(outer):
            inner = outer + "  "
        block = "".join(f"{self.newline}{inner}{line}" for line in text.splitlines())
        if parent.empty:
            tag = self._data[parent.start : parent.tag_end].decode("utf-8")
            opened = tag[:-2].rstrip() + ">"
            ending = f"{self.newline}{outer}</{parent.name}>"
            self._edit(parent.start, parent.tag_end, opened + block + ending)
            return
        at = parent.children[-1].end if last and parent.children else parent.tag_end
        self._edit(at, at, block)

    def replace(self, element: Element, text: str) -> None:
        """Replace a whole element by markup."""
        self._edit(element.start, element.end, text)

    def remove(self, element: Element) -> None:
        """Remove a whole element and the white space before it."""
        self._edit(len(self._data[: element.start].rstrip()), element.end, "")

    def _edit(self, start: int, end: int, text: str) -> None:
        self._edits.append((start, end, text.encode("utf-8")))

    def text(self) -> str:
        """Return the document with all edits made."""
        data = self._data
        # From the back, so that earlier positions stay valid; an insertion right behind a tag
        # that is edited too comes first.
        for start, end, new in sorted(self._edits, key=lambda e: (e[0], e[1]), reverse=True):
            data = data[:start] + new + data[end:]
        return data.decode("utf-8")


def _quoted(value: str, quote: str) -> str:
    """Quote a value with the quotes of the value it replaces."""
    plain = quoteattr(value)[1:-1]
    return f"{quote}{plain}{quote}" if quote not in plain else quoteattr(value)
