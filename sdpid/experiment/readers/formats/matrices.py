"""Folders of text files without names: one matrix a quantity, channels in rows or in columns."""

from __future__ import annotations

import warnings
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.text import printable
from sdpid.errors import DataError
from sdpid.experiment.readers.table import Table
from sdpid.experiment.recording.memory_budget import check_memory

_SUFFIXES = (".dat", ".txt", ".csv", ".tsv")
# Characters of the file by which the separator is decided.
_SNIFFED = 1 << 12
# A number takes at least two bytes as text, and eight in an array.
_MOST_GROWTH = 4


def is_folder_of_matrices(folder: Path) -> bool:
    """Tell whether a folder holds text files that may be matrices."""
    return any(path.suffix.lower() in _SUFFIXES for path in folder.iterdir())


def load_matrices(folder: Path) -> Table:
    """List the text matrices of a folder, by the names of their files.

    The longer side of each matrix is time, whichever way it is written.

    Raises
    ------
    DataError
        When two files have the same name but for their suffix.
    """
    files: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in _SUFFIXES or not path.is_file():
            continue
        name = printable(path.stem)
        if name in files:
            raise DataError(f"{folder}: {files[name].name} and {path.name} have the same name.")
        files[name] = path
    return Table({name: partial(_matrix, path) for name, path in files.items()})


def _matrix(path: Path) -> NDArray[Any]:
    """Return samples × channels of one file."""
    check_memory(path, _MOST_GROWTH * path.stat().st_size)
    try:
        with path.open(encoding="utf-8") as stream:
            begin = stream.read(_SNIFFED)
        delimiter = next((mark for mark in "\t;," if mark in begin), None)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # An empty file is refused below.
            matrix = np.loadtxt(path, delimiter=delimiter, ndmin=2, encoding="utf-8")
    except (OSError, ValueError) as cause:
        line = (str(cause).splitlines() or [type(cause).__name__])[0]
        raise DataError(f"{path}: is no matrix of numbers ({printable(line)}).") from None
    rows, columns = matrix.shape
    if rows == columns or not matrix.size:
        raise DataError(
            f"{path}: is {rows} × {columns} numbers, so that it is not known which side is time."
        )
    return np.ascontiguousarray(matrix.T) if columns > rows else matrix
