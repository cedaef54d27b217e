"""Damaged files: bytes flipped, pieces cut, dropped, doubled or put wrong."""

import re

import numpy as np

from sdpid._common.arrays import Array

_WORDS = (b"nan", b"-1", b"1e308", b'"', b"\n", b",", b"[", b"=", b"\x00")
_EXTREMES = (b"\xff" * 4, b"\xff" * 8, b"\x00\xe1\xf5\x05", b"\x00" * 8, b"\xff\xff\xff\x7f")
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
# What a number may be replaced by: ends of what a double holds, and beyond.
_NUMBERS = (
    *(b"nan", b"inf", b"-inf", b"0", b"-0.0", b"1", b"-1", b"1e308", b"-1e308", b"5e-324", b"1e-9"),
    *(b"1e999", b"1e999999999", b"1e-999999999", b"9" * 400, b"9" * 5000, b"1/0", b"0x10"),
    *(b"", b"true", b"null", b"[]", b"{}", b'"one"', b"1_0", "١".encode(), b"18446744073709551617"),
)
_TOKEN = re.compile(rb"[A-Za-z_]\w*")
_OPENING = (b"[", b"{", b"<a>", b"(", b'"')


def damaged(content: bytes, rng: np.random.Generator, text: bool) -> bytes:
    """Flip bytes, set counts to extremes, cut, drop or double a piece."""
    broken = bytearray(content)
    how = rng.integers(0, 6)
    # Headers are small, so half of the damage is done to the beginning or the end.
    reach = len(content) if rng.random() < 0.5 else min(len(content), 400)
    place = int(rng.integers(0, reach))
    if rng.random() < 0.3:
        place = len(content) - 1 - place
    length = int(rng.integers(1, 1 + min(64, len(content) - place)))
    if how == 0:
        for one in rng.integers(0, reach, rng.integers(1, 5)):
            broken[one] ^= 1 << int(rng.integers(0, 7 if text else 8))
    elif how == 1:
        del broken[place:]
    elif how == 2:
        del broken[place : place + length]
    elif how == 3:
        broken[place:place] = broken[place : place + length] * int(rng.integers(1, 4))
    elif how == 4:
        choice = _WORDS if text else _EXTREMES
        word = choice[int(rng.integers(0, len(choice)))]
        broken[place : place + len(word)] = word
    else:
        broken[place : place + length] = rng.bytes(length)
    return bytes(broken)


def misspelt(content: bytes, rng: np.random.Generator) -> bytes:
    """Put other numbers, names or lines into a text, or nest it deeply."""
    how = rng.integers(0, 8)
    if how < 4:
        for _ in range(int(rng.integers(1, 4))):
            content = _swapped(content, _NUMBER, _NUMBERS[int(rng.integers(len(_NUMBERS)))], rng)
        return content
    if how < 6:
        others = sorted(set(_TOKEN.findall(content)))
        return _swapped(content, _TOKEN, others[int(rng.integers(len(others)))], rng)
    lines = content.splitlines(keepends=True)
    one, two = rng.integers(0, len(lines), 2)
    if how == 6 and len(lines) > 1:
        if rng.random() < 0.5:
            lines[one], lines[two] = lines[two], lines[one]
        else:
            del lines[one]
        return b"".join(lines)
    deep = _OPENING[int(rng.integers(len(_OPENING)))] * int(10 ** rng.uniform(0.0, 5.0))
    return _swapped(content, _NUMBER, deep, rng)


def spoiled(channels: dict[str, Array], rng: np.random.Generator) -> dict[str, Array]:
    """Return a log's channels ``t``, ``q``, ``dq``, ``tau`` as sensors and loggers spoil them."""
    result = {name: values.copy() for name, values in channels.items()}
    name = str(rng.choice(["q", "dq", "tau"]))
    column, rows = result[name][:, rng.integers(result[name].shape[1])], len(result["t"])
    first, length = int(rng.integers(rows)), int(2 ** rng.uniform(0.0, np.log2(rows)))
    how = int(rng.integers(7))
    if how == 0:
        column[first : first + length] = column[first]
    elif how == 1:
        column[first] += 10.0 ** rng.uniform(-3.0, 12.0) * rng.choice([-1.0, 1.0])
    elif how == 2:
        column[:] = column.round(int(rng.integers(-2, 3)))
    elif how == 3:
        result["t"] *= 10.0 ** rng.uniform(-6.0, 6.0)
    elif how == 4:
        shift = int(rng.integers(1, rows))
        column[:] = np.r_[np.full(shift, column[0]), column[:-shift]]
    elif how == 5:
        result[name] = result[name].T if rng.random() < 0.5 else result[name][: rows // 2]
    else:
        column[first] = rng.choice([np.nan, np.inf, -np.inf, 0.0])
    return result


def _swapped(
    content: bytes, pattern: re.Pattern[bytes], new: bytes, rng: np.random.Generator
) -> bytes:
    """Replace one match of a pattern."""
    found = list(pattern.finditer(content))
    if not found:
        return content + new
    match = found[int(rng.integers(len(found)))]
    return content[: match.start()] + new + content[match.end() :]
