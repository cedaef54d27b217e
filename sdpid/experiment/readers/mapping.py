"""The arguments of `read_recording`, completed by a TOML file beside the log, and checked."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import is_number
from sdpid._common.files import load_toml, require_known
from sdpid._common.tables import plain
from sdpid.errors import DataError
from sdpid.experiment.drive_gains.gains import DriveGains
from sdpid.experiment.readers.names import QUANTITIES, UNITS
from sdpid.experiment.recording.motor_side import MotorSide
from sdpid.experiment.recording.recording import mapping_beside

# What to do with samples that lack a value.
MISSING = ("refuse", "drop", "interpolate")
# What the arguments, or tables of a mapping, of a floating base may say.
SETTINGS: dict[str, tuple[str, ...]] = {
    "base": ("quaternion", "velocity_frame", "topic", "held", "orientation"),
    "imu": ("translation", "rotation", "topic"),
    "contacts": ("frames", "kind", "offset", "threshold"),
}
# Of these, the settings of a base that was held.
_HELD = ("held", "orientation")
_ORDERS = ("xyzw", "wxyz")
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
        constants = getattr(self.motors, "torque_constants", None)
        return self.amperes or self.effort_scale is not None or constants is not None

    @property
    def amperes(self) -> bool:
        """Whether efforts are to be read as currents in A, which are turned into torques last."""
        return self.currents or self.gains is not None

    @property
    def floating(self) -> dict[str, dict[str, Any]]:
        """Settings of the columns of base, IMU and contacts."""
        base = {} if "held" in self.base else self.base
        return {"base": base, "imu": self.imu, "contacts": self.contacts}

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
    known = ["path", "mapping", "stored", *known]
    require_known(how, known, "read_recording", "is no argument")
    chosen = checked(how)
    beside = None if log is None else mapping_beside(log)
    there = beside is not None and beside != log and beside.is_file()
    if mapping is True and log is not None and not there:
        raise DataError(f"{log}: there is no mapping beside it.")
    source = mapping or {}
    if mapping is None or mapping is True:
        source = beside if there else {}
    stated, file = read_mapping(source), None if isinstance(source, Mapping) else Path(source)
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
    return arguments, None if file is None else str(file)


def only_signs(scale: Any) -> bool:
    """Tell whether factors only turn signs."""
    try:
        return scale is not None and bool(np.all(np.abs(np.asarray(scale, dtype=float)) == 1.0))
    except (TypeError, ValueError):
        return False


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
    if isinstance(source, Mapping):
        where, content = "mapping", dict(source)
    else:
        where, content = os.fspath(source), load_toml(source)
        if isinstance(content.get("gains"), str):
            content["gains"] = os.fspath(Path(where).parent / content["gains"])
    known = [each.name for each in fields(Arguments) if each.name not in _NO_MAPPING]
    hint = "where this is no mapping of a log, read the log with mapping=False"
    require_known(content, known, f"{where} ({hint})")
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
    try:
        for name, value in found.items():
            if name in _EXPECTED:
                right, expected = _EXPECTED[name]
                _require(right(value), name, value, expected)
                several = isinstance(value, Collection) and not isinstance(value, str)
                found[name] = tuple(value) if several else value
            else:
                found[name] = _MADE.get(name, lambda value: value)(value)
    except DataError as cause:
        raise DataError(f"{where}{cause}") from None
    return found


def _require(holds: bool, name: str, value: Any, expected: str) -> None:
    """Raise where a value is not as expected."""
    if not holds:
        raise DataError(f"{name} is {value!r:.80}, expected {expected}.")


def _table(name: str, value: Any, known: Iterable[str], what: str = "known") -> dict[str, Any]:
    """Return a table of a mapping whose keys are known."""
    _require(isinstance(value, Mapping), name, value, f"a table [{name}]")
    require_known(value, known, name, f"is not {what}")
    return dict(value)


def _columns(value: Any) -> dict[str, Any]:
    """Return the names of columns as texts; None for what is not to be read."""
    found = _table("columns", value, QUANTITIES, "a quantity")
    for quantity, given in found.items():
        # TOML, which has no null, says so that a quantity is not to be read.
        if given is None or given is False or given == "none":
            found[quantity] = None
            continue
        several = isinstance(given, (list, tuple))
        each = given if several else [given]
        right = all(isinstance(x, (str, int, np.integer)) and x is not True for x in each)
        _require(right, f"columns.{quantity}", given, _TEXTS)
        names: list[str] = []
        for text in map(str, each):
            span = _RANGE.fullmatch(text)
            names += map(str, range(int(span[1]), int(span[2]) + 1)) if span else [text]
        found[quantity] = names if several or len(names) > 1 else names[0]
    return found


def _units(value: Any) -> dict[str, Any]:
    """Return the units of quantities."""
    found = _table("units", value, UNITS, "a quantity")
    for quantity, given in found.items():
        right = isinstance(given, str) or (quantity != "time" and _are_texts(given))
        _require(right, f"units.{quantity}", given, _TEXTS)
    return found


def _motors(value: Any) -> MotorSide:
    """Return the conversion from the motors' side."""
    if isinstance(value, MotorSide):
        return value
    _require(isinstance(value, Mapping), "motors", value, "a table [motors]")
    return MotorSide.from_mapping(value)


def _base(value: Any) -> dict[str, Any]:
    """Return the settings of a base, of one that moves or that was held."""
    found = _table("base", value, SETTINGS["base"])
    order, held = found.get("quaternion", "xyzw"), found.get("held", "")
    expected = f"one of {', '.join(_ORDERS)}: the order in which the log has it"
    _require(order in _ORDERS, "base.quaternion", order, expected)
    if "held" in found:
        expected = 'the name of the link that was held, such as "base_link"'
        _require(isinstance(held, str) and held != "", "base.held", held, expected)
        if others := [key for key in found if key not in _HELD]:
            raise DataError(
                f"base.held: the base was held at '{held:.80}', and {', '.join(others)} is "
                "about one that moves; leave one of them out."
            )
    elif "orientation" in found:
        raise DataError(
            "base.orientation: is that of a base that was held; say which link was, "
            'held = "base_link".'
        )
    return found


def _are_texts(value: Any) -> bool:
    """Tell whether a value is a list of texts."""
    several = isinstance(value, Collection) and not isinstance(value, str)
    return several and all(isinstance(entry, str) for entry in value)


def _are_rows(value: Any) -> bool:
    """Tell whether a value is a first and a last row."""
    whole = isinstance(value, (list, tuple)) and all(type(row) is int for row in value)
    return whole and len(value) == 2 and 1 <= value[0] < value[1]


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


# How arguments become what is needed, or what others have to be; the rest is checked by its user.
_MADE: dict[str, Callable[[Any], Any]] = {
    **{"columns": _columns, "units": _units, "motors": _motors, "gains": as_gains, "base": _base},
    **{name: partial(_table, name, known=SETTINGS[name]) for name in ("imu", "contacts")},
}
_NUMBER, _NAMES = (is_number, "a number"), (_are_texts, "names")
_EXPECTED: dict[str, tuple[Callable[[Any], bool], str]] = {
    **{"joint_names": _NAMES, "without_effort": _NAMES, "rate_hz": _NUMBER},
    **{"period": _NUMBER, "start": _NUMBER, "periods": _NUMBER},
    "topic": (lambda value: isinstance(value, str), "a text"),
    "missing": (MISSING.__contains__, f"one of {', '.join(MISSING)}"),
    "rows": (_are_rows, "the first and the last row to read, counted from 1, as in [1, 2000]"),
}
