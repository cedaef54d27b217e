"""Text files of numbers: CSV and its kin, with or without a header, compressed or not."""

from __future__ import annotations

import contextlib
import csv
import gzip
import io
import re
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from sdpid._common.sandbox import memory_limit
from sdpid._common.text import printable
from sdpid.errors import DataError
from sdpid.experiment.readers.table import NoNumbersError, Table
from sdpid.experiment.readers.unit_names import unit_of

__all__ = ["load_text"]

_UTF8 = "utf-8-sig"
# A line is not longer than this.
_LONGEST_LINE = 1 << 20
# Kinds of columns, and the decimal mark, are decided by this many lines.
_LOOKED_AT = 200
# Bytes by which the encoding is decided.
_SNIFFED = 1 << 16
_COMMENTS = ("#", "%", "//")
# How programs write that a value is missing.
_MISSING = {"", "nan", "na", "n/a", "null", "none", "-", "--", "#n/a", "1.#qnan", "-nan(ind)"}
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+(?:[eE][-+]?\d+)?")
_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d.*")
_OFFSET = re.compile(r"\s*(?:Z|UTC|[+-]\d\d:?\d\d)$")
# An integer of more digits does not fit a double; it is read relative to the first one.
_DOUBLE_DIGITS = 15
# What reading damaged text or a damaged archive can raise.
_DAMAGE = (OSError, EOFError, UnicodeError, ValueError, zlib.error, csv.Error)


def load_text(path: Path) -> Table:
    """List the columns of a text file.

    Columns are separated by semicolons, tabs, commas or blanks; decimals by points, or by commas
    where those do not separate columns. Names stand in the first line, in a comment before the
    numbers, or nowhere: then columns are named by numbers from 1. A line of units may follow.
    Missing values are NaN.

    Raises
    ------
    DataError
        When the file is no text, or holds no table.
    """
    layout = _layout(path)
    text = _TextColumns(path, layout)
    arrays = {name: partial(text.column, k) for k, name in enumerate(layout.names) if name}
    return Table(arrays, place=text.place, unnamed=layout.unnamed)


@dataclass(frozen=True)
class _Layout:
    """How a text file is written.

    `names`, `converters` and `words` go by columns: `converters` read what is no plain number,
    `words` are the first values of columns that hold text.
    """

    encoding: str
    names: list[str]
    delimiter: str | None
    first: int  # the line with the first values, counted from 1
    decimal_comma: bool = False
    unnamed: bool = False
    converters: dict[int, Callable[[str], float]] = field(default_factory=dict)
    words: dict[int, str] = field(default_factory=dict)


class _TextColumns:
    """The values of a text file, all read when the first column is needed."""

    def __init__(self, path: Path, layout: _Layout) -> None:
        self._path, self._layout = path, layout
        self._values: NDArray[Any] | None = None
        # Lines that hold no values, as blank ones and comments.
        self._skipped: list[int] = []
        self._line = 0

    def column(self, k: int) -> NDArray[Any]:
        """Return one column."""
        word = self._layout.words.get(k)
        if word is not None:
            raise NoNumbersError(
                f"{self._path}: line {self._layout.first}: '{printable(self._layout.names[k])}' "
                f"holds '{printable(word[:40])}', not a number."
            )
        if self._values is None:
            self._values = self._read()
        return self._values[:, k]

    def place(self, sample: int) -> str:
        """Return the line of a sample, counted from 1 as editors do."""
        for _ in self._lines():  # finds the lines to be skipped
            pass
        line = self._layout.first + sample
        for skipped in self._skipped:
            line += skipped <= line
        return f"line {line}"

    def _read(self) -> NDArray[Any]:
        """Read all numbers; the second try takes words for missing values."""
        layout = self._layout
        if self._plain():
            with contextlib.suppress(*_DAMAGE):
                # A third faster than line by line; NumPy counts the fields of every line as well.
                return self._table(self._path, {}, skiprows=layout.first - 1)
        with contextlib.suppress(*_DAMAGE):
            return self._table(self._lines(), layout.converters)
        numbers = {
            k: partial(self._number, k)
            for k in range(len(layout.names))
            if k not in layout.converters
        }
        try:
            return self._table(self._lines(), {**numbers, **layout.converters})
        except _DAMAGE as cause:
            raise DataError(f"{self._path}: cannot be read ({cause}).") from None

    def _plain(self) -> bool:
        """Tell whether the file holds plain numbers only, and surely fits into memory."""
        layout = self._layout
        # A value takes two bytes of text or more, and eight of memory.
        size = 4 * self._path.stat().st_size
        compressed = self._path.suffix.lower() == ".gz"
        odd = layout.converters or layout.decimal_comma or layout.encoding != _UTF8 or compressed
        return not odd and size <= memory_limit()

    def _table(self, source: Any, converters: dict[int, Any], skiprows: int = 0) -> NDArray[Any]:
        table: NDArray[Any] = np.loadtxt(  # type: ignore[call-overload]
            source,
            skiprows=skiprows,
            delimiter=self._layout.delimiter,
            converters=converters or None,
            ndmin=2,
            comments=None,
            quotechar='"',
            encoding=None if skiprows == 0 else _UTF8,
        )
        return table

    def _lines(self) -> Iterator[str]:
        """Yield the lines with values, each with as many fields as there are columns."""
        layout, self._skipped = self._layout, []
        count, most = len(layout.names), memory_limit() // (8 * len(layout.names))
        with _opened(self._path, layout.encoding) as stream:
            for number, line in enumerate(_bounded(self._path, stream), 1):
                self._line = number
                if number < layout.first:
                    continue
                if not line.strip() or line.startswith(_COMMENTS):
                    self._skipped.append(self._line)
                    continue
                if self._line - layout.first > most:
                    raise DataError(
                        f"{self._path}: has more than {most:,} rows, which do not fit the memory "
                        "limit for one log; cut it into parts, or thin it."
                    )
                held = _count(line, layout.delimiter)
                if held != count:
                    hint = "; repair or delete that line"
                    if layout.delimiter == "," and held > count:
                        hint = "; where commas are decimal marks, separate columns by semicolons"
                    raise _LineError(
                        f"{self._path}: line {self._line} has {held} values for {count} "
                        f"columns{hint}."
                    )
                if layout.decimal_comma:
                    if "." in line:
                        self._refuse_points(line)
                    line = line.replace(",", ".")
                yield line

    def _number(self, k: int, text: str) -> float:
        """Return the number in a field; NaN where it is missing."""
        text = text.strip().strip('"')
        if text.lower() in _MISSING:
            return np.nan
        try:
            return float(text)
        except ValueError:
            hint = "; decimals need a point" if _DECIMAL_COMMA.fullmatch(text) else ""
            raise _LineError(
                f"{self._path}: line {self._line}: '{printable(self._layout.names[k])}' holds "
                f"'{printable(text[:40])}', not a number{hint}."
            ) from None

    def _refuse_points(self, line: str) -> None:
        """Refuse decimal points where others are commas: one of them marks thousands."""
        for k, text in enumerate(_fields(line, self._layout.delimiter)):
            if "." in text and k not in self._layout.converters:
                raise _LineError(
                    f"{self._path}: line {self._line}: '{printable(self._layout.names[k])}' holds "
                    f"'{printable(text[:40])}' where other decimals have commas."
                )


class _LineError(DataError):
    """A line is not as the others."""


def _layout(path: Path) -> _Layout:
    """Find out how a text file is written, from its beginning."""
    try:
        encoding = _encoding(path)
        with _opened(path, encoding) as stream:
            numbered = enumerate(_bounded(path, stream), 1)
            lines = [(k, line) for (k, line), _ in zip(numbered, range(_LOOKED_AT), strict=False)]
    except _DAMAGE as cause:
        raise DataError(f"{path}: not a readable text file ({cause}).") from None
    kept = [(k, line) for k, line in lines if line.strip() and not line.startswith(_COMMENTS)]
    if not kept:
        raise DataError(f"{path}: has no header and no data.")
    if any(ord(c) < ord(" ") and c not in "\t\r\n\f" for _, line in kept[:2] for c in line):
        raise DataError(f"{path}: the first line is no line of column names.")
    comments = [line for k, line in lines if k < kept[0][0] and line.startswith(_COMMENTS)]
    return _described(path, encoding, kept, comments)


def _described(
    path: Path, encoding: str, kept: list[tuple[int, str]], comments: list[str]
) -> _Layout:
    """Return the layout that the first lines show."""
    head = kept[0][1]
    delimiter = next((mark for mark in ";\t," if mark in head), None)
    names, unnamed = _fields(head, delimiter), False
    if all(_is_value(name, delimiter) for name in names):
        # The first line holds values: names may stand in the last comment before.
        kept = [(0, ""), *kept]
        bare = comments[-1].lstrip("#%/ ") if comments else ""
        commented = _fields(bare, next((mark for mark in ";\t," if mark in bare), None))
        unnamed = len(commented) != len(names)
        names = [str(k + 1) for k in range(len(names))] if unnamed else commented
    elif any(_is_value(name, delimiter) for name in names if name):
        raise DataError(
            f"{path}: the first line must name the columns, but some of its fields are numbers "
            f"({printable(head.strip()[:60])})."
        )
    if len(kept) > 1 and (units := _units_row(kept[1][1], delimiter, len(names))):
        kept = kept[1:]
        names = [
            f"{name} [{unit}]" if unit else name for name, unit in zip(names, units, strict=True)
        ]
    named = [name for name in names if name]
    if len(kept) < 2 or not named:
        raise DataError(f"{path}: has no header and no data.")
    if len(set(named)) != len(named):
        raise DataError(
            f"{path}: {len(named)} column names, {len(set(named))} of them distinct; every "
            "column needs a name of its own."
        )
    first = kept[1][0]
    rows = [_fields(line, delimiter) for _, line in kept[1:]]
    if len(rows[0]) != len(names):
        raise DataError(
            f"{path}: {len(names)} column names for {len(rows[0])} values in line {first}."
        )
    columns = list(zip(*(row for row in rows if len(row) == len(names)), strict=True))
    comma = delimiter != "," and any(
        _DECIMAL_COMMA.fullmatch(text) for column in columns for text in column
    )
    converters: dict[int, Callable[[str], float]] = {}
    words: dict[int, str] = {}
    for k, column in enumerate(columns):
        held = [text for text in column if text.lower() not in _MISSING]
        if held and all(_DATE.fullmatch(text) for text in held):
            converters[k] = _Seconds()
        elif held and held[0].isdigit() and len(held[0]) > _DOUBLE_DIGITS:
            converters[k] = _Relative(int(held[0]))
        elif held and not any(_is_value(text, delimiter) for text in held):
            converters[k] = lambda _: np.nan
            words[k] = held[0]
    return _Layout(encoding, names, delimiter, first, comma, unnamed, converters, words)


class _Seconds:
    """Reads dates and times as seconds from the first one."""

    def __init__(self) -> None:
        self._first: np.datetime64 | None = None

    def __call__(self, text: str) -> float:
        stamp = np.datetime64(_OFFSET.sub("", text.strip().strip('"')).replace(",", "."), "ns")
        if self._first is None:
            self._first = stamp
        return float((stamp - self._first) / np.timedelta64(1, "s"))


class _Relative:
    """Reads long integers less the first one, which keeps all of their digits."""

    def __init__(self, first: int) -> None:
        self._first = first

    def __call__(self, text: str) -> float:
        return float(int(text.strip().strip('"')) - self._first)


def _opened(path: Path, encoding: str) -> TextIO:
    """Open a text file, compressed or not."""
    unpack: Any = gzip.open if path.suffix.lower() == ".gz" else open
    raw = unpack(path, "rb")
    return io.TextIOWrapper(raw, encoding=encoding, errors="replace", newline="")


def _encoding(path: Path) -> str:
    """Return UTF-8 or UTF-16 where the bytes are such, else what Windows writes."""
    with _opened(path, "latin-1") as stream:
        start = stream.buffer.read(_SNIFFED)
    if start.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    try:
        # A character may be cut at the end.
        start.decode("utf-8") if len(start) < _SNIFFED else start[:-4].decode("utf-8", "strict")
    except UnicodeDecodeError as cause:
        if cause.start < len(start) - 8:
            return "cp1252"
    return _UTF8


def _bounded(path: Path, stream: TextIO) -> Iterator[str]:
    """Yield lines that are not endless."""
    for line in iter(lambda: stream.readline(_LONGEST_LINE), ""):
        if len(line) == _LONGEST_LINE:
            raise DataError(
                f"{path}: has a line of more than {_LONGEST_LINE:,} characters, which is no line "
                "of column names or of values."
            )
        yield line


def _count(line: str, delimiter: str | None) -> int:
    """Return how many fields a line has."""
    if delimiter is None or '"' in line:
        return len(_fields(line, delimiter))
    return line.count(delimiter) + 1


def _fields(line: str, delimiter: str | None) -> list[str]:
    """Split a line of a text file into fields without their quotes and blanks."""
    if delimiter is None:
        return [text.strip('"') for text in line.split()]
    try:
        row = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        return []
    return [text.strip() for text in row]


def _units_row(line: str, delimiter: str | None, count: int) -> list[str] | None:
    """Return the units of the columns where a line holds nothing else."""
    units = [text.strip("[]() ") for text in _fields(line, delimiter)]
    known = [unit for unit in units if unit]
    if len(units) != count or not known or any(unit_of(unit) is None for unit in known):
        return None
    return units


def _is_value(text: str, delimiter: str | None) -> bool:
    """Tell whether a field can be read as a number."""
    if delimiter != "," and _DECIMAL_COMMA.fullmatch(text):
        return True
    try:
        float(text)
    except ValueError:
        return False
    return True
