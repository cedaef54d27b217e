"""The named arrays of a log, and the quantities among them by the usual names or by given ones."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.files import printable
from sdpid.errors import DataError
from sdpid.experiment.readers.names import (
    CURRENT,
    FLOATING,
    QUANTITIES,
    SINGLE,
    UNITS,
    Quantity,
    of_message,
    split_unit,
)
from sdpid.experiment.recording.recording import OPTIONAL
from sdpid.experiment.recording.stored import StoredArray, check_memory

# How names are made of a key, which is a name of the quantity, and of what they are: a folder, the
# number or the name of a joint, or a foot; and a part. Numbers win over words, so that q_1 is not
# mixed with q_target_1, nor tau_J_1 with tau.
_BETWEEN = r"[_./\s\[-]*"
_STYLES = {
    "array": r"(?:(?P<of>.*)/)?{key}",
    "numbered": r"{key}[_./\s-]?\[?(?P<of>\d+)\]?",
    "labeled": r"{key}[_./\s-](?P<of>.+)",
    "suffixed": r"(?:.*/)?(?P<of>[^/]+?)[_./\s-]{key}",
    "parts": rf"{{key}}(?P<of>){_BETWEEN}q?(?P<part>{{parts}})\]?",
    "axes": rf"{{key}}(?:[_\s-](?P<of>world|base))?{_BETWEEN}(?P<part>{{parts}})\]?",
    "feet": rf"{{key}}{_BETWEEN}(?P<of>.+?){_BETWEEN}(?P<part>{{parts}})\]?",
}
# Words in labels of what is not what the robot did.
_COMMANDED = re.compile(
    r"(?:^|[_./\s-])(?:target|desired|des|cmd|command|commanded|ref|reference|setpoint|goal|err|error)"
    r"(?:$|[_./\s\d-])"
    # q_d_1 of a robot that also logs q_1.
    r"|(?:^|[_./])d[_./]?\[?\d+\]?$",
    re.IGNORECASE,
)
# Words in labels of a joint's other encoder, where the joint has a column without them too.
_SECOND = re.compile(
    r"^(?:link|load|secondary)[_./\s-]|[_./\s-](?:link|load|secondary)$", re.IGNORECASE
)
# A second derivative: beside it q_d is the first.
_DERIVATIVE = re.compile(r"(?:^|.*[_./\s-])q_?dd(?:ot)?(?:[_./\s\[-]?\d+\]?)?", re.IGNORECASE)
# Effort is often logged as a current, which is no torque before it is scaled.
_CURRENT = re.compile(
    r"(?:.*[_./])?(?:(?:current|curr|cur|amps?|i)s?(?:[_./\[]?\d+\]?)?|current_.+)", re.IGNORECASE
)
# Words that tell another quantity from a foot that is named behind ``contact_``.
_OTHERS = re.compile(r"(?:forces?|wrench(?:es)?|states?|torques?|moments?)(?:[_./\s-].*)?", re.I)
# Names of quaternions, and words in the names of what turns and is no base.
_TURNS = rf"(.*(?:quat|orient).*?){_BETWEEN}q?([xyzw])\]?"
_NO_BASE = re.compile(
    r"tcp|tool|eef?\b|ee_|tip|flange|hand|grip|object|target|desired|cmd|camera", re.I
)
# The columns from k to l of an array, counted from 1.
_SLICE = re.compile(r"(.+)\[(\d+):(\d+)\]")
# At most this many names, of at most this many letters, are listed in a message.
_LISTED, _LETTERS = 40, 60

# Columns by what they are of: a joint, its number, a folder or a foot; None for nothing.
_Group = dict[Any, str]
# The name of an array, or of columns; what these are of, and the unit that is implied.
Found = tuple[list[str], tuple[str, ...] | None, str | None]


class NoNumbersError(DataError):
    """A name of a log stands for something else than numbers or text."""


def row_number(sample: int) -> str:
    """Return where a sample stands, rows counted from 1."""
    return f"row {sample + 1}"


@dataclass(frozen=True)
class LogTable:
    """The named arrays of a log file, each read when it is needed.

    Attributes
    ----------
    arrays : mapping
        Names, and how to read what they name. Parts of a path are separated by ``/``. Only what is
        wanted is read, so an array that cannot be used does no harm to the rest.
    place : callable
        Says where sample k, counted from 0, stands in the file; for messages.
    unnamed : bool
        Whether columns have numbers from 1 instead of names.
    columns : callable, optional
        Reads several plain columns at once, as a table.
    plain : frozenset of str
        Names that are known to be columns of numbers.
    units : mapping
        Units that are known for some names.
    stated : mapping
        What the file says of ``base``, ``imu`` and ``contacts``.
    """

    arrays: Mapping[str, Callable[[], NDArray[Any]]]
    place: Callable[[int], str] = row_number
    unnamed: bool = False
    columns: Callable[[Sequence[str]], NDArray[Any]] | None = None
    plain: frozenset[str] = frozenset()
    units: Mapping[str, str] = field(default_factory=dict)
    stated: Mapping[str, Any] = field(default_factory=dict)


@contextmanager
def named(file: Path) -> Iterator[None]:
    """Name the file that is refused, where the message does not begin with it."""
    try:
        yield
    except DataError as cause:
        text = str(cause)
        raise DataError(text if text.startswith(str(file)) else f"{file}: {text}") from None


class Columns:
    """The named arrays of a log, and what was found under which name.

    Parameters
    ----------
    file : Path
        The log.
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
        self._of_message = {name: of_message(plain) for name, plain in self._plain.items()}
        self._units = {name: unit for name, (_, unit) in split.items() if unit is not None}
        self._units |= table.units
        self.used: dict[str, Sequence[str]] = {}
        self.implied: dict[str, Any] = {}

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
        found = next(self.candidates(quantity, names), None)
        if found is None and given is not None:
            of_joints = quantity not in (*SINGLE, *FLOATING)
            more = f", nor are columns '{given}_<joint>'" if of_joints else ""
            raise self._absent(quantity, f"'{given}'", more)
        if found is None:
            return None, None
        columns, labels, unit = found
        table = self.load(quantity, columns, unit)
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
                f"columns: '{self.given[quantity]}' for {quantity} has "
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
            raise DataError(f"joint_names: holds {names.dtype}, expected text.")
        if names.dtype.kind == "S":
            names = np.char.decode(names, "utf-8", "replace")
        return tuple(printable(str(name)) for name in np.atleast_1d(names).ravel())

    def load(self, quantity: str, keys: list[str], unit: str | None = None) -> NDArray[Any]:
        """Read the array of one name, or columns into one array, one after the other."""
        absent = [key for key in keys if key not in self._arrays]
        if absent or not keys:
            raise self._absent(quantity, ", ".join(absent) or "nothing")
        self.used[quantity] = tuple(keys)
        units = [self._units.get(key, unit) for key in keys]
        if any(units):
            plain = next(iter(UNITS[quantity]))
            same = units[0] if len(set(units)) == 1 else None
            self.implied[quantity] = same or [each or plain for each in units]
        single = quantity in SINGLE
        if self._table.columns and self._table.plain.issuperset(keys) and not single:
            return self._table.columns(keys)
        if len(keys) == 1:
            array = self._checked(quantity, keys[0])
            return array[:, None] if array.ndim == 1 and not single else array
        table: NDArray[Any] = np.empty((0, len(keys)))
        for j, key in enumerate(keys):
            column = self._checked(quantity, key)
            if column.ndim == 2 and 1 in column.shape:
                column = column.ravel()
            if column.ndim != 1 or (j and len(column) != len(table)):
                raise DataError(
                    f"columns: '{key}' has shape {column.shape}, expected one "
                    f"column{f' of {len(table)} rows' if j else ''}."
                )
            table = table if j else np.empty((len(column), len(keys)))
            table[:, j] = column
            self._cache.pop(key, None)
        return table

    def forget(self, quantity: str) -> None:
        """Take back that a quantity was read."""
        self.used.pop(quantity, None)
        self.implied.pop(quantity, None)

    def quaternions(self) -> tuple[str, list[str]] | None:
        """Return what columns are called that may be quaternions, and the names of x to w."""
        found: dict[str, dict[str, str]] = {}
        for match, name in self._like("base_orientation", _TURNS):
            found.setdefault(match[1], {}).setdefault(match[2].lower(), name)
        for label, parts in found.items():
            if len(parts) == 4 and not _NO_BASE.search(label):
                return label, [parts[part] for part in "xyzw"]
        return None

    def _absent(self, quantity: str, what: str, more: str = "") -> DataError:
        """Return the error that what was asked for is not there."""
        return DataError(
            f"columns: {what} for {quantity} is not there{more}; found: {_list(self._arrays)}."
        )

    def missing(self, quantity: str, command: str | None = None) -> DataError:
        """Return the error that a quantity was not found, and what was.

        `command` is why commanded positions were left out, if they were.
        """
        if self._table.unnamed:
            return DataError(
                f"its {len(self._arrays)} columns have no names: the first line must "
                "name the columns, or give their numbers from 1, as in columns={'time': 1, "
                "'position': [2, 3], 'effort': [4, 5]}."
            )
        hint = ""
        if quantity == "effort":
            hint = (
                " Without a torque sensor, commanded positions and the law of the drives serve as "
                "well (--law pd --kp 20 --kd 1.5, law=): name them with columns={'reference': ...}."
            )
            hint += "" if command is None else f" They were left out: {command}."
        currents = [name for name, plain in self._plain.items() if _CURRENT.fullmatch(plain)]
        if quantity == "effort" and currents:
            hint = (
                f" {', '.join(currents[:8])} look like currents: give gains= (a file of "
                "`sdpid gains`), effort_scale= or torque constants of motors, or name them as "
                "effort if they are torques."
            )
        return DataError(
            f"{quantity} is missing: none of "
            f"{', '.join(QUANTITIES[quantity].names)} is there. Found: {_list(self._arrays)}. "
            f"Name it with columns={{'{quantity}': ...}}, or in a mapping beside the log.{hint}"
        )

    def candidates(self, quantity: str, names: Sequence[str] | None) -> Iterator[Found]:
        """Yield all that may be a quantity: arrays, then columns that are named by joint or part.

        Columns are in the order of the joints. Last come those that are known by their unit only,
        and currents where they can be scaled.
        """
        given = self.given.get(quantity)
        if given in self._arrays:
            yield [given], None, None
            return
        row = Quantity((given,), bare=()) if given is not None else QUANTITIES[quantity]
        if given is None and any(map(_DERIVATIVE.fullmatch, self._plain.values())):
            row = replace(row, names=tuple(name for name in row.names if name != "q_d"))
        arrays = self._arrays_called(quantity, row, names)
        if quantity in FLOATING:
            # One name goes before another, whether it is an array's or that of columns.
            order = {name.lower(): k for k, name in enumerate(row.names)}
            every = [*arrays, *self._of_base(quantity, row)]
            every.sort(key=lambda each: order.get(each[0], 0))
            yield from (found for _, found in every)
            return
        called = set()
        for key, found in arrays:
            called.add(key)
            yield found
        if quantity not in SINGLE:
            explicit = given is not None
            yield from self._of_joints(quantity, row, names, explicit=explicit, arrays=called)
            if row.bare:
                yield from self._of_joints(quantity, replace(row, names=()), names)
        if quantity == "effort" and given is None and self._scaled:
            yield from (found for _, found in self._arrays_called(quantity, CURRENT, names))
            yield from self._of_joints(quantity, CURRENT, names)

    def _arrays_called(
        self, quantity: str, row: Quantity, names: Sequence[str] | None
    ) -> Iterator[tuple[str, Found]]:
        """Yield names and their arrays, or those of one value a sample in each joint's folder."""
        for key, unit, group in self._groups("array", quantity, row):
            places = list(group.values())
            if "" in group or len(group) == 1:
                yield key, ([group.get("", places[0])], None, unit)
                continue
            parents = [folder.rpartition("/")[2] for folder in group]
            several = quantity in SINGLE or len(set(parents)) < len(parents)
            if several or any(self._array(place).ndim != 1 for place in places):
                raise DataError(
                    f"{quantity} is there more than once: {_list(places)}; "
                    f"name the one to read with columns={{'{quantity}': '{places[0]}'}}."
                )
            yield key, _ordered(dict(zip(parents, places, strict=True)), names, unit)

    def _of_base(self, quantity: str, row: Quantity) -> Iterator[tuple[str, Found]]:
        """Yield names and columns of all parts: of a base, in any axes, or of every foot."""
        parts = QUANTITIES[quantity].parts
        velocity, feet = quantity.endswith("_velocity"), quantity.startswith("contact")
        style = "axes" if velocity else "feet" if feet else "parts"
        for key, _, group in self._groups(style, quantity, replace(row, parts=parts)):
            found = dict.fromkeys(of for of, _ in group if not _OTHERS.fullmatch(of))
            # The world's axes go before the base's, and these before unnamed ones.
            for each in [[*found]] if feet else [[of] for of in sorted(found, reverse=True)]:
                wanted = [(of, part) for of in each for part in parts or ("",)]
                if wanted and group.keys() >= set(wanted):
                    labels = parts if quantity == "base_orientation" else tuple(filter(None, each))
                    yield key, ([group[one] for one in wanted], labels or None, None)

    def _of_joints(
        self,
        quantity: str,
        row: Quantity,
        names: Sequence[str] | None,
        *,
        explicit: bool = False,
        arrays: Collection[str] = (),
    ) -> Iterator[Found]:
        """Yield the columns of joints, by their numbers or names, but of names that arrays have."""
        styles = ["numbered", "labeled", "suffixed"]
        if names is not None and not all(name.isdigit() for name in names):
            styles = ["labeled", "numbered", "suffixed"]
        for style in styles if row.names else ["numbered"]:
            believed = explicit or (style == "numbered" and quantity not in OPTIONAL)
            groups = list(self._groups(style, quantity, row))
            labels = {label for _, _, group in groups for label in group}
            for key, unit, group in groups:
                if key in arrays:
                    continue
                for label, name in list(group.items()):
                    commanded = style != "numbered" and _COMMANDED.search(label)
                    others = commanded and not explicit and label not in (names or ())
                    second = _SECOND.search(label) and _SECOND.sub("", label) in labels
                    if others or second or not (believed or self._is_column(name)):
                        del group[label]
                if group and (believed or self._fits(group)):
                    yield _ordered(group, names, unit, by_number=style != "labeled")

    def _groups(
        self, style: str, quantity: str, row: Quantity
    ) -> Iterator[tuple[str, str | None, _Group]]:
        """Yield each name of a quantity, its unit, and its columns by what they are of."""
        keys = row.names or row.bare
        # Words of a name are joined by underscores, blanks or hyphens.
        words = (map(re.escape, key.split("_")) for key in sorted(keys, key=len, reverse=True))
        spelled = "|".join(map(r"[_\s-]".join, words))
        endings = "|".join(filter(None, row.endings)) or "(?!)"
        key = rf"(?P<key>{spelled})(?:[_\s-](?P<unit>{endings}))?"
        groups: dict[tuple[str, str], _Group] = {}
        pattern = _STYLES[style].format(key=key, parts="|".join(row.parts))
        for match, name in self._like(quantity, pattern):
            at, of = match.groupdict(""), match["of"] or ""
            key, unit = re.sub(r"[\s-]", "_", at["key"]).lower(), at["unit"].lower()
            if not row.names and name not in self._units:
                continue
            label: Any = str(int(of)) if style == "numbered" else of
            label = (of, at["part"].lower()) if "part" in at else label
            group = groups.setdefault((key, unit), {})
            group[label] = name if name in row.names else group.get(label, name)
        order = {key.lower(): k for k, key in enumerate(keys)}

        def rank(entry: tuple[str, str]) -> tuple[bool, int]:
            # Of two endings the longer one leaves the joint's name.
            if style == "suffixed":
                return False, -len("_".join(filter(None, entry)))
            # Of arrays those without a unit go first. Else those with, or `deg` in position_deg
            # would be a joint.
            return bool(entry[1]) == (style == "array"), order.get(entry[0], 0)

        for entry in sorted(groups, key=rank):
            yield entry[0], row.endings.get(entry[1]), groups[entry]

    def _like(self, quantity: str, pattern: str) -> Iterator[tuple[re.Match[str], str]]:
        """Yield names that fit a pattern, or do behind their last /, but those of other units."""
        compiled, known = re.compile(pattern, re.IGNORECASE), UNITS.get(quantity, ())
        once = quantity in OPTIONAL or quantity in FLOATING
        taken = {name for names in self.used.values() for name in names if once}
        for name, text in self._plain.items():
            plain = None if quantity in self.given else self._of_message[name]
            texts = (text, text.rpartition("/")[2]) if plain is None else (plain,)
            match = next(filter(None, (compiled.fullmatch(each) for each in texts)), None)
            if match and name not in taken and self._units.get(name) in (None, *known):
                yield match, name

    def _fits(self, group: _Group) -> bool:
        """Tell whether columns have labels of the joints whose positions were read."""
        if self._joints is None:
            return True
        labels, count = self._joints
        return bool(labels & set(group)) if labels else len(group) == count > 1

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
            raise DataError(f"{quantity}: '{name}' holds {array.dtype}, expected numbers.")
        return array

    def _part(self, name: str, begin: str, end: str) -> NDArray[Any]:
        """Return some columns of an array."""
        array, first, last = self._arrays[name](), int(begin), int(end)
        if array.ndim != 2 or not 1 <= first <= last <= array.shape[1]:
            raise DataError(
                f"columns: '{name}[{first}:{last}]' asks for columns {first} to "
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


def _list(names: Iterable[str]) -> str:
    """Return names for a message, the first ones if there are many."""
    every = [name if len(name) <= _LETTERS else f"{name[:_LETTERS]}..." for name in names]
    more = f" and {len(every) - _LISTED} more" if len(every) > _LISTED else ""
    return (", ".join(every[:_LISTED]) or "nothing") + more


def _ordered(
    group: _Group, names: Sequence[str] | None, unit: str | None, by_number: bool = True
) -> Found:
    """Return columns in the order of the names wanted, else as numbered at their ends."""
    split = [re.fullmatch(r"(.*?)(\d+)", label) for label in group]
    parts = [(int(part[2]), label) for part, label in zip(split, group, strict=True) if part]
    alike = len(parts) == len(group) and len({part[1] for part in split if part}) == 1
    if names is not None and all(name in group for name in names):
        group = {name: group[name] for name in names}
    elif by_number and alike:
        group = {label: group[label] for _, label in sorted(parts)}
    return list(group.values()), tuple(group), unit
