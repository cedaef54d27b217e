"""MATLAB files: formats 4, 5 and 7 by SciPy, format 7.3 as HDF5."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid.errors import DataError
from sdpid.experiment.hdf5 import load_hdf5
from sdpid.experiment.mat_tags import check_tags
from sdpid.experiment.sizes import Budget

__all__ = ["load_mat"]

_Columns = dict[str, Callable[[], NDArray[Any]]]

_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
# MATLAB puts 512 bytes of its own before the HDF5 file.
_USER_BLOCK = 512
_FORMAT_4 = 4
# Classes that hold numbers or text, and bytes an entry.
_ITEMSIZE = {"double": 8, "single": 4, "int64": 8, "uint64": 8, "int32": 4, "uint32": 4}
_ITEMSIZE |= {"int16": 2, "uint16": 2, "int8": 1, "uint8": 1, "logical": 1, "char": 4}
# Structs within structs deeper than this are not looked into.
_DEPTH = 4


def load_mat(path: Path) -> _Columns:
    """List the variables of a MATLAB file; fields of structs are named ``struct/field``.

    Raises
    ------
    DataError
        When the file is damaged, or claims more than it can hold.
    MissingExtraError
        When the file is of format 7.3 and h5py is not installed (extra ``io``).
    """
    from scipy.io import whosmat

    try:
        with path.open("rb") as file:
            head = file.read(_USER_BLOCK + len(_HDF5_SIGNATURE))
    except OSError as cause:
        raise DataError(f"cannot read {path}: {cause.strerror}.") from None
    if _HDF5_SIGNATURE in (head[: len(_HDF5_SIGNATURE)], head[_USER_BLOCK:]):
        return load_hdf5(path)
    if not head:
        raise DataError(f"{path}: not a readable MATLAB file (it is empty).")
    budget = Budget(path)
    # A zero among the first four bytes means format 4, whose headers `whosmat` checks.
    if len(head) < _FORMAT_4 or 0 not in head[:_FORMAT_4]:
        check_tags(path, budget)
    try:
        listed = whosmat(path, appendmat=False)
    except Exception as cause:  # a damaged file makes the library raise almost anything
        raise DataError(f"{path}: not a readable MATLAB file ({_brief(cause)}).") from None
    found: _Columns = {}
    cache: dict[str, dict[str, NDArray[Any]]] = {}

    def flat(name: str) -> dict[str, NDArray[Any]]:
        if name not in cache:
            cache[name] = _variable(path, name)
        return cache[name]

    for name, shape, kind in listed:
        if not isinstance(name, str):
            continue
        if kind in _ITEMSIZE:
            found[name] = partial(_array, path, name, tuple(shape), _ITEMSIZE[kind], budget)
        elif kind == "struct" and int(np.prod(shape)) == 1:
            found |= {key: partial(flat(name).__getitem__, key) for key in flat(name)}
        elif kind == "cell":
            found[name] = partial(_cell, path, name)
        else:
            found[name] = partial(_refuse, path, name, kind)
    return found


def _load(path: Path, name: str) -> Any:
    """Read one variable."""
    from scipy.io import loadmat

    try:
        return loadmat(
            path,
            appendmat=False,
            variable_names=[name],
            struct_as_record=False,
            squeeze_me=True,
            chars_as_strings=True,
        )[name]
    except Exception as cause:  # as above
        raise DataError(f"{path}: '{name}' is damaged ({_brief(cause)}).") from None


def _array(
    path: Path, name: str, shape: tuple[int, ...], itemsize: int, budget: Budget
) -> NDArray[Any]:
    """Read a variable of numbers or text."""
    budget.take(name, shape, itemsize)
    return np.asarray(_load(path, name))


def _cell(path: Path, name: str) -> NDArray[Any]:
    """Read a cell array of names."""
    return _names(path, name, np.atleast_1d(np.asarray(_load(path, name), dtype=object)))


def _names(path: Path, name: str, cells: NDArray[Any]) -> NDArray[Any]:
    """Return a cell array of texts as an array of text."""
    if not all(isinstance(cell, str) for cell in cells.ravel()):
        raise DataError(f"{path}: '{name}' is a cell array, expected numbers or names.")
    return np.asarray([str(cell) for cell in cells.ravel()])


def _variable(path: Path, name: str) -> dict[str, NDArray[Any]]:
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
    raise DataError(
        f"{path}: '{name}' is of class {kind}, expected a full array of numbers; convert it in "
        "MATLAB, a timetable by its variables, a sparse matrix by full()."
    )


def _brief(cause: BaseException) -> str:
    """Return the first line of a library's message."""
    return (str(cause).splitlines() or [type(cause).__name__])[0][:200]
