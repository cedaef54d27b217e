"""States of a robot, one or many, and Pinocchio's algorithms at each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, real_array
from sdpid.errors import DataError


@dataclass(frozen=True, eq=False)
class States:
    """States for Pinocchio, one a row."""

    model: Any
    expansion: Array
    configurations: Array
    rates: list[Array]
    single: bool

    def each(self, algorithm: Callable[..., Array], *, matrix: bool = False) -> Array:
        """Return the results of an algorithm of Pinocchio, (K, nv) or (K, nv, nv)."""
        data, nv = self.model.createData(), self.model.nv
        out = np.empty((len(self.configurations), *((nv, nv) if matrix else (nv,))))
        expanded = [rate @ self.expansion.T for rate in self.rates]
        for k, row in enumerate(zip(self.configurations, *expanded, strict=True)):
            out[k] = algorithm(self.model, data, *row)
        return out

    def result(self, values: Array) -> Array:
        """Return the values, of a single state without the first axis."""
        return values[0] if self.single else values


def is_single(values: ArrayLike) -> bool:
    """Return whether values are one state, and not many."""
    try:
        return np.ndim(values) == 1
    except ValueError:  # ragged, as `real_array` then says
        return False


def many(values: ArrayLike, name: str, columns: int | None) -> Array:
    """Return values (columns,) or (K, columns) as (K, columns)."""
    array = real_array(values, name, ndim=1 if is_single(values) else 2)
    rows = np.atleast_2d(array)
    if columns is not None and rows.shape[1] != columns:
        raise DataError(f"{name}: {rows.shape[1]} columns, the robot has {columns} joints.")
    return rows
