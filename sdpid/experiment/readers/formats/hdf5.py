"""MATLAB files (formats 4, 5 and 7 by SciPy, 7.3 is HDF5 with reversed axes) and HDF5 files.

Read in the sandbox only: on damaged files the libraries may hang or crash.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.extras import require
from sdpid.errors import DataError
from sdpid.experiment.readers.columns import LogTable, NoNumbersError
from sdpid.experiment.recording.stored import check_claim

_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
# MATLAB puts 512 bytes of its own before the HDF5 file.
_USER_BLOCK = 512
# What MATLAB says of an array that it wrote; such arrays have their axes reversed.
_MATLAB = "MATLAB_class"
# MATLAB keeps internal references here.
_PRIVATE = ("#refs#", "#subsystem#")
# More entries than this in one file are not a log.
_MOST_ENTRIES = 10_000
# Nor are more levels than this; a group may hold itself.
_DEPTH = 16
# Classes of MATLAB that hold numbers or text.
_PLAIN = {"double", "single", "logical", "char"}
_PLAIN |= {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
# Structs within structs deeper than this are not looked into.
_STRUCTS = 4


def load_hdf5(path: Path) -> LogTable:
    """List the arrays of an HDF5 file by their paths, columns of tables and attributes included.

    Attributes of the file and of groups are found like arrays, so a rate or joint names may be
    kept there. Links to other files are not followed.

    Raises
    ------
    DataError
        When there are too many arrays. Whatever the library raises passes on to the sandbox.
    MissingExtraError
        When h5py is not installed (extra ``io``).
    """
    h5py = require("h5py", extra="io")
    found: dict[str, Callable[[], NDArray[Any]]] = {}

    def visit(prefix: str, group: Any, depth: int) -> None:
        for name in group.attrs:
            if name.startswith("MATLAB_") or f"{prefix}{name}" in found:
                continue
            try:
                value = np.asarray(group.attrs[name])
            except Exception:  # an unreadable attribute does no harm unless it is needed
                continue
            value = _text(value.ravel()) if value.dtype.kind in "OSU" else value
            found[f"{prefix}{name}"] = partial(np.asarray, value)
        for key in group:
            name = f"{prefix}{key}"
            if key in _PRIVATE or not isinstance(group.get(key, getlink=True), h5py.HardLink):
                continue
            if len(found) > _MOST_ENTRIES or depth > _DEPTH:
                raise DataError(
                    f"{path}: has more than {_MOST_ENTRIES} entries or {_DEPTH} levels of groups; "
                    "this is no log."
                )
            node = group[key]
            if isinstance(node, h5py.Group):
                visit(f"{name}/", node, depth + 1)
            elif isinstance(node, h5py.Dataset):
                empty = node.attrs.get(_MATLAB) is None and node.shape is None
                for field in (None if empty else node.dtype.names) or (None,):
                    column = name if field is None else f"{name}/{field}"
                    found[column] = partial(_read, path, name, field)

    with h5py.File(path, "r") as file:
        # Not by `visititems`: it asks for the sizes of indices, and where a damaged index leads
        # back to itself, HDF5 2.0 never comes back.
        visit("", file, 0)
    return LogTable(found)


def _read(path: Path, name: str, field: str | None) -> NDArray[Any]:
    """Read one array of an HDF5 file, or one column of a table; honest ones of this file only."""
    h5py = require("h5py", extra="io")
    with h5py.File(path, "r") as file:
        node = file[name]
        if node.shape is None:
            raise DataError(f"{path}: '{name}' is empty.")
        if node.external or node.is_virtual:
            raise DataError(f"{path}: '{name}' is kept in another file; copy it into this one.")
        if node.dtype.kind not in "biufSOV":
            raise NoNumbersError(f"{path}: '{name}' holds {node.dtype}, expected numbers.")
        check_claim(path, name, node.shape, node.dtype.itemsize)
        if node.chunks is not None:
            check_claim(path, f"a chunk of {name}", node.chunks, node.dtype.itemsize)
            held = math.prod(node.shape) * node.dtype.itemsize
            if held > 0 and node.id.get_storage_size() == 0:
                raise DataError(f"{path}: '{name}' was announced, but never written.")
        matlab = node.attrs.get(_MATLAB)
        if matlab is not None:
            return _of_matlab(path, file, name, bytes(matlab).decode())
        if h5py.check_string_dtype(node.dtype) is not None:
            return _text(np.asarray(node[()]).ravel())
        return np.asarray(node[()] if field is None else node[field])


def _of_matlab(path: Path, file: Any, name: str, kind: str) -> NDArray[Any]:
    """Read an array that MATLAB wrote: axes reversed, text as numbers, cells as references."""
    node = file[name]
    if kind == "char":
        return np.asarray(_characters(node))
    if kind == "cell":
        parts = [file[reference] for reference in np.asarray(node[()]).T.ravel()]
        named = all(part.attrs.get(_MATLAB) == b"char" for part in parts)
        return _cell(path, name, [_characters(part) if named else None for part in parts])
    if "MATLAB_sparse" in node.attrs or node.dtype.kind not in "biuf":
        raise _no_array(path, name, kind)
    array = np.asarray(node[()]).T
    return array.ravel() if array.ndim == 2 and 1 in array.shape else array


def _characters(node: Any) -> str:
    """Return the text of a MATLAB char array of one row."""
    return "".join(map(chr, np.asarray(node[()]).T.ravel()))


def _text(values: NDArray[Any]) -> NDArray[Any]:
    """Return byte strings and objects as text."""
    return np.asarray([v.decode() if isinstance(v, bytes) else str(v) for v in values])


def load_mat(path: Path) -> LogTable:
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
    for name, shape, kind in whosmat(path, appendmat=False):
        if isinstance(name, str) and kind == "struct" and int(np.prod(shape)) == 1:
            for field, value in _fields(path, name, _variable(path, name), 0):
                found[field] = partial(np.asarray, value)
        elif isinstance(name, str):
            found[name] = partial(_loaded, path, name, kind)
    return LogTable(found)


def _variable(path: Path, name: str) -> Any:
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


def _loaded(path: Path, name: str, kind: str) -> NDArray[Any]:
    """Read a variable of numbers, text or names; rows of text are filled up with blanks."""
    if kind == "cell":
        return _cell(path, name, _variable(path, name))
    if kind not in _PLAIN:
        raise _no_array(path, name, kind)
    array = np.asarray(_variable(path, name))
    return np.char.rstrip(array) if array.dtype.kind == "U" else array


def _cell(path: Path, name: str, cells: Any) -> NDArray[Any]:
    """Return a cell array of names."""
    texts = np.atleast_1d(np.asarray(cells, dtype=object)).ravel()
    if not all(isinstance(text, str) for text in texts):
        raise NoNumbersError(f"{path}: '{name}' is a cell array, expected numbers or names.")
    return np.asarray([str(text) for text in texts])


def _fields(path: Path, struct: str, value: Any, depth: int) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the fields of a struct and of those in it, but what is neither numbers nor names."""
    for field in getattr(value, "_fieldnames", ()):
        inner, name = getattr(value, field), f"{struct}/{field}"
        if hasattr(inner, "_fieldnames"):
            if depth < _STRUCTS:
                yield from _fields(path, name, inner, depth + 1)
            continue
        array = np.asarray(inner)
        if array.dtype.kind != "O":
            yield name, array
        elif all(isinstance(cell, str) for cell in array.ravel()):
            yield name, _cell(path, name, array)


def _no_array(path: Path, name: str, kind: str) -> NoNumbersError:
    """Return the error that a variable is of a class that holds no samples."""
    return NoNumbersError(
        f"{path}: '{name}' is of class {kind}, expected a full array of numbers; convert it in "
        "MATLAB, a timetable by its variables, a sparse matrix by full()."
    )
