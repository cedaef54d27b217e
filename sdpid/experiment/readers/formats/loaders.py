"""One loader for each file format: from a path to named arrays, each read when it is needed."""

from __future__ import annotations

import tokenize
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.extras import require
from sdpid.errors import DataError
from sdpid.experiment.readers.columns import LogTable, NoNumbersError
from sdpid.experiment.readers.formats.hdf5 import load_hdf5, load_mat
from sdpid.experiment.readers.formats.parquet_file import load_parquet
from sdpid.experiment.readers.formats.ros_bag import load_rosbag
from sdpid.experiment.readers.formats.text_file import load_matrices, load_text
from sdpid.experiment.recording.stored import check_claim

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


def load_npz(path: Path) -> LogTable:
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
    return LogTable({name: partial(member, name) for name in names})


def load_frame(frame: Any) -> LogTable:
    """List the columns of a data frame (pandas, polars), and an index that is named or of times.

    Raises
    ------
    DataError
        When several columns have the same name.
    """
    arrays: dict[str, Callable[[], NDArray[Any]]] = {}
    index = getattr(frame, "index", None)
    if index is not None:
        kind = getattr(getattr(index, "dtype", None), "kind", "")
        name = "time" if index.name is None and kind in "Mm" else index.name
        if name is not None:
            arrays[str(name)] = partial(_frame_column, index, name)
    if len(set(frame.columns)) < len(frame.columns):
        raise DataError("has several columns of one name.")
    for name in frame.columns:
        arrays[str(name)] = partial(_frame_column, frame[name], name)
    return LogTable(arrays)


def load_feather(path: Path) -> LogTable:
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


@dataclass(frozen=True)
class Format:
    """A format of logs.

    Attributes
    ----------
    load : callable
        From a path to a `LogTable`.
    suffixes : tuple of str
        What names of its files end with; of a folder none.
    sandboxed : bool
        Whether the library hangs, crashes or asks for all memory on some damaged files, so that
        it runs in a child process.
    choices : tuple of str
        The arguments that its loader takes beside the path: of ``topic``, ``joint_names`` and
        ``topics`` of a bag, and ``stored``.
    moves : bool
        Whether motions to run are read from it; others can be exported as one of these.
    """

    load: Callable[..., LogTable]
    suffixes: tuple[str, ...]
    sandboxed: bool = False
    choices: tuple[str, ...] = ()
    moves: bool = False


MATRICES, FRAMES = Format(load_matrices, ()), Format(load_frame, ())
# A new format is one function and one row here.
FORMATS = (
    Format(
        load_text,
        (".csv", ".csv.gz", ".tsv", ".tsv.gz", ".txt", ".txt.gz"),
        moves=True,
    ),
    Format(load_parquet, (".parquet",), choices=("stored",), moves=True),
    Format(load_npz, (".npz",), moves=True),
    Format(load_feather, (".feather",), sandboxed=True),
    Format(load_mat, (".mat",), sandboxed=True),
    Format(load_hdf5, (".h5", ".hdf5"), sandboxed=True),
    Format(
        load_rosbag,
        (".bag", ".db3", ".mcap"),
        sandboxed=True,
        choices=("topic", "joint_names", "topics"),
    ),
    MATRICES,
)
BY_SUFFIX = {suffix: each for each in FORMATS for suffix in each.suffixes}


def suffix_of(file: Path) -> str:
    """Return the suffix that tells the format, with the one before ``.gz``."""
    last = file.suffix.lower()
    return "".join(file.suffixes[-2:]).lower() if last == ".gz" else last
