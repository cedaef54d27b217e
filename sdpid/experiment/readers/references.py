"""Find the commanded positions of a log, where it is clear which they are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid.errors import DataError
from sdpid.experiment.readers.column_names import Columns
from sdpid.experiment.readers.missing import sound

# ``q_d`` is the desired position in some logs and the derivative in others. What a controller
# follows differs from the positions by less than this part of their standard deviation; the rate
# of a sine by more than all of it.
_FOLLOWED = 0.5
# Samples that are compared.
_COMPARED = 10_000


def find_reference(
    log: Columns,
    names: Sequence[str] | None,
    position: NDArray[Any],
    labels: Sequence[str] | None,
) -> tuple[NDArray[Any] | None, tuple[str, ...] | None, str | None]:
    """Return commanded positions (N, n), the joints of their columns, or why they are left out.

    A log is never refused for a reference that nobody asked for.

    Parameters
    ----------
    log : Columns
        Position, effort and velocity are read already.
    names : sequence of str or None
        Names of the joints, where they are known.
    position : (N, n) ndarray
        What was measured, in the unit of the file.
    labels : sequence of str or None
        The joints of its columns.
    """
    try:
        found = log.commands(names)
        if len(found) > 1:
            several = " or ".join(next(iter(group.values())) for _, group in found)
            return None, None, f"it could be {several}; name one with columns= (--column)"
        if not found:
            return None, None, None
        unit, group = found[0]
        table = log.read("reference", unit, group)
    except DataError as cause:
        log.forget("reference")
        return None, None, str(cause)
    label = None if "" in group else tuple(group)
    why = _unsound(table, position)
    if why is None and label is not None and labels is not None and set(label) != set(labels):
        why = f"its columns are of joints {', '.join(label)}"
    if why is None and "q_d" in next(iter(group.values())) and not _followed(table, position):
        why = "the positions do not follow it, so that it may be a derivative"
    if why is not None:
        first = next(iter(group.values()))
        log.forget("reference")
        return None, None, f"{first}: {why}; name it with columns= (--column) where it is one"
    return table, label, None


def _unsound(table: NDArray[Any], position: NDArray[Any]) -> str | None:
    """Return why a table cannot be a reference."""
    if table.dtype.kind not in "fiu":
        return f"it holds {table.dtype}"
    if table.shape != position.shape:
        return f"it has the shape {table.shape}, positions {position.shape}"
    return None if sound(table) else "it lacks values"


def _followed(table: NDArray[Any], position: NDArray[Any]) -> bool:
    """Tell whether positions are near the reference, on the whole."""
    stride = -(-len(table) // _COMPARED)
    measured = np.asarray(position[::stride], dtype=np.float64)
    off = np.asarray(table[::stride], dtype=np.float64) - measured
    if not sound(measured):
        return False
    return bool(np.mean(off**2) < _FOLLOWED**2 * np.mean(measured.var(axis=0)))
