"""Text files of numbers: CSV and its kin, with or without a header, compressed or not."""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import re
import warnings
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from sdpid._common.sandbox import memory_limit
from sdpid._common.text import printable
from sdpid.errors import DataError
from sdpid.experiment.readers.table import NoNumbersError, Table
from sdpid.experiment.readers.unit_names import unit_of

# A line is not longer than this.
_LONGEST_LINE = 1 << 20
# Lines that are handed on at once.
_AT_ONCE = 128
# Kinds of columns, and the decimal mark, are decided by this many lines.
_LOOKED_AT = 200
# Bytes by which the encoding is decided.
_SNIFFED = 1 << 16
_COMMENTS = ("#", "%", "//")
# How programs write that a value is missing, in any case.
_MISSING = ("", "nan", "na", "n/a", "null", "none", "-", "--", "#n/a", "1.#qnan", "-nan(ind)")
_CASES = (str.lower, str.upper, str.title, lambda _: "NaN")
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+(?:[eE][-+]?\d+)?")
_EXCHANGED = str.maketrans(",.", ".,")
_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d.*")
# Integers from here on do not fit a double; they are read relative to the first one.
_BEYOND_DOUBLE = 10**15
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
    try:
        encoding = _encoding(path)
        with _opened(path, encoding) as stream:
            lines = list(islice(enumerate(_bounded(path, stream), 1), _LOOKED_AT))
    except _DAMAGE as cause:
        raise DataError(f"{path}: not a readable text file ({cause}).") from None
    kept = [(k, line) for k, line in lines if line.strip() and not line.startswith(_COMMENTS)]
    if not kept:
        raise DataError(f"{path}: has no header and no data.")
    if any(ord(c) < ord(" ") and c not in "\t\r\n\f" for _, line in kept[:2] for c in line):
        raise DataError(f"{path}: the first line is no line of column names.")
    comments = [line for k, line in lines if k < kept[0][0] and line.startswith(_COMMENTS)]
    text, unnamed = _described(path, encoding, kept, comments)
    arrays = {name: partial(text.column, k) for k, name in enumerate(text.names) if name}
    return Table(arrays, place=text.place, unnamed=unnamed)


class _LinesAsFile(io.TextIOBase):
    """Lines as a file that pandas reads."""

    def __init__(self, lines: Iterator[str]) -> None:
        self._lines = lines

    def read(self, size: int | None = -1) -> str:
        return "".join(islice(self._lines, _AT_ONCE))


@dataclass(frozen=True)
class _Text:
    """The values of a text file, all read when the first column is needed."""

    path: Path
    encoding: str
    names: list[str]
    delimiter: str | None
    first: int  # the line with the first values, counted from 1
    comma: bool  # whether decimals have commas

    def column(self, k: int) -> NDArray[Any]:
        """Return one column."""
        values = self._frame[k]
        if values.dtype.kind in "iu" and abs(int(values[0])) >= _BEYOND_DOUBLE:
            values = values - values[0]
        if values.dtype.kind not in "iuf":
            values = self._numbers(k, values.dropna().astype(str)).reindex(values.index)
        return np.asarray(values, dtype=np.float64)

    def place(self, sample: int) -> str:
        """Return the line of a sample, counted from 1 as editors do."""
        return f"line {next(islice(self._lines(), sample, None))[0]}"

    @cached_property
    def _frame(self) -> Any:
        """All values as a data frame; columns that hold no plain numbers are texts."""
        import pandas as pd

        try:
            with warnings.catch_warnings():
                # Newer versions read all digits by default, and warn of the argument.
                warnings.simplefilter("ignore")
                return pd.read_csv(
                    _LinesAsFile(line for _, line in self._lines()),
                    sep=self.delimiter or r"\s+",
                    header=None,
                    names=range(len(self.names)),
                    index_col=False,
                    na_values=[case(text) for text in _MISSING for case in _CASES],
                    keep_default_na=False,
                    skipinitialspace=True,
                    float_precision="round_trip",
                )
        except _DAMAGE as cause:
            raise DataError(f"{self.path}: cannot be read ({cause}).") from None

    def _numbers(self, k: int, texts: Any) -> Any:
        """Return texts as numbers: dates and times as seconds from the first one."""
        import pandas as pd

        texts, kind = texts.str.strip(), "a number"
        if all(map(_DATE.fullmatch, texts[:_LOOKED_AT])):
            kind, iso = "a date and time", texts.str.removesuffix("UTC").str.strip()
            iso = iso.str.replace(",", ".", regex=False)
            stamps = pd.to_datetime(iso, utc=True, format="ISO8601", errors="coerce")
            numbers = (stamps - stamps.iloc[0]) / pd.Timedelta(seconds=1)
        else:
            numbers = texts.map(_number).astype(float)
        bad = numbers.isna()
        if not bad.any():
            return numbers
        sample, name = int(texts.index[bad][0]), printable(self.names[k])
        word = texts[sample].translate(_EXCHANGED) if self.comma else texts[sample]
        said = f"{self.path}: {self.place(sample)}: '{name}' holds '{printable(word[:40])}'"
        if bad[:_LOOKED_AT].all():
            raise NoNumbersError(f"{said}, not {kind}.")
        if self.comma and "." in word:
            raise DataError(f"{said} where other decimals have commas.")
        hint = "; decimals need a point" if _DECIMAL_COMMA.fullmatch(word) else ""
        raise DataError(f"{said}, not {kind}{hint}.")

    def _lines(self) -> Iterator[tuple[int, str]]:
        """Yield the lines with values and their numbers, checked to have as many as columns."""
        count = len(self.names)
        most = memory_limit() // (8 * count)
        with _opened(self.path, self.encoding) as stream:
            for number, line in enumerate(_bounded(self.path, stream), 1):
                if number < self.first or not line.strip() or line.startswith(_COMMENTS):
                    continue
                if number - self.first > most:
                    raise DataError(
                        f"{self.path}: has more than {most:,} rows, which do not fit the memory "
                        "limit for one log; cut it into parts, or thin it."
                    )
                plain = self.delimiter is not None and '"' not in line
                fields = line.split(self.delimiter) if plain else _fields(line, self.delimiter)
                held = len(fields)
                if held != count:
                    hint = "; repair or delete that line"
                    if self.delimiter == "," and held > count:
                        hint = "; where commas are decimal marks, separate columns by semicolons"
                    raise DataError(
                        f"{self.path}: line {number} has {held} values for {count} columns{hint}."
                    )
                # A point beside commas marks thousands: as a comma it is no part of a number.
                yield number, line.translate(_EXCHANGED) if self.comma else line


def _described(
    path: Path, encoding: str, kept: list[tuple[int, str]], comments: list[str]
) -> tuple[_Text, bool]:
    """Return the text that the first lines show, and whether its columns have no names."""
    head = kept[0][1]
    delimiter = _delimiter(head)
    names, unnamed = _fields(head, delimiter), False
    comma = delimiter != ","
    values = [_number(name, comma=comma) is not None for name in names]
    if all(values):
        # The first line holds values: names may stand in the last comment before.
        kept = [(0, ""), *kept]
        bare = comments[-1].lstrip("#%/ ") if comments else ""
        commented = _fields(bare, _delimiter(bare))
        unnamed = len(commented) != len(names)
        names = [str(k + 1) for k in range(len(names))] if unnamed else commented
    elif any(values):
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
    rows = [_fields(line, delimiter) for _, line in kept[1:]]
    if len(rows[0]) != len(names):
        raise DataError(
            f"{path}: {len(names)} column names for {len(rows[0])} values in line {kept[1][0]}."
        )
    comma = comma and any(_DECIMAL_COMMA.fullmatch(text) for row in rows for text in row)
    return _Text(path, encoding, names, delimiter, kept[1][0], comma), unnamed


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
        codecs.getincrementaldecoder("utf-8")().decode(start)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _bounded(path: Path, stream: TextIO) -> Iterator[str]:
    """Yield lines that are not endless."""
    while line := stream.readline(_LONGEST_LINE):
        if len(line) == _LONGEST_LINE:
            raise DataError(
                f"{path}: has a line of more than {_LONGEST_LINE:,} characters, which is no line "
                "of column names or of values."
            )
        yield line


def _delimiter(line: str) -> str | None:
    """Return what separates the fields of a line; None for blanks."""
    return next((mark for mark in ";\t," if mark in line), None)


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


def _number(text: str, comma: bool = False) -> float | None:
    """Return the number that a text is, if it is one."""
    if comma and _DECIMAL_COMMA.fullmatch(text):
        text = text.replace(",", ".")
    try:
        return float(text)
    except ValueError:
        return None
