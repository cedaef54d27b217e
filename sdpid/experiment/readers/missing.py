"""Samples without a value: refused by name, dropped, or interpolated."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid.errors import DataError
from sdpid.experiment.readers.names import FLOATING
from sdpid.experiment.recording.floating import LARGEST

# Linear interpolation over more samples than this would invent motion.
_LONGEST_GAP = 10
# Of a type of its own, so that it is not cut to that of a table.
_LARGEST = np.float64(LARGEST)
# What to do where a column has no value at all.
_REMEDIES = {
    "effort": "leave a joint that the robot lacks out with joint_names=, and the effort of "
    "one that it has with without_effort=",
    "velocity": "leave the velocity out with columns={'velocity': None}",
}

_Tables = dict[str, NDArray[Any]]


def mend_missing(
    tables: _Tables, names: Mapping[str, Sequence[str]], place: Callable[[int], str], how: str
) -> tuple[_Tables, str | None]:
    """Check that every value is a finite number, or mend what is missing by the rule given.

    Parameters
    ----------
    tables : dict of (N, n) ndarrays
        The quantities, and the stamps as ``time``.
    names : mapping of sequences of str
        What the columns of each table are called in the file.
    place : callable
        Says where sample k stands in the file.
    how : {"refuse", "drop", "interpolate"}
        What to do with NaN. Infinite and absurdly large values are always refused.

    Returns
    -------
    tables, note
        The last says in words what was mended, None where nothing was missing.

    Raises
    ------
    DataError
        Naming the place and column of the first bad value, or of a gap that is too long.
    """
    # Of tables of different lengths the recording says which is wrong.
    if len(set(map(len, tables.values()))) > 1 or all(map(sound, tables.values())):
        return tables, None
    huge = {name: np.isinf(table) | (np.abs(table) > _LARGEST) for name, table in tables.items()}
    lacking = {quantity: np.isnan(table) for quantity, table in tables.items()}
    rows = np.logical_or.reduce([lacks.any(axis=1) for lacks in lacking.values()])
    refused = how == "refuse" or (how == "interpolate" and lacking["time"].any())
    for masks in (huge, lacking) if refused else (huge,):
        for quantity, bad in masks.items():
            if bad.any():
                raise _bad_value(quantity, tables[quantity], bad, names[quantity], place)
    count = f"{np.count_nonzero(rows)} of {rows.size} samples"
    if how == "drop":
        return {name: table[~rows] for name, table in tables.items()}, f"{count} dropped"
    filled: _Tables = {}
    for quantity, table in tables.items():
        if quantity in FLOATING and lacking[quantity].any():
            raise DataError(
                f"{quantity} lacks values, and missing='interpolate' fills only what "
                "belongs to joints; read it with missing='drop'."
            )
        filled[quantity] = table = np.array(table, dtype=np.float64)
        time = filled["time"][:, 0]
        for j in map(int, np.flatnonzero(lacking[quantity].any(axis=0))):
            lacks = lacking[quantity][:, j]
            _check_gaps(lacks, names[quantity][j], place)
            table[lacks, j] = np.interp(time[lacks], time[~lacks], table[~lacks, j])
    return filled, f"interpolated in {count}"


def sound(table: NDArray[Any]) -> bool:
    """Tell whether all values are finite and of a size that robots have."""
    if not table.size or table.dtype.kind not in "fiu":
        return True
    # What is not a number is not below the limit either.
    return bool(table.min() >= -_LARGEST and table.max() <= _LARGEST)


def _bad_value(
    quantity: str,
    table: NDArray[Any],
    bad: NDArray[Any],
    names: Sequence[str],
    place: Callable[[int], str],
) -> DataError:
    """Return the error that names the first of some bad values."""
    row, column = (int(k) for k in np.argwhere(bad)[0])
    name, value = names[column], float(table[row, column])
    count = int(np.count_nonzero(bad[:, column]))
    where = f"{place(row)}: {quantity}: '{name}'"
    if not np.isnan(value):
        what = "not finite" if np.isinf(value) else f"more than {LARGEST:g}, which no robot has"
        return DataError(f"{where} is {value:.3g}, {what}; repair that sample, or name its unit.")
    if count == len(table):
        remedy = _REMEDIES.get(quantity, f"name another column for the {quantity} with columns=")
        return DataError(f"{quantity}: '{name}' has no value in any row; {remedy}.")
    return DataError(
        f"{where} has no value (NaN), as in {count} of {len(table)} rows; repair the file, or read "
        "it with missing='drop' or missing='interpolate'."
    )


def _check_gaps(lacks: NDArray[Any], name: str, place: Callable[[int], str]) -> None:
    """Refuse gaps that are too long to interpolate, or that reach an end of the log."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], lacks, [False]]).astype(np.int8)))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        if end - begin > _LONGEST_GAP or begin == 0 or end == lacks.size:
            raise DataError(
                f"'{name}' has no value in {end - begin} samples from {place(int(begin))} "
                f"on; at most {_LONGEST_GAP} between two values are interpolated. Read it with "
                "missing='drop', or cut the log there."
            )
