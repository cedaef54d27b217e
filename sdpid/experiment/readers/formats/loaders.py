"""One loader for each file format: from a path to named arrays, each read when it is needed."""

from __future__ import annotations

import tokenize
import zipfile
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.extras import require
from sdpid.errors import DataError
from sdpid.experiment.readers.formats.hdf5 import load_hdf5
from sdpid.experiment.readers.formats.matlab import load_mat
from sdpid.experiment.readers.formats.matrices import load_matrices
from sdpid.experiment.readers.formats.parquet_file import load_parquet
from sdpid.experiment.readers.formats.ros_bag import load_rosbag
from sdpid.experiment.readers.formats.text_file import load_text
from sdpid.experiment.readers.table import NoNumbersError, Table
from sdpid.experiment.recording.memory_budget import check_claim

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


def load_npz(path: Path) -> Table:
    """List the arrays of a NumPy archive; pickled objects are never loaded."""

    def member(name: str) -> NDArray[Any]:
        try:
            with zipfile.ZipFile(path) as archive, archive.open(f"{name}.npy") as stream:
                version = np.lib.format.read_magic(stream)
                if version not in _HEADERS:
                    raise ValueError(f"arrays of version {version} are not read")
                shape, _, dtype = _HEADERS[version](stream)
                check_claim(path, name, shape, dtype.itemsize)
            with np.load(path, allow_pickle=False) as arrays:
                return np.asarray(arrays[name])
        except ValueError as cause:
            if "allow_pickle" in str(cause):
                raise NoNumbersError(
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
    return Table({name: partial(member, name) for name in names})


def load_frame(frame: Any) -> Table:
    """List the columns of a data frame (pandas, polars), and an index that is named or of times."""
    arrays: dict[str, Callable[[], NDArray[Any]]] = {}
    index = getattr(frame, "index", None)
    if index is not None:
        kind = getattr(getattr(index, "dtype", None), "kind", "")
        name = "time" if index.name is None and kind in "Mm" else index.name
        if name is not None:
            arrays[str(name)] = partial(_frame_column, index, name)
    for name in frame.columns:
        arrays[str(name)] = partial(_frame_column, frame[name], name)
    return Table(arrays)


def load_feather(path: Path) -> Table:
    """List the columns of an Arrow or Feather file."""
    feather = require("pyarrow.feather", extra="io")
    try:
        return load_frame(feather.read_table(path).to_pandas())
    except (*_DAMAGE, ValueError) as cause:
        raise DataError(f"{path}: not a readable Feather file ({cause}).") from None


def _frame_column(column: Any, name: Any) -> NDArray[Any]:
    """Return one column of a data frame."""
    zoned = getattr(column.dtype, "tz", None) is not None
    values = np.asarray(column, "datetime64[ns]" if zoned else None)
    if values.dtype.kind != "O":
        return values
    try:
        return values.astype(np.float64)
    except (TypeError, ValueError):
        raise NoNumbersError(f"data frame: '{name}' holds objects, expected numbers.") from None


# The format of a folder of text matrices, which has no suffix.
MATRICES = "folder"
# A new format is one function and one line here.
LOADERS: dict[str, Callable[..., Table]] = {
    MATRICES: load_matrices,
    ".bag": load_rosbag,
    ".csv": load_text,
    ".csv.gz": load_text,
    ".db3": load_rosbag,
    ".feather": load_feather,
    ".h5": load_hdf5,
    ".hdf5": load_hdf5,
    ".mat": load_mat,
    ".mcap": load_rosbag,
    ".npz": load_npz,
    ".parquet": load_parquet,
    ".tsv": load_text,
    ".tsv.gz": load_text,
    ".txt": load_text,
    ".txt.gz": load_text,
}
# Formats whose libraries hang, crash or ask for all memory on some damaged files.
SANDBOXED = (".bag", ".db3", ".feather", ".h5", ".hdf5", ".mat", ".mcap")
