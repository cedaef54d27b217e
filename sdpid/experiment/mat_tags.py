"""The structure of a MATLAB file of format 5 or 7, checked before a library follows it.

A reader that trusts the type codes and counts of a damaged file may end the whole process, not
only its own work: of some thousand damaged files, SciPy 1.17 crashes on one.
"""

from __future__ import annotations

import math
import mmap
import struct
import zlib
from pathlib import Path

from sdpid.errors import DataError
from sdpid.experiment.sizes import Budget

__all__ = ["check_tags"]

# A header of 128 bytes comes first; its last two tell the byte order.
_HEADER = 128
_ORDERS = {b"IM": "<", b"MI": ">"}
# Type codes of elements, and bytes an entry of those that hold data.
_INT8, _INT32, _UINT32, _MATRIX, _COMPRESSED = 1, 5, 6, 14, 15
_SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8, 16: 1, 17: 2, 18: 4}
_TEXT = (16, 17, 18)
# Classes of arrays.
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _OPAQUE = 1, 2, 3, 4, 5, 17
_NUMERIC = range(6, 16)
_COMPLEX = 0x0800
_PIECE = 1 << 20
# Cells in cells in cells ...: no log is deeper.
_DEPTH = 16
_MOST_AXES = 32


def check_tags(path: Path, budget: Budget) -> None:
    """Follow every element of a file and check that it is what it says, where it says.

    Compressed variables are unpacked one after the other, each within the budget.

    Raises
    ------
    DataError
        Naming the byte where the structure breaks.
    """
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        order = _ORDERS.get(content[_HEADER - 2 : _HEADER])
        if order is None or len(content) <= _HEADER:
            raise DataError(f"{path}: not a readable MATLAB file (its header is damaged).")
        place = _HEADER
        while place < len(content):
            try:
                kind, begin, end, _ = _tag(order, content, place, len(content))
                if kind == _COMPRESSED:
                    inside = _unpacked(path, content, begin, end, budget)
                    kind, begin, end, _ = _tag(order, inside, 0, len(inside))
                    if kind != _MATRIX:
                        raise ValueError(f"a compressed element of type {kind}")
                    _matrix(order, inside, begin, end, 0)
                    del inside
                    place = _tag(order, content, place, len(content))[2]
                elif kind == _MATRIX:
                    _matrix(order, content, begin, end, 0)
                    place = end
                else:
                    raise ValueError(f"an element of type {kind}")
            except (ValueError, struct.error, zlib.error) as cause:
                raise DataError(
                    f"{path}: the variable at byte {place} is damaged ({cause})."
                ) from None


def _unpacked(path: Path, content: mmap.mmap, begin: int, end: int, budget: Budget) -> bytes:
    """Return what a compressed element holds."""
    unpack = zlib.decompressobj()
    parts, size = [], 0
    for place in range(begin, end, _PIECE):
        piece = content[place : min(place + _PIECE, end)]
        while piece:
            parts.append(unpack.decompress(piece, _PIECE))
            piece = unpack.unconsumed_tail
            size += len(parts[-1])
            budget.take(f"variable at byte {begin - 8}", (size,), 1)
    if not unpack.eof:
        raise ValueError("its compressed data end too soon")
    return b"".join(parts)


def _tag(order: str, data: bytes | mmap.mmap, place: int, limit: int) -> tuple[int, int, int, int]:
    """Return the type of an element, where its data begin and end, and where the next begins."""
    if place + 8 > limit:
        raise ValueError(f"it ends within the element at byte {place}")
    first, count = struct.unpack_from(f"{order}II", data, place)
    if first >> 16:
        count, kind = first >> 16, first & 0xFFFF
        if count > 4:
            raise ValueError(f"a short element of {count} bytes at byte {place}")
        return kind, place + 4, place + 4 + count, place + 8
    begin = place + 8
    end = begin + count
    if end > limit:
        raise ValueError(f"the element at byte {place} claims {count:,} bytes of {limit - begin:,}")
    return first, begin, end, end + -count % 8


def _element(
    order: str, data: bytes | mmap.mmap, place: int, limit: int, allowed: tuple[int, ...]
) -> tuple[int, int, int, int]:
    """Return an element that must be of one of some types."""
    found = _tag(order, data, place, limit)
    if found[0] not in allowed:
        raise ValueError(f"type {found[0]} at byte {place}")
    return found


def _matrix(order: str, data: bytes | mmap.mmap, place: int, limit: int, depth: int) -> None:
    """Check an array between two places."""
    if place == limit:
        # An empty cell or field.
        return
    if depth > _DEPTH:
        raise ValueError(f"more than {_DEPTH} levels of cells and structs")
    _, begin, end, place = _element(order, data, place, limit, (_UINT32,))
    if end - begin != 8:
        raise ValueError("its flags are not two numbers")
    (flags,) = struct.unpack_from(f"{order}I", data, begin)
    kind = flags & 0xFF
    if kind == _OPAQUE and depth == 0:
        # Objects of MATLAB's own, which are listed but never read.
        return
    _, begin, end, place = _element(order, data, place, limit, (_INT32, _UINT32))
    axes = (end - begin) // 4
    if not 2 <= axes <= _MOST_AXES or (end - begin) % 4:
        raise ValueError(f"{axes} axes")
    shape = struct.unpack_from(f"{order}{axes}i", data, begin)
    if min(shape) < 0:
        raise ValueError(f"the shape {shape}")
    count = math.prod(shape)
    place = _element(order, data, place, limit, (_INT8, 16))[3]
    if kind in _NUMERIC or kind == _CHAR:
        allowed = tuple(_SIZES) if kind == _CHAR else tuple(set(_SIZES) - set(_TEXT))
        for _ in range(2 if flags & _COMPLEX and kind != _CHAR else 1):
            code, begin, end, place = _element(order, data, place, limit, allowed)
            held = (end - begin) / _SIZES[code]
            # UTF-8 takes one byte a character or more.
            if held != count and not (code in _TEXT and held >= count):
                raise ValueError(f"{count:,} values are announced, {held:,g} are there")
    elif kind == _CELL:
        _children(order, data, place, limit, count, depth)
    elif kind in (_STRUCT, _OBJECT):
        if kind == _OBJECT:
            place = _element(order, data, place, limit, (_INT8, 16))[3]
        _, begin, end, place = _element(order, data, place, limit, (_INT32, _UINT32))
        if end - begin != 4:
            raise ValueError("no length of names of fields")
        (length,) = struct.unpack_from(f"{order}i", data, begin)
        _, begin, end, place = _element(order, data, place, limit, (_INT8,))
        if length < 1 or (end - begin) % length:
            raise ValueError(f"names of fields of length {length}")
        _children(order, data, place, limit, count * ((end - begin) // length), depth)
    elif kind == _SPARSE and depth == 0:
        # Listed, never read.
        return
    else:
        raise ValueError(f"an array of class {kind}, which is not read")


def _children(
    order: str, data: bytes | mmap.mmap, place: int, limit: int, count: int, depth: int
) -> None:
    """Check the arrays within an array."""
    for _ in range(count):
        _, begin, end, place = _element(order, data, place, limit, (_MATRIX,))
        _matrix(order, data, begin, end, depth + 1)
