"""Names of some columns of an array: ``q[8:19]`` are its columns 8 to 19."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from sdpid.errors import DataError
from sdpid.experiment.readers.table import Table

_SLICE = re.compile(r"(.+)\[(\d+):(\d+)\]")


def with_slices(file: Path, table: Table, columns: Mapping[str, Any]) -> Table:
    """Return the arrays of a log, and the parts of arrays that `columns` names.

    Columns count from 1, and the last one belongs to the part.
    """
    added: dict[str, Callable[[], NDArray[Any]]] = {}
    for name in columns.values():
        match = _SLICE.fullmatch(name) if isinstance(name, str) else None
        if match is None or name in table.arrays or match[1] not in table.arrays:
            continue
        first, last = int(match[2]), int(match[3])
        added[name] = partial(_part, file, match[1], table.arrays[match[1]], first, last)
    return replace(table, arrays={**table.arrays, **added}) if added else table


def _part(
    file: Path, name: str, read: Callable[[], NDArray[Any]], first: int, last: int
) -> NDArray[Any]:
    """Return some columns of an array."""
    array = read()
    if array.ndim != 2 or not 1 <= first <= last <= array.shape[1]:
        raise DataError(
            f"{file}: columns: '{name}[{first}:{last}]' asks for columns {first} to {last} of an "
            f"array of the shape {array.shape}; columns count from 1."
        )
    return array[:, first - 1 : last]
