"""One loader a file format: from a path to named arrays that are read when asked for."""

from __future__ import annotations

import csv
import tokenize
import zipfile
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._extras import require
from sdpid.errors import DataError
from sdpid.experiment.hdf5 import load_hdf5
from sdpid.experiment.mat import load_mat
from sdpid.experiment.rosbag import load_rosbag
from sdpid.experiment.sizes import Budget

__all__ = ["LOADERS", "Table"]

# What a file holds: a name and a way to read it. Only what is wanted is read, so an array that
# cannot be used does no harm to the rest.
Table = dict[str, Callable[[], NDArray[Any]]]

# What reading a damaged archive can raise; a broken header may also ask for too much memory.
_DAMAGE = (
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
    OSError,
    EOFError,
    KeyError,
    MemoryError,
    RuntimeError,
    SyntaxError,
)


# The headers of arrays that are read; version 3 is for names of fields that are not Latin.
_HEADERS: dict[tuple[int, int], Any] = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
# The first line of a text file is not longer than this.
_LONGEST_LINE = 1 << 20


def load_npz(path: Path) -> Table:
    """List the arrays of a NumPy archive; pickled objects are never loaded."""
    budget = Budget(path)

    def member(name: str) -> NDArray[Any]:
        try:
            with zipfile.ZipFile(path) as archive, archive.open(f"{name}.npy") as stream:
                version = np.lib.format.read_magic(stream)
                if version not in _HEADERS:
                    raise ValueError(f"arrays of version {version} are not read")
                shape, _, dtype = _HEADERS[version](stream)
                budget.take(name, shape, dtype.itemsize)
            with np.load(path, allow_pickle=False) as arrays:
                return np.asarray(arrays[name])
        except ValueError as cause:
            if "allow_pickle" in str(cause):
                raise DataError(
                    f"{path}: '{name}' holds Python objects, which are never loaded because they "
                    "can run code; save it as an array of numbers."
                ) from None
            raise DataError(f"{path}: '{name}' is damaged ({cause}).") from None
        except _DAMAGE as cause:
            raise DataError(f"{path}: '{name}' is damaged ({cause}).") from None

    try:
        with zipfile.ZipFile(path) as archive:
            entries = [entry for entry in archive.namelist() if entry.endswith(".npy")]
    except (*_DAMAGE, ValueError) as cause:
        raise DataError(f"{path}: not a readable NumPy archive ({cause}).") from None
    names = [entry.removesuffix(".npy") for entry in entries]
    return {name: partial(member, name) for name in names}


def load_csv(path: Path) -> Table:
    """List the numeric columns of a text file whose first line names them.

    Columns are separated by commas, semicolons, tabs or blanks. Whether a column is numeric is
    decided by its first value.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            header, first = stream.readline(_LONGEST_LINE), stream.readline(_LONGEST_LINE)
    except (OSError, UnicodeDecodeError) as cause:
        raise DataError(f"{path}: not a readable text file ({cause}).") from None
    if len(header) == _LONGEST_LINE or "\0" in header:
        raise DataError(f"{path}: the first line is no line of column names.")
    delimiter = next((mark for mark in ",;\t" if mark in header), None)
    names = _fields(header, delimiter)
    values = _fields(first, delimiter)
    if not names or not values:
        raise DataError(f"{path}: has no header and no data.")
    if any(_is_number(name) for name in names):
        raise DataError(
            f"{path}: the first line must name the columns, but it holds numbers "
            f"({header.strip()[:60]})."
        )
    if len(values) != len(names) or len(set(names)) != len(names):
        raise DataError(
            f"{path}: {len(names)} column names, {len(set(names))} of them distinct, for "
            f"{len(values)} values in the next line."
        )
    numeric = [k for k, value in enumerate(values) if _is_number(value)]
    cache: dict[str, NDArray[Any]] = {}

    def column(name: str) -> NDArray[Any]:
        if not cache:
            try:
                table = np.loadtxt(
                    path,
                    delimiter=delimiter,
                    skiprows=1,
                    usecols=numeric,
                    ndmin=2,
                    comments=None,
                    quotechar='"',
                    encoding="utf-8-sig",
                )
            except (ValueError, OSError, MemoryError) as cause:
                raise DataError(_first_bad(path, delimiter, names, numeric, cause)) from None
            cache.update({names[k]: table[:, i] for i, k in enumerate(numeric)})
        return cache[name]

    return {names[k]: partial(column, names[k]) for k in numeric}


def load_parquet(path: Path) -> Table:
    """List the columns of a Parquet file, and what `Recording.to_parquet` kept beside them."""
    from sdpid.experiment.parquet import read_metadata

    pa = require("pyarrow", extra="io")
    pq = require("pyarrow.parquet", extra="io")
    errors = (pa.lib.ArrowException, OSError, ValueError, NotImplementedError, MemoryError)

    budget = Budget(path)

    def column(name: str) -> NDArray[Any]:
        try:
            with pq.ParquetFile(path) as file:
                _take_column(budget, file.metadata, name)
            values = pq.read_table(path, columns=[name]).column(0).combine_chunks()
        except errors as cause:
            raise DataError(f"{path}: column '{name}' is damaged ({cause}).") from None
        if values.null_count:
            raise DataError(f"{path}: column '{name}' has {values.null_count} missing values.")
        if not (pa.types.is_list(values.type) or pa.types.is_fixed_size_list(values.type)):
            return np.asarray(values.to_numpy(zero_copy_only=False))
        if not len(values):
            raise DataError(f"{path}: column '{name}' has no rows.")
        lengths = np.unique(values.value_lengths().to_numpy(zero_copy_only=False))
        if lengths.size != 1:
            raise DataError(
                f"{path}: column '{name}' is ragged: its rows have {lengths.min()} to "
                f"{lengths.max()} entries."
            )
        flat = np.asarray(values.flatten().to_numpy(zero_copy_only=False))
        return flat.reshape(len(values), int(lengths[0]))

    try:
        schema = pq.read_schema(path)
    except errors as cause:
        raise DataError(f"{path}: not a readable Parquet file ({cause}).") from None
    table: Table = {name: partial(column, name) for name in schema.names}
    metadata = read_metadata(schema.metadata, path)
    for name in ("joint_names", "period", "start", "periods", "effort_scale"):
        if metadata.get(name) is not None:
            table[name] = partial(np.asarray, metadata[name])
    return table


def _take_column(budget: Budget, metadata: Any, name: str) -> None:
    """Account for a column: run lengths may stand for any number of values."""
    count = 0
    for group in range(metadata.num_row_groups):
        row_group = metadata.row_group(group)
        for k in range(row_group.num_columns):
            chunk = row_group.column(k)
            if chunk.path_in_schema.split(".")[0] == name:
                count += max(chunk.num_values, row_group.num_rows)
    budget.take(name, (count,), 8)


# A new format is one function and one line here.
LOADERS: dict[str, Callable[..., Table]] = {
    ".bag": load_rosbag,
    ".csv": load_csv,
    ".db3": load_rosbag,
    ".h5": load_hdf5,
    ".hdf5": load_hdf5,
    ".mat": load_mat,
    ".mcap": load_rosbag,
    ".npz": load_npz,
    ".parquet": load_parquet,
    ".tsv": load_csv,
    ".txt": load_csv,
}


def _first_bad(
    path: Path, delimiter: str | None, names: list[str], numeric: list[int], cause: Exception
) -> str:
    """Say what is wrong with the first bad row of a text file, by line and column."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            stream.readline()
            for line, text in enumerate(iter(lambda: stream.readline(_LONGEST_LINE), ""), 2):
                values = _fields(text, delimiter)
                if not any(values) and len(values) <= 1:
                    continue
                if len(values) != len(names):
                    return (
                        f"{path}: line {line} (row {line - 2}) has {len(values)} values for "
                        f"{len(names)} columns."
                    )
                for k in numeric:
                    if not _is_number(values[k]):
                        what = (
                            f"holds '{values[k][:40]}', not a number" if values[k] else "is empty"
                        )
                        hint = "; decimals need a point" if "," in values[k] else ""
                        return f"{path}: line {line} (row {line - 2}): '{names[k]}' {what}{hint}."
    except (OSError, UnicodeDecodeError, csv.Error) as other:
        cause = other
    return f"{path}: {cause} (rows counted after the header)."


def _fields(line: str, delimiter: str | None) -> list[str]:
    """Split a line of a text file into fields without their quotes and blanks."""
    if delimiter is None:
        return [field.strip('"') for field in line.split()]
    try:
        return [field.strip() for field in next(csv.reader([line], delimiter=delimiter), [])]
    except csv.Error:
        return []


def _is_number(text: str) -> bool:
    """Tell whether a field can be read as a float."""
    try:
        float(text)
    except ValueError:
        return False
    return True
