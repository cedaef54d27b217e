"""`read_recording`: from a log file to a `Recording`, by names and units."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid.errors import DataError
from sdpid.experiment.formats import LOADERS, Table
from sdpid.experiment.recording import Recording

__all__ = ["read_recording"]

# Names under which quantities are usually found, in the order in which they are looked for.
_CONVENTIONS: dict[str, tuple[str, ...]] = {
    "time": ("time", "t", "timestamp", "time_s", "stamp"),
    "position": ("position", "q", "positions", "pos", "joint_position", "joint_positions"),
    "effort": ("effort", "tau", "torque", "efforts", "torques", "joint_effort", "joint_torque"),
    "velocity": ("velocity", "dq", "qd", "velocities", "vel", "qdot", "joint_velocity"),
    "joint_names": ("joint_names", "names"),
    "rate": ("fs", "rate_hz", "rate", "sample_rate"),
    "period": ("period",),
    "start": ("start",),
    "periods": ("periods",),
    "effort_scale": ("effort_scale",),
}
_TABLES = ("position", "effort", "velocity")

_DEGREE = np.pi / 180.0
# Factors to SI. Amperes stay amperes: `effort_scale` turns them into torques.
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
    "effort": {"N.m": 1.0, "Nm": 1.0, "N·m": 1.0, "mN.m": 1e-3, "mNm": 1e-3, "N": 1.0, "A": 1.0},
}


def read_recording(
    path: str | os.PathLike[str],
    *,
    columns: Mapping[str, str | Sequence[str] | None] | None = None,
    units: Mapping[str, str] | None = None,
    joint_names: Sequence[str] | None = None,
    period: float | None = None,
    start: float | None = None,
    periods: int | None = None,
    effort_scale: Any = None,
) -> Recording:
    """Read a log from a Parquet, CSV or NPZ file.

    Quantities are found by the usual names (``t``, ``q``, ``dq``, ``tau``, ``time``,
    ``position``, ``velocity``, ``effort``, ``fs``, ``joint_names``, ...): either an array of
    samples × joints, or one column a joint, named like ``q1``, ``q_1``, ``q[0]`` or
    ``position_<joint>``. Without time stamps, ``fs`` gives the sample rate in Hz. Nothing is ever
    unpickled.

    Parameters
    ----------
    path : path-like
        The file; its suffix tells the format.
    columns : mapping, optional
        Where to find quantities that have other names: ``{"effort": "tau_current"}`` names an
        array (or the beginning of the names of its columns), ``{"effort": ["i1", "i2"]}`` lists
        columns, ``{"velocity": None}`` leaves a quantity out.
    units : mapping, optional
        Units of the file where they are not SI, as ``{"position": "deg", "time": "ms"}``.
    joint_names : sequence of str, optional
        Overrides the names in the file; also picks and orders columns ``position_<joint>``.
    period, start, periods, effort_scale : optional
        As in `Recording`; override what the file says.

    Returns
    -------
    Recording

    Raises
    ------
    DataError
        When the file is missing or damaged, its format is unknown, a quantity is not found, a
        unit is unknown, or the data are not a valid recording.
    MissingExtraError
        When the format needs a package that is not installed.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    if suffix not in LOADERS:
        raise DataError(
            f"{file}: format '{suffix}' is not known; supported are {', '.join(sorted(LOADERS))}."
        )
    if not file.is_file():
        raise DataError(f"{file}: there is no such file.")
    columns = _known(columns or {}, _CONVENTIONS, "columns")
    units = _known(units or {}, _UNITS, "units")
    own_layout = suffix == ".parquet" and not columns and not units and joint_names is None
    if own_layout and (recording := _own_recording(file)) is not None:
        given = {"period": period, "start": start, "periods": periods}
        given |= {"effort_scale": effort_scale}
        changed = {name: value for name, value in given.items() if value is not None}
        return _replaced(recording, changed) if changed else recording

    found = LOADERS[suffix](file)
    names = joint_names if joint_names is not None else _names(found, columns)
    tables: dict[str, NDArray[Any] | None] = {}
    labels: dict[str, tuple[str, ...]] = {}
    for quantity in _TABLES:
        table, label = _table(found, quantity, columns, names)
        if table is None and quantity != "velocity":
            raise DataError(_missing(file, quantity, found))
        if table is not None:
            tables[quantity] = _scaled(table, quantity, units)
        if label is not None:
            labels[quantity] = label
    for quantity, label in labels.items():
        if label != labels.get("position", label):
            raise DataError(
                f"{file}: the columns of {quantity} are of joints {', '.join(label)}, those of "
                f"position of joints {', '.join(labels['position'])}; give columns=."
            )
    if names is None and not all(name.isdigit() for name in labels.get("position", ("1",))):
        names = labels["position"]

    def scalar(name: str, given: Any) -> Any:
        if given is not None:
            return given
        value = _single(found, name, columns)
        return None if value is None else value.item() if value.size == 1 else value

    count = scalar("periods", periods)
    scale = effort_scale
    if scale is None and (raw := _single(found, "effort_scale", columns)) is not None:
        scale = np.atleast_1d(raw)
        order, stored = labels.get("position"), _names(found, columns)
        if order is not None and stored is not None and set(order) <= set(stored):
            # Columns were picked by name: the factors follow them.
            scale = scale[[stored.index(name) for name in order]]
    if units.get("effort") == "A" and scale is None:
        raise DataError(
            f"{file}: effort in A needs effort_scale: torque constant times gear ratio, for each "
            "joint, in N.m/A."
        )
    position = tables["position"]
    assert position is not None
    return Recording(
        time=_time(file, found, columns, units, position.shape[0]),
        position=position,
        effort=tables["effort"],  # type: ignore[arg-type]
        velocity=tables.get("velocity"),
        joint_names=None if names is None else tuple(names),
        period=scalar("period", period),
        start=scalar("start", start),
        periods=None if count is None else int(count),
        effort_scale=scale,
    )


def _own_recording(file: Path) -> Recording | None:
    """Read a file with the columns of `Recording.to_parquet`; None when it has others."""
    found = LOADERS[".parquet"](file)
    wanted = ("time", "position_", "effort_")
    if all(any(name.startswith(prefix) for name in found) for prefix in wanted):
        return Recording.from_parquet(file)
    return None


def _replaced(recording: Recording, changed: dict[str, Any]) -> Recording:
    """Return the recording with some fields changed; arrays are shared."""
    from dataclasses import replace

    return replace(recording, **changed)


def _known(given: Mapping[str, Any], allowed: Mapping[str, Any], what: str) -> Mapping[str, Any]:
    """Return a mapping whose keys are all allowed."""
    unknown = sorted(set(given) - set(allowed))
    if unknown:
        raise DataError(
            f"{what}: {', '.join(unknown)} is not a quantity; known are {', '.join(allowed)}."
        )
    return given


def _missing(file: Path, quantity: str, found: Table) -> str:
    """Say that a quantity was not found, and what was."""
    return (
        f"{file}: {quantity} is missing: none of {', '.join(_CONVENTIONS[quantity])} is there. "
        f"Found: {', '.join(found) or 'nothing'}. Name it with columns={{'{quantity}': ...}}."
    )


def _keys(found: Table, quantity: str, columns: Mapping[str, Any]) -> list[str]:
    """Return the names to look for: the one given, or the usual ones, as the file spells them."""
    if quantity in columns:
        key = columns[quantity]
        return [] if key is None else [key] if isinstance(key, str) else list(key)
    spelled = {name.lower(): name for name in reversed(list(found))}
    return [spelled.get(name, name) for name in _CONVENTIONS[quantity]]


def _single(found: Table, quantity: str, columns: Mapping[str, Any]) -> NDArray[Any] | None:
    """Read the array of a quantity that is a single array, if there is one."""
    for key in _keys(found, quantity, columns):
        if key in found:
            return found[key]()
    if columns.get(quantity) is not None:
        raise DataError(
            f"columns: '{columns[quantity]}' for {quantity} is not there; found: "
            f"{', '.join(found)}."
        )
    return None


def _names(found: Table, columns: Mapping[str, Any]) -> tuple[str, ...] | None:
    """Read the joint names of a file, if it has any."""
    names = _single(found, "joint_names", columns)
    if names is None:
        return None
    if names.dtype.kind not in "US":
        raise DataError(f"joint_names: holds {names.dtype}, expected text.")
    return tuple(str(name) for name in np.atleast_1d(names.astype(np.str_)))


def _table(
    found: Table, quantity: str, columns: Mapping[str, Any], names: Sequence[str] | None
) -> tuple[NDArray[Any] | None, tuple[str, ...] | None]:
    """Read samples × joints, and the joints' labels where columns carry them."""
    given = columns.get(quantity)
    if given is not None and not isinstance(given, str):
        absent = [key for key in given if key not in found]
        if absent:
            raise DataError(
                f"columns: {', '.join(absent)} for {quantity} is not there; found: "
                f"{', '.join(found)}."
            )
        return _stacked(found, list(given)), None
    for key in _keys(found, quantity, columns):
        if key in found:
            table = found[key]()
            return (table[:, None] if table.ndim == 1 else table), None
        group = _group(found, key, names)
        if group:
            return _stacked(found, list(group.values())), tuple(group)
    if given is not None:
        raise DataError(
            f"columns: '{given}' for {quantity} is not there, nor are columns '{given}_<joint>'; "
            f"found: {', '.join(found)}."
        )
    return None, None


def _group(found: Table, key: str, names: Sequence[str] | None) -> dict[str, str]:
    """Return label -> column for the columns that are named `key` and a joint or a number.

    Numbers win over words, so that ``q_1`` is not mixed with ``q_target_1``.
    """
    pattern = re.compile(re.escape(key) + r"(?:[_./]?\[?(\d+)\]?|[_./](.+))", re.IGNORECASE)
    numbered: dict[int, str] = {}
    labelled: dict[str, str] = {}
    for name in found:
        match = pattern.fullmatch(name)
        if match is not None and match[1] is not None:
            numbered[int(match[1])] = name
        if match is not None and match[2] is not None:
            labelled[match[2]] = name
        elif match is not None:
            labelled[match[1]] = name
    if names is not None and all(name in labelled for name in names):
        return {name: labelled[name] for name in names}
    if numbered:
        return {str(number): numbered[number] for number in sorted(numbered)}
    return labelled


def _stacked(found: Table, keys: list[str]) -> NDArray[Any]:
    """Read single columns into one array, one after the other."""
    table: NDArray[Any] | None = None
    for j, key in enumerate(keys):
        column = found[key]()
        if column.ndim != 1 or (table is not None and column.shape != table.shape[:1]):
            raise DataError(f"columns: '{key}' has shape {column.shape}, expected one column.")
        if column.dtype.kind not in "fiub":
            raise DataError(f"columns: '{key}' holds {column.dtype}, expected numbers.")
        if table is None:
            table = np.empty((column.size, len(keys)))
        table[:, j] = column
    assert table is not None
    return table


def _scaled(values: NDArray[Any], quantity: str, units: Mapping[str, str]) -> NDArray[Any]:
    """Convert to SI."""
    unit = units.get(quantity)
    if unit is None:
        return values
    factors = _UNITS[quantity]
    if unit not in factors:
        raise DataError(
            f"units: '{unit}' is not known for {quantity}; known are {', '.join(factors)}."
        )
    if values.dtype.kind not in "fiu":
        raise DataError(f"{quantity}: holds {values.dtype}, expected numbers.")
    return values if factors[unit] == 1.0 else values * factors[unit]


def _time(
    file: Path, found: Table, columns: Mapping[str, Any], units: Mapping[str, str], count: int
) -> NDArray[Any]:
    """Read the time stamps, or make them from the sample rate."""
    time = _single(found, "time", columns)
    if time is not None:
        if time.ndim == 2 and 1 in time.shape:
            time = time.ravel()
        return _scaled(time, "time", units)
    rate = _single(found, "rate", columns)
    if rate is None:
        raise DataError(_missing(file, "time", found))
    if rate.size != 1 or rate.dtype.kind not in "fiu" or not 0.0 < rate.item() < np.inf:
        raise DataError(f"{file}: the sample rate is {rate!r}, expected one positive number.")
    stamps: NDArray[Any] = np.arange(count) / float(rate.item())
    return stamps
