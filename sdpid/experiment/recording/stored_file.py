"""A Parquet file of numbers, decoded column by column in small pieces that are checked at once."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid.errors import DataError

__all__ = ["LARGEST", "ROWS", "StoredFile", "numbers", "readable"]

# No robot moves, turns or pulls so much, in SI units, nor since 1970 have so many seconds passed;
# squares of what is below are far from overflow.
LARGEST = 1e12
# Rows decoded at a time: a megabyte, which stays in the cache while it is checked and copied.
ROWS = 1 << 17
# Bytes read from the file at a time, so that the size of row groups is no matter (from 2^15 to 2^23
# rows each, decoding takes as long).
_BUFFER = 1 << 20
# What pyarrow calls plain numbers.
_KINDS = {"double": "f8", "float": "f4"}
_KINDS |= {f"int{8 * k}": f"i{k}" for k in (1, 2, 4, 8)}
_KINDS |= {f"uint{8 * k}": f"u{k}" for k in (1, 2, 4, 8)}


@dataclass(frozen=True, eq=False)
class StoredFile:
    """A Parquet file of numbers, and where its row groups begin.

    Attributes
    ----------
    path : Path
        Where it is.
    names : tuple of str
        Of its columns.
    starts : tuple of int
        First row of each row group, and the number of rows.
    """

    path: Path
    names: tuple[str, ...]
    starts: tuple[int, ...]
    _size_and_time: tuple[int, int]
    _metadata: list[Any] = field(default_factory=list, repr=False)

    @staticmethod
    def of(path: str | os.PathLike[str], metadata: Any, names: Sequence[str]) -> StoredFile:
        """Describe a file whose metadata have been read."""
        counts = [metadata.row_group(g).num_rows for g in range(metadata.num_row_groups)]
        starts = np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]).tolist()
        file = Path(path)
        return StoredFile(file, tuple(names), tuple(starts), _signature(file), [metadata])

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self.starts[-1]

    @property
    def metadata(self) -> Any:
        """What pyarrow knows of the file; read again in another process."""
        if not self._metadata:
            with readable(self.path) as pq:
                self._metadata.append(pq.read_metadata(self.path))
        return self._metadata[0]

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_metadata": []}

    def batches(self, index: int, group: int) -> Iterator[tuple[int, Array]]:
        """Yield first rows and values of a column, from the beginning of a row group on.

        Raises
        ------
        DataError
            When the file changed or is damaged, or a value is missing, not a number, not finite,
            or larger than anything that a robot measures.
        """
        if _signature(self.path) != self._size_and_time:
            raise DataError(f"{self.path}: has changed since it was opened; open it again.")
        name, begin = self.names[index], self.starts[group]
        groups = range(group, len(self.starts) - 1)
        with (
            readable(self.path) as pq,
            pq.ParquetFile(
                self.path, metadata=self.metadata, pre_buffer=False, buffer_size=_BUFFER
            ) as file,
        ):
            for batch in file.iter_batches(
                batch_size=ROWS, row_groups=list(groups), columns=[name], use_threads=False
            ):
                values = _checked(batch.column(0), name, begin, self.path)
                yield begin, values
                begin += values.size
        if begin != self.rows:
            raise DataError(f"{self.path}: holds {begin} rows where {self.rows} are announced.")


class readable:  # noqa: N801 (used as a function)
    """Give pyarrow.parquet, and turn what goes wrong in it into a `DataError`."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = path
        self._arrow = require("pyarrow", extra="io")

    def __enter__(self) -> Any:
        return require("pyarrow.parquet", extra="io")

    def __exit__(self, _: Any, cause: BaseException | None, __: Any) -> None:
        errors = (self._arrow.lib.ArrowException, OSError, ValueError, MemoryError)
        if isinstance(cause, errors) and not isinstance(cause, DataError):
            line = (str(cause).splitlines() or [type(cause).__name__])[0]
            raise DataError(f"{self._path}: not a readable Parquet file ({line}).") from None


def numbers(column: Any, name: str, path: str | os.PathLike[str]) -> NDArray[Any]:
    """Return some rows of a pyarrow column as an array of numbers of any type.

    Raises
    ------
    DataError
        When a value is missing, or they are no numbers.
    """
    if column.null_count:
        raise DataError(f"{path}: column '{name}' has missing values.")
    kind = _KINDS.get(str(column.type))
    if kind is not None and len(column):
        # As to_numpy does, but that loads pandas, which takes a quarter of a second.
        begin = column.offset
        return np.frombuffer(column.buffers()[1], dtype=kind)[begin : begin + len(column)]
    values: NDArray[Any] = column.to_numpy(zero_copy_only=False)
    if values.dtype.kind not in "fiu":
        raise DataError(f"{path}: column '{name}' is not numeric.")
    return values


def _checked(column: Any, name: str, begin: int, path: Path) -> Array:
    """Return some rows of a column as finite float64, or say which is none."""
    values: Array = numbers(column, name, path).astype(np.float64, copy=False)
    # What is not a number is not below the limit either.
    if values.size and not (values.min() >= -LARGEST and values.max() <= LARGEST):
        row = int(np.argmax(~(np.abs(values) <= LARGEST)))
        what = "not finite"
        if np.isfinite(values[row]):
            what = f"more than {LARGEST:g}, which no robot has"
        raise DataError(
            f"{path}: column '{name}' is {values[row]:.3g} at row {begin + row}, {what}; repair "
            "that sample, or remove it."
        )
    values.setflags(write=False)
    return values


def _signature(path: Path) -> tuple[int, int]:
    """Return what changes when a file is written again."""
    try:
        state = path.stat()
    except OSError as cause:
        raise DataError(f"{path}: cannot be read: {cause.strerror}.") from None
    return state.st_size, state.st_mtime_ns
