"""The arguments of `read_recording`, completed by a TOML file beside the log, and checked."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import is_number
from sdpid._common.files import load_toml
from sdpid._common.tables import plain
from sdpid.errors import DataError
from sdpid.experiment.drive_gains.gains import DriveGains
from sdpid.experiment.readers.column_names import CONVENTIONS
from sdpid.experiment.readers.floating.quantities import HELD, SETTINGS, checked_settings
from sdpid.experiment.readers.missing import MISSING
from sdpid.experiment.readers.unit_names import UNITS
from sdpid.experiment.recording.floating.columns import mapping_beside
from sdpid.experiment.recording.motor_side import MotorSide

# Arguments that a mapping does not take.
_NO_MAPPING = ("currents", "without_effort")
_TEXTS = "a text or a list of texts"
# Columns of a file without names, from the first to the last.
_RANGE = re.compile(r"(\d{1,4}):(\d{1,4})")


@dataclass(kw_only=True)
class Arguments:
    """The arguments of `read_recording` that say what is in a log; see there."""

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
    gains: Any = None
    currents: bool = False
    without_effort: tuple[str, ...] = ()
    base: dict[str, Any] = field(default_factory=dict)
    imu: dict[str, Any] = field(default_factory=dict)
    contacts: dict[str, Any] = field(default_factory=dict)
    rows: tuple[int, int] | None = None

    @property
    def scaled(self) -> bool:
        """Whether there are factors that turn currents into torques, or currents are wanted."""
        constants = None if self.motors is None else self.motors.torque_constants
        given = (self.effort_scale, constants, self.gains)
        return self.currents or any(each is not None for each in given)

    @property
    def amperes(self) -> bool:
        """Whether efforts are to be read as currents in A, which are turned into torques last."""
        return self.currents or self.gains is not None

    @property
    def selection(self) -> dict[str, Any]:
        """Arguments of `select`."""
        return {
            "columns": self.columns,
            "wanted": self.joint_names,
            "scaled": self.scaled,
            "timeless": self.rate_hz is not None,
            "floating": self.floating,
        }

    @property
    def floating(self) -> dict[str, Any]:
        """What is said of the columns of base, IMU and contacts."""
        said: dict[str, Any] = {name: plain(getattr(self, name)) for name in SETTINGS}
        said["base"] = {key: value for key, value in said["base"].items() if key not in HELD}
        return said

    def to_dict(self) -> dict[str, Any]:
        """Return the arguments that differ from their defaults, as plain values.

        ``read_recording(path, mapping=False, **arguments)`` reads the same again.
        """
        given = {each.name: plain(getattr(self, each.name)) for each in fields(self)}
        if isinstance(self.gains, DriveGains):
            given["gains"] = self.gains.to_dict()
        standard = plain(vars(Arguments()))
        return {name: value for name, value in given.items() if value != standard[name]}


def complete_arguments(
    log: Path | None, mapping: Any, how: Mapping[str, Any]
) -> tuple[Arguments, str | None]:
    """Return the arguments, those of the mapping where none are given, and the mapping's path.

    Parameters
    ----------
    log : Path or None
        The log, beside which a mapping may lie; None for a data frame.
    mapping : path-like, mapping or bool, optional
        As in `read_recording`.
    how : mapping
        The other arguments of `read_recording`.

    Raises
    ------
    DataError
        When an argument or a quantity is not known, or the mapping cannot be read.
    """
    known = [each.name for each in fields(Arguments)]
    if unknown := sorted(set(how) - set(known)):
        raise DataError(
            f"read_recording: {', '.join(unknown)} is no argument; known are path, mapping, "
            f"stored, {', '.join(known)}."
        )
    chosen = checked(how)
    beside = find_mapping(log) if log is not None and mapping in (None, True) else None
    if mapping is True and beside is None:
        raise DataError(f"{log}: there is no mapping beside it.")
    if beside is None and not isinstance(mapping, (bool, type(None), Mapping)):
        beside = Path(mapping)
    stated = read_mapping(beside or mapping) if beside or isinstance(mapping, Mapping) else {}
    # Either turns currents into torques: what is given wins over what the mapping says.
    if "gains" in chosen and not only_signs(stated.get("effort_scale")):
        stated.pop("effort_scale", None)
    if "effort_scale" in chosen and not only_signs(chosen["effort_scale"]):
        stated.pop("gains", None)
    tables = ("columns", "units", *SETTINGS)
    merged = {name: {**stated.get(name, {}), **chosen.get(name, {})} for name in tables}
    arguments = Arguments(**{**stated, **chosen, **merged})
    if arguments.currents and arguments.gains is not None:
        raise DataError("gains: turn currents into torques, and currents=True asks for currents.")
    return arguments, None if beside is None else str(beside)


def only_signs(scale: Any) -> bool:
    """Tell whether factors only turn signs."""
    try:
        return scale is not None and bool(np.all(np.abs(np.asarray(scale, dtype=float)) == 1.0))
    except (TypeError, ValueError):
        return False


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
    known = [each.name for each in fields(Arguments) if each.name not in _NO_MAPPING]
    if unknown := sorted(map(str, set(content) - set(known))):
        raise DataError(
            f"{where}: {', '.join(unknown)} is not known; known are {', '.join(known)}. "
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
    for name, (holds, expected) in _EXPECTED.items():
        label = f"{name}:" if name in ("missing", "rows") else name
        require(name not in found or holds(found[name]), label, expected, found.get(name))
    found |= {name: tuple(found[name]) for name in _LISTS if name in found}
    for name in set(SETTINGS) & set(found):
        found[name] = checked_settings(name, found[name])
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


def _are_rows(value: Any) -> bool:
    """Tell whether a value is a first and a last row."""
    whole = isinstance(value, (list, tuple)) and all(type(row) is int for row in value)
    return whole and len(value) == 2 and 1 <= value[0] < value[1]


_LISTS = ("joint_names", "without_effort", "rows")
# Of arguments that stand for themselves: whether they are right, and what is expected.
_EXPECTED: dict[str, tuple[Callable[[Any], bool], str]] = {
    "joint_names": (_are_texts, "names"),
    "without_effort": (_are_texts, "names"),
    "topic": (lambda value: isinstance(value, str), "a text"),
    "missing": (lambda value: value in MISSING, f"one of {', '.join(MISSING)}"),
    **dict.fromkeys(("period", "start", "periods", "rate_hz"), (is_number, "a number")),
    "rows": (
        _are_rows,
        "the first and the last row to read, counted from 1, as in [1, 2000]",
    ),
}


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
