"""HDF5 files, and MATLAB's format 7.3, which is HDF5 with its own habits."""

from __future__ import annotations

import contextlib
import math
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._extras import require
from sdpid.errors import DataError
from sdpid.experiment.sizes import Budget

__all__ = ["load_hdf5"]

_Columns = dict[str, Callable[[], NDArray[Any]]]

# What MATLAB says of an array that it wrote; such arrays have their axes reversed.
_MATLAB = "MATLAB_class"
# MATLAB keeps its own references here.
_PRIVATE = ("#refs#", "#subsystem#")
# More entries than this in one file are not a log.
_MOST_ENTRIES = 10_000
# Nor are so many levels; a group may hold itself.
_DEPTH = 16
# Listing what is in a log takes a fraction of a second.
_PATIENCE = 30.0


def load_hdf5(path: Path) -> _Columns:
    """List the arrays of an HDF5 file by their paths, columns of tables and attributes included.

    Attributes of the file and of groups are found like arrays, so a rate or joint names may be
    kept there. Links to other files are not followed.

    Raises
    ------
    DataError
        When the file is damaged.
    MissingExtraError
        When h5py is not installed (extra ``io``).
    """
    require("h5py", extra="io")
    _probe(path)
    return _listed(path)


def _probe(path: Path) -> None:
    """Look through the file in another process first: on damaged ones the library may hang or die.

    Raises
    ------
    DataError
        When it does.
    """
    code = "import sys; from sdpid.experiment import hdf5; hdf5._look_through(sys.argv[1])"
    try:
        ended = subprocess.run(
            [sys.executable, "-c", code, str(path)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=_PATIENCE,
            check=False,
        ).returncode
    except subprocess.TimeoutExpired:
        raise DataError(
            f"{path}: not a readable HDF5 file (looking through it took more than "
            f"{_PATIENCE:g} s); write it again."
        ) from None
    if ended < 0:
        raise DataError(f"{path}: not a readable HDF5 file (the library died of it).")


def _look_through(path: str) -> None:
    """List all arrays and touch their attributes; errors are left to whoever reads the file."""
    with contextlib.suppress(DataError):
        _listed(Path(path))


def _listed(path: Path) -> _Columns:
    """List the arrays of a file."""
    h5py = require("h5py", extra="io")
    budget = Budget(path)
    found: _Columns = {}

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
                found[name] = partial(_read, path, name, budget, None)
            elif node.dtype.names:
                for field in node.dtype.names:
                    found[f"{name}/{field}"] = partial(_read, path, name, budget, field)
            else:
                found[name] = partial(_read, path, name, budget, None)

    try:
        with h5py.File(path, "r") as file:
            # Not by `visititems`: it asks for the sizes of indices, and where a damaged index
            # leads back to itself, HDF5 2.0 never comes back.
            visit("", file, 0)
    except DataError:
        raise
    except Exception as cause:  # a damaged file makes the library raise almost anything
        raise DataError(f"{path}: not a readable HDF5 file ({_brief(cause)}).") from None
    return found


def _attributes(found: _Columns, prefix: str, node: Any) -> None:
    """Add the numbers and texts among the attributes of a group."""
    for name in node.attrs:
        if name.startswith("MATLAB_") or f"{prefix}{name}" in found:
            continue
        try:
            value = np.asarray(node.attrs[name])
        except Exception:  # an attribute nobody asked for does no harm
            continue
        if value.dtype.kind in "OSU":
            value = _text(value.ravel())
        found[f"{prefix}{name}"] = partial(np.asarray, value)


def _read(path: Path, name: str, budget: Budget, field: str | None) -> NDArray[Any]:
    """Read one array, or one column of a table."""
    h5py = require("h5py", extra="io")
    try:
        with h5py.File(path, "r") as file:
            node = file[name]
            _check(path, name, node, budget)
            matlab = node.attrs.get(_MATLAB)
            if matlab is not None:
                return _matlab(path, file, name, node, bytes(matlab).decode())
            if h5py.check_string_dtype(node.dtype) is not None:
                return _text(np.asarray(node[()]).ravel())
            return np.asarray(node[()] if field is None else node[field])
    except DataError:
        raise
    except Exception as cause:  # as above
        raise DataError(f"{path}: '{name}' is damaged ({_brief(cause)}).") from None


def _check(path: Path, name: str, node: Any, budget: Budget) -> None:
    """Refuse what is not an honest array of this file, before reading it."""
    if node.shape is None:
        raise DataError(f"{path}: '{name}' is empty.")
    if node.external or node.is_virtual:
        raise DataError(f"{path}: '{name}' is kept in another file; copy it into this one.")
    if node.dtype.kind not in "biufSOV":
        raise DataError(f"{path}: '{name}' holds {node.dtype}, expected numbers.")
    budget.take(name, node.shape, node.dtype.itemsize)
    if node.chunks is not None:
        budget.take(f"a chunk of {name}", node.chunks, node.dtype.itemsize)
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
            raise DataError(f"{path}: '{name}' is a cell array, expected numbers or names.")
        return np.asarray([_characters(part) for part in parts])
    if "MATLAB_sparse" in node.attrs or node.dtype.kind not in "biuf":
        raise DataError(f"{path}: '{name}' is of class {kind}, expected a full array of numbers.")
    array = np.asarray(node[()]).T
    return array.ravel() if array.ndim == 2 and 1 in array.shape else array


def _characters(node: Any) -> str:
    """Return the text of a MATLAB char array of one row."""
    return "".join(map(chr, np.asarray(node[()]).T.ravel()))


def _text(values: NDArray[Any]) -> NDArray[Any]:
    """Return byte strings and objects as text."""
    decoded = [v.decode() if isinstance(v, bytes) else str(v) for v in values]
    return np.asarray(decoded)


def _brief(cause: BaseException) -> str:
    """Return the first line of a library's message."""
    return (str(cause).splitlines() or [type(cause).__name__])[0][:200]
