"""What the header of a file claims, checked before memory is given to it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

from sdpid._common.sandbox import memory_limit
from sdpid.errors import DataError

# Deflate compresses at most 1032 times; measured numbers hardly twice. Run lengths have no such
# bound, so a small file that claims much more is taken for damaged or hostile ...
_MOST_COMPRESSION = 1100
# ... but for arrays so small that they do no harm.
_HARMLESS_BYTES = 1 << 25


def check_claim(
    path: Path, name: str, shape: Iterable[int], itemsize: int, *, loaded: bool = True
) -> None:
    """Refuse an array that is larger than its file can hold, or than memory allows.

    Parameters
    ----------
    path : Path
        The file.
    name : str
        What the file calls the array.
    shape : iterable of int
        The shape that the file claims.
    itemsize : int
        Bytes of an entry.
    loaded : bool, optional
        Whether it will be in memory as a whole.

    Raises
    ------
    DataError
        With the size and the limit.
    """
    shape = tuple(int(size) for size in shape)
    size = math.prod(shape) * max(1, itemsize)
    if min(shape, default=0) < 0:
        raise DataError(f"{path}: '{name}' claims the shape {shape}.")
    if size > _HARMLESS_BYTES and size > _MOST_COMPRESSION * (held := path.stat().st_size):
        amount = " × ".join(f"{each:,}" for each in shape)
        raise DataError(
            f"{path}: '{name}' claims {amount} values, {_mega(size)}, in a file of "
            f"{_mega(held)}: the file is damaged, or its header is not honest."
        )
    if loaded:
        check_memory(path, size)


def check_memory(path: Path, size: int) -> None:
    """Refuse a log whose arrays take more bytes than `memory_limit`.

    Raises
    ------
    DataError
        With the size and the limit.
    """
    limit = memory_limit()
    if size > limit:
        raise DataError(
            f"{path}: its arrays take {_mega(size)}, more than the limit of {_mega(limit)}; cut "
            "the log into parts, or thin it."
        )


def _mega(size: int) -> str:
    """Return bytes in MB."""
    return f"{size / 1e6:,.3g} MB" if size < 1e9 else f"{size / 1e9:,.4g} GB"
