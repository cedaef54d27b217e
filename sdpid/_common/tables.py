"""How results and settings are shown: tables as text, CSV and HTML, lines, plain values."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import reprlib
from collections.abc import Iterable, Mapping, Sequence, Sized
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from html import escape
from typing import Any, ClassVar

import numpy as np

from sdpid._common.files import atomic_write_text, printable

# Characters of a value, and of all settings together.
_VALUE, _LINE = 40, 120


@dataclass(frozen=True)
class Table:
    """Rows under a header.

    A missing value is None; numbers that are not finite are shown and written as missing too.

    Attributes
    ----------
    header : tuple of str
        Column names.
    rows : tuple of tuple
        The cells.
    formats : dict of str to str
        Format of the numbers of some columns in `text` and `html`, such as ``{"cost": ".8g"}``.
    """

    header: tuple[str, ...]
    rows: tuple[tuple[object, ...], ...]
    formats: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of_columns(
        cls, columns: Mapping[str, Sequence[object]], formats: Mapping[str, str] | None = None
    ) -> Table:
        """Return a table of columns by name, all of one length."""
        rows = zip(*(plain(list(column)) for column in columns.values()), strict=True)
        return cls(tuple(columns), tuple(rows), formats or {})

    def text(self, digits: int = 4) -> str:
        """Return aligned text, numbers with `digits` significant digits where no format is given.

        Columns of numbers, and of texts that begin with one, are aligned on the right.
        """
        lines = [self.header, *self._cells(digits)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        right = self._right()
        return "\n".join(
            "  ".join(
                cell.rjust(width) if to_right else cell.ljust(width)
                for cell, width, to_right in zip(line, widths, right, strict=True)
            ).rstrip()
            for line in lines
        )

    def html(self, digits: int = 4) -> str:
        """Return an HTML ``<table>`` with every text escaped."""
        sides = [' style="text-align:right"' if right else "" for right in self._right()]
        rows = [_html_row("td", cells, sides) for cells in self._cells(digits)]
        return "\n".join(["<table>", _html_row("th", self.header, sides), *rows, "</table>"])

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write as CSV with all digits, whole or not at all."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.header)
        # None is an empty cell.
        writer.writerows(map(plain, self.rows))
        atomic_write_text(path, text.getvalue())

    def _cells(self, digits: int) -> list[tuple[str, ...]]:
        """Return the rows as text."""
        formats = [self.formats.get(name, f".{digits}g") for name in self.header]
        return [
            tuple(_cell(cell, spec) for cell, spec in zip(row, formats, strict=True))
            for row in self.rows
        ]

    def _right(self) -> list[bool]:
        """Return which columns are aligned on the right: those that hold no text."""
        return [
            i > 0 and not any(isinstance(row[i], str) for row in self.rows)
            for i in range(len(self.header))
        ]


def _cell(value: object, spec: str) -> str:
    """Return a value as text, a dash where it is missing."""
    value = plain(value)
    if value is None:
        return "-"
    return format(value, spec) if isinstance(value, float) else printable(str(value))


def _html_row(tag: str, cells: Sequence[str], sides: Sequence[str]) -> str:
    """Return one row of an HTML table."""
    inner = "".join(
        f"<{tag}{side}>{escape(cell)}</{tag}>" for cell, side in zip(cells, sides, strict=True)
    )
    return f"<tr>{inner}</tr>"


def facts_html(title: str, facts: Mapping[str, object], *tables: Table) -> str:
    """Return a result as HTML for a notebook: a title, named facts, and tables below them.

    Parameters
    ----------
    title : str
        What it is, such as ``"Estimate of arm"``.
    facts : mapping of str to object
        Names and values; numbers with five significant digits.
    *tables : Table
        Shown below, in order.

    Returns
    -------
    str
        Every text is escaped. For a method ``_repr_html_``.
    """
    rows = [_html_row("td", (name, _cell(x, ".5g")), ("", "")) for name, x in facts.items()]
    parts = [f"<b>{escape(title)}</b>", "<table>", *rows, "</table>"]
    return "\n".join([*parts, *(table.html() for table in tables)])


# Numbers of an array that is shown as it is.
_FEW = 8

# Last parts of paths that say little: what is before them names the fact.
_VAGUE = frozenset({"name", "count", "ok", "min", "max"})


class Shown:
    """A result that shows itself by its facts: in a line, and above its tables in a notebook.

    Attributes
    ----------
    _facts : tuple of str
        Paths to attributes, such as ``"robot.name"`` or ``"mass, kg"`` with a unit. Methods are
        called; of lists and large arrays the length is shown.
    """

    _facts: ClassVar[tuple[str, ...]] = ()

    def _shown(self) -> Mapping[str, object]:
        """Return the facts by what they are called, with their units."""
        return {_fact_name(fact): _fact(self, fact.partition(",")[0]) for fact in self._facts}

    def _tables(self) -> Iterable[Table]:
        """Return what stands below the facts in a notebook."""
        return ()

    def __repr__(self) -> str:
        parts = []
        for name, value in self._shown().items():
            text = _cell(value, ".6g") if isinstance(value, float) else brief(value)
            parts.append(f"{name.partition(',')[0]}={text}")
        return f"{type(self).__name__}({_cut(', '.join(parts))})"

    def _repr_html_(self) -> str:
        return facts_html(type(self).__name__, self._shown(), *self._tables())


def _fact_name(fact: str) -> str:
    """Return what a fact is called: the last part of its path that says something, and its unit."""
    path, comma, unit = fact.partition(",")
    parts = [part for part in path.split(".") if part not in _VAGUE] or [path]
    return f"{parts[-1].lstrip('_')}{comma}{unit}"


def _fact(shown: object, path: str) -> object:
    """Return what a path leads to; None where an attribute on it is None."""
    for part in path.split("."):
        shown = None if shown is None else getattr(shown, part)
        shown = shown() if callable(shown) else shown
    if isinstance(shown, np.ndarray) and shown.size <= _FEW:
        return ", ".join(f"{number:.4g}" for number in shown.ravel())
    return len(shown) if isinstance(shown, Sized) and not isinstance(shown, str) else shown


def _cut(line: str) -> str:
    return line if len(line) <= _LINE else f"{line[:_LINE]}…"


class Settings(Shown):
    """A dataclass of settings, which shows those that are not the defaults, cut where long."""

    def __repr__(self) -> str:
        shown = ", ".join(f"{name}={brief(value)}" for name, value in changed(self).items())
        return f"{type(self).__name__}({_cut(shown)})"

    def _shown(self) -> Mapping[str, object]:
        return {k: brief(v) for k, v in changed(self).items()} or {"settings": "the defaults"}


def changed(settings: Any) -> dict[str, Any]:
    """Return the settings by name that are compared and are not the defaults."""
    return {
        each.name: value
        for each in fields(settings)
        if each.repr and not _is_default(value := getattr(settings, each.name), each)
    }


def _is_default(value: object, field: Field[Any]) -> bool:
    default = field.default if field.default_factory is MISSING else field.default_factory()
    if isinstance(value, np.ndarray) or default is MISSING:
        return False
    return bool(value is default or value == default)


# What is shown as it is in a list.
_SIMPLE = (str, int, float, tuple, list, type(None))


def brief(value: object) -> str:
    """Return a value in a few characters: of an array its shape, of a long list its beginning."""
    if isinstance(value, np.ndarray):
        return f"array {value.shape}"
    if isinstance(value, tuple | list) and value and not isinstance(value[0], _SIMPLE):
        return f"({', '.join(type(each).__name__ for each in value[:3])}{', …' * (len(value) > 3)})"
    short = reprlib.Repr()
    short.maxstring = short.maxother = _VALUE
    short.maxdict = short.maxtuple = short.maxlist = 3
    text = short.repr(value).replace("\n", " ")
    return text if len(text) <= 2 * _VALUE else f"{text[: 2 * _VALUE]}…"


def plain(value: Any) -> Any:
    """Return a value as JSON has it: the one way by which results become dictionaries.

    Parameters
    ----------
    value : object
        Nested dataclasses (by their public fields; what they hold by its `to_dict`), tables (as
        rows by name), mappings, sequences, arrays and scalars.

    Returns
    -------
    object
        Dictionaries, lists, strings, numbers, booleans and None; a number that is not finite is
        None, since JSON has no other word for it.
    """
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Mapping):
        return {str(key): _part(each) for key, each in value.items()}
    if isinstance(value, Table):
        return [dict(zip(value.header, plain(row), strict=True)) for row in value.rows]
    if is_dataclass(value):
        names = [each.name for each in fields(value) if not each.name.startswith("_")]
        return {name: _part(getattr(value, name)) for name in names}
    return [_part(each) for each in value]


def _part(value: Any) -> Any:
    """Return what is held by a value, as it says itself with `to_dict` where it has that."""
    return plain(value.to_dict() if hasattr(value, "to_dict") else value)


def plain_dict(values: Mapping[str, object]) -> dict[str, Any]:
    """Return values by name as JSON has them, see `plain`."""
    return {name: _part(value) for name, value in values.items()}


def json_text(value: Any) -> str:
    """Return a value as JSON text with an indent of one; numbers that are not finite are null."""
    return json.dumps(plain(value), indent=1, allow_nan=False)
