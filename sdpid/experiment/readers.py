"""`read_recording`: from a log file to a `Recording`, by names and units."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from sdpid.errors import DataError
from sdpid.experiment.columns import CONVENTIONS, Columns
from sdpid.experiment.formats import LOADERS, Table
from sdpid.experiment.mapping import find_mapping, read_mapping
from sdpid.experiment.motors import MotorSide
from sdpid.experiment.recording import Recording

__all__ = ["Reading", "read_described", "read_recording"]

_TABLES = ("position", "effort", "velocity")

_DEGREE = np.pi / 180.0
# Factors to SI. Amperes stay amperes: `effort_scale`, or constants of motors, give torques.
_CURRENTS = {"A": 1.0, "mA": 1e-3}
_UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "position": {"rad": 1.0, "deg": _DEGREE, "turn": 2.0 * np.pi, "m": 1.0, "mm": 1e-3},
    "velocity": {
        "rad/s": 1.0,
        "deg/s": _DEGREE,
        "rpm": 2.0 * np.pi / 60.0,
        "m/s": 1.0,
        "mm/s": 1e-3,
    },
    "effort": {
        **{"N.m": 1.0, "Nm": 1.0, "N·m": 1.0, "mN.m": 1e-3, "mNm": 1e-3, "N": 1.0},
        **_CURRENTS,
    },
}
# Whole numbers beyond this are counts since 1970, which a double cannot hold to the last one.
_LONG_COUNT = 1 << 50


@dataclass(frozen=True, kw_only=True)
class Reading:
    """A recording, and where in the file it was found.

    Attributes
    ----------
    recording : Recording
        What was read.
    file : str
        From which file.
    mapping : str or None
        The mapping that was followed.
    sources : dict
        For each quantity, what it was read from, in words.
    """

    recording: Recording
    file: str
    mapping: str | None = None
    sources: dict[str, str] = field(default_factory=dict)


@overload
def read_recording(path: str | os.PathLike[str], **how: Any) -> Recording: ...
@overload
def read_recording(path: Sequence[str | os.PathLike[str]], **how: Any) -> list[Recording]: ...
def read_recording(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]], **how: Any
) -> Recording | list[Recording]:
    """Read a log, or several that were logged in the same way.

    CSV, Parquet, NPZ, MATLAB (MAT), HDF5, and ROS bags with ``sensor_msgs/JointState`` (files
    ``.db3``, ``.mcap``, ``.bag``, or the folder of a ROS 2 bag).

    Quantities are found by the usual names (``t``, ``q``, ``dq``, ``tau``, ``time``,
    ``position``, ``velocity``, ``effort``, ``actual_q``, ``fs``, ``joint_names``, ...): either an
    array of samples × joints, or one column a joint, named like ``q1``, ``q_1``, ``q[0]``,
    ``position_<joint>`` or ``<joint>_position``; the name may end with a unit (``time_ms``,
    ``position_deg_1``). In files with groups or structs the last part of the path counts. Without
    time stamps, ``fs`` gives the sample rate in Hz. Nothing is ever unpickled or run.

    What is named otherwise is said by arguments, or by a mapping: a small TOML file beside the
    log, ``run.toml`` for ``run.csv``, with the same names as the arguments. Arguments win.

    Parameters
    ----------
    path : path-like, or a sequence of them
        The file; its suffix tells the format. A sequence gives a list, and all must then have the
        same joints.
    mapping : path-like, mapping or False, optional
        A mapping elsewhere, or its content; False ignores the one beside the log.
    columns : mapping, optional
        Where to find quantities that have other names: ``{"effort": "tau_current"}`` names an
        array (or the beginning of the names of its columns), ``{"effort": ["i1", "i2"]}`` lists
        columns, ``{"velocity": None}`` leaves a quantity out.
    units : mapping, optional
        Units of the file where they are not SI, as ``{"position": "deg", "time": "ms"}``; a list
        has one unit for each joint.
    motors : MotorSide or mapping, optional
        For what was logged at the motors: gear ratios, signs, offsets, or a full matrix where
        joints are coupled; a mapping as in `MotorSide.from_mapping`.
    joint_names : sequence of str, optional
        Joints in the order wanted: picks and orders those that the file names. Where the file
        has other names for as many joints, it renames them.
    topic : str, optional
        Of a ROS bag.
    rate_hz : float, optional
        Sample rate of a log without time stamps.
    period, start, periods, effort_scale : optional
        As in `Recording`; override what the file says.
    stored : bool, optional
        Leave the values of a Parquet file in it; see `Recording.from_parquet`.

    Returns
    -------
    Recording, or a list of them

    Raises
    ------
    DataError
        When the file is missing or damaged, its format is unknown, a quantity is not found, a
        unit is unknown, or the data are not a valid recording.
    MissingExtraError
        When the format needs a package that is not installed.
    """
    if isinstance(path, (str, os.PathLike)):
        return read_described(path, **how).recording
    records = [read_described(one, **how).recording for one in path]
    for one, record in zip(path, records, strict=True):
        if (record.n, record.joint_names) != (records[0].n, records[0].joint_names):
            raise DataError(
                f"{one}: has the joints {', '.join(record.names)}, {path[0]} has "
                f"{', '.join(records[0].names)}; give joint_names=."
            )
    return records


def read_described(
    path: str | os.PathLike[str],
    *,
    mapping: str | os.PathLike[str] | Mapping[str, Any] | bool | None = None,
    columns: Mapping[str, str | Sequence[str] | None] | None = None,
    units: Mapping[str, str | Sequence[str]] | None = None,
    motors: MotorSide | Mapping[str, Any] | None = None,
    joint_names: Sequence[str] | None = None,
    topic: str | None = None,
    rate_hz: float | None = None,
    period: float | None = None,
    start: float | None = None,
    periods: int | None = None,
    effort_scale: Any = None,
    stored: bool | None = None,
) -> Reading:
    """Read a log, and tell where its quantities were found; see `read_recording`."""
    file = Path(path)
    suffix = _suffix(file)
    beside = find_mapping(file) if mapping is None or mapping is True else None
    said: dict[str, Any] = {}
    if beside is not None:
        said = read_mapping(beside)
    elif mapping is True:
        raise DataError(f"{file}: there is no mapping beside it.")
    elif mapping is not None and mapping is not False:
        said = read_mapping(mapping)
        beside = None if isinstance(mapping, Mapping) else Path(mapping)
    columns = {**said.get("columns", {}), **_known(columns or {}, CONVENTIONS, "columns")}
    units = {**said.get("units", {}), **_known(units or {}, _UNITS, "units")}
    columns, units = _known(columns, CONVENTIONS, "columns"), _known(units, _UNITS, "units")
    motors = said.get("motors") if motors is None else motors
    if isinstance(motors, Mapping):
        motors = MotorSide.from_mapping(motors)
    joint_names = _tuple(said.get("joint_names") if joint_names is None else joint_names)
    topic = said.get("topic") if topic is None else topic
    rate_hz = said.get("rate_hz") if rate_hz is None else rate_hz
    given = {"period": period, "start": start, "periods": periods, "effort_scale": effort_scale}
    given = {key: said.get(key) if value is None else value for key, value in given.items()}

    described = partial(Reading, file=str(file), mapping=None if beside is None else str(beside))
    plain = not columns and not units and joint_names is None and motors is None
    own = _own_recording(file, stored) if suffix == ".parquet" and plain else None
    if own is not None:
        changed = {name: value for name, value in given.items() if value is not None}
        recording = replace(own, **changed) if changed else own
        return described(recording=recording, sources={"all": "as written by Recording.to_parquet"})
    if stored:
        raise DataError(
            f"{file}: stored=True leaves the values in a Parquet file with the columns of "
            "Recording.to_parquet, read without columns, units, motors and joint_names; write one, "
            "or leave stored out."
        )
    if suffix in _BAGS:
        found: Table = LOADERS[suffix](file, topic=topic, joint_names=joint_names)
    elif topic is not None:
        raise DataError(f"{file}: topic is for ROS bags; this is a file {suffix}.")
    else:
        found = LOADERS[suffix](file)
    return _assembled(file, found, columns, units, motors, joint_names, rate_hz, given, described)


# Formats whose loaders choose among topics and joints.
_BAGS = (".db3", ".mcap", ".bag")


def _suffix(file: Path) -> str:
    """Return what tells the format; the folder of a ROS 2 bag counts as a ``.db3``."""
    if file.is_dir():
        if (file / "metadata.yaml").is_file():
            return ".db3"
        raise DataError(f"{file}: is a folder without metadata.yaml, so it is no ROS 2 bag.")
    suffix = file.suffix.lower()
    if suffix not in LOADERS:
        raise DataError(
            f"{file}: format '{suffix}' is not known; supported are {', '.join(sorted(LOADERS))}."
        )
    if not file.is_file():
        raise DataError(f"{file}: there is no such file.")
    return suffix


def _assembled(
    file: Path,
    found: Table,
    columns: Mapping[str, Any],
    units: Mapping[str, Any],
    motors: MotorSide | None,
    wanted: tuple[str, ...] | None,
    rate_hz: float | None,
    given: dict[str, Any],
    described: Any,
) -> Reading:
    """Turn the named arrays of a file into a recording."""
    log = Columns(file, found, columns)
    stored = log.names()
    tables: dict[str, NDArray[Any]] = {}
    labels: dict[str, tuple[str, ...]] = {}
    for quantity in _TABLES:
        table, label = log.table(quantity, stored if wanted is None else wanted)
        if table is None:
            if quantity == "velocity":
                continue
            raise log.missing(quantity)
        tables[quantity] = _numbers(file, quantity, table)
        if label is not None:
            labels[quantity] = label
    _align(file, tables, labels)
    own = labels.get("position")
    if own is None or all(name.isdigit() for name in own):
        # Numbers are no names; arrays, and numbered columns, follow the stored names.
        own = stored
    scale = given["effort_scale"]
    if scale is None and (raw := log.single("effort_scale")) is not None:
        scale = np.atleast_1d(raw)
        if own is not None and stored is not None and own != stored and set(own) <= set(stored):
            # Columns were picked by name: the factors follow them.
            scale = scale[[stored.index(name) for name in own]]
    units = {**log.implied, **units}
    tables = {name: _scaled(file, table, name, units) for name, table in tables.items()}
    if _is_current(units) and scale is None and (motors is None or motors.torque_constants is None):
        raise DataError(
            f"{file}: effort in A needs effort_scale: torque constant times gear ratio, for each "
            "joint, in N.m/A; or torque constants of motors."
        )
    if motors is not None:
        if scale is not None and "effort" in motors.applies_to:
            raise DataError(
                f"{file}: effort_scale is of the joints' side, but motors says that efforts are of "
                "the motors'; give torque_constants in motors instead."
            )
        tables = {name: motors.to_joints(name, table) for name, table in tables.items()}
    names, order = _ordered(file, own, wanted, tables["position"].shape[1])
    if order is not None:
        tables = {name: _picked(file, name, table, order) for name, table in tables.items()}
        if given["effort_scale"] is None and scale is not None and scale.size > max(order):
            scale = scale[order]

    def scalar(name: str) -> Any:
        if given[name] is not None:
            return given[name]
        value = log.single(name)
        return None if value is None else value.item() if value.size == 1 else value

    count = scalar("periods")
    recording = Recording(
        time=_time(file, log, units, len(tables["position"]), rate_hz),
        position=tables["position"],
        effort=tables["effort"],
        velocity=tables.get("velocity"),
        joint_names=names,
        period=scalar("period"),
        start=scalar("start"),
        periods=_whole(count),
        effort_scale=scale,
    )
    sources = {}
    for quantity, used in log.used.items():
        text = used[0] if len(used) == 1 else f"{used[0]} ... {used[-1]}"
        unit = units.get(quantity)
        text += "" if unit is None else f" in {unit if isinstance(unit, str) else '/'.join(unit)}"
        if motors is not None and quantity in motors.applies_to:
            text += ", motor side"
        sources[quantity] = text
    return described(recording=recording, sources=sources)  # type: ignore[no-any-return]


def _own_recording(file: Path, stored: bool | None) -> Recording | None:
    """Read a file with the columns of `Recording.to_parquet`; None when it has others."""
    found = LOADERS[".parquet"](file)
    wanted = ("time", "position_", "effort_")
    if all(any(name.startswith(prefix) for name in found) for prefix in wanted):
        return Recording.from_parquet(file, stored=stored)
    return None


def _tuple(names: Any) -> tuple[str, ...] | None:
    """Return joint names as a tuple of texts."""
    if names is None:
        return None
    if isinstance(names, str) or not all(isinstance(name, str) for name in names):
        raise DataError(f"joint_names: is {names!r}, expected a sequence of names.")
    return tuple(names)


def _whole(count: Any) -> Any:
    """Return a whole number of any numeric type as an int; `Recording` refuses the rest."""
    if isinstance(count, float) and count.is_integer():
        return int(count)
    return count


def _known(given: Mapping[str, Any], allowed: Mapping[str, Any], what: str) -> dict[str, Any]:
    """Return a mapping whose keys are all allowed."""
    unknown = sorted(set(given) - set(allowed))
    if unknown:
        raise DataError(
            f"{what}: {', '.join(unknown)} is not a quantity; known are {', '.join(allowed)}."
        )
    return dict(given)


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
    own = labels.get("position")
    for quantity, label in labels.items():
        if own is None or label == own:
            continue
        if set(label) != set(own):
            raise DataError(
                f"{file}: the columns of {quantity} are of joints {', '.join(label)}, those of "
                f"position of joints {', '.join(own)}; give columns=."
            )
        tables[quantity] = tables[quantity][:, [label.index(name) for name in own]]


def _ordered(
    file: Path, own: tuple[str, ...] | None, wanted: tuple[str, ...] | None, n: int
) -> tuple[tuple[str, ...] | None, list[int] | None]:
    """Return the joints' names, and which columns to take where some are picked by name."""
    if wanted is None or own is None or wanted == own:
        return (own if wanted is None else wanted), None
    common = set(own) & set(wanted)
    if not common and len(wanted) == n:
        return wanted, None
    if common != set(wanted) or len(own) != n:
        raise DataError(
            f"{file}: joint_names are {', '.join(wanted)}, the file has {', '.join(own)} for "
            f"{n} columns; give names that are all in the file, or a new one for each column."
        )
    return wanted, [own.index(name) for name in wanted]


def _picked(file: Path, name: str, table: NDArray[Any], order: list[int]) -> NDArray[Any]:
    """Return some columns of a table."""
    if table.shape[1] <= max(order):
        raise DataError(
            f"{file}: {name} has {table.shape[1]} columns, too few for column {max(order) + 1}."
        )
    return table[:, order]


def _is_current(units: Mapping[str, Any]) -> bool:
    """Tell whether efforts are logged as currents."""
    unit = units.get("effort")
    return any(one in _CURRENTS for one in ([unit] if isinstance(unit, str) else unit or ()))


def _scaled(
    file: Path, values: NDArray[Any], quantity: str, units: Mapping[str, Any]
) -> NDArray[Any]:
    """Convert to SI."""
    unit = units.get(quantity)
    if unit is None:
        return values
    each = [unit] if isinstance(unit, str) else list(unit)
    for one in each:
        if one not in _UNITS[quantity]:
            raise DataError(
                f"units: '{one}' is not known for {quantity}; known are "
                f"{', '.join(_UNITS[quantity])}."
            )
    if values.dtype.kind not in "fiu":
        raise DataError(f"{file}: {quantity}: holds {values.dtype}, expected numbers.")
    factors = np.array([_UNITS[quantity][one] for one in each])
    if isinstance(unit, str):
        return values if factors[0] == 1.0 else np.asarray(values * factors[0])
    if values.ndim != 2 or len(each) != values.shape[1]:
        raise DataError(
            f"units: {len(each)} units for {quantity}, which has the shape {values.shape}."
        )
    return np.asarray(values * factors)


def _time(
    file: Path, log: Columns, units: Mapping[str, Any], count: int, rate_hz: float | None
) -> NDArray[Any]:
    """Read the time stamps, or make them from the sample rate."""
    time = log.single("time")
    if time is not None:
        if time.ndim == 2 and 1 in time.shape:
            time = time.ravel()
        if time.dtype.kind in "Mm":
            # Relative, since seconds since 1970 in a double resolve no microsecond.
            time = (time - time[:1]) / np.timedelta64(1, "ns") * 1e-9
        elif time.dtype.kind in "iu" and time.ndim == 1 and time.size and time[0] > _LONG_COUNT:
            time = time.astype(np.int64) - np.int64(time[0])
        return _scaled(file, np.asarray(time), "time", {**log.implied, **units})
    rate: Any = rate_hz if rate_hz is not None else log.single("rate")
    if rate is None:
        raise log.missing("time")
    rate = np.asarray(rate)
    if rate.size != 1 or rate.dtype.kind not in "fiu" or not 0.0 < rate.item() < np.inf:
        raise DataError(f"{file}: the sample rate is {rate!r}, expected one positive number.")
    log.used["time"] = (f"sample rate, {rate.item():g} Hz",)
    stamps: NDArray[Any] = np.arange(count) / float(rate.item())
    return stamps
