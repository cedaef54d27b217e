"""Select the quantities of a log among its arrays, in the units of the file."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.sandbox import run_in_sandbox
from sdpid.errors import DataError
from sdpid.experiment.readers.column_names import Columns
from sdpid.experiment.readers.floating.find import Floating, find_floating
from sdpid.experiment.readers.formats.loaders import LOADERS, SANDBOXED
from sdpid.experiment.readers.missing import sound
from sdpid.experiment.readers.table import Table, row_number
from sdpid.experiment.recording.recording import CHANNELS

_SCALARS = ("period", "start", "periods")
_SLICE = re.compile(r"(.+)\[(\d+):(\d+)\]")
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


@dataclass(kw_only=True)
class Selection:
    """What a log holds of each quantity, in the units of the file.

    Attributes
    ----------
    tables : dict
        Position, effort and, where there are any, velocity and reference: (N, n) each.
    labels : tuple of str or None
        Names of the joints in the order of the columns.
    time : (N,) ndarray or None
        Stamps.
    rate : float or None
        Samples a second, where there are no stamps.
    numbers : dict
        What the file says of ``period``, ``start``, ``periods`` and ``effort_scale``.
    used : dict
        The names that each quantity was read from.
    units : dict
        The units that these names imply.
    left_out : dict
        Why a quantity is left out that seems to be there.
    floating : Floating
        Of a base and its contacts.
    """

    tables: dict[str, NDArray[Any]]
    labels: Sequence[str] | None = None
    time: NDArray[Any] | None = None
    rate: float | None = None
    numbers: dict[str, Any] = field(default_factory=dict)
    used: dict[str, Sequence[str]] = field(default_factory=dict)
    units: dict[str, Any] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    floating: Floating = field(default_factory=Floating)


def select(
    file: Path,
    table: Table,
    columns: Mapping[str, Any],
    wanted: Sequence[str] | None,
    *,
    scaled: bool,
    timeless: bool = False,
    floating: Mapping[str, Any] | None = None,
) -> Selection:
    """Find the quantities of a log.

    Parameters
    ----------
    file : Path
        For messages.
    table : Table
        The arrays of the log.
    columns : mapping
        Names for quantities, as in `read_recording`.
    wanted : sequence of str or None
        The joints to be read.
    scaled : bool
        Whether currents will be turned into torques.
    timeless : bool, optional
        Whether a sample rate is given, so that no stamps are needed.
    floating : mapping, optional
        What was said of ``base``, ``imu`` and ``contacts``.

    Raises
    ------
    DataError
        When a quantity is not found, is ambiguous, or holds no numbers.
    """
    table = with_slices(file, table, columns)
    log = Columns(file, table, columns, scaled=scaled)
    stored = log.names()
    tables: dict[str, NDArray[Any]] = {}
    labels: dict[str, tuple[str, ...]] = {}
    known = stored if wanted is None else tuple(wanted)
    left_out: dict[str, str] = {}
    for quantity in CHANNELS:
        joints = labels.get("position", known)
        if quantity == "reference" and quantity not in columns:
            of_positions = labels.get("position")
            found, label, why = find_reference(log, joints, tables["position"], of_positions)
            left_out |= {} if why is None else {quantity: why}
        else:
            found, label = log.table(quantity, joints)
        if found is None:
            if quantity in ("velocity", "reference"):
                continue
            raise log.missing(quantity)
        tables[quantity] = _numbers(file, quantity, found)
        if label is not None:
            labels[quantity] = label
    _align(file, tables, labels)
    names = labels.get("position")
    if names is None or all(name.isdigit() for name in names):
        # Numbers are no names; arrays, and numbered columns, follow the stored names.
        names = stored
    count = tables["position"].shape[1]
    numbers = {name: _item(log.number(name, 1)) for name in _SCALARS}
    scale = log.number("effort_scale", count if stored is None else len(stored))
    if scale is not None:
        scale = np.atleast_1d(scale)
        if stored is not None and names != stored and set(names or ()) <= set(stored):
            # Columns were picked by name: the factors follow them.
            scale = scale[[stored.index(name) for name in names or ()]]
    time = log.single("time")
    rate = None if time is not None else _rate(file, log.number("rate", 1))
    if time is None and rate is None and not timeless:
        raise log.missing("time")
    base = find_floating(file, log, table.stated, floating or {})
    return Selection(
        tables=tables,
        labels=names,
        time=time,
        rate=rate,
        numbers={**numbers, "effort_scale": scale},
        used=dict(log.used),
        units=dict(log.implied),
        left_out=left_out | base.left_out,
        floating=base,
    )


def read_selection(
    file: Path, suffix: str, choices: Mapping[str, Any], how: Mapping[str, Any]
) -> tuple[Selection, Callable[[int], str]]:
    """Load a log and find its quantities; in a child process where its library may come to harm.

    Parameters
    ----------
    file : Path
        The log.
    suffix : str
        Its format, as in `LOADERS`.
    choices : mapping
        Arguments of the loader.
    how : mapping
        Arguments of `select`.

    Returns
    -------
    Selection, callable
        The second says where sample k stands in the file.
    """
    if suffix in SANDBOXED:
        arguments = (str(file), suffix, dict(choices), dict(how))
        found = run_in_sandbox(_plain_selection, *arguments, subject=str(file))
        return Selection(**{**found, "floating": Floating(**found["floating"])}), row_number
    table = LOADERS[suffix](file, **choices)
    return select(file, table, **how), table.place


def _plain_selection(
    path: str, suffix: str, choices: dict[str, Any], how: dict[str, Any]
) -> dict[str, Any]:
    """Load a log and return its `Selection` as plain values."""
    file = Path(path)
    found = vars(select(file, LOADERS[suffix](file, **choices), **how))
    return {**found, "floating": vars(found["floating"])}


def _item(value: NDArray[Any] | None) -> Any:
    """Return a single number as such."""
    return None if value is None else value.item()


def _rate(file: Path, rate: NDArray[Any] | None) -> float | None:
    """Return the sample rate that a file says, checked."""
    if rate is None:
        return None
    if rate.dtype.kind not in "fiu" or not 0.0 < rate.item() < np.inf:
        raise DataError(f"{file}: the sample rate is {rate!r}, expected one positive number.")
    return float(rate.item())


def _numbers(file: Path, quantity: str, table: NDArray[Any]) -> NDArray[Any]:
    """Check that a table has two axes and holds numbers."""
    if table.dtype.kind not in "fiub":
        raise DataError(f"{file}: {quantity}: holds {table.dtype}, expected numbers.")
    if table.ndim != 2:
        raise DataError(
            f"{file}: {quantity}: has the shape {table.shape}, expected samples × joints."
        )
    return table


def _align(file: Path, tables: dict[str, NDArray[Any]], labels: dict[str, tuple[str, ...]]) -> None:
    """Bring columns that carry labels into the order of the positions'."""
    first = labels.get("position")
    for quantity, label in labels.items():
        if first is None or label == first:
            continue
        if set(label) != set(first):
            raise DataError(
                f"{file}: the columns of {quantity} are of joints {', '.join(label)}, those of "
                f"position of joints {', '.join(first)}; give columns=."
            )
        tables[quantity] = tables[quantity][:, [label.index(name) for name in first]]
