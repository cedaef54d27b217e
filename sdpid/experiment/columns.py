"""Where a log keeps its quantities: by the usual names, or by those that are given."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid.errors import DataError

__all__ = ["CONVENTIONS", "Columns"]

# Names under which quantities are usually found, in the order in which they are looked for.
CONVENTIONS: dict[str, tuple[str, ...]] = {
    "time": ("time", "t", "timestamp", "time_s", "stamp", "times", "__time", "elapsed_time"),
    "position": (
        *("position", "q", "positions", "pos", "joint_position", "joint_positions"),
        *("actual_q", "actual_position", "measured_position", "position_measured", "q_measured"),
        "angle",
    ),
    "effort": (
        *("effort", "tau", "torque", "efforts", "torques", "joint_effort", "joint_torque"),
        *("joint_torques", "tau_j", "tau_measured", "actual_torque", "measured_torque"),
        *("torque_measured",),
    ),
    "velocity": (
        *("velocity", "dq", "qd", "velocities", "vel", "qdot", "joint_velocity"),
        *("joint_velocities", "actual_qd", "actual_velocity", "measured_velocity"),
        *("velocity_measured", "dq_measured", "qd_measured"),
    ),
    "joint_names": ("joint_names", "names"),
    "rate": ("fs", "rate_hz", "rate", "sample_rate"),
    "period": ("period",),
    "start": ("start",),
    "periods": ("periods",),
    "effort_scale": ("effort_scale",),
}
# Units that stand at the end of names, as in time_ms or position_deg_1.
_UNIT_ENDINGS: dict[str, dict[str, str]] = {
    "time": {"ms": "ms", "us": "us", "ns": "ns", "sec": "s"},
    "position": {"deg": "deg", "rad": "rad"},
    "velocity": {
        "deg_s": "deg/s",
        "rad_s": "rad/s",
        "degs": "deg/s",
        "rads": "rad/s",
        "rpm": "rpm",
    },
    "effort": {"nm": "N.m", "mnm": "mN.m"},
}
# What was asked of a robot is not what it did.
_ASKED = re.compile(
    r"(?:^|[_./])(?:target|desired|des|cmd|command|commanded|ref|reference|setpoint|goal|err|error)"
    r"(?:$|[_./\d])",
    re.IGNORECASE,
)
# Effort is often logged as a current; it is named in messages, never taken for a torque.
_CURRENT = re.compile(
    r"(?:.*[_./])?(?:current|curr|cur|amps?|i)s?(?:[_./\[]?\d+\]?)?", re.IGNORECASE
)
# So many names are listed in a message.
_LISTED = 40

_Found = Mapping[str, Callable[[], NDArray[Any]]]


class Columns:
    """The named arrays of a log, and what was found under which name.

    Parameters
    ----------
    file : Path
        For messages.
    found : mapping
        Names, and how to read what they name. Parts of a path are separated by ``/``.
    given : mapping
        Names to be used instead of the usual ones; None leaves a quantity out.

    Attributes
    ----------
    used : dict
        The names that were read, for each quantity.
    implied : dict
        Units that those names end with.
    """

    def __init__(
        self, file: Path, found: _Found, given: Mapping[str, str | Sequence[str] | None]
    ) -> None:
        self._file = file
        self._found = found
        self._given = given
        self.used: dict[str, tuple[str, ...]] = {}
        self.implied: dict[str, str] = {}

    def single(self, quantity: str) -> NDArray[Any] | None:
        """Read a quantity that is a single array, if there is one."""
        given = self._given.get(quantity)
        if quantity in self._given:
            if given is None:
                return None
            for key in [given] if isinstance(given, str) else given:
                if key in self._found:
                    return self._read(quantity, key)
            raise DataError(
                f"{self._file}: columns: '{given}' for {quantity} is not there; found: "
                f"{self._listing()}."
            )
        for key, unit in self._keys(quantity):
            places = self._exact(key)
            if len(places) > 1:
                raise self._ambiguous(quantity, places)
            if places:
                if unit is not None:
                    self.implied[quantity] = unit
                return self._read(quantity, places[0])
        return None

    def names(self) -> tuple[str, ...] | None:
        """Read the joint names, if there are any."""
        names = self.single("joint_names")
        if names is None:
            return None
        if names.dtype.kind not in "US":
            raise DataError(f"{self._file}: joint_names: holds {names.dtype}, expected text.")
        if names.dtype.kind == "S":
            names = np.char.decode(names, "utf-8", "replace")
        return tuple(str(name).strip() for name in np.atleast_1d(names).ravel())

    def table(
        self, quantity: str, names: Sequence[str] | None
    ) -> tuple[NDArray[Any] | None, tuple[str, ...] | None]:
        """Read samples × joints, and the joints' labels where columns carry them."""
        given = self._given.get(quantity)
        if quantity in self._given and given is None:
            return None, None
        if given is not None and not isinstance(given, str):
            return self._stacked(quantity, list(given)), None
        keys = self._keys(quantity) if given is None else [(given, None)]
        for key, unit in keys:
            places = [key] if key in self._found else self._exact(key)
            if not places:
                continue
            if unit is not None:
                self.implied[quantity] = unit
            if len(places) == 1:
                table = self._read(quantity, places[0])
                return (table[:, None] if table.ndim == 1 else table), None
            parents = [place.split("/")[-2] if "/" in place else "" for place in places]
            if len(set(parents)) < len(parents):
                raise self._ambiguous(quantity, places)
            order = _order(dict(zip(parents, places, strict=True)), names)
            if any(np.ndim(self._found[place]()) != 1 for place in order.values()):
                raise self._ambiguous(quantity, places)
            return self._stacked(quantity, list(order.values())), tuple(order)
        # Names with a unit are looked for first, or `deg` in position_deg would be a joint.
        ordered = sorted(keys, key=lambda entry: entry[1] is None)
        # Of two endings the longer one leaves the joint's name: joint_1_actual_position.
        longest = sorted(ordered, key=lambda entry: -len(entry[0]))
        for style, listed in ((_prefixed, ordered), (_suffixed, longest)):
            for key, unit in listed:
                group = style(self._found, key, names, given is not None)
                if group:
                    if unit is not None:
                        self.implied[quantity] = unit
                    return self._stacked(quantity, list(group.values())), tuple(group)
        if given is not None:
            raise DataError(
                f"{self._file}: columns: '{given}' for {quantity} is not there, nor are columns "
                f"'{given}_<joint>'; found: {self._listing()}."
            )
        return None, None

    def missing(self, quantity: str) -> DataError:
        """Say that a quantity was not found, and what was."""
        hint = ""
        currents = [name for name in self._found if _CURRENT.fullmatch(name)]
        if quantity == "effort" and currents:
            hint = (
                f" {', '.join(currents[:8])} look like currents: name them as effort, with "
                "units={'effort': 'A'} and effort_scale= (or torque constants of motors)."
            )
        return DataError(
            f"{self._file}: {quantity} is missing: none of {', '.join(CONVENTIONS[quantity])} is "
            f"there. Found: {self._listing()}. Name it with columns={{'{quantity}': ...}}, or "
            f"in a mapping beside the log.{hint}"
        )

    def _keys(self, quantity: str) -> list[tuple[str, str | None]]:
        """Return the usual names, plain ones first, with the units that they imply."""
        plain = CONVENTIONS[quantity]
        endings = _UNIT_ENDINGS.get(quantity, {})
        keys: list[tuple[str, str | None]] = [(key, None) for key in plain]
        return keys + [(f"{key}_{end}", unit) for key in plain for end, unit in endings.items()]

    def _exact(self, key: str) -> list[str]:
        """Return the names whose last part is `key`, however it is spelled."""
        if key in self._found:
            return [key]
        wanted = key.lower()
        top = [name for name in self._found if name.lower() == wanted]
        if top:
            return top[:1]
        return [n for n in self._found if n.rpartition("/")[2].lower() == wanted]

    def _read(self, quantity: str, key: str) -> NDArray[Any]:
        self.used[quantity] = (key,)
        return self._found[key]()

    def _stacked(self, quantity: str, keys: list[str]) -> NDArray[Any]:
        """Read single columns into one array, one after the other."""
        absent = [key for key in keys if key not in self._found]
        if absent or not keys:
            raise DataError(
                f"{self._file}: columns: {', '.join(absent) or 'nothing'} for {quantity} is not "
                f"there; found: {self._listing()}."
            )
        self.used[quantity] = tuple(keys)
        table: NDArray[Any] | None = None
        for j, key in enumerate(keys):
            column = self._found[key]()
            if column.ndim == 2 and 1 in column.shape:
                column = column.ravel()
            if column.ndim != 1 or (table is not None and column.shape != table.shape[:1]):
                raise DataError(
                    f"{self._file}: columns: '{key}' has shape {column.shape}, expected one "
                    f"column{'' if table is None else f' of {len(table)} rows'}."
                )
            if column.dtype.kind not in "fiub":
                raise DataError(
                    f"{self._file}: columns: '{key}' holds {column.dtype}, expected numbers."
                )
            if table is None:
                table = np.empty((column.size, len(keys)))
            table[:, j] = column
        assert table is not None
        return table

    def _ambiguous(self, quantity: str, places: Sequence[str]) -> DataError:
        return DataError(
            f"{self._file}: {quantity} is there more than once: {', '.join(places[:_LISTED])}; "
            f"name the one to read with columns={{'{quantity}': '{places[0]}'}}."
        )

    def _listing(self) -> str:
        names = list(self._found)
        more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
        return (", ".join(names[:_LISTED]) or "nothing") + more


def _prefixed(found: _Found, key: str, names: Sequence[str] | None, asked: bool) -> dict[str, str]:
    """Return label -> name for columns that are named `key` and a joint or a number.

    Numbers win over words, so that ``q_1`` is not mixed with ``q_target_1``.
    """
    pattern = re.compile(re.escape(key) + r"(?:[_./]?\[?(\d+)\]?|[_./](.+))", re.IGNORECASE)
    numbered: dict[int, str] = {}
    labelled: dict[str, str] = {}
    for name in found:
        match = pattern.fullmatch(name) or pattern.fullmatch(name.rpartition("/")[2])
        if match is None:
            continue
        if match[1] is not None:
            numbered.setdefault(int(match[1]), name)
            labelled.setdefault(match[1], name)
        elif asked or not _ASKED.search(match[2]) or match[2] in (names or ()):
            labelled.setdefault(match[2], name)
    if names is not None and all(name in labelled for name in names):
        return {name: labelled[name] for name in names}
    if numbered:
        return {str(number): numbered[number] for number in sorted(numbered)}
    return labelled


def _suffixed(found: _Found, key: str, names: Sequence[str] | None, asked: bool) -> dict[str, str]:
    """Return label -> name for columns that are named a joint and `key`."""
    pattern = re.compile(r"(.+?)[_./]" + re.escape(key), re.IGNORECASE)
    labelled: dict[str, str] = {}
    for name in found:
        match = pattern.fullmatch(name)
        label = None if match is None else match[1].rpartition("/")[2]
        if label and (asked or not _ASKED.search(label)):
            labelled.setdefault(label, name)
    return _order(labelled, names)


def _order(labelled: dict[str, str], names: Sequence[str] | None) -> dict[str, str]:
    """Return labelled columns in the order of the names wanted, else as numbered at their ends."""
    if names is not None and all(name in labelled for name in names):
        return {name: labelled[name] for name in names}
    parts = [re.fullmatch(r"(.*?)(\d+)", label) for label in labelled]
    if all(parts) and len({part[1] for part in parts if part}) == 1:
        return {label: labelled[label] for label in sorted(labelled, key=_number)}
    return labelled


def _number(label: str) -> int:
    """Return the number at the end of a label."""
    digits = re.search(r"\d+$", label)
    return int(digits[0]) if digits else 0
