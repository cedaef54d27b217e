"""XML read without trust: no entities, no document type, no network."""

from __future__ import annotations

import unicodedata
from typing import Any

from sdpid.errors import ModelError

# The largest robot description seen in the wild is below 1 MB; this bounds a hostile one.
MAX_BYTES = 64 * 2**20

# Categories of characters that no name needs: names are printed, and would forge lines.
_CONTROLS = ("Cc", "Zl", "Zp")


def parse_xml(text: str | bytes, what: str) -> Any:
    """Return the root element of an XML document.

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

    data = text.encode("utf-8") if isinstance(text, str) else text
    if len(data) > MAX_BYTES:
        raise ModelError(f"{what}: {len(data)} bytes of XML, more than the {MAX_BYTES} allowed.")
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False
    )
    try:
        root = etree.fromstring(data.lstrip(), parser)
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
