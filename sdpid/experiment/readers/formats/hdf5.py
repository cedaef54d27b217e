"""HDF5 files, and MATLAB's format 7.3, which is HDF5 with reversed axes.

Read in the sandbox only: on damaged files the library may hang or crash.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.extras import require
from sdpid.errors import DataError
from sdpid.experiment.readers.table import NoNumbersError, Table
from sdpid.experiment.recording.memory_budget import check_claim

# What MATLAB says of an array that it wrote; such arrays have their axes reversed.
_MATLAB = "MATLAB_class"
# MATLAB keeps internal references here.
_PRIVATE = ("#refs#", "#subsystem#")
# More entries than this in one file are not a log.
_MOST_ENTRIES = 10_000
# Nor are more levels than this; a group may hold itself.
_DEPTH = 16


def load_hdf5(path: Path) -> Table:
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
        _attributes(found, prefix, group)
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
            elif not isinstance(node, h5py.Dataset):
                continue
            elif node.attrs.get(_MATLAB) is None and node.shape is None:
                found[name] = partial(_read, path, name, None)
            elif node.dtype.names:
                for field in node.dtype.names:
                    found[f"{name}/{field}"] = partial(_read, path, name, field)
            else:
                found[name] = partial(_read, path, name, None)

    with h5py.File(path, "r") as file:
        # Not by `visititems`: it asks for the sizes of indices, and where a damaged index leads
        # back to itself, HDF5 2.0 never comes back.
        visit("", file, 0)
    return Table(found)


def _attributes(found: dict[str, Any], prefix: str, node: Any) -> None:
    """Add the numbers and texts among the attributes of a group."""
    for name in node.attrs:
        if name.startswith("MATLAB_") or f"{prefix}{name}" in found:
            continue
        try:
            value = np.asarray(node.attrs[name])
        except Exception:  # an unreadable attribute does no harm unless it is needed
            continue
        if value.dtype.kind in "OSU":
            value = _text(value.ravel())
        found[f"{prefix}{name}"] = partial(np.asarray, value)


def _read(path: Path, name: str, field: str | None) -> NDArray[Any]:
    """Read one array, or one column of a table."""
    h5py = require("h5py", extra="io")
    with h5py.File(path, "r") as file:
        node = file[name]
        _check(path, name, node)
        matlab = node.attrs.get(_MATLAB)
        if matlab is not None:
            return _matlab(path, file, name, node, bytes(matlab).decode())
        if h5py.check_string_dtype(node.dtype) is not None:
            return _text(np.asarray(node[()]).ravel())
        return np.asarray(node[()] if field is None else node[field])


def _check(path: Path, name: str, node: Any) -> None:
    """Refuse what is not an honest array of this file, before reading it."""
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


def _matlab(path: Path, file: Any, name: str, node: Any, kind: str) -> NDArray[Any]:
    """Read an array that MATLAB wrote: axes reversed, text as numbers, cells as references."""
    if kind == "char":
        return np.asarray(_characters(node))
    if kind == "cell":
        parts = [file[reference] for reference in np.asarray(node[()]).T.ravel()]
        if any(part.attrs.get(_MATLAB) != b"char" for part in parts):
            raise NoNumbersError(f"{path}: '{name}' is a cell array, expected numbers or names.")
        return np.asarray([_characters(part) for part in parts])
    if "MATLAB_sparse" in node.attrs or node.dtype.kind not in "biuf":
        raise NoNumbersError(
            f"{path}: '{name}' is of class {kind}, expected a full array of numbers."
        )
    array = np.asarray(node[()]).T
    return array.ravel() if array.ndim == 2 and 1 in array.shape else array


def _characters(node: Any) -> str:
    """Return the text of a MATLAB char array of one row."""
    return "".join(map(chr, np.asarray(node[()]).T.ravel()))


def _text(values: NDArray[Any]) -> NDArray[Any]:
    """Return byte strings and objects as text."""
    decoded = [v.decode() if isinstance(v, bytes) else str(v) for v in values]
    return np.asarray(decoded)
