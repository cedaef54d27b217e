"""Columns that stay in their Parquet file and are decoded piece by piece where they are read."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from threading import Lock
from typing import Any, TypeVar

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.recording import stored_file
from sdpid.experiment.recording.stored_file import StoredFile

__all__ = ["StoredColumn", "StoredTable"]

T = TypeVar("T")


class _Stored(NDArrayOperatorsMixin):
    """What is read into an array wherever a calculation needs one."""

    dtype = np.dtype(np.float64)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **how: Any) -> Any:
        """Calculate with arrays."""
        arrays = [np.asarray(each) if isinstance(each, _Stored) else each for each in inputs]
        return getattr(ufunc, method)(*arrays, **how)


class StoredColumn(_Stored):
    """One column of a file: as long as it, sliced into arrays, never held as a whole.

    Reading on where the last reading ended costs nothing beside the decoding; reading from
    further back decodes the row group again, unless it is among the pieces kept.

    Parameters
    ----------
    file : StoredFile
        The file.
    index : int
        Which column.
    """

    ndim = 1

    def __init__(self, file: StoredFile, index: int) -> None:
        self._file, self._index = file, index
        self._said: dict[Any, Any] = {}
        self._rewind()

    def _rewind(self) -> None:
        self._pieces: deque[tuple[int, Array]] = deque()
        self._batches: Iterator[tuple[int, Array]] | None = None
        self._next, self._last, self._kept = 0, 0, 2 * stored_file.ROWS
        self._lock = Lock()

    def __getstate__(self) -> tuple[StoredFile, int]:
        return self._file, self._index

    def __setstate__(self, state: tuple[StoredFile, int]) -> None:
        self._file, self._index = state
        self._said = {}
        self._rewind()

    @property
    def shape(self) -> tuple[int]:
        """``(N,)``."""
        return (self._file.rows,)

    @property
    def size(self) -> int:
        """Number of rows, N."""
        return self._file.rows

    def __len__(self) -> int:
        return self._file.rows

    def __getitem__(self, key: Any) -> Any:
        """Return an array for a slice or for indices, a number for one index."""
        if isinstance(key, slice):
            start, stop, step = key.indices(self.size)
            if step == 1:
                return self._read(start, max(start, stop))
            if step > 1 and stop > start:
                return self._read(start, stop)[::step]
            return self[np.arange(start, stop, step)]
        if isinstance(key, (int, np.integer)):
            row = range(self.size)[key]
            return self._read(row, row + 1)[0]
        rows = np.asarray(key)
        rows = np.flatnonzero(rows) if rows.dtype == np.bool_ else rows
        out = np.empty(rows.shape)
        for begin, values in self.blocks():
            here = (rows >= begin) & (rows < begin + values.size)
            out[here] = values[rows[here] - begin]
        return out

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Return all of it as an array."""
        if copy is False:
            raise ValueError("a stored column is not an array yet: a copy is needed")
        return self._read(0, self.size).astype(dtype or self.dtype, copy=False)

    def blocks(self) -> Iterator[tuple[int, Array]]:
        """Yield the first rows and the values of pieces that together are the column."""
        return self._file.batches(self._index, 0)

    def remembered(self, action: Callable[[StoredColumn], T]) -> T:
        """Return what an action says of the column, asked once."""
        if action not in self._said:
            self._said[action] = action(self)
        said: T = self._said[action]
        return said

    def min(self, axis: int | None = None, out: None = None) -> float:
        """Return the least value; the arguments are those that NumPy gives."""
        return self._extremes[0]

    def max(self, axis: int | None = None, out: None = None) -> float:
        """Return the largest value."""
        return self._extremes[1]

    def mean(self, axis: int | None = None, dtype: None = None, out: None = None) -> float:
        """Return the mean, from a pass over the file."""
        return float(sum(float(values.sum()) for _, values in self.blocks()) / self.size)

    @cached_property
    def _extremes(self) -> tuple[float, float]:
        """The least and the largest value, as the file says, else from a pass over it."""
        metadata, lows, highs = self._file.metadata, [], []
        for g in range(metadata.num_row_groups):
            said = metadata.row_group(g).column(self._index).statistics
            if said is None or not said.has_min_max:
                break
            lows.append(float(said.min))
            highs.append(float(said.max))
        else:
            return min(lows), max(highs)
        each = [(float(values.min()), float(values.max())) for _, values in self.blocks()]
        return min(low for low, _ in each), max(high for _, high in each)

    def _read(self, start: int, stop: int) -> Array:
        """Return the rows from `start` on, before `stop`; read-only where it is not a copy."""
        with self._lock:
            if start >= stop:
                return np.empty(0)
            begin, values = self._piece(start, start)
            self._last = start
            if stop <= begin + values.size:
                return values[start - begin : stop - begin]
            out = np.empty(stop - start)
            at = start
            while at < stop:
                begin, values = self._piece(at, start)
                part = values[at - begin : stop - begin]
                out[at - start : at - start + part.size] = part
                at += part.size
            return out

    def _piece(self, row: int, start: int) -> tuple[int, Array]:
        """Return the piece with a row, decoding on from where the last one ended if possible."""
        for begin, values in self._pieces:
            if begin <= row < begin + values.size:
                return begin, values
        starts = self._file.starts
        group = bisect_right(starts, row) - 1
        if self._batches is None or not starts[group] <= self._next <= row:
            if self._batches is not None and self._last <= start:
                # It overlaps the reading before: keep what the next one will want again.
                self._kept = max(self._kept, self._next - start + stored_file.ROWS)
            self._batches, self._next = self._file.batches(self._index, group), starts[group]
            self._pieces.clear()
        for begin, values in self._batches:
            self._pieces.append((begin, values))
            self._next = begin + values.size
            while self._next - self._pieces[0][0] - self._pieces[0][1].size > self._kept:
                self._pieces.popleft()
            if row < self._next:
                return begin, values
        raise DataError(f"{self._file.path}: has no row {row}.")


class StoredTable(_Stored):
    """Columns of a file as a table: ``table[:, j]`` is a column, ``table[a:b]`` an array.

    Parameters
    ----------
    file : StoredFile
        The file.
    columns : sequence of int
        Which columns of it.
    """

    ndim = 2

    def __init__(self, file: StoredFile, columns: Sequence[int]) -> None:
        self._file, self._columns = file, tuple(columns)

    @property
    def shape(self) -> tuple[int, int]:
        """``(N, n)``."""
        return self._file.rows, len(self._columns)

    @property
    def size(self) -> int:
        """Number of values."""
        return self._file.rows * len(self._columns)

    def __len__(self) -> int:
        return self._file.rows

    def column(self, j: int) -> StoredColumn:
        """Return a column, with a place of its own in the file."""
        return StoredColumn(self._file, self._columns[j])

    def __getitem__(self, key: Any) -> Any:
        """Return a column or a table for all rows, else an array."""
        rows, which = key if isinstance(key, tuple) else (key, slice(None))
        everything = isinstance(rows, slice) and rows == slice(None)
        if isinstance(which, (int, np.integer)):
            column = self.column(range(len(self._columns))[which])
            return column if everything else column[rows]
        picked = StoredTable(self._file, np.asarray(self._columns)[which].tolist())
        if everything:
            return picked
        each = [picked.column(j)[rows] for j in range(len(picked._columns))]
        return np.stack(each, axis=-1)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Return all of it as an array."""
        if copy is False:
            raise ValueError("a stored table is not an array yet: a copy is needed")
        out = np.empty(self.shape, dtype or self.dtype)
        for j in range(len(self._columns)):
            for begin, values in self.column(j).blocks():
                out[begin : begin + values.size, j] = values
        return out

    def min(self, axis: int | None = None, out: None = None) -> Any:
        """Return the least value of each column (``axis=0``), or of all."""
        return self._over([self.column(j).min() for j in range(self.shape[1])], axis, np.min)

    def max(self, axis: int | None = None, out: None = None) -> Any:
        """Return the largest value of each column (``axis=0``), or of all."""
        return self._over([self.column(j).max() for j in range(self.shape[1])], axis, np.max)

    def mean(self, axis: int | None = None, dtype: None = None, out: None = None) -> Any:
        """Return the mean of each column (``axis=0``), or of all."""
        return self._over([self.column(j).mean() for j in range(self.shape[1])], axis, np.mean)

    @staticmethod
    def _over(each: list[float], axis: int | None, together: Any) -> Any:
        if axis not in (0, None):
            raise ValueError(f"axis: is {axis}, a stored table is reduced over 0 or None")
        return np.array(each) if axis == 0 else together(each)
