"""Convert what a log holds to a `Recording`: pick joints, mend gaps, convert units and motors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import real_array
from sdpid.errors import DataError
from sdpid.experiment.readers.floating.build import base_of, contacts_of
from sdpid.experiment.readers.mapping import Arguments, only_signs
from sdpid.experiment.readers.missing import mend_missing
from sdpid.experiment.readers.scaled import IN_AMPERES, scaled
from sdpid.experiment.readers.selection import Selection
from sdpid.experiment.readers.unit_names import UNITS, is_current
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.recording.stored import transformed
from sdpid.experiment.recording.timestamps import guess_time_unit

# Larger stamps, in s, count from 1970. Finer units are then made relative before they are
# converted, since seconds since 1970 in a double resolve 0.2 microseconds.
_SINCE_1970 = 1e9

# What sources say of a unit of time that is not given.
_INFERRED = "taken for"

_Tables = dict[str, NDArray[Any]]


def convert(
    file: Path, found: Selection, arguments: Arguments, place: Callable[[int], str]
) -> tuple[Recording, dict[str, str]]:
    """Return the recording, and for each quantity what it was read from, in words.

    Parameters
    ----------
    file : Path
        For messages.
    found : Selection
        What the log holds.
    arguments : Arguments
        Of `read_recording`; they win over what the log says.
    place : callable
        Says where sample k stands in the file.

    Raises
    ------
    DataError
        When a unit is not known, currents have no factor, a value is missing or absurd, or the
        arrays do not make a recording.
    """
    found = _some_rows(file, found, arguments.rows)
    motors, units = arguments.motors, {**found.units, **arguments.units}
    if arguments.amperes:
        _require_amperes(file, arguments, units)
    if "position" in units:
        # Where nothing is said of references, they are as positions are.
        units = {"reference": units["position"], **units}
    scale = _effort_scale(file, found, arguments, units)
    labels = None if found.labels is None else tuple(found.labels)
    count = found.tables["position"].shape[1]
    names, order = _joint_order(file, labels, arguments.joint_names, count)
    # Motors may be coupled, so joints are picked behind them; else before, since joints that are
    # not wanted may lack values.
    first = order if motors is None else None
    tables = _picked(file, found.tables, first)
    columns = {name: _column_names(found, name, first) for name in tables}
    time, sources = _time(file, found, arguments, len(tables["position"]))
    if arguments.without_effort and "effort" in tables:
        shown = labels if first is None else names
        tables["effort"] = _zero_where_absent(tables["effort"], shown, arguments.without_effort)
    floating = found.floating.tables
    columns |= {name: _of_floating(found, name) for name in floating}
    begin = 0 if arguments.rows is None else arguments.rows[0] - 1
    time, mended_tables, mended = mend_missing(
        file, time, {**tables, **floating}, columns, lambda k: place(k + begin), arguments.missing
    )
    tables = {name: _in_si(name, mended_tables[name], units, first) for name in tables}
    floating = {name: _in_si(name, mended_tables[name], units, None) for name in floating}
    if motors is not None:
        joints = {n: transformed(t, partial(motors.to_joints, n)) for n, t in tables.items()}
        tables = _picked(file, joints, order)
    if scale is not None:
        if arguments.effort_scale is None and order is not None and scale.size > max(order):
            scale = scale[order]
        tables["effort"] = _torques(file, tables["effort"], scale)
    stated: dict[str, Any] = {
        name: getattr(arguments, name) for name in ("period", "start", "periods")
    }
    stated = {n: found.numbers.get(n) if v is None else v for n, v in stated.items()}
    stated["periods"] = _whole(stated["periods"])
    notes = [f"time: {sources['time']}"] if _INFERRED in sources.get("time", "") else []
    each = {n: [u] if isinstance(u, str) else sorted(set(u)) for n, u in units.items()}
    converted = [
        f"{name} in {'/'.join(own)}"
        for name, own in each.items()
        if name in tables.keys() | floating.keys() and {UNITS[name][one] for one in own} != {1.0}
    ]
    if converted:
        notes.append(f"units: {', '.join(converted)}, converted")
    try:
        recording = Recording(
            time=time,
            joint_names=names,
            notes=tuple(notes),
            currents=arguments.amperes,
            base=base_of(file, found.floating, floating, arguments.floating),
            contacts=contacts_of(file, found.floating, floating, arguments.floating),
            **{**tables, **stated},
        )
        if arguments.gains is not None:
            recording = scaled(recording, arguments.gains)
    except DataError as cause:
        text = str(cause).removeprefix(f"{file}: ")
        raise DataError(f"{file}: {text}") from None
    sources = {**_sources(found, units, arguments), **sources}
    if recording.gains is not None:
        sources["gains"] = recording.gains.in_words
    return recording, {**sources, "missing values": mended} if mended else sources


def _some_rows(file: Path, found: Selection, rows: tuple[int, int] | None) -> Selection:
    """Return the wanted rows of all that was found."""
    if rows is None:
        return found
    count, part = len(found.tables["position"]), slice(rows[0] - 1, rows[1])
    if rows[1] > count:
        raise DataError(f"{file}: rows: asks for row {rows[1]}, the log has {count}.")
    tables = {name: table[part] for name, table in found.floating.tables.items()}
    return replace(
        found,
        tables={name: table[part] for name, table in found.tables.items()},
        time=None if found.time is None else found.time.reshape(-1)[part],
        floating=replace(found.floating, tables=tables),
    )


def _of_floating(found: Selection, quantity: str) -> list[str]:
    """Return a name for each column of a table of the base, for messages."""
    used, count = list(found.used[quantity]), found.floating.tables[quantity].shape[1]
    return used if len(used) == count else [f"{used[0]}[{j + 1}]" for j in range(count)]


def _effort_scale(
    file: Path, found: Selection, arguments: Arguments, units: Mapping[str, Any]
) -> NDArray[np.float64] | None:
    """Return the factors from the unit of effort to N.m; None where there are none."""
    given = found.numbers.get("effort_scale")
    given = given if arguments.effort_scale is None else arguments.effort_scale
    motors = arguments.motors
    if given is None:
        if is_current(units.get("effort")) and not arguments.scaled:
            raise DataError(f"{file}: {IN_AMPERES}")
        return None
    if motors is not None and "effort" in motors.applies_to:
        raise DataError(
            f"{file}: effort_scale is of the joints' side, but motors says that efforts are of "
            "the motors'; give torque_constants in motors instead."
        )
    if arguments.amperes and not only_signs(given):
        raise DataError(
            f"{file}: effort_scale makes torques of currents, and "
            f"{'currents are wanted' if arguments.currents else 'so do gains'}; leave it out. Only "
            "signs, 1 and -1, are taken beside gains."
        )
    return np.atleast_1d(real_array(given, f"{file}: effort_scale", ndim=np.ndim(given)))


def _require_amperes(file: Path, arguments: Arguments, units: Mapping[str, Any]) -> None:
    """Refuse gains for what is no current."""
    unit, motors = units.get("effort"), arguments.motors
    asked = "currents=True is" if arguments.currents else "gains are"
    if unit is not None and not is_current(unit):
        raise DataError(f"{file}: {asked} for currents in A, but the unit of the effort is {unit}.")
    if motors is not None and motors.torque_constants is not None:
        raise DataError(
            f"{file}: {asked} for currents, and torque_constants of motors make torques of them "
            "already; leave one out."
        )


def _torques(file: Path, efforts: NDArray[Any], scale: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return efforts times their factors to N.m."""
    count = efforts.shape[1]
    if scale.shape != (count,) or not scale.all():
        raise DataError(
            f"{file}: effort_scale: is {scale.tolist()}, expected {count} non-zero factors, one "
            "for each joint."
        )
    return transformed(efforts, lambda values: values * scale)


def _joint_order(
    file: Path, labels: tuple[str, ...] | None, wanted: tuple[str, ...] | None, n: int
) -> tuple[tuple[str, ...] | None, list[int] | None]:
    """Return the joints' names, and which columns to take where some are picked by name."""
    if wanted is None or labels is None or wanted == labels:
        return (labels if wanted is None else wanted), None
    common = set(labels) & set(wanted)
    if not common and len(wanted) == n:
        return wanted, None
    if common != set(wanted) or len(labels) != n:
        raise DataError(
            f"{file}: joint_names are {', '.join(wanted)}, the file has {', '.join(labels)} for "
            f"{n} columns; give names that are all in the file, or a new one for each column."
        )
    return wanted, [labels.index(name) for name in wanted]


def _picked(file: Path, tables: Mapping[str, NDArray[Any]], order: list[int] | None) -> _Tables:
    """Return some columns of every table."""
    if order is None:
        return dict(tables)
    for name, table in tables.items():
        if table.shape[1] <= max(order):
            raise DataError(
                f"{file}: {name} has {table.shape[1]} columns, too few for column {max(order) + 1}."
            )
    return {name: transformed(table, lambda rows: rows[:, order]) for name, table in tables.items()}


def _zero_where_absent(
    efforts: NDArray[Any], labels: tuple[str, ...] | None, joints: tuple[str, ...]
) -> NDArray[Any]:
    """Return efforts with zeros for those of some joints that have no value in any row."""
    count = efforts.shape[1]
    if efforts.dtype.kind != "f":
        return efforts
    called = [str(j + 1) for j in range(count)] if labels is None else list(labels)
    absent = [
        j
        for j in range(min(count, len(called)))
        if called[j] in joints and bool(np.isnan(efforts[:, j]).all())
    ]
    if not absent:
        return efforts

    def zeroed(rows: NDArray[Any]) -> NDArray[Any]:
        rows = np.array(rows)
        rows[:, absent] = 0.0
        return rows

    return transformed(efforts, zeroed)


def _column_names(found: Selection, quantity: str, order: list[int] | None) -> list[str]:
    """Return a name for each column of a table, for messages."""
    used, count = list(found.used.get(quantity, [quantity])), found.tables[quantity].shape[1]
    if len(used) != count:
        # Of a table that is turned, there are more columns than joints.
        labels = [*(found.labels or ()), *map(str, range(len(found.labels or ()) + 1, count + 1))]
        used = [f"{used[0]} of joint {labels[j]}" for j in range(count)]
    return used if order is None else [used[j] for j in order]


def _sources(found: Selection, units: Mapping[str, Any], arguments: Arguments) -> dict[str, str]:
    """Return for each quantity what it was read from, in words."""
    motors, sources = arguments.motors, {}
    for quantity, names in found.used.items():
        text = names[0] if len(names) == 1 else f"{names[0]} ... {names[-1]}"
        unit = units.get(quantity)
        text += "" if unit is None else f" in {unit if isinstance(unit, str) else '/'.join(unit)}"
        if motors is not None and quantity in motors.applies_to:
            text += ", motor side"
        sources[quantity] = text
    return sources | {quantity: f"left out: {why}" for quantity, why in found.left_out.items()}


def _whole(count: Any) -> Any:
    """Return a whole number of any numeric type as an int; `Recording` refuses the rest."""
    if isinstance(count, float) and count.is_integer():
        return int(count)
    return count


def _in_si(
    quantity: str, values: NDArray[Any], units: Mapping[str, Any], order: list[int] | None
) -> NDArray[Any]:
    """Convert a table to SI units; amperes stay amperes."""
    unit = units.get(quantity)
    if unit is None:
        return values
    each = [unit] if isinstance(unit, str) else list(unit)
    for one in each:
        if one not in UNITS[quantity]:
            raise DataError(
                f"units: '{one}' is not known for {quantity}; known are "
                f"{', '.join(UNITS[quantity])}."
            )
    factors = np.array([UNITS[quantity][one] for one in each])
    if isinstance(unit, str):
        if factors[0] == 1.0:
            return values
    elif order is not None and len(each) > max(order):
        factors = factors[order]
    if not isinstance(unit, str) and len(factors) != values.shape[1]:
        raise DataError(
            f"units: {len(each)} units for {quantity}, which has the shape {values.shape}."
        )
    return transformed(values, lambda part: part * factors)


def _time(
    file: Path, found: Selection, arguments: Arguments, count: int
) -> tuple[NDArray[Any], dict[str, str]]:
    """Return the time stamps in s, and where they come from if that is not plain."""
    time = found.time
    if time is None:
        rate = found.rate if arguments.rate_hz is None else arguments.rate_hz
        if isinstance(rate, bool) or not isinstance(rate, (int, float)) or not 0.0 < rate < np.inf:
            raise DataError(f"{file}: the sample rate is {rate!r}, expected one positive number.")
        return np.arange(count) / float(rate), {"time": f"sample rate, {rate:g} Hz"}
    if time.ndim == 2 and 1 in time.shape:
        time = time.ravel()
    if time.ndim != 1:
        raise DataError(f"{file}: time: has the shape {time.shape}, expected one stamp a sample.")
    name = found.used["time"][0]
    if time.dtype.kind in "Mm":
        # Relative, since seconds since 1970 in a double resolve no microsecond.
        return (time - time[:1]) / np.timedelta64(1, "ns") * 1e-9, {}
    if time.dtype.kind not in "fiu":
        raise DataError(f"{file}: time: holds {time.dtype}, expected numbers.")
    if time.dtype.kind == "f":
        time = time.astype(np.float64, copy=False)
    unit = arguments.units.get("time", found.units.get("time"))
    if unit is not None and unit not in UNITS["time"]:
        raise DataError(
            f"units: '{unit}' is not known for time; known are {', '.join(UNITS['time'])}."
        )
    note = {}
    if unit is None:
        unit = guess_time_unit(time)
        if unit != "s":
            note = {"time": f"{name}, {_INFERRED} {unit} by the steps of its numbers"}
    if unit == "s":
        return time, note
    if time.size and time[0] * UNITS["time"][unit] > _SINCE_1970:
        time = time - time[0]
    return time * UNITS["time"][unit], note
