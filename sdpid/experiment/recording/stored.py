"""Arrays that lie in temporary files, mapped into memory, for logs larger than memory."""

from __future__ import annotations

import mmap
import tempfile
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError

# Rows written or read at a time: a megabyte, which stays in the cache while it is worked on.
ROWS = 1 << 17
# What a page fault brings in beside the page, in bytes: the system's largest page.
_AROUND = 1 << 21
# Rows put side by side to find extremes: NumPy compares long rows ten times faster than short ones.
_FOLDED = 64


class StoredArray(np.memmap[Any, np.dtype[np.float64]]):
    """A read-only array in a temporary file, made by `store`, columns one after the other.

    It behaves as any array; the pages that `taken`, `blocks`, `min` and `max` have read are given
    back at once, so that the memory of the process does not grow with the record.
    """

    _address: int = 0

    def __array_finalize__(self, other: Any) -> None:
        super().__array_finalize__(other)
        self._address = getattr(other, "_address", 0)

    @property
    def mapped(self) -> bool:
        """Whether the values lie in the file; results of calculations do not."""
        return getattr(self, "_mmap", None) is not None

    def min(self, axis: Any = None, out: Any = None, **others: Any) -> Any:
        """Return the smallest value of all, or of each column (``axis=0``)."""
        return self._extreme(np.minimum, np.ndarray.min, axis, out, others)

    def max(self, axis: Any = None, out: Any = None, **others: Any) -> Any:
        """Return the largest value of all, or of each column (``axis=0``)."""
        return self._extreme(np.maximum, np.ndarray.max, axis, out, others)

    def _extreme(self, of: np.ufunc, plain: Any, axis: Any, out: Any, others: Any) -> Any:
        """Reduce block by block."""
        if not self.mapped or out is not None or others or axis not in (None, 0):
            return plain(np.asarray(self), axis=axis, out=out, **others)
        table = self if self.ndim == 2 else self.reshape(-1, 1)
        each = [
            of.reduce([of.reduce(values) for _, values in blocks(table[:, j])])
            for j in range(table.shape[1])
        ]
        return np.array(each) if axis == 0 and self.ndim == 2 else of.reduce(each)

    def give_back(self: Any) -> None:
        """Take the pages of these values out of the process's memory; the file keeps them."""
        if self.mapped and self.flags.f_contiguous and hasattr(mmap, "MADV_DONTNEED"):
            begin = self.__array_interface__["data"][0] - self._address
            # A page fault brings pages around it in as well.
            first = max(0, begin - _AROUND) // mmap.PAGESIZE * mmap.PAGESIZE
            self._mmap.madvise(mmap.MADV_DONTNEED, first, begin + self.nbytes - first)


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
            table = StoredArray(file, np.float64, "r", 0, (rows, columns), "F")
    except OSError as cause:
        raise DataError(
            f"a log of {8 * rows * columns / 1e6:.4g} MB does not fit the folder for temporary "
            f"files, {tempfile.gettempdir()} ({cause.strerror}); set TMPDIR to another one."
        ) from None
    table._address = table.__array_interface__["data"][0]
    return table


def taken(values: Array, start: int, stop: int) -> Array:
    """Return some rows of an array; of a stored one a copy, and its pages are given back."""
    part = values[start:stop]
    if not isinstance(part, StoredArray):
        return part
    copy = np.array(part, subok=False)
    for column in part.T if part.ndim > 1 else [part]:
        column.give_back()
    return copy


def blocks(values: Array, rows: int | None = None) -> Iterator[tuple[int, Array]]:
    """Yield the first rows and the values of parts, of `ROWS` rows, that together are an array."""
    rows = ROWS if rows is None else rows
    for begin in range(0, len(values), rows):
        yield begin, taken(values, begin, begin + rows)


def extremes(table: Array) -> tuple[Array, Array]:
    """Return the least and the largest value of each column of (N, n) finite values, (n,) each."""
    if isinstance(table, StoredArray) or not table.flags.c_contiguous:
        return np.asarray(table.min(axis=0)), np.asarray(table.max(axis=0))
    count, n = table.shape
    whole = count - count % _FOLDED
    folded, rest = table[:whole].reshape(-1, _FOLDED * n), table[whole:]

    def extreme(of: np.ufunc) -> Array:
        if not whole:
            return np.asarray(of.reduce(rest))
        found = of.reduce(folded).reshape(_FOLDED, n)
        return np.asarray(of.reduce(np.concatenate([found, rest])))

    return extreme(np.minimum), extreme(np.maximum)


def transformed(table: Array, function: Callable[[Array], Array]) -> Array:
    """Return ``function(table)``, which works row by row; of a stored table stored again."""
    if not isinstance(table, StoredArray):
        return function(table)
    columns = function(np.array(table[:1], subok=False)).shape[1]
    parts = ((begin, function(values)) for begin, values in blocks(table))
    return store(len(table), columns, parts)
