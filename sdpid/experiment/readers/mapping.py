"""What a log is read with: a TOML file beside it with names, units and motors, and arguments."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import is_number
from sdpid._common.files import load_toml
from sdpid.errors import DataError
from sdpid.experiment.drive_gains.gains import DriveGains
from sdpid.experiment.readers.column_names import CONVENTIONS
from sdpid.experiment.readers.floating.quantities import SETTINGS, checked_settings
from sdpid.experiment.readers.missing import MISSING
from sdpid.experiment.readers.unit_names import UNITS
from sdpid.experiment.recording.floating.columns import mapping_beside
from sdpid.experiment.recording.motor_side import MotorSide

_NUMBERS = ("period", "start", "periods", "rate_hz")
_NAMES = ("joint_names", "without_effort")
_KNOWN = (
    *("columns", "units", "motors", "joint_names", "topic", "missing", "effort_scale", "gains"),
    *(*_NUMBERS, *SETTINGS, "rows"),
)
_TEXTS = "a text or a list of texts"
# Columns of a file without names, from the first to the last.
_RANGE = re.compile(r"(\d{1,4}):(\d{1,4})")


def find_mapping(log: Path) -> Path | None:
    """Return the mapping beside a log, if there is one."""
    beside = mapping_beside(log)
    return beside if beside.is_file() and beside != log else None


def read_mapping(source: str | os.PathLike[str] | Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of `read_recording` that a mapping holds.

    Parameters
    ----------
    source : path-like or mapping
        A TOML file, or its content. Keys are ``columns``, ``units`` and ``motors`` (tables),
        ``joint_names``, ``topic``, ``missing``, ``effort_scale``, ``gains`` (a file beside the
        mapping), ``rate_hz``, ``rows``, ``period``, ``start`` and ``periods``; of a floating
        base the tables ``base``, ``imu`` and ``contacts``.

    Raises
    ------
    DataError
        When the file cannot be read, or a key or value is not as expected.
    """
    inline = isinstance(source, Mapping)
    where = "mapping" if isinstance(source, Mapping) else os.fspath(source)
    content = dict(source) if isinstance(source, Mapping) else load_toml(source)
    if unknown := sorted(map(str, set(content) - set(_KNOWN))):
        raise DataError(
            f"{where}: {', '.join(unknown)} is not known; known are {', '.join(_KNOWN)}. "
            "Where this is no mapping of a log, read the log with mapping=False."
        )
    if isinstance(content.get("gains"), str) and not inline:
        content["gains"] = os.fspath(Path(where).parent / content["gains"])
    return checked(content, f"{where}: ")


def checked(given: Mapping[str, Any], where: str = "") -> dict[str, Any]:
    """Return arguments of `read_recording` as it needs them.

    Parameters
    ----------
    given : mapping
        From a mapping, or as they were given; those that are None are left out.
    where : str, optional
        What messages begin with.

    Raises
    ------
    DataError
        When a value is not as expected.
    """
    found = {name: value for name, value in given.items() if value is not None}

    def require(holds: bool, name: str, expected: str, value: Any) -> None:
        if not holds:
            raise DataError(f"{where}{name} is {value!r:.80}, expected {expected}.")

    for name, allowed in (("columns", CONVENTIONS), ("units", UNITS), ("motors", None)):
        table = found.get(name, {})
        if name != "motors" or not isinstance(table, MotorSide):
            require(isinstance(table, Mapping), name, f"a table [{name}]", table)
        if allowed is not None and (unknown := sorted(map(str, set(table) - set(allowed)))):
            raise DataError(
                f"{where}{name}: {', '.join(unknown)} is not a quantity; known are "
                f"{', '.join(allowed)}."
            )
    for quantity, value in found.get("columns", {}).items():
        several = isinstance(value, (list, tuple))
        each = value if several else [value]
        # TOML, which has no null, says so that a quantity is not to be read.
        nothing = value is None or value is False or value == "none"
        right = all(isinstance(x, (str, int, np.integer)) and x is not True for x in each)
        require(right or nothing, f"columns.{quantity}", _TEXTS, value)
        names = [text for x in each for text in _columns(str(x))]
        wanted: Any = names if several or len(names) > 1 else names[0]
        found["columns"] = {**found["columns"], quantity: None if nothing else wanted}
    for quantity, value in found.get("units", {}).items():
        right = isinstance(value, str) or (quantity != "time" and _are_texts(value))
        require(right, f"units.{quantity}", _TEXTS, value)
    for name in _NAMES:
        if name in found:
            require(_are_texts(found[name]), name, "names", found[name])
            found[name] = tuple(found[name])
    require(isinstance(found.get("topic", ""), str), "topic", "a text", found.get("topic"))
    missing = found.get("missing", MISSING[0])
    require(missing in MISSING, "missing:", f"one of {', '.join(MISSING)}", missing)
    for name in _NUMBERS:
        require(is_number(found.get(name, 0)), name, "a number", found.get(name))
    for name in set(SETTINGS) & set(found):
        found[name] = checked_settings(name, found[name])
    if "rows" in found:
        rows = found["rows"]
        whole = isinstance(rows, (list, tuple)) and all(type(row) is int for row in rows)
        right = whole and len(rows) == 2 and 1 <= rows[0] < rows[1]
        expected = "the first and the last row to read, counted from 1, as in [1, 2000]"
        require(right, "rows:", expected, rows)
        found["rows"] = tuple(rows)
    if isinstance(found.get("motors"), Mapping):
        try:
            found["motors"] = MotorSide.from_mapping(found["motors"])
        except DataError as cause:
            raise DataError(f"{where}{cause}") from None
    if "gains" in found:
        found["gains"] = as_gains(found["gains"])
    return found


def _are_texts(value: Any) -> bool:
    """Tell whether a value is a list of texts."""
    several = isinstance(value, Collection) and not isinstance(value, str)
    return several and all(isinstance(entry, str) for entry in value)


def _columns(text: str) -> list[str]:
    """Return the columns that a text stands for: itself, or of ``2:7`` those from 2 to 7."""
    match = _RANGE.fullmatch(text)
    return [str(k) for k in range(int(match[1]), int(match[2]) + 1)] if match else [text]


def as_gains(given: Any) -> Any:
    """Return gains that are given as such, by their file, by `DriveGains.to_dict`, or as numbers.

    Raises
    ------
    DataError
        When a file cannot be read, or a mapping is none of gains.
    """
    if isinstance(given, (str, os.PathLike)):
        return DriveGains.from_toml(given)
    return DriveGains.from_dict(given) if isinstance(given, Mapping) else given
