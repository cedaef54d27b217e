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
from sdpid.experiment.readers.formats.torch_file import load_torch
from sdpid.experiment.recording.stored import check_claim

# What reading a damaged archive can raise; a broken header may also ask for too much memory.
_DAMAGE = (
    *(tokenize.TokenError, zipfile.BadZipFile, zlib.error, OSError, EOFError),
    *(KeyError, MemoryError, RuntimeError, SyntaxError),
)


def load_npz(path: Path) -> LogTable:
    """List the arrays of a NumPy archive; pickled objects are never loaded."""
    try:
        with zipfile.ZipFile(path) as archive:
            entries = {entry.filename: entry.file_size for entry in archive.infolist()}
    except (*_DAMAGE, ValueError) as cause:
        raise DataError(f"not a readable NumPy archive ({cause}).") from None
    found = {entry.removesuffix(".npy"): n for entry, n in entries.items() if entry[-4:] == ".npy"}
    return LogTable({name: partial(_member, path, name, size) for name, size in found.items()})


def _member(path: Path, name: str, size: int) -> NDArray[Any]:
    """Read an array of a NumPy archive, of which no more is unpacked than its size."""
    check_claim(path, name, (size,), 1)
    try:
        with np.load(path, allow_pickle=False) as arrays:
            return np.asarray(arrays[name])
    except (*_DAMAGE, ValueError) as cause:
        if "allow_pickle" in str(cause):
            raise NoNumbersError(
                f"'{name}' holds Python objects, which are never loaded because they can "
                "run code; save it as an array of numbers."
            ) from None
        raise DataError(f"'{name}' is damaged ({cause}).") from None


def load_frame(frame: Any) -> LogTable:
    """List the columns of a data frame (pandas, polars), and an index that is named or of times.

    Raises
    ------
    DataError
        When several columns have the same name.
    """
    if len(set(frame.columns)) < len(frame.columns):
        raise DataError("has several columns of one name.")
    columns = {str(name): frame[name] for name in frame.columns}
    index = getattr(frame, "index", None)
    if index is not None:
        name = index.name or ("time" if getattr(index.dtype, "kind", "") in "Mm" else None)
        columns = columns if name is None else {str(name): index} | columns
    return LogTable({name: partial(_frame_column, name, one) for name, one in columns.items()})


def load_feather(path: Path) -> LogTable:
    """List the columns of an Arrow or Feather file."""
    feather = require("pyarrow.feather", extra="io")
    try:
        return load_frame(feather.read_table(path).to_pandas())
    except (*_DAMAGE, ValueError) as cause:
        raise DataError(f"not a readable Feather file ({cause}).") from None


def _frame_column(name: str, column: Any) -> NDArray[Any]:
    """Return one column of a data frame."""
    zoned = getattr(column.dtype, "tz", None) is not None
    values = np.asarray(column, "datetime64[ns]" if zoned else None)
    if values.dtype.kind != "O":
        return values
    try:
        return values.astype(np.float64)
    except (TypeError, ValueError):
        raise NoNumbersError(f"'{name}' holds objects, expected numbers.") from None


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
    Format(load_text, (".csv", ".csv.gz", ".tsv", ".tsv.gz", ".txt", ".txt.gz"), moves=True),
    Format(load_parquet, (".parquet",), choices=("stored",), moves=True),
    Format(load_npz, (".npz",), moves=True),
    Format(load_torch, (".pt",)),
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
