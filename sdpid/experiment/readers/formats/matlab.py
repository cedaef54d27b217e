"""MATLAB files: formats 4, 5 and 7 by SciPy, format 7.3 as HDF5.

Read in the sandbox only: on damaged files SciPy may crash.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid.errors import DataError
from sdpid.experiment.readers.formats.hdf5 import load_hdf5
from sdpid.experiment.readers.table import NoNumbersError, Table

_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
# MATLAB puts 512 bytes of its own before the HDF5 file.
_USER_BLOCK = 512
# Classes that hold numbers or text.
_PLAIN = {"double", "single", "logical", "char"}
_PLAIN |= {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
# Structs within structs deeper than this are not looked into.
_DEPTH = 4


def load_mat(path: Path) -> Table:
    """List the variables of a MATLAB file; fields of structs are named ``struct/field``.

    Raises
    ------
    DataError
        When the file is empty. Whatever the library raises passes on to the sandbox.
    MissingExtraError
        When the file is of format 7.3 and h5py is not installed (extra ``io``).
    """
    with path.open("rb") as file:
        head = file.read(_USER_BLOCK + len(_HDF5_SIGNATURE))
    if _HDF5_SIGNATURE in (head[: len(_HDF5_SIGNATURE)], head[_USER_BLOCK:]):
        return load_hdf5(path)
    if not head:
        raise DataError(f"{path}: not a readable MATLAB file (it is empty).")
    from scipy.io import whosmat

    found: dict[str, Callable[[], NDArray[Any]]] = {}
    fields = cache(partial(_fields, path))
    for name, shape, kind in whosmat(path, appendmat=False):
        if not isinstance(name, str):
            continue
        if kind in _PLAIN:
            found[name] = partial(_array, path, name)
        elif kind == "struct" and int(np.prod(shape)) == 1:
            found |= {key: partial(fields(name).__getitem__, key) for key in fields(name)}
        elif kind == "cell":
            found[name] = partial(_cell, path, name)
        else:
            found[name] = partial(_refuse, path, name, kind)
    return Table(found)


def _load(path: Path, name: str) -> Any:
    """Read one variable."""
    from scipy.io import loadmat

    return loadmat(
        path,
        appendmat=False,
        variable_names=[name],
        struct_as_record=False,
        squeeze_me=True,
        chars_as_strings=True,
    )[name]


def _array(path: Path, name: str) -> NDArray[Any]:
    """Read a variable of numbers or text; rows of text are filled up with blanks."""
    array = np.asarray(_load(path, name))
    return np.char.rstrip(array) if array.dtype.kind == "U" else array


def _cell(path: Path, name: str) -> NDArray[Any]:
    """Read a cell array of names."""
    return _names(path, name, np.atleast_1d(np.asarray(_load(path, name), dtype=object)))


def _names(path: Path, name: str, cells: NDArray[Any]) -> NDArray[Any]:
    """Return a cell array of texts as an array of text."""
    if not all(isinstance(cell, str) for cell in cells.ravel()):
        raise NoNumbersError(f"{path}: '{name}' is a cell array, expected numbers or names.")
    return np.asarray([str(cell) for cell in cells.ravel()])


def _fields(path: Path, name: str) -> dict[str, NDArray[Any]]:
    """Read a struct and name its fields."""
    found: dict[str, NDArray[Any]] = {}

    def walk(prefix: str, value: Any, depth: int) -> None:
        for field in getattr(value, "_fieldnames", ()):
            inner, key = getattr(value, field), f"{prefix}/{field}"
            if hasattr(inner, "_fieldnames"):
                if depth < _DEPTH:
                    walk(key, inner, depth + 1)
                continue
            array = np.asarray(inner)
            if array.dtype.kind == "O":
                if not all(isinstance(cell, str) for cell in array.ravel()):
                    continue
                array = _names(path, key, array)
            found[key] = array

    walk(name, _load(path, name), 0)
    return found


def _refuse(path: Path, name: str, kind: str) -> NDArray[Any]:
    """Say that a variable is of a class that holds no samples."""
    raise NoNumbersError(
        f"{path}: '{name}' is of class {kind}, expected a full array of numbers; convert it in "
        "MATLAB, a timetable by its variables, a sparse matrix by full()."
    )
