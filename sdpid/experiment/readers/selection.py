"""Select the quantities of a log among its arrays, and see to samples without a value."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid.errors import DataError
from sdpid.experiment.readers.columns import Columns, Found, LogTable
from sdpid.experiment.readers.mapping import SETTINGS, Arguments
from sdpid.experiment.readers.names import FLOATING, QUANTITIES
from sdpid.experiment.recording.floating import LARGEST
from sdpid.experiment.recording.recording import CHANNELS, OPTIONAL
from sdpid.experiment.recording.stored import transformed

# ``q_d`` is the desired position in some logs and the derivative in others. What a controller
# follows differs from the positions by less than this part of their standard deviation; the rate
# of a sine by more than all of it.
_FOLLOWED = 0.5
# Samples that are compared.
_COMPARED = 10_000


@dataclass(kw_only=True)
class Selection:
    """What a log holds of each quantity, in the units of the file.

    Attributes
    ----------
    tables : dict of (N, m) ndarray
        Position, effort and, where there are any, velocity and reference: (N, n) each. Of a
        floating base its quantities; contacts one after the other.
    labels : dict of sequences of str
        What the columns of each are called where they say so: joints, the parts of a quaternion,
        the frame of a velocity's axes, or feet.
    names : sequence of str or None
        Names of the joints in the order of the columns.
    single : dict
        Stamps as ``time``, or else samples a second as ``rate``; and ``period``, ``start``,
        ``periods`` and ``effort_scale``, None for what the file does not say.
    used : dict
        The names that each quantity was read from.
    units : dict
        The units that these names imply.
    left_out : dict
        Why a quantity is left out that seems to be there.
    said : dict
        Settings of ``base``, ``imu`` and ``contacts``, by arguments and file.
    """

    tables: dict[str, NDArray[Any]] = field(default_factory=dict)
    labels: dict[str, Sequence[str]] = field(default_factory=dict)
    names: Sequence[str] | None = None
    single: dict[str, Any] = field(default_factory=dict)
    used: dict[str, Sequence[str]] = field(default_factory=dict)
    units: dict[str, Any] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    said: dict[str, dict[str, Any]] = field(default_factory=dict)


def select(file: Path, table: LogTable, how: Arguments) -> Selection:
    """Find the quantities of a log.

    Parameters
    ----------
    file : Path
        For messages.
    table : LogTable
        The arrays of the log.
    how : Arguments
        Those of `read_recording`.

    Raises
    ------
    DataError
        When a quantity is not found, is ambiguous, or holds no numbers.
    """
    log = Columns(file, table, how.columns, scaled=how.scaled)
    found = Selection(used=log.used, units=log.implied)
    found.said = {key: {**table.stated.get(key, {}), **how.floating[key]} for key in SETTINGS}
    stored = log.names()
    for quantity in CHANNELS:
        joints = found.labels.get("position", how.joint_names or stored)
        if quantity in OPTIONAL and quantity not in how.columns:
            try:
                if quantity == "feedforward":
                    _add(log, found, quantity, joints)
                else:
                    (_add_reference if quantity == "reference" else _add_links)(log, found, joints)
            except DataError as cause:
                # A log is never refused for what nobody asked for.
                found.left_out[quantity] = str(cause)
                found.tables.pop(quantity, None)
                log.forget(quantity)
        elif not _add(log, found, quantity, joints) and quantity == "position":
            raise log.missing(quantity)
    if not {"effort", "reference"} & found.tables.keys():
        if not how.without_effort:
            raise log.missing("effort", found.left_out.get("reference"))
        # No value of any joint: those that are named need none.
        found.tables["effort"] = np.full(found.tables["position"].shape, np.nan)
    _align(found, CHANNELS)
    found.names = found.labels.get("position")
    if found.names is None or all(name.isdigit() for name in found.names):
        # Numbers are no names; arrays, and numbered columns, follow the stored names.
        found.names = stored
    for name in ("period", "start", "periods"):
        number = log.number(name)
        found.single[name] = None if number is None else number.item()
    count = found.tables["position"].shape[1] if stored is None else len(stored)
    scale = log.number("effort_scale", count)
    if scale is not None:
        scale = np.atleast_1d(scale)
        if stored is not None and set(found.names or ()) <= set(stored) and found.names != stored:
            # Columns were picked by name: the factors follow them.
            scale = scale[[stored.index(name) for name in found.names or ()]]
    found.single["effort_scale"] = scale
    found.single["time"], _ = log.read("time")
    if found.single["time"] is None:
        rate = log.number("rate")
        if rate is None and how.rate_hz is None:
            raise log.missing("time")
        found.single["rate"] = None if rate is None else rate.item()
    _add_floating(log, found, how)
    return found


def _add(
    log: Columns, found: Selection, quantity: str, joints: Sequence[str] | None = None
) -> bool:
    """Add a quantity, if it is there."""
    array, labels = log.read(quantity, joints)
    if array is None:
        return False
    if array.ndim == 3 and quantity in FLOATING:
        array = array.reshape(len(array), -1)
    if array.ndim != 2:
        raise DataError(f"{quantity}: has the shape {array.shape}, expected samples × columns.")
    found.tables[quantity] = array
    if labels is not None:
        found.labels[quantity] = labels
    return True


def _align(found: Selection, quantities: Sequence[str]) -> None:
    """Bring columns that carry labels into the order of those of the first quantity."""
    first = found.labels.get(quantities[0])
    for quantity in quantities:
        label = found.labels.get(quantity, first)
        if first is None or label is None or label == first:
            continue
        if quantity == "effort" and set(label) < set(first):
            _add_absent(found, label, first)
            continue
        if set(label) != set(first):
            of = "feet" if quantity in FLOATING else "joints"
            raise DataError(
                f"the columns of {quantity} are of {of} {', '.join(label)}, those of "
                f"{quantities[0]} of {of} {', '.join(first)}; give columns=."
            )
        table, order = found.tables[quantity], [label.index(name) for name in first]
        # Of contacts there are several columns each.
        each = np.arange(table.shape[1]).reshape(len(first), -1)
        found.tables[quantity] = table[:, each[order].ravel()]


def _add_absent(found: Selection, own: Sequence[str], joints: Sequence[str]) -> None:
    """Add columns without any value for joints whose effort has none in the file."""
    places = [joints.index(name) for name in own]

    def spread(rows: NDArray[Any]) -> NDArray[Any]:
        wide = np.full((len(rows), len(joints)), np.nan)
        wide[:, places] = rows
        return wide

    found.tables["effort"] = transformed(found.tables["effort"], spread)
    used = dict(zip(own, found.used["effort"], strict=False))
    found.used["effort"] = [used.get(name, f"effort of {name}") for name in joints]
    found.labels["effort"] = joints


def _add_reference(log: Columns, found: Selection, joints: Sequence[str] | None) -> None:
    """Add commanded positions, where there are any and nothing else has their name.

    Raises
    ------
    DataError
        Saying why they are left out.
    """
    commands: dict[frozenset[str], Found] = {}
    for command in log.candidates("reference", joints):
        commands.setdefault(frozenset(command[0]), command)
    # Files of our own say it by this name, whatever their joints are called.
    own = frozenset({"reference"})
    commands = {own: commands[own]} if own in commands else commands
    first = [columns[0] for columns, _, _ in commands.values()]
    if len(commands) > 1:
        raise DataError(f"it could be {' or '.join(first)}; name one with columns= (--column)")
    for columns, labels, unit in commands.values():
        table, why = log.load("reference", columns, unit), None
        position, of_positions = found.tables["position"], found.labels.get("position")
        if table.shape != position.shape:
            why = f"it has the shape {table.shape}, positions {position.shape}"
        elif not sound(table):
            why = "it lacks values"
        elif labels is not None and set(labels) != set(of_positions or labels):
            why = f"its columns are of joints {', '.join(labels)}"
        elif ("q_d" in first[0] or first[0] == "commanded") and not _followed(table, position):
            why = "the positions do not follow it, so that it may be a derivative"
        if why is not None:
            remedy = "name it with columns= (--column) where it is one"
            raise DataError(f"{first[0]}: {why}; {remedy}")
        found.tables["reference"] = table
        found.labels |= {} if labels is None else {"reference": labels}


def _add_links(log: Columns, found: Selection, joints: Sequence[str] | None) -> None:
    """Add positions of links; joints without an encoder there keep the position of their motor.

    Raises
    ------
    DataError
        Saying why they are left out.
    """
    if not _add(log, found, "link_position", joints):
        return
    table, position = found.tables["link_position"], found.tables["position"]
    labels, every = found.labels.pop("link_position", None), found.labels.get("position", joints)
    first = log.used["link_position"][0]
    if labels is not None and every is not None and set(labels) <= set(every):
        columns = [every.index(label) for label in labels]
        filled = np.array(position, dtype=np.float64)
        if len(table) == len(filled):
            filled[:, columns] = table
            table = filled
    if table.shape != position.shape:
        raise DataError(f"{first}: it has the shape {table.shape}, positions {position.shape}")
    if not sound(table):
        raise DataError(f"{first}: it lacks values")
    found.tables["link_position"] = table


def _followed(table: NDArray[Any], position: NDArray[Any]) -> bool:
    """Tell whether positions are near the reference, on the whole."""
    stride = -(-len(table) // _COMPARED)
    measured = np.asarray(position[::stride], dtype=np.float64)
    off = np.asarray(table[::stride], dtype=np.float64) - measured
    return sound(measured) and bool(np.mean(off**2) < _FOLLOWED**2 * np.mean(measured.var(axis=0)))


def _add_floating(log: Columns, found: Selection, how: Arguments) -> None:
    """Add the quantities of a base and its contacts; nothing where there is no orientation."""
    first = FLOATING[0]
    if not _add(log, found, first):
        asked = [name for name in FLOATING if how.columns.get(name) is not None]
        asked += sorted(name for name, value in how.floating.items() if value)
        if asked and first not in how.columns:
            raise DataError(
                f"{', '.join(asked)} is given, but {first} is missing: none of "
                f"{', '.join(QUANTITIES[first].names)} is there. Name it with "
                f"columns={{'{first}': ...}}."
            )
        if first not in how.columns and (quaternions := log.quaternions()):
            label, parts = quaternions
            found.left_out[first] = (
                f"{parts[0]} ... {parts[-1]} may be those of a floating base; then say "
                f"columns={{'{first}': {label!r}}} (--column {first}={label})"
            )
        return
    there = [quantity for quantity in FLOATING[1:] if _add(log, found, quantity)]
    # Velocities whose axes nobody says are left out: they are not needed, and never guessed. The
    # base refuses by name what was asked for.
    for quantity in [] if found.said["base"].get("velocity_frame") else there:
        if quantity.endswith("_velocity") and not {quantity} & {*found.labels, *how.columns}:
            del found.tables[quantity]
            found.left_out[quantity] = (
                f"{log.used[quantity][0]}: its axes are not known; say "
                "base={'velocity_frame': 'world'} or 'base'"
            )
            log.forget(quantity)
    feet = [name for name in there if name.startswith("contact") and name in found.labels]
    if feet:
        _align(found, feet)


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
