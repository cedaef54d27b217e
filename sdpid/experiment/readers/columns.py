"""Find the quantities of a log by the usual names, or by those that are given."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.files import printable
from sdpid.errors import DataError
from sdpid.experiment.readers.names import FLOATING, QUANTITIES, SINGLE, UNITS, split_unit
from sdpid.experiment.readers.table import LogTable, NoNumbersError
from sdpid.experiment.recording.recording import CHANNELS
from sdpid.experiment.recording.stored import StoredArray, check_memory

# How a column of a joint is called, in the order in which it is looked for: numbers win over
# words, so that q_1 is not mixed with q_target_1, nor tau_J_1 with tau.
_STYLES = {
    "numbered": r"{key}[_./\s-]?\[?(\d+)\]?",
    "labeled": r"{key}[_./\s-](.+)",
    "suffixed": r"(?:.*/)?(.+?)[_./\s-]{key}",
}
# Names that any quantity may have; the unit beside them tells which: Joint 1 [deg].
_BARE = ("joint", "axis", "j", "a")
# Words that say of which quantity a command is by their unit only: command_1 [deg].
_BARE_COMMANDS = ("desired", "commanded", "command", "cmd", "target", "setpoint")
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
_CURRENTS = ("current", "actual_current", "motor_current", "currents", "curr", "cur", "i")
_CURRENT = re.compile(
    r"(?:.*[_./])?(?:(?:current|curr|cur|amps?|i)s?(?:[_./\[]?\d+\]?)?|current_.+)", re.IGNORECASE
)
# What stands between a quantity of a base, a foot and a part.
_BETWEEN = r"[_./\s\[-]*"
_FRAMES = ("world", "base")
# Words that tell another quantity from a foot that is named behind ``contact_``.
_OTHERS = re.compile(r"(?:forces?|wrench(?:es)?|states?|torques?|moments?)(?:[_./\s-].*)?", re.I)
# Words in the names of what turns and is no base.
_NO_BASE = re.compile(
    r"tcp|tool|eef?\b|ee_|tip|flange|hand|grip|object|target|desired|cmd|camera", re.I
)
# The columns from k to l of an array, counted from 1.
_SLICE = re.compile(r"(.+)\[(\d+):(\d+)\]")
# At most this many names, of at most this many letters, are listed in a message.
_LISTED, _LETTERS = 40, 60

# The columns of joints: label -> name. A label is the joint's name, or its number.
_Group = dict[str, str]
# The name of an array or of columns, the labels that columns carry, and the unit that is implied.
_Found = tuple[str | list[str], tuple[str, ...] | None, str | None]
# A name that is looked for, and the unit that it implies.
_Key = tuple[str, str | None]


class Columns:
    """The named arrays of a log, and what was found under which name.

    Parameters
    ----------
    file : Path
        For messages.
    table : LogTable
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
        self, file: Path, table: LogTable, given: Mapping[str, Any], *, scaled: bool = False
    ) -> None:
        self._file, self._table, self.given, self._scaled = file, table, given, scaled
        self._arrays = {printable(name): read for name, read in table.arrays.items()}
        for name in given.values():
            part = _SLICE.fullmatch(name) if isinstance(name, str) else None
            if part is not None and name not in self._arrays and part[1] in self._arrays:
                self._arrays[name] = partial(self._part, *part.groups())
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

    def read(
        self, quantity: str, names: Sequence[str] | None = None
    ) -> tuple[NDArray[Any] | None, tuple[str, ...] | None]:
        """Read a quantity, if it is there, and what its columns are called where they say so.

        Parameters
        ----------
        quantity : str
            Any of `QUANTITIES`.
        names : sequence of str, optional
            Names of the joints, where they are known. Once positions are read, columns with other
            labels than theirs are left alone.

        Returns
        -------
        array, labels
            Samples × joints, samples × parts, or what else an array of that name holds. The labels
            are joints, parts of a quaternion, the frame of a velocity's axes, or feet.
        """
        given = self.given.get(quantity)
        if given is None and quantity in self.given:
            return None, None
        if given is not None and not isinstance(given, str):
            # The last letters of the names tell the order of a quaternion's parts.
            ends = tuple(name.rstrip("])")[-1:].lower() for name in given)
            parts = quantity == "base_orientation" and sorted(ends) == ["w", "x", "y", "z"]
            return self.load(quantity, list(given)), ends if parts else None
        keys: list[_Key] = _keys(quantity) if given is None else [(given, None)]
        found = self._found(quantity, keys, names, explicit=given is not None)
        if found is None and given is not None:
            of_joints = quantity not in (*SINGLE, *FLOATING)
            more = f", nor are columns '{given}_<joint>'" if of_joints else ""
            raise self._absent(quantity, f"'{given}'", more)
        if found is None:
            found = self._found_by_unit(quantity, names)
        if found is None:
            return None, None
        columns, labels, unit = found
        table = self.load(quantity, columns, unit)
        if quantity not in SINGLE and table.ndim == 1:
            table = table[:, None]
        if quantity == "position" and table.ndim > 1:
            self._joints = set(labels or names or ()), table.shape[1]
        return table, labels

    def number(self, quantity: str, count: int = 1) -> NDArray[Any] | None:
        """Read one number, or `count` of them; a column of as many rows as samples is another."""
        value, _ = self.read(quantity)
        if value is None or value.size in (1, count):
            return value
        if quantity in self.given:
            raise DataError(
                f"{self._file}: columns: '{self.given[quantity]}' for {quantity} has "
                f"{value.size} values, expected one."
            )
        self.forget(quantity)
        return None

    def names(self) -> tuple[str, ...] | None:
        """Read the joint names, if there are any."""
        names, _ = self.read("joint_names")
        if names is None:
            return None
        if names.dtype.kind not in "US":
            raise DataError(f"{self._file}: joint_names: holds {names.dtype}, expected text.")
        if names.dtype.kind == "S":
            names = np.char.decode(names, "utf-8", "replace")
        return tuple(printable(str(name)) for name in np.atleast_1d(names).ravel())

    def commands(self, names: Sequence[str] | None) -> list[_Found]:
        """Return all that may be references by the usual names."""
        plain = self._candidates("reference")
        texts = " ".join(plain.values()).lower()
        derived = any(_DERIVATIVE.fullmatch(text) for text in self._plain.values())
        found: dict[frozenset[str], _Found] = {}
        for key, unit in _keys("reference") if plain else ():
            if (derived and key == "q_d") or any(word not in texts for word in key.split("_")):
                continue
            if places := self._places(key, "reference"):
                found |= {frozenset([place]): (place, None, unit) for place in places}
                continue
            for style in _STYLES:
                group = _group(style, plain, key, names)
                if group and self._fits(group) and all(map(self._is_column, group.values())):
                    found.setdefault(frozenset(group.values()), _of_group(group, unit))
        said = {name: text for name, text in plain.items() if name in self._units}
        for key in _BARE_COMMANDS:
            if (group := _group("numbered", said, key, names)) and self._fits(group):
                found.setdefault(frozenset(group.values()), _of_group(group, None))
        return list(found.values())

    def load(
        self, quantity: str, columns: str | list[str], unit: str | None = None
    ) -> NDArray[Any]:
        """Read an array of a name, or columns into one array, one after the other."""
        keys = [columns] if isinstance(columns, str) else columns
        absent = [key for key in keys if key not in self._arrays]
        if absent or not keys:
            raise self._absent(quantity, ", ".join(absent) or "nothing")
        self.used[quantity] = tuple(keys)
        units = [self._units.get(key, unit) for key in keys]
        if any(units):
            plain = next(iter(UNITS[quantity]))
            same = units[0] if len(set(units)) == 1 else None
            self.implied[quantity] = same or [each or plain for each in units]
        if isinstance(columns, str) or (quantity in SINGLE and len(keys) == 1):
            return self._checked(quantity, keys[0])
        if self._table.columns is not None and self._table.plain.issuperset(keys):
            return self._table.columns(keys)
        table: NDArray[Any] | None = None
        for j, key in enumerate(keys):
            column = self._checked(quantity, key)
            if column.ndim == 2 and 1 in column.shape:
                column = column.ravel()
            if column.ndim != 1 or (table is not None and column.shape != table.shape[:1]):
                raise DataError(
                    f"{self._file}: columns: '{key}' has shape {column.shape}, expected one "
                    f"column{'' if table is None else f' of {len(table)} rows'}."
                )
            table = np.empty((column.size, len(keys))) if table is None else table
            table[:, j] = column
            self._cache.pop(key, None)
        assert table is not None
        return table

    def forget(self, quantity: str) -> None:
        """Take back that a quantity was read."""
        self.used.pop(quantity, None)
        self.implied.pop(quantity, None)

    def quaternions(self) -> tuple[str, list[str]] | None:
        """Return what columns are called that may be quaternions, and the names of x to w."""
        columns = self._like("base_orientation", rf"(.*(?:quat|orient).*?){_BETWEEN}q?([xyzw])\]?")
        for label in dict.fromkeys(label for label, _ in columns):
            parts = {part.lower(): name for (of, part), name in columns.items() if of == label}
            if len(parts) == 4 and not _NO_BASE.search(label):
                return label, [parts[part] for part in "xyzw"]
        return None

    def _absent(self, quantity: str, what: str, more: str = "") -> DataError:
        """Return the error that what was asked for is not there."""
        return DataError(
            f"{self._file}: columns: {what} for {quantity} is not there{more}; found: "
            f"{_list(self._arrays)}."
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
            f"{self._file}: {quantity} is missing: none of "
            f"{', '.join(QUANTITIES[quantity].names)} is there. Found: {_list(self._arrays)}. "
            f"Name it with columns={{'{quantity}': ...}}, or in a mapping beside the log.{hint}"
        )

    def _found(
        self, quantity: str, keys: list[_Key], names: Sequence[str] | None, explicit: bool = False
    ) -> _Found | None:
        """Look for arrays of a name, then for columns that are named so and by joint or part."""
        for key, unit in keys:
            for frame in _FRAMES if quantity.endswith("_velocity") else ():
                if columns := self._parts(quantity, f"{key}_{frame}"):
                    return columns, (frame,), None
            places = self._places(key, quantity)
            if len(places) == 1:
                return places[0], None, unit
            if places:
                parents = [place.split("/")[-2] if "/" in place else "" for place in places]
                several = quantity in SINGLE or len(set(parents)) < len(parents)
                if several or any(self._array(place).ndim != 1 for place in places):
                    raise DataError(
                        f"{self._file}: {quantity} is there more than once: {_list(places)}; "
                        f"name the one to read with columns={{'{quantity}': '{places[0]}'}}."
                    )
                return _of_group(_ordered(dict(zip(parents, places, strict=True)), names), unit)
            if quantity.startswith("contact") and (feet := self._feet(quantity, key)):
                return feet
            if quantity in FLOATING and (columns := self._parts(quantity, key)):
                return columns, QUANTITIES[quantity].parts, None
        if quantity in SINGLE or quantity in FLOATING:
            return None
        # Names with a unit are looked for first, or `deg` in position_deg would be a joint.
        keys = sorted(keys, key=lambda entry: entry[1] is None)
        plain = self._candidates(quantity)
        styles = list(_STYLES)
        if names is not None and not all(name.isdigit() for name in names):
            styles = ["labeled", "numbered", "suffixed"]
        for style in styles:
            if style == "suffixed":
                # Of two endings the longer one leaves the joint's name: joint_1_actual_position.
                keys = sorted(keys, key=lambda entry: -len(entry[0]))
            believed = explicit or style == "numbered"
            for key, unit in keys:
                group = _group(style, plain, key, names, explicit)
                if not believed:
                    group = {k: name for k, name in group.items() if self._is_column(name)}
                if group and (believed or self._fits(group)):
                    return _of_group(group, unit)
        return None

    def _found_by_unit(self, quantity: str, names: Sequence[str] | None) -> _Found | None:
        """Look for columns known by their unit only, and for currents where they can be scaled."""
        if quantity not in CHANNELS:
            return None
        plain = {n: p for n, p in self._candidates(quantity).items() if n in self._units}
        for key in _BARE:
            if group := _group("numbered", plain, key, names):
                return _of_group(group, None)
        if quantity != "effort" or not self._scaled:
            return None
        found = self._found("effort", [(key, "A") for key in _CURRENTS], names)
        return found or self._found("effort", [(f"{key}_ma", "mA") for key in _CURRENTS], names)

    def _like(self, quantity: str, pattern: str) -> dict[tuple[str, ...], str]:
        """Return by what the groups of a pattern stand for, and of nothing that was read."""
        return _like(self._candidates(quantity), pattern)

    def _parts(self, quantity: str, key: str) -> list[str]:
        """Return the columns ``key_x``, ``key_y`` and so on, if all are there."""
        parts = QUANTITIES[quantity].parts
        sign = "q?" if quantity == "base_orientation" else ""
        pattern = rf"{_spelled(key)}{_BETWEEN}{sign}({'|'.join(parts)})\]?"
        found = {part.lower(): name for (part,), name in self._like(quantity, pattern).items()}
        return [found[part] for part in parts] if set(found) == set(parts) else []

    def _feet(self, quantity: str, key: str) -> _Found | None:
        """Return the columns ``key_foot``, or ``key_foot_x`` and so on, of every foot."""
        parts = QUANTITIES[quantity].parts
        end = rf"{_BETWEEN}({'|'.join(parts)})\]?" if parts else r"()\]?"
        columns = self._like(quantity, rf"{_spelled(key)}{_BETWEEN}(.+?){end}")
        found = {
            (f, part.lower()): n for (f, part), n in columns.items() if not _OTHERS.fullmatch(f)
        }
        feet = tuple(dict.fromkeys(foot for foot, _ in found))
        wanted = [(foot, part) for foot in feet for part in parts or ("",)]
        if not feet or any(each not in found for each in wanted):
            return None
        return [found[each] for each in wanted], feet, None

    def _fits(self, group: _Group) -> bool:
        """Tell whether columns have labels of the joints whose positions were read."""
        if self._joints is None:
            return True
        labels, count = self._joints
        return bool(labels & set(group)) if labels else len(group) == count > 1

    def _places(self, key: str, quantity: str) -> list[str]:
        """Return the names whose last part is `key`, however it is spelled."""
        if key in self._arrays:
            return [key]
        plain = self._candidates(quantity)
        pattern = re.compile(_spelled(key), re.IGNORECASE)
        top = [name for name in plain if pattern.fullmatch(plain[name])]
        ends = [name for name in plain if pattern.fullmatch(plain[name].rpartition("/")[2])]
        return top[:1] or ends

    def _candidates(self, quantity: str) -> dict[str, str]:
        """Return names and how they are looked for, but those in units of other quantities."""
        known = UNITS.get(quantity, ())
        found = {n: p for n, p in self._plain.items() if self._units.get(n) in (None, *known)}
        if quantity == "reference" or quantity in FLOATING:
            taken = {name for names in self.used.values() for name in names}
            found = {name: plain for name, plain in found.items() if name not in taken}
        if quantity == "reference":
            return {
                name: plain
                for name, plain in found.items()
                if (_COMMANDED.search(plain) or _DESIRED.search(plain))
                and not _NO_REFERENCE.search(plain)
            }
        return found

    def _array(self, name: str) -> NDArray[Any]:
        """Read an array once."""
        if name not in self._cache:
            self._cache[name] = self._arrays[name]()
            if not isinstance(self._cache[name], StoredArray):
                self._bytes += self._cache[name].nbytes
                check_memory(self._file, self._bytes)
        return self._cache[name]

    def _checked(self, quantity: str, name: str) -> NDArray[Any]:
        """Read an array of numbers; of joints' names and of stamps anything."""
        array = self._array(name)
        if quantity not in SINGLE and array.dtype.kind not in "fiub":
            raise DataError(
                f"{self._file}: {quantity}: '{name}' holds {array.dtype}, expected numbers."
            )
        return array

    def _part(self, name: str, begin: str, end: str) -> NDArray[Any]:
        """Return some columns of an array."""
        array, first, last = self._arrays[name](), int(begin), int(end)
        if array.ndim != 2 or not 1 <= first <= last <= array.shape[1]:
            raise DataError(
                f"{self._file}: columns: '{name}[{first}:{last}]' asks for columns {first} to "
                f"{last} of an array of the shape {array.shape}; columns count from 1."
            )
        return array[:, first - 1 : last]

    def _is_column(self, name: str) -> bool:
        """Tell whether an array has one value a sample."""
        if name in self._table.plain:
            return True
        try:
            shape = self._array(name).shape
        except NoNumbersError:
            return False
        return len(shape) == 1 or (len(shape) == 2 and 1 in shape)


def _spelled(key: str) -> str:
    """Return a pattern of a name whose words are joined by underscores, blanks or hyphens."""
    return r"[_\s-]".join(re.escape(word) for word in key.split("_"))


def _keys(quantity: str) -> list[_Key]:
    """Return the usual names, plain ones first, with the units that they imply."""
    row = QUANTITIES[quantity]
    ended = [(f"{key}_{end}", u) for key in row.names for end, u in row.endings.items()]
    return [*((key, None) for key in row.names), *ended]


def _list(names: Iterable[str]) -> str:
    """Return names for a message, the first ones if there are many."""
    every = [name if len(name) <= _LETTERS else f"{name[:_LETTERS]}..." for name in names]
    more = f" and {len(every) - _LISTED} more" if len(every) > _LISTED else ""
    return (", ".join(every[:_LISTED]) or "nothing") + more


def _like(plain: Mapping[str, str], pattern: str) -> dict[tuple[str, ...], str]:
    """Return names by what the groups of a pattern stand for, in them or behind their last /."""
    compiled = re.compile(pattern, re.IGNORECASE)
    found: dict[tuple[str, ...], str] = {}
    for name, text in plain.items():
        match = compiled.fullmatch(text) or compiled.fullmatch(text.rpartition("/")[2])
        if match is not None:
            found.setdefault(match.groups(), name)
    return found


def _of_group(group: _Group, unit: str | None) -> _Found:
    """Return what was found by the labels of columns."""
    return list(group.values()), tuple(group), unit


def _group(
    style: str,
    plain: Mapping[str, str],
    key: str,
    names: Sequence[str] | None,
    explicit: bool = False,
) -> _Group:
    """Return the columns that are named by `key` and by joint, in the order of the joints."""
    found = {
        label: name
        for (label,), name in _like(plain, _STYLES[style].format(key=_spelled(key))).items()
    }
    if style == "numbered":
        found = {str(int(label)): name for label, name in found.items()}
    elif not explicit:
        wanted = names or ()
        found = {k: n for k, n in found.items() if k in wanted or not _COMMANDED.search(k)}
    return _ordered(found, names, by_number=style != "labeled")


def _ordered(group: _Group, names: Sequence[str] | None, by_number: bool = True) -> _Group:
    """Return columns in the order of the names wanted, else as numbered at their ends."""
    if names is not None and all(name in group for name in names):
        return {name: group[name] for name in names}
    split = [re.fullmatch(r"(.*?)(\d+)", label) for label in group]
    parts = [(int(part[2]), label) for part, label in zip(split, group, strict=True) if part]
    alike = len(parts) == len(group) and len({part[1] for part in split if part}) == 1
    return {label: group[label] for _, label in sorted(parts)} if by_number and alike else group
