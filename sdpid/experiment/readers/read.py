"""`read_recording`: from a log file to a `Recording`, by names and units."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias, overload

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import real_array
from sdpid.errors import DataError
from sdpid.experiment.readers.column_names import CONVENTIONS
from sdpid.experiment.readers.formats import LOADERS, load_frame
from sdpid.experiment.readers.mapping import find_mapping, read_mapping
from sdpid.experiment.readers.missing import MISSING, mend_missing
from sdpid.experiment.readers.selection import Selection, read_selection, select
from sdpid.experiment.readers.table import row_number
from sdpid.experiment.readers.unit_names import UNITS, is_current
from sdpid.experiment.recording.motor_side import MotorSide
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.recording.stored import transformed
from sdpid.experiment.recording.timestamps import guess_time_unit

__all__ = ["Reading", "read_described", "read_recording"]

# A file, or a data frame of pandas or polars.
Source: TypeAlias = "str | os.PathLike[str] | Any"

# Larger stamps, in s, count from 1970. Finer units are then made relative before they are
# converted, since seconds since 1970 in a double resolve 0.2 microseconds.
_SINCE_1970 = 1e9
# Formats whose loaders choose among topics and joints.
_BAGS = (".db3", ".mcap", ".bag")


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
def read_recording(path: Sequence[str | os.PathLike[str]], **how: Any) -> list[Recording]: ...
@overload
def read_recording(path: Source, **how: Any) -> Recording: ...
def read_recording(path: Any, **how: Any) -> Any:
    """Read a log, or several that were logged in the same way.

    CSV (also ``.csv.gz``), Parquet, NPZ, MATLAB (MAT), HDF5, ROS bags with
    ``sensor_msgs/JointState`` (files ``.db3``, ``.mcap``, ``.bag``, or the folder of a ROS 2
    bag), and data frames of pandas or polars.

    Quantities are found by the usual names (``t``, ``q``, ``dq``, ``tau``, ``time``,
    ``position``, ``velocity``, ``effort``, ``actual_q``, ``fs``, ``joint_names``, ...): either an
    array of samples × joints, or one column a joint, named like ``q1``, ``q_1``, ``q[0]``,
    ``position_<joint>`` or ``<joint>_position``; the name may end with a unit (``time_ms``,
    ``position_deg_1``, ``Joint 1 [deg]``). Stamps without a unit that are whole numbers, or that
    count from 1970, are read in the unit that makes a rate of a robot. In files with groups or
    structs the last part of the path counts. Without time stamps, ``fs`` gives the sample rate in
    Hz. Nothing is ever unpickled or run.

    What is named otherwise is said by arguments, or by a mapping: a small TOML file beside the
    log, ``run.toml`` for ``run.csv``, with the same names as the arguments. Arguments win.

    Parameters
    ----------
    path : path-like, data frame, or a sequence of paths
        The file; its suffix tells the format. A sequence gives a list, and all must then have the
        same joints.
    mapping : path-like, mapping or False, optional
        A mapping elsewhere, or its content; False ignores the one beside the log.
    columns : mapping, optional
        Where to find quantities that have other names: ``{"effort": "tau_current"}`` names an
        array (or the beginning of the names of its columns), ``{"effort": ["i1", "i2"]}`` lists
        columns, ``{"velocity": None}`` leaves a quantity out. Of a text file without names,
        numbers from 1: ``{"time": 1, "position": [2, 3]}``.
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
    missing : {"refuse", "drop", "interpolate"}, optional
        What to do with samples that have no value (NaN, or an empty field): refuse the log (the
        default), drop the samples, or interpolate linearly over gaps of at most 10 samples.
    period, start, periods : optional
        As in `Recording`; override what the file says.
    effort_scale : (n,) array_like, optional
        N·m per unit of effort, where efforts are currents on the joints' side: the torque constant
        times the gear ratio. Efforts are multiplied by it.
    stored : bool, optional
        Whether to keep the values of a Parquet file in temporary files that are mapped into
        memory, so that a log may be larger than memory; by default those of logs that would take
        more than 256 MB. `TMPDIR` says where they lie.

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
    if not isinstance(path, (list, tuple)):
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
    path: Source,
    *,
    mapping: str | os.PathLike[str] | Mapping[str, Any] | bool | None = None,
    stored: bool | None = None,
    **how: Any,
) -> Reading:
    """Read a log, and tell where its quantities were found; see `read_recording`.

    Raises
    ------
    DataError
        As `read_recording`; also when an argument is not known.
    """
    is_frame = hasattr(path, "columns") and not isinstance(path, (str, os.PathLike))
    file = Path("data frame") if is_frame else _checked_path(path)
    options, mapped = _options(file, None if is_frame else file, mapping, how)
    if is_frame:
        selection = select(file, load_frame(path), **options.selection)
        return _converted(file, selection, options, row_number, mapped)
    suffix = _suffix(file)
    choices: dict[str, Any] = {}
    if suffix in _BAGS:
        choices = {"topic": options.topic, "joint_names": options.joint_names}
    elif options.topic is not None:
        raise DataError(f"{file}: topic is for ROS bags; this is a file {suffix}.")
    if suffix == ".parquet":
        choices = {"stored": stored}
    elif stored:
        raise DataError(
            f"{file}: stored=True keeps the values of Parquet files on disk; this is a file "
            f"{suffix}. Write it as Parquet (Recording.to_parquet), or leave stored out."
        )
    selection, place = read_selection(file, suffix, choices, options.selection)
    return _converted(file, selection, options, place, mapped)


@dataclass(kw_only=True)
class _Options:
    """The arguments of `read_recording`, completed by a mapping."""

    columns: dict[str, Any] = field(default_factory=dict)
    units: dict[str, Any] = field(default_factory=dict)
    motors: MotorSide | None = None
    joint_names: tuple[str, ...] | None = None
    topic: str | None = None
    rate_hz: float | None = None
    missing: str = "refuse"
    period: float | None = None
    start: float | None = None
    periods: int | None = None
    effort_scale: Any = None

    @property
    def scaled(self) -> bool:
        """Whether there are factors that turn currents into torques."""
        constants = None if self.motors is None else self.motors.torque_constants
        return self.effort_scale is not None or constants is not None

    @property
    def selection(self) -> dict[str, Any]:
        """Arguments of `select`."""
        return {
            "columns": self.columns,
            "wanted": self.joint_names,
            "scaled": self.scaled,
            "timeless": self.rate_hz is not None,
        }


def _options(
    file: Path, log: Path | None, mapping: Any, how: Mapping[str, Any]
) -> tuple[_Options, str | None]:
    """Return the arguments, those of a mapping where none are given, and the mapping's path."""
    known = [each.name for each in fields(_Options)]
    if unknown := sorted(set(how) - set(known)):
        raise DataError(
            f"read_recording: {', '.join(unknown)} is no argument; known are path, mapping, "
            f"stored, {', '.join(known)}."
        )
    beside = find_mapping(log) if log is not None and mapping in (None, True) else None
    if mapping is True and beside is None:
        raise DataError(f"{file}: there is no mapping beside it.")
    stated: dict[str, Any] = {}
    if beside is not None:
        stated = read_mapping(beside)
    elif mapping is not None and mapping is not False:
        stated = read_mapping(mapping)
        beside = None if isinstance(mapping, Mapping) else Path(mapping)
    merged = {**stated, **{name: value for name, value in how.items() if value is not None}}
    for name, allowed in (("columns", CONVENTIONS), ("units", UNITS)):
        merged[name] = _known({**stated.get(name, {}), **(how.get(name) or {})}, allowed, name)
    merged["columns"] = {q: _as_names(value) for q, value in merged["columns"].items()}
    if isinstance(merged.get("motors"), Mapping):
        merged["motors"] = MotorSide.from_mapping(merged["motors"])
    merged["joint_names"] = _tuple(merged.get("joint_names"))
    options = _Options(**merged)
    if options.missing not in MISSING:
        raise DataError(f"missing: is {options.missing!r}, expected one of {', '.join(MISSING)}.")
    return options, None if beside is None else str(beside)


def _checked_path(path: Any) -> Path:
    """Return a path."""
    try:
        return Path(path)
    except TypeError:
        raise DataError(
            f"read_recording: is given {type(path).__name__}, expected the path of a log, a data "
            "frame, or a list of paths."
        ) from None


def _suffix(file: Path) -> str:
    """Return what tells the format; the folder of a ROS 2 bag counts as a ``.db3``."""
    if file.is_dir():
        if (file / "metadata.yaml").is_file():
            return ".db3"
        raise DataError(f"{file}: is a folder without metadata.yaml, so it is no ROS 2 bag.")
    suffix = file.suffix.lower()
    if suffix == ".gz":
        suffix = "".join(file.suffixes[-2:]).lower()
    if suffix not in LOADERS:
        raise DataError(
            f"{file}: format '{suffix}' is not known; supported are {', '.join(sorted(LOADERS))}."
        )
    if not file.is_file():
        what = "is no regular file" if file.exists() else "there is no such file"
        raise DataError(f"{file}: {what}.")
    return suffix


def _converted(
    file: Path,
    found: Selection,
    options: _Options,
    place: Any,
    mapped: str | None,
) -> Reading:
    """Turn what a log holds into a recording: joints picked, units converted, gaps mended."""
    tables, motors = found.tables, options.motors
    units = {**found.units, **options.units}
    scale = found.numbers.get("effort_scale")
    scale = scale if options.effort_scale is None else options.effort_scale
    constants = None if motors is None else motors.torque_constants
    if is_current(units.get("effort")) and scale is None and constants is None:
        raise DataError(
            f"{file}: effort in A needs effort_scale: torque constant times gear ratio, for each "
            "joint, in N.m/A; or torque constants of motors."
        )
    if motors is not None and scale is not None and "effort" in motors.applies_to:
        raise DataError(
            f"{file}: effort_scale is of the joints' side, but motors says that efforts are of "
            "the motors'; give torque_constants in motors instead."
        )
    labels = None if found.labels is None else tuple(found.labels)
    names, order = _ordered(file, labels, options.joint_names, tables["position"].shape[1])
    if order is not None and motors is None:
        # Joints that are not wanted may lack values.
        tables = {name: _picked(file, name, table, order) for name, table in tables.items()}
    time, sources = _time(file, found, options, len(tables["position"]))
    used = {name: _column_names(found, name, order, motors) for name in tables}
    time, tables, note = mend_missing(file, time, tables, used, place, options.missing)
    tables = {name: _scaled(table, name, units, order, motors) for name, table in tables.items()}
    if motors is not None:
        tables = {
            name: transformed(table, partial(motors.to_joints, name))
            for name, table in tables.items()
        }
        if order is not None:
            tables = {name: _picked(file, name, table, order) for name, table in tables.items()}
    if scale is not None:
        if order is not None and options.effort_scale is None and np.size(scale) > max(order):
            scale = np.asarray(scale)[order]
        scale = _checked_scale(file, scale, tables["effort"].shape[1])
        tables["effort"] = transformed(tables["effort"], lambda values: values * scale)
    stated = {
        name: value if (value := getattr(options, name)) is not None else found.numbers.get(name)
        for name in ("period", "start", "periods")
    }
    try:
        recording = Recording(
            time=time,
            position=tables["position"],
            effort=tables["effort"],
            velocity=tables.get("velocity"),
            joint_names=names,
            **{**stated, "periods": _whole(stated["periods"])},
        )
    except DataError as cause:
        raise DataError(f"{file}: {cause}") from None
    for quantity, names_read in found.used.items():
        if quantity in sources:
            continue
        text = names_read[0] if len(names_read) == 1 else f"{names_read[0]} ... {names_read[-1]}"
        unit = units.get(quantity)
        text += "" if unit is None else f" in {unit if isinstance(unit, str) else '/'.join(unit)}"
        if motors is not None and quantity in motors.applies_to:
            text += ", motor side"
        sources[quantity] = text
    if note:
        sources["missing values"] = note
    return Reading(recording=recording, file=str(file), mapping=mapped, sources=sources)


def _checked_scale(file: Path, scale: Any, count: int) -> NDArray[np.float64]:
    """Return the factors from the unit of effort to N.m, one for each joint that is read."""
    factors = np.atleast_1d(real_array(scale, f"{file}: effort_scale", ndim=np.ndim(scale)))
    if factors.shape != (count,) or not factors.all():
        raise DataError(
            f"{file}: effort_scale: is {factors.tolist()}, expected {count} non-zero factors, one "
            "for each joint."
        )
    return factors


def _column_names(
    found: Selection, quantity: str, order: list[int] | None, motors: MotorSide | None
) -> list[str]:
    """Return a name for each column of a table, for messages."""
    used, count = list(found.used.get(quantity, [quantity])), found.tables[quantity].shape[1]
    if len(used) != count:
        labels = found.labels
        used = [f"{used[0]} of joint {labels[j] if labels else j + 1}" for j in range(count)]
    return used if order is None or motors is not None else [used[j] for j in order]


def _as_names(value: Any) -> Any:
    """Return the names of columns as texts; numbers stand for columns without names."""
    if isinstance(value, (list, tuple)):
        return [str(entry) for entry in value]
    return value if value is None else str(value)


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
    return transformed(table, lambda part: part[:, order])


def _scaled(
    values: NDArray[Any],
    quantity: str,
    units: Mapping[str, Any],
    order: list[int] | None,
    motors: MotorSide | None,
) -> NDArray[Any]:
    """Convert to SI."""
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
    elif order is not None and motors is None and len(each) > max(order):
        factors = factors[order]
    if not isinstance(unit, str) and len(factors) != values.shape[1]:
        raise DataError(
            f"units: {len(each)} units for {quantity}, which has the shape {values.shape}."
        )
    return transformed(values, lambda part: part * factors)


def _time(
    file: Path, found: Selection, options: _Options, count: int
) -> tuple[NDArray[Any], dict[str, str]]:
    """Return the time stamps in s, and where they come from if that is not plain."""
    time = found.time
    if time is None:
        rate = found.rate if options.rate_hz is None else options.rate_hz
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
    unit = options.units.get("time", found.units.get("time"))
    if unit is not None and unit not in UNITS["time"]:
        raise DataError(
            f"units: '{unit}' is not known for time; known are {', '.join(UNITS['time'])}."
        )
    note = {}
    if unit is None:
        unit = guess_time_unit(time)
        if unit != "s":
            note = {"time": f"{name}, taken for {unit} by the steps of its numbers"}
    if unit == "s":
        return time, note
    if time.size and time[0] * UNITS["time"][unit] > _SINCE_1970:
        time = time - time[0]
    return time * UNITS["time"][unit], note
