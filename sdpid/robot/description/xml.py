"""Read robot descriptions as XML: decode, parse safely, and encode them again."""

from __future__ import annotations

import codecs
import os
import re
import unicodedata
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sdpid._common.files import Source, read_regular
from sdpid.errors import ModelError

# The largest robot description seen in the wild is below 1 MB; this bounds a hostile one.
MAX_BYTES = 64 * 2**20

# Unicode categories that names must not have: names are printed, and could forge lines.
_CONTROLS = ("Cc", "Zl", "Zp")

_BYTE_ORDER_MARK = "\ufeff"
_DECLARATION = re.compile(r"^\ufeff?\s*<\?xml\s[^>]*?\?>")
_ENCODING = re.compile(r"\sencoding\s*=\s*[\"']([A-Za-z][\w.:-]*)[\"']", re.ASCII)


@dataclass(frozen=True)
class Description:
    """The text of a robot description and its source.

    Attributes
    ----------
    text : str
        Every character, a byte order mark included; `encode_xml` returns the file's bytes.
    path : Path or None
        The file, None for text.
    what : str
        What it is called in messages.
    source : Source or None
        The file's name, size and SHA-256; of text those of its UTF-8, without a name.
    """

    text: str
    path: Path | None
    what: str
    source: Source | None = None


def is_xml(source: object) -> bool:
    """Return whether a source is XML text rather than a name or a path."""
    return isinstance(source, str) and source.lstrip("\ufeff \t\r\n").startswith("<")


def read_description(source: str | os.PathLike[str]) -> Description:
    """Return a description from a file, or from its text.

    Raises
    ------
    ModelError
        When the file cannot be read, is larger than 64 MiB, or its bytes are not in the encoding
        that it declares.
    """
    if isinstance(source, str) and is_xml(source):
        origin = Source.of_bytes(source.encode("utf-8", "surrogatepass"), "")
        return Description(source, None, "description", origin)
    path = Path(source)
    data = read_regular(path, MAX_BYTES, ModelError)
    origin = Source.of_bytes(data, path.name)
    return Description(decode_xml(data, path.name), path, path.name, origin)


def decode_xml(data: bytes, what: str) -> str:
    """Return the text of an XML document in the encoding of its byte order mark or declaration.

    Raises
    ------
    ModelError
        When the encoding is unknown or the bytes are not in it.
    """
    if data.startswith((codecs.BOM_UTF16_LE, b"<\0")):
        encoding = "utf-16-le"
    elif data.startswith((codecs.BOM_UTF16_BE, b"\0<")):
        encoding = "utf-16-be"
    else:
        # All that a declaration consists of is the same in ASCII and what extends it.
        encoding = _declared_encoding(data[:200].decode("utf-8", "replace"))
    try:
        return data.decode(encoding)
    except (LookupError, UnicodeError) as cause:
        raise ModelError(
            f"cannot read {what}: it is not {encoding.upper()} text ({cause}); save it as UTF-8, "
            'or declare its encoding in the first line: <?xml version="1.0" encoding="..."?>.'
        ) from None


def encode_xml(text: str) -> bytes:
    """Return the bytes of an XML document in the encoding that it declares.

    UTF-16 is written with the low byte first, whatever the source's order was.

    Raises
    ------
    ModelError
        When the encoding is not known.
    """
    encoding = _declared_encoding(text)
    if codecs.lookup(encoding).name == "utf-16":
        encoding = "utf-16-le"
    try:
        return text.encode(encoding, "xmlcharrefreplace")
    except UnicodeError as cause:
        raise ModelError(
            f"XML: cannot be written in its encoding '{encoding}' ({cause})."
        ) from None


def _declared_encoding(text: str) -> str:
    """Return the name of the encoding that an XML text declares, UTF-8 by default."""
    declaration = _DECLARATION.match(text)
    found = _ENCODING.search(declaration.group()) if declaration else None
    encoding = found.group(1) if found else "utf-8"
    try:
        "".encode(encoding)
    except (LookupError, UnicodeError):
        raise ModelError(
            f"XML: the encoding '{encoding}' is not known; save the file as UTF-8."
        ) from None
    marked = text.startswith(_BYTE_ORDER_MARK) and not encoding.lower().startswith("utf-16")
    return "utf-8" if marked else encoding


def undeclared(text: str) -> str:
    """Return an XML text without byte order mark, leading space and declaration.

    Its declared encoding is that of a file and no longer that of the text.
    """
    return _DECLARATION.sub("", text, count=1).lstrip("\ufeff \t\r\n")


def parse_xml(text: str | bytes, what: str) -> Any:
    """Return the root element of an XML document. No entity is expanded, no network is used.

    Parameters
    ----------
    text : str or bytes
        The document.
    what : str
        What it is called in messages.

    Raises
    ------
    ModelError
        When it is not well-formed, declares a document type, is larger than 64 MiB, or has a name
        with a line end or another control character in it.
    """
    from lxml import etree

    if isinstance(text, bytes):
        text = decode_xml(text, what)
    # Line numbers in messages are those of the file.
    data = text.removeprefix(_BYTE_ORDER_MARK).lstrip().encode("utf-8", "surrogatepass")
    if len(data) > MAX_BYTES:
        raise ModelError(f"{what}: {len(data)} bytes of XML, more than the {MAX_BYTES} allowed.")
    parser = etree.XMLParser(
        encoding="utf-8", resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False
    )
    try:
        root = etree.fromstring(data, parser)
    except (etree.XMLSyntaxError, ValueError) as cause:
        raise ModelError(f"{what}: not well-formed XML ({cause}).") from None
    if root.getroottree().docinfo.doctype:
        raise ModelError(
            f"{what}: declares a document type; entities are not expanded, remove the declaration."
        )
    for element in root.iter(etree.Element):
        name = element.get("name", "")
        if any(unicodedata.category(c) in _CONTROLS for c in name):
            raise ModelError(
                f"{what}: the name {name!r} of a <{element.tag}> has a line end or another control "
                "character; rename it."
            )
    return root


def xml_text(root: Any, source: str) -> str:
    """Return the text of a document that was parsed from a source and then changed.

    Its byte order mark, declaration and line ends are the source's; white space within tags and
    quotes are those of the serializer.
    """
    from lxml import etree

    declaration = _DECLARATION.match(source)
    mark = _BYTE_ORDER_MARK if source.startswith(_BYTE_ORDER_MARK) else ""
    head = f"{declaration.group()}\n" if declaration else mark
    # With comments before and behind the root.
    nodes = [*reversed([*root.itersiblings(preceding=True)]), root, *root.itersiblings()]
    texts = [etree.tostring(each, encoding="unicode", with_tail=False) for each in nodes]
    text = head + "\n".join(texts)
    if source.endswith("\n"):
        text += "\n"
    return text.replace("\n", "\r\n") if "\r\n" in source else text


def add_child(parent: Any, child: Any, *, last: bool = False) -> None:
    """Add an element to another as its first or its last child, indented."""
    from lxml import etree

    level = 1 + sum(1 for _ in parent.iterancestors())
    etree.indent(child, level=level)
    if not len(parent):
        parent.text, child.tail = "\n" + level * "  ", "\n" + (level - 1) * "  "
    elif last:
        child.tail, parent[-1].tail = parent[-1].tail, parent.text
    else:
        child.tail = parent.text
    parent.insert(len(parent) if last else 0, child)


def is_mjcf(text: str, what: str) -> bool:
    """Return whether a description is MJCF: whether its root element is ``<mujoco>``.

    Raises
    ------
    ModelError
        When it is not well-formed XML.
    """
    return bool(parse_xml(text, what).tag == "mujoco")
