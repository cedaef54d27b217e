"""Text that comes from files, made safe to print."""

from __future__ import annotations

import unicodedata

# Characters that a terminal obeys instead of showing: controls (escape sequences begin with one),
# format characters (they reverse the order of a line, or have no width), line and paragraph
# separators, and halves of surrogate pairs.
_OBEYED = frozenset({"Cc", "Cf", "Zl", "Zp", "Cs"})

_REPLACEMENT = "\ufffd"


def printable(text: str, *, keep: str = "") -> str:
    """Return text with every character that a terminal would obey replaced by U+FFFD.

    Parameters
    ----------
    text : str
        The text to print.
    keep : str, optional
        Characters that stay, such as line ends in text of several lines.
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(
        c if c in keep or unicodedata.category(c) not in _OBEYED else _REPLACEMENT for c in text
    )
