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
# Nor are more levels of groups than this; a group may hold itself.
_DEPTH = 16
# Structs within structs deeper than this are not looked into.
_STRUCTS = 4

_Arrays = dict[str, Callable[[], NDArray[Any]]]


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
    found: _Arrays = {}

    def visit(prefix: str, group: Any, depth: int) -> None:
        for name in group.attrs:
            try:
                value = np.asarray(group.attrs[name])
            except Exception:  # an unreadable attribute does no harm unless it is needed
                continue
            value = _text(value) if value.dtype.kind in "OSU" else value
            if not name.startswith("MATLAB_"):
                found.setdefault(f"{prefix}{name}", partial(np.asarray, value))
        for key in group:
            name = f"{prefix}{key}"
            if key in _PRIVATE or not isinstance(group.get(key, getlink=True), h5py.HardLink):
                continue
            if len(found) > _MOST_ENTRIES or depth > _DEPTH:
                raise DataError(
                    f"has more than {_MOST_ENTRIES} entries or {_DEPTH} levels of groups; "
                    "this is no log."
                )
            node = group[key]
            if isinstance(node, h5py.Group):
                visit(f"{name}/", node, depth + 1)
            elif isinstance(node, h5py.Dataset):
                for field in node.dtype.names or (None,):
                    column = name if field is None else f"{name}/{field}"
                    found[column] = partial(_read, path, node, name, field)

    # Not by `visititems`: it asks for the sizes of indices, and where a damaged index leads back
    # to itself, HDF5 2.0 never comes back. The file stays open for what is read.
    visit("", h5py.File(path, "r"), 0)
    return LogTable(found)


def _read(path: Path, node: Any, name: str, field: str | None) -> NDArray[Any]:
    """Read one array of an HDF5 file, or one column of a table; honest ones of this file only."""
    if node.shape is None:
        raise DataError(f"'{name}' is empty.")
    if node.external or node.is_virtual:
        raise DataError(f"'{name}' is kept in another file; copy it into this one.")
    if node.dtype.kind not in "biufSOV":
        raise NoNumbersError(f"'{name}' holds {node.dtype}, expected numbers.")
    check_claim(path, name, node.shape, node.dtype.itemsize)
    if node.chunks is not None:
        check_claim(path, f"a chunk of {name}", node.chunks, node.dtype.itemsize)
        if math.prod(node.shape) > 0 and node.id.get_storage_size() == 0:
            raise DataError(f"'{name}' was announced, but never written.")
    if _MATLAB in node.attrs:
        return _of_matlab(node, name, bytes(node.attrs[_MATLAB]).decode())
    array = np.asarray(node[()] if field is None else node[field])
    return _text(array) if node.dtype.kind in "OS" else array


def _of_matlab(node: Any, name: str, kind: str) -> NDArray[Any]:
    """Read an array that MATLAB wrote: axes reversed, text as numbers, cells as references."""
    sparse = "MATLAB_sparse" in node.attrs or node.dtype.kind not in "biuf"
    array = np.asarray(node[()]).T
    if kind == "char":
        return np.asarray("".join(map(chr, array.ravel())))
    if kind == "cell":
        parts = [node.file[reference] for reference in array.ravel()]
        named = all(part.attrs.get(_MATLAB) == b"char" for part in parts)
        cells = [str(_of_matlab(part, name, "char")) if named else None for part in parts]
        array = np.asarray(cells, dtype=object)
    elif sparse:
        raise _no_array(name, kind)
    return _plain(name, kind, array.ravel() if 1 in array.shape and array.ndim == 2 else array)


def _text(values: NDArray[Any]) -> NDArray[Any]:
    """Return byte strings and objects as text."""
    return np.asarray([v.decode() if isinstance(v, bytes) else str(v) for v in values.ravel()])


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
        raise DataError("not a readable MATLAB file (it is empty).")
    from scipy.io import loadmat, whosmat

    def variable(name: str) -> Any:
        how = {"struct_as_record": False, "squeeze_me": True, "chars_as_strings": True}
        return loadmat(path, appendmat=False, variable_names=[name], **how)[name]

    def loaded(name: str, kind: str) -> NDArray[Any]:
        return _plain(name, kind, variable(name))

    found: _Arrays = {}
    for name, _, kind in whosmat(path, appendmat=False):
        fields = dict(_fields(name, variable(name))) if kind == "struct" else {}
        for field, value in fields.items():
            found[field] = partial(_plain, field, "cell", value)
        if not fields:
            found[name] = partial(loaded, name, kind)
    return LogTable(found)


def _fields(struct: str, value: Any, depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Yield the fields of a struct, and of those in it."""
    for field in getattr(value, "_fieldnames", ()):
        inner, name = getattr(value, field), f"{struct}/{field}"
        if not hasattr(inner, "_fieldnames"):
            yield name, inner
        elif depth < _STRUCTS:
            yield from _fields(name, inner, depth + 1)


def _plain(name: str, kind: str, value: Any) -> NDArray[Any]:
    """Return an array of numbers, text or names; rows of text were filled up with blanks."""
    array = np.asarray(value)
    if array.dtype.kind == "O" and kind == "cell":
        if not all(isinstance(text, str) for text in array.flat):
            raise NoNumbersError(f"'{name}' is a cell array, expected numbers or names.")
        return np.asarray([str(text) for text in array.flat])
    if array.dtype.kind in "OV":
        raise _no_array(name, kind)
    return np.char.rstrip(array) if array.dtype.kind == "U" else array


def _no_array(name: str, kind: str) -> NoNumbersError:
    """Return the error that a variable is of a class that holds no samples."""
    return NoNumbersError(
        f"'{name}' is of class {kind}, expected a full array of numbers; convert it in "
        "MATLAB, a timetable by its variables, a sparse matrix by full()."
    )
