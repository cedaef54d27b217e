"""Read JSON that may have been made to deceive: bounded, and nothing in it is overlooked."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

# A certificate of a humanoid with 51 links has 3 MB. Parsed, a file takes some 20 times its size.
MAX_BYTES = 32 * 2**20

# No double has more decimal digits than this before its point or, written out, behind it.
_MAX_DIGITS = 1100

# Names are printed; longer ones hide what stands behind them.
_MAX_NAME = 200


class MalformedError(ValueError):
    """The file is no proof of this version."""


# What a file that makes no sense may cause.
REFUSED = (LookupError, TypeError, AttributeError, ArithmeticError, ValueError, RecursionError)


def shown(name: str) -> str:
    """Return a name in quotes, with every character escaped that a terminal would not print."""
    cut = name if len(name) <= _MAX_NAME else f"{name[:_MAX_NAME]}…"
    return f"'{''.join(map(_escaped, cut))}'"


def listed(words: Iterable[str], most: int = 20) -> str:
    """Return words, of which only some are listed where there are many."""
    every = list(words)
    more = f" and {len(every) - most} more" if len(every) > most else ""
    return ", ".join(every[:most]) + more


def _escaped(c: str) -> str:
    """Return a character as it is seen for what it is, also between quotes."""
    if c in "'\\":
        return f"\\{c}"
    return c if c.isprintable() else c.encode("unicode_escape").decode()


def read_bytes(path: Any, limit: int = MAX_BYTES) -> bytes:
    """Return what is in a regular file; a pipe or a device may never end."""
    file = Path(path)
    if file.exists() and not file.is_file():
        raise MalformedError("it is no regular file")
    if (size := file.stat().st_size) > limit:
        raise MalformedError(f"it has {size} bytes, and {limit} are read at most")
    with file.open("rb") as opened:
        content = opened.read(limit + 1)
    if len(content) > limit:
        raise MalformedError(f"it has more than {limit} bytes")
    return content


def parse(content: bytes) -> dict[str, Any]:
    """Parse a JSON object in which no key occurs twice and every number is finite."""

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        if len(found := dict(pairs)) < len(pairs):
            raise MalformedError("a key occurs twice")
        return found

    def bounded(literal: str) -> str:
        if len(literal) > _MAX_DIGITS:
            raise MalformedError(f"a number has {len(literal)} characters")
        return literal

    def finite(literal: str) -> Any:
        return numbers(float(bounded(literal)))

    try:
        data = json.loads(
            content.decode("utf-8"),
            object_pairs_hook=unique,
            parse_int=lambda literal: int(bounded(literal)),
            parse_float=finite,
            parse_constant=finite,
        )
    except RecursionError:
        raise MalformedError("it is nested too deeply") from None
    if type(data) is not dict:
        raise MalformedError("it is no JSON object")
    return data


def require_schema(data: dict[str, Any], schema: str, *versions: int) -> None:
    """Refuse another schema or version."""
    given = data.get("version")
    # True and 3.0 equal integers.
    if data.get("schema") != schema or type(given) is not int or given not in versions:
        found = f"{shown(str(data.get('schema')))}, version {shown(str(given))}"
        known = " or ".join(map(str, versions))
        raise MalformedError(f"not schema {schema}, version {known}, but {found}")


def require_keys(data: Any, expected: Iterable[str], where: str) -> dict[str, Any]:
    """Return an object that has exactly these keys."""
    if type(data) is not dict:
        raise MalformedError(f"{where} is no object")
    if wrong := sorted(data.keys() ^ set(expected)):
        names = ", ".join(map(shown, wrong))
        raise MalformedError(f"{where} has keys that are missing or not known: {names}")
    return data


def items(value: Any, where: str) -> list[Any]:
    """Return a list."""
    if type(value) is not list:
        raise MalformedError(f"{where} is no list")
    return value


def text(value: Any, where: str) -> str:
    """Return a text."""
    if type(value) is not str:
        raise MalformedError(f"{where} is no text")
    return value


def names(value: Any, count: int, where: str) -> list[str]:
    """Return a list of so many texts, no two of them alike."""
    found = [text(each, where) for each in items(value, where)]
    if len(found) != count or len(set(found)) != count:
        raise MalformedError(f"{where} are not {count} different names")
    return found


def numbers(value: Any, *shape: int) -> Any:
    """Return finite doubles, in nested lists of the given shape."""
    if shape:
        if type(value) is not list or len(value) != shape[0]:
            raise MalformedError(f"expected a list of {shape[0]} items")
        return [numbers(item, *shape[1:]) for item in value]
    if type(value) not in (int, float) or not math.isfinite(value):
        raise MalformedError(f"{value!r:.80} is not a finite number")
    return float(value)


def index(value: Any, count: int) -> int:
    """Return an integer from 0 up to, but not, count."""
    if type(value) is not int or not 0 <= value < count:
        raise MalformedError(f"{value!r:.80} is not an integer from 0 to {count - 1}")
    return value


def digest(data: dict[str, Any], unsealed: Iterable[str] = ("metadata", "sha256")) -> str:
    """Return the SHA-256 of an object without some keys, in one way of writing it down."""
    sealed = {key: value for key, value in data.items() if key not in unsealed}
    written = json.dumps(sealed, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(written.encode("ascii")).hexdigest()
