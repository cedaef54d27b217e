"""Convert what a log holds to a `Recording`: joints, gaps, units, motors, base and contacts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array, real_array
from sdpid._common.files import require_known
from sdpid.errors import DataError
from sdpid.experiment.readers.mapping import Arguments, only_signs
from sdpid.experiment.readers.names import QUANTITIES, UNITS, is_current
from sdpid.experiment.readers.scaled import IN_AMPERES, scaled
from sdpid.experiment.readers.selection import Selection, mend_missing
from sdpid.experiment.recording.floating import BaseMotion, Contacts, Imu
from sdpid.experiment.recording.motor_side import MotorSide
from sdpid.experiment.recording.recording import CHANNELS, Recording, guess_time_unit
from sdpid.experiment.recording.stored import transformed

# Larger stamps, in s, count from 1970. Finer units are then made relative before they are
# converted, since seconds since 1970 in a double resolve 0.2 microseconds.
_SINCE_1970 = 1e9

# What sources say of a unit of time that is not given.
_INFERRED = "taken for"
_UPRIGHT = (0.0, 0.0, 0.0, 1.0)

_Tables = dict[str, NDArray[Any]]


def convert(
    found: Selection, arguments: Arguments, place: Callable[[int], str]
) -> tuple[Recording, dict[str, str]]:
    """Return the recording, and for each quantity what it was read from, in words.

    Parameters
    ----------
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
    held = arguments.base.get("held")
    if held is not None and "base_orientation" in found.tables:
        raise DataError(
            f"base.held: the base was held at '{held}', and the log has the motion of one; "
            "leave it out with columns={'base_orientation': None}, or leave held out."
        )
    tables, stamps, first_row = dict(found.tables), found.single["time"], 0
    if arguments.rows is not None:
        first_row, last = arguments.rows[0] - 1, arguments.rows[1]
        if last > (count := len(tables["position"])):
            raise DataError(f"rows: asks for row {last}, the log has {count}.")
        tables = {name: table[first_row:last] for name, table in tables.items()}
        stamps = None if stamps is None else stamps.reshape(-1)[first_row:last]
    motors, units = arguments.motors, {**found.units, **arguments.units}
    if "position" in units:
        # Where nothing is said of references, they are as positions are.
        units = {"reference": units["position"], **units}
    scale = _effort_scale(found, arguments, units)
    labels = None if found.names is None else tuple(found.names)
    count = tables["position"].shape[1]
    names, order = _joint_order(labels, arguments.joint_names, count)
    # Motors may be coupled, so joints are picked behind them; else before, since joints that are
    # not wanted may lack values.
    first = order if motors is None else None
    columns = {name: _column_names(found, name, first) for name in tables}
    tables = _picked(tables, first)
    time, of_time = _time(stamps, found, arguments, len(tables["position"]))
    shown = labels if first is None else names
    if "effort" in tables:
        tables["effort"] = _zero_where_absent(tables["effort"], shown, arguments.without_effort)
    tables, mended = mend_missing(
        {"time": time[:, None], **tables},
        {"time": ["time"], **columns},
        lambda k: place(k + first_row),
        arguments.missing,
    )
    time = tables.pop("time")[:, 0]
    for name, table in tables.items():
        tables[name] = in_si(name, table, units, first if name in CHANNELS else None)
        if motors is not None and name in CHANNELS:
            tables[name] = transformed(tables[name], partial(motors.to_joints, name))
    if motors is not None:
        tables = _picked(tables, order)
    if scale is not None and "effort" in tables:
        if arguments.effort_scale is None:
            scale = _one_each(scale, order)
        if scale.shape != (count := tables["effort"].shape[1],) or not scale.all():
            raise DataError(
                f"effort_scale: is {scale.tolist()}, expected {count} non-zero factors, "
                "one for each joint."
            )
        tables["effort"] = transformed(tables["effort"], lambda values: values * scale)
    stated: dict[str, Any] = {name: tables[name] for name in CHANNELS if name in tables}
    for name in ("period", "start", "periods"):
        given = getattr(arguments, name)
        stated[name] = found.single[name] if given is None else given
    if isinstance(stated["periods"], float) and stated["periods"].is_integer():
        stated["periods"] = int(stated["periods"])  # `Recording` refuses the rest.
    notes = [f"time: {of_time}"] if _INFERRED in of_time else []
    each = {n: [u] if isinstance(u, str) else sorted(set(u)) for n, u in units.items()}
    converted = [
        f"{name} in {'/'.join(own)}"
        for name, own in each.items()
        if name in tables and {UNITS[name][one] for one in own} != {1.0}
    ]
    if converted:
        notes.append(f"units: {', '.join(converted)}, converted")
    recording = Recording(
        time=time,
        joint_names=names,
        notes=tuple(notes),
        currents=arguments.amperes,
        base=base_of(found, tables),
        contacts=contacts_of(found, tables, arguments),
        **stated,
    )
    if arguments.gains is not None:
        recording = scaled(recording, arguments.gains)
    if held is not None:
        orientation = arguments.base.get("orientation", _UPRIGHT)
        recording = recording.with_held_base(held, orientation=orientation)
    more = {
        "time": of_time,
        "gains": None if recording.gains is None else recording.gains.in_words,
        "missing values": mended,
        "base": None if held is None else f"held at {held}",
    }
    return recording, _sources(found, units, motors) | {k: said for k, said in more.items() if said}


def _effort_scale(
    found: Selection, arguments: Arguments, units: Mapping[str, Any]
) -> NDArray[np.float64] | None:
    """Return the factors from the unit of effort to N.m; None where there are none."""
    given, motors, unit = arguments.effort_scale, arguments.motors, units.get("effort")
    given = found.single["effort_scale"] if given is None else given
    asked = "currents=True is" if arguments.currents else "gains are"
    if arguments.amperes and unit is not None and not is_current(unit):
        raise DataError(f"{asked} for currents in A, but the unit of the effort is {unit}.")
    if arguments.amperes and motors is not None and motors.torque_constants is not None:
        raise DataError(
            f"{asked} for currents, and torque_constants of motors make torques of them "
            "already; leave one out."
        )
    if given is None:
        if is_current(unit) and not arguments.scaled:
            raise DataError(IN_AMPERES)
        return None
    if motors is not None and "effort" in motors.applies_to:
        raise DataError(
            "effort_scale is of the joints' side, but motors says that efforts are of "
            "the motors'; give torque_constants in motors instead."
        )
    if arguments.amperes and not only_signs(given):
        raise DataError(
            f"effort_scale makes torques of currents, and "
            f"{'currents are wanted' if arguments.currents else 'so do gains'}; leave it out. Only "
            "signs, 1 and -1, are taken beside gains."
        )
    return np.atleast_1d(real_array(given, "effort_scale", ndim=np.ndim(given)))


def _joint_order(
    labels: tuple[str, ...] | None, wanted: tuple[str, ...] | None, n: int
) -> tuple[tuple[str, ...] | None, list[int] | None]:
    """Return the joints' names, and which columns to take where some are picked by name."""
    if wanted is None or labels is None or wanted == labels:
        return (labels if wanted is None else wanted), None
    common = set(labels) & set(wanted)
    if not common and len(wanted) == n:
        return wanted, None
    if common != set(wanted) or len(labels) != n:
        raise DataError(
            f"joint_names are {', '.join(wanted)}, the file has {', '.join(labels)} for "
            f"{n} columns; give names that are all in the file, or a new one for each column."
        )
    return wanted, [labels.index(name) for name in wanted]


def _picked(tables: _Tables, order: list[int] | None) -> _Tables:
    """Return tables with some columns of those of joints."""
    joints = {name: tables[name] for name in CHANNELS if name in tables and order is not None}
    for name, table in joints.items():
        if (count := table.shape[1]) <= (last := max(order or ())):
            raise DataError(f"{name} has {count} columns, too few for column {last + 1}.")
        joints[name] = transformed(table, lambda rows: rows[:, order])
    return tables | joints


def _zero_where_absent(
    efforts: NDArray[Any], labels: tuple[str, ...] | None, joints: tuple[str, ...]
) -> NDArray[Any]:
    """Return efforts with zeros for those of some joints that have no value in any row."""
    columns = range(efforts.shape[1] if joints and efforts.dtype.kind == "f" else 0)
    named = zip(columns, labels or (str(j + 1) for j in columns), strict=False)
    absent = [j for j, name in named if name in joints and np.isnan(efforts[:, j]).all()]
    zeros = np.isin(columns, absent)
    return transformed(efforts, lambda rows: np.where(zeros, 0.0, rows)) if absent else efforts


def _column_names(found: Selection, quantity: str, order: list[int] | None) -> list[str]:
    """Return a name for each column of a table, for messages."""
    used, count = list(found.used.get(quantity, [quantity])), found.tables[quantity].shape[1]
    numbers = [str(j + 1) for j in range(count)]
    if quantity not in CHANNELS:
        return used if len(used) == count else [f"{used[0]}[{number}]" for number in numbers]
    if len(used) != count:
        # Of a table that is turned, there are more columns than joints.
        labels = [*(found.names or ()), *numbers[len(found.names or ()) :]]
        used = [f"{used[0]} of joint {label}" for label in labels[:count]]
    return used if order is None else [used[j] for j in order]


def _sources(
    found: Selection, units: Mapping[str, Any], motors: MotorSide | None
) -> dict[str, str]:
    """Return for each quantity what it was read from, in words."""
    sources = {}
    for quantity, names in found.used.items():
        text = names[0] if len(names) == 1 else f"{names[0]} ... {names[-1]}"
        unit = units.get(quantity)
        text += "" if unit is None else f" in {unit if isinstance(unit, str) else '/'.join(unit)}"
        if motors is not None and quantity in motors.applies_to:
            text += ", motor side"
        sources[quantity] = text
    return sources | {quantity: f"left out: {why}" for quantity, why in found.left_out.items()}


def _one_each(values: NDArray[Any], order: list[int] | None) -> NDArray[Any]:
    """Return those of picked columns where there is a value for every column of the file."""
    return values if order is None or len(values) <= max(order) else values[order]


def _factor(quantity: str, unit: str) -> float:
    """Return the factor of a unit to SI."""
    require_known([unit], UNITS[quantity], "units", f"is not known for {quantity}")
    return UNITS[quantity][unit]


def in_si(
    quantity: str, values: NDArray[Any], units: Mapping[str, Any], order: list[int] | None
) -> NDArray[Any]:
    """Convert a table to SI units; amperes stay amperes."""
    unit = units.get(quantity)
    each = [unit] if isinstance(unit, str) else list(unit or ())
    factors = np.array([_factor(quantity, one) for one in each])
    if not isinstance(unit, str):
        factors = _one_each(factors, order)
        if each and len(factors) != values.shape[1]:
            raise DataError(
                f"units: {len(each)} units for {quantity}, which has the shape {values.shape}."
            )
    return values if np.all(factors == 1.0) else transformed(values, lambda part: part * factors)


def in_seconds(time: NDArray[Any]) -> NDArray[Any]:
    """Return dates and times in s from the first one, NaN for none; numbers as they are."""
    if time.dtype.kind not in "Mm":
        return time
    known = time[~np.isnat(time)]
    # Relative, since seconds since 1970 in a double resolve no microsecond.
    since = time - (known if known.size else time)[:1]
    return np.asarray(since / np.timedelta64(1, "ns") * 1e-9)


def _time(
    time: NDArray[Any] | None, found: Selection, arguments: Arguments, count: int
) -> tuple[NDArray[Any], str]:
    """Return the time stamps in s, and where they come from if that is not plain."""
    if time is None:
        rate = found.single["rate"] if arguments.rate_hz is None else arguments.rate_hz
        if isinstance(rate, bool) or not isinstance(rate, (int, float)) or not 0.0 < rate < np.inf:
            raise DataError(f"the sample rate is {rate!r}, expected one positive number.")
        return np.arange(count) / float(rate), f"sample rate, {rate:g} Hz"
    if time.ndim == 2 and 1 in time.shape:
        time = time.ravel()
    if time.ndim != 1:
        raise DataError(f"time: has the shape {time.shape}, expected one stamp a sample.")
    if time.dtype.kind in "Mm":
        return in_seconds(time), ""
    if time.dtype.kind not in "fiu":
        raise DataError(f"time: holds {time.dtype}, expected numbers.")
    if time.dtype.kind == "f":
        time = time.astype(np.float64, copy=False)
    unit, note = arguments.units.get("time", found.units.get("time")), ""
    if unit is None:
        unit = guess_time_unit(time)
        note = f"{found.used['time'][0]}, {_INFERRED} {unit} by the steps of its numbers"
    factor = _factor("time", unit)
    if unit == "s":
        return time, ""
    if time.size and time[0] * factor > _SINCE_1970:
        time = time - time[0]
    return time * factor, note


_FIELDS = {"contact": "down", "contact_force": "forces", "contact_wrench": "wrenches"}


def base_of(found: Selection, tables: Mapping[str, Array]) -> BaseMotion | None:
    """Return the motion of the base, None without one.

    Parameters
    ----------
    found : Selection
        What the columns of tables are called, and the settings of ``base`` and ``imu``.
    tables : mapping of (N, m) ndarray
        The values in SI units.

    Raises
    ------
    DataError
        When nothing says the order of quaternions, two velocities have different axes, or a
        table has another number of columns.
    """
    if "base_orientation" not in tables:
        return None
    for quantity, table in tables.items():
        parts = QUANTITIES[quantity].parts
        if parts and not quantity.startswith("contact") and table.shape[1] != len(parts):
            raise DataError(
                f"{quantity}: has {table.shape[1]} columns, expected {len(parts)}: "
                f"{', '.join(parts)}."
            )
    base, imu = found.said["base"], found.said["imu"]
    order = base.get("quaternion") or found.labels.get("base_orientation")
    if order is None:
        raise DataError(
            "base_orientation: the order of its quaternions is not known; say "
            "base={'quaternion': 'xyzw'} or 'wxyz' (quaternion in the table [base] of a mapping), "
            "or leave the base out with columns={'base_orientation': None}."
        )
    velocities = [name for name in tables if name.startswith("base") and name.endswith("velocity")]
    said = (base.get("velocity_frame"),)
    frames: list[Any] = [found.labels.get(name, said)[0] for name in velocities]
    if len(set(frames)) > 1:
        raise DataError(
            f"{' and '.join(velocities)} have different axes; leave one out, as with "
            f"columns={{'{velocities[0]}': None}}."
        )
    placed = {key: imu[key] for key in ("translation", "rotation") if key in imu}
    sensors = {name: tables[name] for name in ("gyroscope", "accelerometer") if name in tables}
    return BaseMotion(
        orientation=tables["base_orientation"][:, [order.index(part) for part in "xyzw"]],
        position=tables.get("base_position"),
        linear_velocity=tables.get("base_linear_velocity"),
        angular_velocity=tables.get("base_angular_velocity"),
        velocity_frame=frames[0] if frames else None,
        imu=Imu(**sensors, **placed) if sensors else None,
    )


def contacts_of(
    found: Selection, tables: Mapping[str, Array], arguments: Arguments
) -> Contacts | None:
    """Return the contacts, None without any.

    Raises
    ------
    DataError
        When the frames are not known, or are another number than there are columns.
    """
    there, said = [name for name in _FIELDS if name in tables], found.said["contacts"]
    if not there and arguments.contacts:
        raise DataError(
            "contacts is given, but there are no columns of contacts; name them with "
            "columns={'contact': ...}, or 'contact_force' or 'contact_wrench'."
        )
    if not there:
        return None
    feet = next((found.labels[name] for name in there if name in found.labels), None)
    if feet is not None and all(label.isdigit() for label in feet):
        feet = None  # Numbers are no names.
    frames = said.get("frames", feet)
    if frames is None:
        raise DataError(
            f"{', '.join(there)}: say which frame of the robot each column is of, "
            "contacts={'frames': [...]}."
        )
    if isinstance(frames, str):
        raise DataError(f"contacts.frames: is {frames!r}, expected a list of names.")
    # Frames may be told in another order than the columns have.
    turned = feet is not None and set(feet) == set(frames)
    order = [feet.index(frame) for frame in frames] if feet and turned else slice(None)
    shaped: dict[str, Any] = {}
    for quantity in there:
        table, size = tables[quantity], len(QUANTITIES[quantity].parts) or 1
        if table.shape[1] != size * len(frames):
            raise DataError(
                f"{quantity}: has {table.shape[1]} columns, expected {size} for each of "
                f"the {len(frames)} frames {', '.join(map(str, frames))}."
            )
        values: NDArray[Any] = table.reshape(len(table), len(frames), size)[:, order]
        if quantity == "contact":
            # Flags, or what is above the threshold where contacts are closed.
            values, threshold = values[:, :, 0], said.get("threshold")
            values = values if threshold is None else np.asarray(values > float(threshold))
        shaped[_FIELDS[quantity]] = values
    placed = {key: said[key] for key in ("kind", "offset") if key in said}
    return Contacts(frames=tuple(frames), **shaped, **placed)
