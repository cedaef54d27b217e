"""Find the quantities of a log by the usual names, or by those that are given."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.text import printable
from sdpid.errors import DataError
from sdpid.experiment.readers.floating.quantities import NAMES
from sdpid.experiment.readers.table import NoNumbersError, Table
from sdpid.experiment.readers.unit_names import UNITS, split_unit
from sdpid.experiment.recording.memory_budget import check_memory
from sdpid.experiment.recording.stored import StoredArray

# Words of positions that are commanded, and not what the robot did.
_COMMAND_WORDS = (
    *("reference", "ref", "desired", "des", "commanded", "command", "cmd", "target"),
    "setpoint",
)
_POSITIONS = ("q", "position", "positions", "pos", "joint_position", "joint_positions", "angle")
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
        *("torque_measured", "eff", "trq"),
    ),
    "velocity": (
        *("velocity", "dq", "qd", "velocities", "vel", "qdot", "joint_velocity"),
        *("joint_velocities", "actual_qd", "actual_velocity", "measured_velocity"),
        *("velocity_measured", "dq_measured", "qd_measured", "speed"),
    ),
    # What is commanded may be a velocity or a torque as well: the name must say position.
    "reference": (
        *(f"{name}_{word}" for name in _POSITIONS for word in _COMMAND_WORDS),
        *(f"{word}_{name}" for name in _POSITIONS for word in _COMMAND_WORDS),
        *("q_d", "reference"),
    ),
    "joint_names": ("joint_names", "names"),
    "rate": ("fs", "rate_hz", "rate", "sample_rate"),
    "period": ("period",),
    "start": ("start",),
    "periods": ("periods",),
    "effort_scale": ("effort_scale",),
    **NAMES,
}
# Names that any quantity may have; the unit beside them tells which: Joint 1 [deg].
_BARE = ("joint", "axis", "j", "a")
# Words that say of which quantity a command is by their unit only: command_1 [deg].
_BARE_COMMANDS = ("desired", "commanded", "command", "cmd", "target", "setpoint")
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
_UNIT_ENDINGS["reference"] = _UNIT_ENDINGS["position"]
# Names of commanded quantities, which are not what the robot did.
_COMMANDED = re.compile(
    r"(?:^|[_./\s-])(?:target|desired|des|cmd|command|commanded|ref|reference|setpoint|goal|err|error)"
    r"(?:$|[_./\s\d-])"
    # q_d_1 of a robot that also logs q_1.
    r"|(?:^|[_./])d[_./]?\[?\d+\]?$",
    re.IGNORECASE,
)
# Those of differences, and of a derivative: q_d beside q_dd.
_NO_REFERENCE = re.compile(r"(?:^|[_./\s-])(?:err|error|goal)(?:$|[_./\s\d-])", re.IGNORECASE)
_DERIVATIVE = re.compile(r"(?:^|.*[_./\s-])q_?dd(?:ot)?(?:[_./\s\[-]?\d+\]?)?", re.IGNORECASE)
_DESIRED = re.compile(r"(?:^|[_./\s-])q_d(?:$|[_./\s\[-])", re.IGNORECASE)
# Effort is often logged as a current, which is no torque before it is scaled.
_CURRENT_NAMES = ("current", "actual_current", "motor_current", "currents", "curr", "cur", "i")
_CURRENT = re.compile(
    r"(?:.*[_./])?(?:(?:current|curr|cur|amps?|i)s?(?:[_./\[]?\d+\]?)?|current_.+)", re.IGNORECASE
)
# At most this many names, of at most this many letters, are listed in a message.
_LISTED, _LETTERS = 40, 60

# The columns of joints: label -> name. A label is the joint's name, or its number.
_Group = dict[str, str]


class Columns:
    """The named arrays of a log, and what was found under which name.

    Parameters
    ----------
    file : Path
        For messages.
    table : Table
        The arrays.
    given : mapping
        Names to be used instead of the usual ones; None leaves a quantity out.
    scaled : bool
        Whether there are factors from currents to torques, so that currents serve as efforts.

    Attributes
    ----------
    used : dict
        The names that were read, for each quantity.
    implied : dict
        The units that those names imply: one, or one for each column.
    """

    def __init__(
        self,
        file: Path,
        table: Table,
        given: Mapping[str, str | Sequence[str] | None],
        *,
        scaled: bool = False,
    ) -> None:
        self._file = file
        self._table = table
        self._arrays = {printable(name): read for name, read in table.arrays.items()}
        self._given = given
        self._scaled = scaled
        self._cache: dict[str, NDArray[Any]] = {}
        self._bytes = 0
        # The labels of the positions' columns, or the joints' names, and their number.
        self._joints: tuple[set[str], int] | None = None
        split = {name: split_unit(name) for name in self._arrays}
        self._plain = {name: part for name, (part, _) in split.items()}
        self._units = {name: unit for name, (_, unit) in split.items() if unit is not None}
        self._units |= table.units
        self.used: dict[str, tuple[str, ...]] = {}
        self.implied: dict[str, str | list[str]] = {}

    def single(self, quantity: str) -> NDArray[Any] | None:
        """Read a quantity that is a single array, if there is one."""
        given = self._given.get(quantity)
        if quantity in self._given:
            if given is None:
                return None
            for key in [given] if isinstance(given, str) else given:
                if key in self._arrays:
                    return self._one(quantity, key, None)
            raise DataError(
                f"{self._file}: columns: '{given}' for {quantity} is not there; found: "
                f"{self._listing()}."
            )
        for key, unit in self._keys(quantity):
            places = self._exact(key, quantity)
            if len(places) > 1:
                raise self._ambiguous(quantity, places)
            if places:
                return self._one(quantity, places[0], unit)
        return None

    def number(self, quantity: str, count: int) -> NDArray[Any] | None:
        """Read one number, or `count` of them; a column of as many rows as samples is another."""
        value = self.single(quantity)
        if value is None or value.size in (1, count):
            return value
        if quantity in self._given:
            raise DataError(
                f"{self._file}: columns: '{self._given[quantity]}' for {quantity} has "
                f"{value.size} values, expected one."
            )
        del self.used[quantity]
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
        return tuple(printable(str(name)) for name in np.atleast_1d(names).ravel())

    def table(
        self, quantity: str, names: Sequence[str] | None
    ) -> tuple[NDArray[Any] | None, tuple[str, ...] | None]:
        """Read samples × joints, and the joints' labels where columns carry them.

        Parameters
        ----------
        quantity : str
            Position, effort or velocity.
        names : sequence of str, optional
            Names of the joints, where they are known. Once positions are read, columns with other
            labels than theirs are left alone.
        """
        given = self._given.get(quantity)
        if quantity in self._given and given is None:
            return None, None
        if given is not None and not isinstance(given, str):
            return self._stacked(quantity, list(given), None), None
        keys = self._keys(quantity) if given is None else [(given, None)]
        found = self._found(quantity, keys, names, explicit=given is not None)
        if found is None and given is None:
            found = self._found_by_unit(quantity, names)
        if found is None and given is not None:
            raise DataError(
                f"{self._file}: columns: '{given}' for {quantity} is not there, nor are columns "
                f"'{given}_<joint>'; found: {self._listing()}."
            )
        if found is None:
            return None, None
        if quantity == "position" and found[0].ndim > 1:
            self._joints = set(found[1] or names or ()), found[0].shape[1]
        return found

    def commands(self, names: Sequence[str] | None) -> list[tuple[str | None, _Group]]:
        """Return all that may be references by the usual names: their unit, and their columns.

        Columns are found by the labels of joints; an array of samples × joints has none, and its
        label is empty.
        """
        plain = self._candidates("reference")
        texts = " ".join(plain.values()).lower()
        derived = any(_DERIVATIVE.fullmatch(text) for text in self._plain.values())
        keys = [(k, u) for k, u in self._keys("reference") if not (derived and k == "q_d")]
        found: dict[frozenset[str], tuple[str | None, _Group]] = {}
        for key, unit in keys if plain else ():
            if any(word not in texts for word in key.split("_")):
                continue
            if places := self._exact(key, "reference"):
                found |= {frozenset([place]): (unit, {"": place}) for place in places}
                continue
            for style in (_numbered, _labeled, _suffixed):
                group = style(plain, key, names, False)
                if group and self._fits(group) and all(map(self._is_column, group.values())):
                    found.setdefault(frozenset(group.values()), (unit, group))
        said = {name: text for name, text in plain.items() if name in self._units}
        for key in _BARE_COMMANDS:
            if (group := _numbered(said, key, names, False)) and self._fits(group):
                found.setdefault(frozenset(group.values()), (None, group))
        return list(found.values())

    def read(self, quantity: str, unit: str | None, group: _Group) -> NDArray[Any]:
        """Read columns, or an array, that are a quantity."""
        if "" in group:
            table = self._one(quantity, group[""], unit)
            return table[:, None] if table.ndim == 1 else table
        return self._stacked(quantity, list(group.values()), unit)

    def forget(self, quantity: str) -> None:
        """Take back that a quantity was read."""
        self.used.pop(quantity, None)
        self.implied.pop(quantity, None)

    def given(self, quantity: str) -> tuple[bool, Any]:
        """Return whether it is said where a quantity is, and where."""
        return quantity in self._given, self._given.get(quantity)

    def places(self, key: str, quantity: str) -> list[str]:
        """Return the names that are `key`, however it is spelled."""
        return self._exact(key, quantity)

    def like(self, quantity: str, pattern: str) -> _Group:
        """Return by what a group of the pattern stands for, and of nothing that was read."""
        taken = {name for names in self.used.values() for name in names}
        found: _Group = {}
        for name, plain in self._candidates(quantity).items():
            match = re.fullmatch(pattern, plain.rpartition("/")[2] or plain, re.IGNORECASE)
            match = match or re.fullmatch(pattern, plain, re.IGNORECASE)
            if match is not None and name not in taken:
                found.setdefault(match[1], name)
        return found

    def absent(self, quantity: str, given: str) -> DataError:
        """Return the error that what was asked for is not there."""
        return DataError(
            f"{self._file}: columns: '{given}' for {quantity} is not there; found: "
            f"{self._listing()}."
        )

    def missing(self, quantity: str) -> DataError:
        """Return the error that a quantity was not found, and what was."""
        if self._table.unnamed:
            return DataError(
                f"{self._file}: its {len(self._arrays)} columns have no names: the first line must "
                "name the columns, or give their numbers from 1, as in columns={'time': 1, "
                "'position': [2, 3], 'effort': [4, 5]}."
            )
        hint = ""
        currents = [name for name, plain in self._plain.items() if _CURRENT.fullmatch(plain)]
        if quantity == "effort" and currents:
            hint = (
                f" {', '.join(currents[:8])} look like currents: give gains= (a file of "
                "`sdpid gains`), effort_scale= or torque constants of motors, or name them as "
                "effort if they are torques."
            )
        return DataError(
            f"{self._file}: {quantity} is missing: none of {', '.join(CONVENTIONS[quantity])} is "
            f"there. Found: {self._listing()}. Name it with columns={{'{quantity}': ...}}, or "
            f"in a mapping beside the log.{hint}"
        )

    def _found(
        self,
        quantity: str,
        keys: Sequence[tuple[str, str | None]],
        names: Sequence[str] | None,
        *,
        explicit: bool,
    ) -> tuple[NDArray[Any], tuple[str, ...] | None] | None:
        """Look for arrays of a name, then for columns that are named so and by joint."""
        for key, unit in keys:
            places = [key] if key in self._arrays else self._exact(key, quantity)
            if not places:
                continue
            if len(places) == 1:
                table = self._one(quantity, places[0], unit)
                return (table[:, None] if table.ndim == 1 else table), None
            parents = [place.split("/")[-2] if "/" in place else "" for place in places]
            if len(set(parents)) < len(parents):
                raise self._ambiguous(quantity, places)
            order = _order(dict(zip(parents, places, strict=True)), names)
            if any(self._array(place).ndim != 1 for place in order.values()):
                raise self._ambiguous(quantity, places)
            return self._stacked(quantity, list(order.values()), unit), tuple(order)
        # Names with a unit are looked for first, or `deg` in position_deg would be a joint.
        ordered = sorted(keys, key=lambda entry: entry[1] is None)
        # Of two endings the longer one leaves the joint's name: joint_1_actual_position.
        longest = sorted(ordered, key=lambda entry: -len(entry[0]))
        plain = self._candidates(quantity)
        # Numbers win over words, so that q_1 is not mixed with q_target_1, nor tau_J_1 with tau.
        styles: tuple[tuple[Callable[..., _Group], Sequence[tuple[str, str | None]]], ...] = (
            (_numbered, ordered),
            (_labeled, ordered),
            (_suffixed, longest),
        )
        if names is not None and not all(name.isdigit() for name in names):
            styles = (styles[1], styles[0], styles[2])
        for style, listed in styles:
            for key, unit in listed:
                group = style(plain, key, names, explicit)
                if style is not _numbered and not explicit:
                    group = {k: name for k, name in group.items() if self._is_column(name)}
                if group and (explicit or style is _numbered or self._fits(group)):
                    return self._stacked(quantity, list(group.values()), unit), tuple(group)
        return None

    def _fits(self, group: _Group) -> bool:
        """Tell whether columns have labels of the joints whose positions were read."""
        if self._joints is None:
            return True
        labels, count = self._joints
        return bool(labels & set(group)) if labels else len(group) == count > 1

    def _found_by_unit(
        self, quantity: str, names: Sequence[str] | None
    ) -> tuple[NDArray[Any], tuple[str, ...] | None] | None:
        """Look for columns known by their unit only, and for currents where they can be scaled."""
        plain = {n: p for n, p in self._candidates(quantity).items() if n in self._units}
        for key in _BARE:
            if group := _numbered(plain, key, names, False):
                return self._stacked(quantity, list(group.values()), None), tuple(group)
        if quantity == "effort" and self._scaled:
            found = self._found("effort", [(k, "A") for k in _CURRENT_NAMES], names, explicit=False)
            if found is None:
                ended = [(f"{key}_ma", "mA") for key in _CURRENT_NAMES]
                found = self._found("effort", ended, names, explicit=False)
            return found
        return None

    def _candidates(self, quantity: str) -> dict[str, str]:
        """Return names and how they are looked for, but those in units of other quantities."""
        names = self._plain if quantity != "reference" else self._commanded
        return {
            name: plain
            for name, plain in names.items()
            if self._units.get(name) is None or self._units[name] in UNITS.get(quantity, ())
        }

    @property
    def _commanded(self) -> dict[str, str]:
        """The names that may be of commands, and of nothing that was read."""
        taken = {name for names in self.used.values() for name in names}
        return {
            name: plain
            for name, plain in self._plain.items()
            if name not in taken
            and (_COMMANDED.search(plain) or _DESIRED.search(plain))
            and not _NO_REFERENCE.search(plain)
        }

    def _keys(self, quantity: str) -> list[tuple[str, str | None]]:
        """Return the usual names, plain ones first, with the units that they imply."""
        plain = CONVENTIONS[quantity]
        endings = _UNIT_ENDINGS.get(quantity, {})
        keys: list[tuple[str, str | None]] = [(key, None) for key in plain]
        return keys + [(f"{key}_{end}", unit) for key in plain for end, unit in endings.items()]

    def _exact(self, key: str, quantity: str) -> list[str]:
        """Return the names whose last part is `key`, however it is spelled."""
        if key in self._arrays:
            return [key]
        plain = self._candidates(quantity)
        pattern = re.compile(spelled(key), re.IGNORECASE)
        top = [name for name in plain if pattern.fullmatch(plain[name])]
        if top:
            return top[:1]
        return [name for name in plain if pattern.fullmatch(plain[name].rpartition("/")[2])]

    def _array(self, name: str) -> NDArray[Any]:
        """Read an array once."""
        if name not in self._cache:
            self._cache[name] = self._arrays[name]()
            if not isinstance(self._cache[name], StoredArray):
                self._bytes += self._cache[name].nbytes
                check_memory(self._file, self._bytes)
        return self._cache[name]

    def _is_column(self, name: str) -> bool:
        """Tell whether an array has one value a sample."""
        if name in self._table.plain:
            return True
        try:
            shape = self._array(name).shape
        except NoNumbersError:
            return False
        return len(shape) == 1 or (len(shape) == 2 and 1 in shape)

    def _one(self, quantity: str, name: str, unit: str | None) -> NDArray[Any]:
        """Read an array as a quantity."""
        self._note(quantity, [name], unit)
        return self._array(name)

    def _note(self, quantity: str, names: list[str], unit: str | None) -> None:
        """Remember from which names a quantity was read, and their units."""
        self.used[quantity] = tuple(names)
        units = [self._units.get(name, unit) for name in names]
        if len(set(units)) == 1 and units[0] is not None:
            self.implied[quantity] = units[0]
        elif any(units):
            plain = next(iter(UNITS[quantity]))
            self.implied[quantity] = [unit or plain for unit in units]

    def _stacked(self, quantity: str, keys: list[str], unit: str | None) -> NDArray[Any]:
        """Read single columns into one array, one after the other."""
        absent = [key for key in keys if key not in self._arrays]
        if absent or not keys:
            raise DataError(
                f"{self._file}: columns: {', '.join(absent) or 'nothing'} for {quantity} is not "
                f"there; found: {self._listing()}."
            )
        self._note(quantity, keys, unit)
        if self._table.columns is not None and self._table.plain.issuperset(keys):
            return self._table.columns(keys)
        table: NDArray[Any] | None = None
        for j, key in enumerate(keys):
            column = self._array(key)
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
            self._cache.pop(key, None)
        assert table is not None
        return table

    def _ambiguous(self, quantity: str, places: Sequence[str]) -> DataError:
        return DataError(
            f"{self._file}: {quantity} is there more than once: {_list(places)}; "
            f"name the one to read with columns={{'{quantity}': '{places[0]}'}}."
        )

    def _listing(self) -> str:
        return _list(self._arrays)


def _list(names: Iterable[str]) -> str:
    """Return names for a message, the first ones if there are many."""
    every = [name if len(name) <= _LETTERS else f"{name[:_LETTERS]}..." for name in names]
    more = f" and {len(every) - _LISTED} more" if len(every) > _LISTED else ""
    return (", ".join(every[:_LISTED]) or "nothing") + more


def spelled(key: str) -> str:
    """Return a pattern of a name whose words are joined by underscores, blanks or hyphens."""
    return r"[_\s-]".join(re.escape(word) for word in key.split("_"))


def _numbered(plain: dict[str, str], key: str, names: Sequence[str] | None, _: bool) -> _Group:
    """Return the columns that are named `key` and a number, in numeric order."""
    pattern = re.compile(spelled(key) + r"[_./\s-]?\[?(\d+)\]?", re.IGNORECASE)
    numbered: dict[int, str] = {}
    for name, text in plain.items():
        match = pattern.fullmatch(text) or pattern.fullmatch(text.rpartition("/")[2])
        if match is not None:
            numbered.setdefault(int(match[1]), name)
    labels = {str(number): numbered[number] for number in sorted(numbered)}
    if names is not None and all(name in labels for name in names):
        return {name: labels[name] for name in names}
    return labels


def _labeled(
    plain: dict[str, str], key: str, names: Sequence[str] | None, explicit: bool
) -> _Group:
    """Return the columns that are named `key` and a joint."""
    pattern = re.compile(spelled(key) + r"[_./\s-](.+)", re.IGNORECASE)
    labeled: _Group = {}
    for name, text in plain.items():
        match = pattern.fullmatch(text) or pattern.fullmatch(text.rpartition("/")[2])
        if match and (explicit or not _COMMANDED.search(match[1]) or match[1] in (names or ())):
            labeled.setdefault(match[1], name)
    if names is not None and all(name in labeled for name in names):
        return {name: labeled[name] for name in names}
    return labeled


def _suffixed(
    plain: dict[str, str], key: str, names: Sequence[str] | None, explicit: bool
) -> _Group:
    """Return the columns that are named a joint and `key`."""
    pattern = re.compile(r"(.+?)[_./\s-]" + spelled(key), re.IGNORECASE)
    labeled: _Group = {}
    for name, text in plain.items():
        match = pattern.fullmatch(text)
        label = None if match is None else match[1].rpartition("/")[2]
        if label and (explicit or not _COMMANDED.search(label)):
            labeled.setdefault(label, name)
    return _order(labeled, names)


def _order(labeled: _Group, names: Sequence[str] | None) -> _Group:
    """Return labeled columns in the order of the names wanted, else as numbered at their ends."""
    if names is not None and all(name in labeled for name in names):
        return {name: labeled[name] for name in names}
    parts = [re.fullmatch(r"(.*?)(\d+)", label) for label in labeled]
    if all(parts) and len({part[1] for part in parts if part}) == 1:
        return {label: labeled[label] for label in sorted(labeled, key=_number)}
    return labeled


def _number(label: str) -> int:
    """Return the number at the end of a label."""
    digits = re.search(r"\d+$", label)
    return int(digits[0]) if digits else 0
