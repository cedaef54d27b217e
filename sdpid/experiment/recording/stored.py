"""Memory for logs: checked before it is given, or mapped from temporary files for larger ones."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.sandbox import memory_limit
from sdpid.errors import DataError

# Rows written or read at a time: a megabyte, which stays in the cache while it is worked on.
ROWS = 1 << 17
# Deflate compresses at most 1032 times; measured numbers hardly twice. Run lengths have no such
# bound, so a small file that claims much more is taken for damaged or hostile ...
_MOST_COMPRESSION = 1100
# ... but for arrays so small that they do no harm.
_HARMLESS_BYTES = 1 << 25


class StoredArray(np.memmap[Any, np.dtype[np.float64]]):
    """A read-only array in a temporary file, made by `store`, columns one after the other.

    It behaves as any array. The system takes its pages back where memory is scarce.
    """

    @property
    def mapped(self) -> bool:
        """Whether the values lie in the file; results of calculations do not."""
        return getattr(self, "_mmap", None) is not None


def store(rows: int, columns: int, parts: Iterable[tuple[int, Array]]) -> StoredArray:
    """Write a table to a temporary file and map it into memory.

    Parameters
    ----------
    rows, columns : int
        Shape of the table.
    parts : iterable of (int, (K, columns) ndarray)
        Its rows: the first row of each part, and the values.

    Raises
    ------
    DataError
        When there is no space for it.
    """
    try:
        # The mapping outlives the file, which is unlinked already. Writing through the mapping
        # would end the process on a full disk.
        with tempfile.TemporaryFile(prefix="sdpid-") as file:
            file.truncate(8 * rows * columns)
            for begin, values in parts:
                for j in range(columns):
                    file.seek(8 * (j * rows + begin))
                    file.write(np.ascontiguousarray(values[:, j], dtype=np.float64).data)
            file.flush()
            return StoredArray(file, np.float64, "r", 0, (rows, columns), "F")
    except OSError as cause:
        raise DataError(
            f"a log of {8 * rows * columns / 1e6:.4g} MB does not fit the folder for temporary "
            f"files, {tempfile.gettempdir()} ({cause.strerror}); set TMPDIR to another one."
        ) from None


def blocks(values: Array) -> Iterator[tuple[int, Array]]:
    """Yield the first rows and the values of parts, of `ROWS` rows, that together are an array."""
    for begin in range(0, len(values), ROWS):
        yield begin, np.asarray(values[begin : begin + ROWS])


def middle(count: int, most: int) -> slice:
    """Return at most so many rows, in the middle of a number of rows."""
    first = max(0, (count - most) // 2)
    return slice(first, first + most)


def extremes(table: Array) -> tuple[Array, Array]:
    """Return the least and the largest value of each column of (N, n) finite values, (n,) each."""
    # By columns: NumPy compares a long one several times faster than many short rows.
    low, high = np.array([(column.min(), column.max()) for column in table.T]).T
    return low, high


def transformed(table: Array, function: Callable[[Array], Array]) -> Array:
    """Return ``function(table)``, which works row by row; of a stored table stored again."""
    if not isinstance(table, StoredArray):
        return function(table)
    columns = function(np.array(table[:1], subok=False)).shape[1]
    parts = ((begin, function(values)) for begin, values in blocks(table))
    return store(len(table), columns, parts)


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
