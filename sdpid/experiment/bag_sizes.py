"""What a ROS bag unpacks to, counted before it is read: the library that reads bags sets no limit.

Chunks of MCAP and of ROS 1 bags, whole files and single messages of ROS 2 may be compressed. Here
every compressed piece is unpacked into nothing, up to the size that it claims, and the claims are
held against the budget. Readers find chunks by an index; one that points anywhere but at a chunk
that was counted is refused.
"""

from __future__ import annotations

import bz2
import contextlib
import io
import sqlite3
import struct
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

from sdpid._extras import require
from sdpid.errors import DataError
from sdpid.experiment.sizes import Budget

__all__ = ["check_bag"]

_MCAP = b"\x89MCAP0\r\n"
_ROS1 = b"#ROSBAG V2.0\n"
_SQLITE = b"SQLite format 3\x00"

# Records of MCAP, and of ROS 1 bags.
_FOOTER, _CHUNK, _CHUNK_INDEX = 2, 6, 8
_ROS1_HEADER, _ROS1_CHUNK, _ROS1_CHUNK_INFO = 3, 5, 6

# What a piece is called in the budget.
_PART = "compressed data"

# Bytes that are unpacked at a time.
_PIECE = 1 << 20

# A record's header of ROS 1, or a message's name of a compression, is no larger.
_SMALL = 1 << 16


def check_bag(path: Path, budget: Budget) -> None:
    """Check what the files of a bag unpack to.

    Parameters
    ----------
    path : Path
        A file, or the folder of a ROS 2 bag.
    budget : Budget
        Of that path.

    Raises
    ------
    DataError
        When a piece unpacks to more than it says, all pieces to more than the budget allows, or an
        index points elsewhere.
    """
    if not path.is_dir():
        _check_file(path, budget)
        return
    mode = _mode(path / "metadata.yaml")
    for file in sorted(path.iterdir()):
        if not file.is_file() or file.name == "metadata.yaml":
            continue
        if mode == "file":
            with file.open("rb") as stream:
                _count(file, "the file", stream.read, None, budget, "zstd")
            # What is in it is counted as it is unpacked once more.
            with _unpacked(file) as inner:
                _check_stream(file, inner, budget)
        else:
            _check_file(file, budget, packed=mode == "message")


def _mode(metadata: Path) -> str:
    """Return what of a folder's bag is compressed: nothing, files or messages."""
    try:
        yaml = require("ruamel.yaml", extra="ros").YAML(typ="safe")
        told = yaml.load(metadata.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
        return str(told.get("compression_mode") or "").lower()
    except DataError:
        raise
    except Exception:  # the reader itself says what is wrong with it
        return ""


def _unpacked(file: Path) -> contextlib.AbstractContextManager[BinaryIO]:
    opened: contextlib.AbstractContextManager[BinaryIO] = _zstd().open(file, "rb")
    return opened


def _check_file(path: Path, budget: Budget, *, packed: bool = False) -> None:
    try:
        with path.open("rb") as stream:
            start = stream.read(len(_SQLITE))
            stream.seek(0)
            if start == _SQLITE and packed:
                _check_messages(path, budget)
            elif start != _SQLITE and packed:
                raise DataError(
                    f"{path}: its messages are compressed one by one, which is only read from "
                    "db3 files; write the bag anew without (ros2 bag convert)."
                )
            else:
                _check_stream(path, stream, budget)
    except OSError as cause:
        raise DataError(f"cannot read {path}: {cause.strerror}.") from None


def _check_stream(path: Path, stream: BinaryIO, budget: Budget) -> None:
    start = stream.read(len(_ROS1))
    stream.seek(0)
    with contextlib.suppress(_EndedError):
        if start.startswith(_MCAP):
            _check_mcap(path, stream, budget)
        elif start == _ROS1:
            _check_ros1(path, stream, budget)


class _EndedError(Exception):
    """The file ends within a record: the reader itself says so."""


def _exactly(stream: BinaryIO, size: int) -> bytes:
    found = stream.read(size)
    if len(found) < size:
        raise _EndedError
    return found


def _check_mcap(path: Path, stream: BinaryIO, budget: Budget) -> None:
    """Walk over the records of an MCAP file."""
    stream.seek(len(_MCAP))
    end = stream.seek(0, 2)
    stream.seek(len(_MCAP))
    records: set[int] = set()
    chunks: dict[int, tuple[int, int, str]] = {}
    while (at := stream.tell()) + 9 <= end - len(_MCAP):
        kind, size = struct.unpack("<BQ", _exactly(stream, 9))
        after = at + 9 + size
        if after > end:
            raise _EndedError
        records.add(at)
        if kind == _CHUNK:
            claimed = struct.unpack("<16xQ4x", _exactly(stream, 28))[0]
            name = _name(path, stream)
            length = struct.unpack("<Q", _exactly(stream, 8))[0]
            if stream.tell() + length > after:
                raise _EndedError
            chunks[at] = claimed, length, name
            where = f"chunk at byte {at}"
            _count(path, where, partial(_some, stream, [length]), claimed, budget, name)
        elif kind == _CHUNK_INDEX:
            start = struct.unpack("<16xQ8x", _exactly(stream, 32))[0]
            pairs = struct.unpack("<I", _exactly(stream, 4))[0]
            stream.seek(pairs + 8, 1)
            name = _name(path, stream)
            length, claimed = struct.unpack("<QQ", _exactly(stream, 16))
            if chunks.get(start) != (claimed, length, name):
                raise DataError(
                    f"{path}: its index points at byte {start} for a chunk of {claimed:,} bytes; "
                    "there is no such chunk: the file is damaged."
                )
        elif kind == _FOOTER:
            summary = struct.unpack("<Q", _exactly(stream, 8))[0]
            if summary and summary not in records:
                raise DataError(
                    f"{path}: its summary is said to be at byte {summary}, where no record "
                    "begins: the file is damaged."
                )
        stream.seek(after)


def _name(path: Path, stream: BinaryIO) -> str:
    size = struct.unpack("<I", _exactly(stream, 4))[0]
    if size > _SMALL:
        raise DataError(f"{path}: names a compression with {size:,} letters: it is damaged.")
    return _exactly(stream, size).decode("utf-8", errors="replace")


def _some(stream: BinaryIO, left: list[int], size: int) -> bytes:
    """Read up to so many of the bytes that are left."""
    found = stream.read(min(size, left[0]))
    left[0] -= len(found)
    return found


def _check_ros1(path: Path, stream: BinaryIO, budget: Budget) -> None:
    """Walk over the records of a ROS 1 bag."""
    end = stream.seek(0, 2)
    stream.seek(len(_ROS1))
    records: set[int] = set()
    chunks: set[int] = set()
    while (at := stream.tell()) < end:
        fields = _fields(path, stream)
        size = struct.unpack("<I", _exactly(stream, 4))[0]
        after = stream.tell() + size
        if after > end:
            raise _EndedError
        records.add(at)
        kind = fields.get(b"op", b"\0")[0]
        if kind == _ROS1_CHUNK:
            chunks.add(at)
            claimed = struct.unpack("<I", fields.get(b"size", b"").ljust(4, b"\0")[:4])[0]
            name = fields.get(b"compression", b"none").decode("ascii", errors="replace")
            where = f"chunk at byte {at}"
            name = "" if name == "none" else name
            _count(path, where, partial(_some, stream, [size]), claimed, budget, name)
        elif kind == _ROS1_CHUNK_INFO:
            start = struct.unpack("<Q", fields.get(b"chunk_pos", b"").ljust(8, b"\0")[:8])[0]
            if start not in chunks:
                raise DataError(
                    f"{path}: its index points at byte {start}, where there is no chunk: the file "
                    "is damaged."
                )
        stream.seek(after)


def _fields(path: Path, stream: BinaryIO) -> dict[bytes, bytes]:
    """Return the fields of a record's header."""
    size = struct.unpack("<I", _exactly(stream, 4))[0]
    if size > _SMALL:
        raise DataError(f"{path}: has a header of {size:,} bytes: it is damaged.")
    raw, fields = _exactly(stream, size), {}
    while len(raw) >= 4:
        length = struct.unpack("<I", raw[:4])[0]
        key, equals, value = raw[4 : 4 + length].partition(b"=")
        if equals:
            fields[key] = value or b"\0"
        raw = raw[4 + length :]
    return fields


def _check_messages(path: Path, budget: Budget) -> None:
    """Count what the messages of a database unpack to."""
    try:
        name = f"{path.resolve().as_uri()}?mode=ro"
        with contextlib.closing(sqlite3.connect(name, uri=True)) as file:
            for number, (data,) in enumerate(file.execute("SELECT data FROM messages"), 1):
                _count(path, f"message {number}", io.BytesIO(data).read, None, budget, "zstd")
    except sqlite3.Error:
        return  # the reader itself says what is wrong with it


def _zstd() -> Any:
    return require("rosbags.rosbag2.reader", extra="ros").zstd


def _unpackers(name: str) -> Callable[[], Any] | None:
    """Return what makes an unpacker of a compression, None where nothing is compressed."""
    if name == "zstd":
        return _zstd().ZstdDecompressor  # type: ignore[no-any-return]
    if name == "lz4":
        return require("lz4.frame", extra="ros").LZ4FrameDecompressor  # type: ignore[no-any-return]
    return bz2.BZ2Decompressor if name == "bz2" else None


def _count(
    path: Path,
    where: str,
    read: Callable[[int], bytes],
    claimed: int | None,
    budget: Budget,
    name: str,
) -> None:
    """Unpack a piece into nothing, up to what it claims, or to what the budget allows.

    Pieces are read one after another, so that each may take all of the budget.
    """
    if claimed is not None:
        budget.take(_PART, (claimed,), 1)
    make = _unpackers(name)
    if make is None:
        return
    size = 0
    for part in _parts(make, read):
        size += part
        if claimed is None:
            budget.take(_PART, (size,), 1)
        elif size > claimed:
            raise DataError(
                f"{path}: the {where} claims {claimed:,} bytes and unpacks to more: the file is "
                "damaged, or its header is not honest."
            )


def _parts(make: Callable[[], Any], read: Callable[[int], bytes]) -> Iterator[int]:
    """Yield how many bytes come out, piece by piece; what is damaged ends it."""
    unpacker, given = make(), b""
    while True:
        if not given:
            given = read(_PIECE)
            if not given and unpacker.needs_input:
                return
        try:
            found = unpacker.decompress(given, _PIECE)
        except Exception:  # the reader itself says what is wrong with it
            return
        given = b""
        yield len(found)
        if unpacker.eof:
            given = unpacker.unused_data or b""
            if not given and not (given := read(_PIECE)):
                return
            unpacker = make()
        elif not unpacker.needs_input:
            continue
