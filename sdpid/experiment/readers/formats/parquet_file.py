"""Parquet files: columns of numbers, lists one row a sample, and what `to_parquet` wrote."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid.errors import DataError
from sdpid.experiment.readers.columns import LogTable
from sdpid.experiment.recording.recording import CHANNELS, FORMAT, KEY
from sdpid.experiment.recording.stored import ROWS, check_claim, store

# Logs that would take more bytes than this are kept in temporary files.
LARGE = 1 << 28
# Bytes read from the file at a time, so that the size of row groups is no matter.
_BUFFER = 1 << 20
_MOST_JOINTS = 10_000
# What pyarrow calls plain numbers.
_KINDS = {"double": "f8", "float": "f4"}
_KINDS |= {f"{sign}int{8 * k}": f"{sign or 'i'}{k}" for sign in ("", "u") for k in (1, 2, 4, 8)}

_Arrays = dict[str, Callable[[], NDArray[Any]]]


def load_parquet(path: Path, *, stored: bool | None = None) -> LogTable:
    """List the columns of a Parquet file, and what `Recording.to_parquet` kept beside them.

    Parameters
    ----------
    path : Path
        The file.
    stored : bool, optional
        Whether to keep columns of numbers in temporary files; by default those of logs that would
        take more than 256 MB.

    Raises
    ------
    DataError
        When the file is damaged.
    MissingExtraError
        When pyarrow is not installed (extra ``io``).
    """
    file = _ParquetFile(path)
    plain = frozenset(name for name, kind in file.kinds.items() if kind in _KINDS)
    if stored is None:
        stored = 8 * file.rows * len(plain) > LARGE
    several = partial(file.numbers, stored=stored)
    arrays: _Arrays = {name: partial(file.any, name) for name in file.kinds}
    arrays |= {name: partial(_first, several, name) for name in plain}
    if KEY not in file.metadata:
        return LogTable(arrays, columns=several, plain=plain)
    recorded, stated = _recorded(file.metadata[KEY], plain, several)
    arrays |= recorded
    return LogTable(arrays, columns=several, plain=plain, units={"time": "s"}, stated=stated)


def _first(several: Callable[[Sequence[str]], Array], name: str) -> Array:
    """Read a single column."""
    return several([name])[:, 0]


class _ParquetFile:
    """An open Parquet file; whatever goes wrong in it is a `DataError`."""

    def __init__(self, path: Path) -> None:
        self._path, self._pa = path, require("pyarrow", extra="io")
        parquet = require("pyarrow.parquet", extra="io")
        with self._refused_if_damaged():
            # Buffered ahead, the whole file would be in memory beside the arrays.
            self._file = parquet.ParquetFile(path, pre_buffer=False, buffer_size=_BUFFER)
            schema = self._file.schema_arrow
        self.kinds = {field.name: str(field.type) for field in schema}
        if len(self.kinds) != len(schema):
            raise DataError("has several columns of one name.")
        self.rows: int = self._file.metadata.num_rows
        self.metadata: Mapping[bytes, bytes] = schema.metadata or {}

    def numbers(self, names: Sequence[str], *, stored: bool) -> Array:
        """Return columns of numbers as a table; NaN where they lack values."""
        shape = (self.rows, len(names))
        for name in names:
            check_claim(self._path, name, (self._held(name),), 8, loaded=not stored)
        if stored:
            return store(*shape, self._parts(names))
        check_claim(self._path, ", ".join(names), shape, 8)
        table = np.empty(shape)
        for begin, values in self._parts(names):
            table[begin : begin + len(values)] = values
        return table

    def any(self, name: str) -> NDArray[Any]:
        """Return a column of lists, times or anything else."""
        check_claim(self._path, name, (self._held(name),), 8)
        where = f"column '{name}'"
        with self._refused_if_damaged():
            values = self._file.read(columns=[name]).column(0).combine_chunks()
            if values.null_count:
                raise DataError(f"{where} has {values.null_count} missing values.")
            types = self._pa.types
            if not (types.is_list(values.type) or types.is_fixed_size_list(values.type)):
                return np.asarray(values.to_numpy(zero_copy_only=False))
            if not len(values):
                raise DataError(f"{where} has no rows.")
            lengths = values.value_lengths().to_numpy(zero_copy_only=False)
            least, most = lengths.min(), lengths.max()
            if least != most:
                raise DataError(f"{where} is ragged: its rows have {least} to {most} entries.")
            flat = np.asarray(values.flatten().to_numpy(zero_copy_only=False))
            return flat.reshape(len(values), int(most))

    def _parts(self, names: Sequence[str]) -> Iterator[tuple[int, Array]]:
        """Yield the first rows and the values of parts of some columns."""
        begin = 0
        with self._refused_if_damaged():
            for batch in self._file.iter_batches(batch_size=ROWS, columns=list(names)):
                values = np.empty((batch.num_rows, len(names)), order="F")
                for j, name in enumerate(names):
                    values[:, j] = _values(batch.column(batch.schema.get_field_index(name)))
                yield begin, values
                begin += batch.num_rows
        if begin != self.rows:
            raise DataError(f"holds {begin} rows where {self.rows} are announced.")

    def _held(self, name: str) -> int:
        """Return how many values a column claims: run lengths may stand for any number."""
        metadata, count = self._file.metadata, 0
        for group in map(metadata.row_group, range(metadata.num_row_groups)):
            for chunk in map(group.column, range(group.num_columns)):
                if chunk.path_in_schema.split(".")[0] == name:
                    count += max(chunk.num_values, group.num_rows)
        return count

    @contextmanager
    def _refused_if_damaged(self) -> Iterator[None]:
        """Refuse a file that pyarrow cannot read."""
        try:
            yield
        except (self._pa.lib.ArrowException, OSError, ValueError, MemoryError) as cause:
            line = (str(cause).splitlines() or [type(cause).__name__])[0]
            raise DataError(f"not a readable Parquet file ({line}).") from None


def _values(column: Any) -> NDArray[Any]:
    """Return some rows of a pyarrow column of numbers; NaN where values are missing."""
    if column.null_count or not len(column):
        return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)
    # As to_numpy does, but that loads pandas, which takes a quarter of a second.
    begin, kind = column.offset, _KINDS[str(column.type)]
    return np.frombuffer(column.buffers()[1], dtype=kind)[begin : begin + len(column)]


def _recorded(
    raw: bytes, plain: Collection[str], several: Callable[[Sequence[str]], Array]
) -> tuple[_Arrays, dict[str, Any]]:
    """Return the arrays that `Recording.to_parquet` wrote, and what it kept of IMU and contacts.

    Raises
    ------
    DataError
        When its metadata are damaged or of a later format, or a column is missing.
    """
    try:
        stated = json.loads(raw)
    except (ValueError, RecursionError):
        stated = None
    damage = "the metadata under 'sdpid' is damaged"
    if not isinstance(stated, dict):
        raise DataError(f"{damage}.")
    if stated.get("format") != FORMAT:
        raise DataError(f"is of format {stated.get('format')}, this version reads {FORMAT}.")
    count, names = stated.get("n"), stated.get("joint_names")
    if names is None and isinstance(count, int) and 0 < count <= _MOST_JOINTS:
        names = [str(j + 1) for j in range(count)]
    elif not (names and isinstance(names, list) and all(isinstance(n, str) for n in names)):
        raise DataError(f"{damage}: it names no joints.")
    arrays: _Arrays = {}
    for quantity in CHANNELS:
        called = "current" if quantity == "effort" and stated.get("currents") else quantity
        columns = [f"{called}_{name}" for name in names]
        absent = [name for name in columns if name not in plain]
        if not absent:
            arrays[called] = partial(several, columns)
        elif quantity == "position" or absent != columns:
            raise DataError(f"lacks the columns {', '.join(absent)}.")
    for name in ("joint_names", "period", "start", "periods"):
        if stated.get(name) is not None:
            arrays[name] = partial(np.asarray, stated[name])
    of_base = {key: stated[key] for key in ("imu", "contacts") if isinstance(stated.get(key), dict)}
    return arrays, of_base
