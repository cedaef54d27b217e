"""Text files of numbers: CSV and its kin, with or without a header, compressed or not.

A folder of such files without names is a log too: one matrix a quantity.
"""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import re
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property, partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.files import printable
from sdpid._common.sandbox import memory_limit
from sdpid.errors import DataError
from sdpid.experiment.readers.columns import LogTable, NoNumbersError
from sdpid.experiment.readers.names import unit_of
from sdpid.experiment.recording.stored import check_memory

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
_MISSING = (
    *("", "nan", "-nan", "na", "n/a", "null", "none"),
    *("-", "--", "#n/a", "1.#qnan", "-nan(ind)"),
)
_CASES = (str.lower, str.upper, str.title, lambda _: "NaN")
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+(?:[eE][-+]?\d+)?")
_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d.*")
# Integers from here on do not fit a double; they are read relative to the first one.
_BEYOND_DOUBLE = 10**15
# What reading damaged text or a damaged archive can raise.
_DAMAGE = (OSError, EOFError, UnicodeError, ValueError, zlib.error)
_SUFFIXES = (".dat", ".txt", ".csv", ".tsv")
# A number takes at least two bytes as text, and eight in an array.
_MOST_GROWTH = 4


def load_text(path: Path) -> LogTable:
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
    text = _Text(path)
    arrays = {name: partial(text.column, k) for k, name in enumerate(text.names) if name}
    return LogTable(arrays, place=text.place, unnamed=text.unnamed)


class _Lines(io.TextIOBase):
    """Lines as a file that pandas reads."""

    def __init__(self, lines: Iterator[str]) -> None:
        self._lines = lines

    def read(self, size: int | None = -1) -> str:
        return "".join(islice(self._lines, _AT_ONCE))


class _Text:
    """A text file: how its first lines say that it is written, and its values."""

    def __init__(self, path: Path) -> None:
        self.path, self.encoding = path, _encoding(path)
        lines = list(islice(enumerate(_lines(path, self.encoding), 1), _LOOKED_AT))
        kept = [(k, line) for k, line in lines if _is_row(line)]
        if any(ord(c) < ord(" ") and c not in "\t\r\n\f" for _, line in kept[:2] for c in line):
            raise DataError("the first line is no line of column names.")
        head = kept[0][1] if kept else ""
        self.delimiter = _delimiter(head)
        self.names, self.unnamed = _fields(head, self.delimiter), False
        # Where commas do not separate columns, they may be decimal marks.
        self.comma = self.delimiter != ","
        values = [self._number(name) is not None for name in self.names]
        if any(values) and not all(values):
            raise DataError(
                f"the first line must name the columns, but some of its fields are numbers "
                f"({printable(head.strip()[:60])})."
            )
        if any(values):
            # The first line holds values: names may stand in the last comment before.
            before = [line for k, line in lines if k < kept[0][0] and line.startswith(_COMMENTS)]
            bare = before[-1].lstrip("#%/ ") if before else ""
            named, count = _fields(bare, _delimiter(bare)), len(self.names)
            self.unnamed = len(named) != count
            self.names = [str(k + 1) for k in range(count)] if self.unnamed else named
        else:
            kept = kept[1:]
        rows = [_fields(line, self.delimiter) for _, line in kept]
        units = [text.strip("[]() ") for text in rows[0]] if rows else []
        known = [unit_of(unit) is not None for unit in units if unit]
        if known and all(known) and len(units) == len(self.names):
            # A line of units under the names.
            kept, rows = kept[1:], rows[1:]
            pairs = zip(self.names, units, strict=True)
            self.names = [f"{name} [{unit}]" if unit else name for name, unit in pairs]
        named = [name for name in self.names if name]
        if not rows or not named:
            raise DataError("has no header and no data.")
        if len(set(named)) != len(named):
            raise DataError(
                f"{len(named)} column names, {len(set(named))} of them distinct; every "
                "column needs a name of its own."
            )
        self._first = kept[0][0]
        if len(rows[0]) != len(self.names):
            raise DataError(
                f"{len(self.names)} column names for {len(rows[0])} values in line {self._first}."
            )
        marks = (_DECIMAL_COMMA.fullmatch(text) for row in rows for text in row)
        self.comma = self.comma and any(marks)

    def column(self, k: int) -> NDArray[Any]:
        """Return one column: numbers, or dates and times."""
        values = self._frame[k]
        if values.dtype.kind in "iu" and abs(int(values[0])) >= _BEYOND_DOUBLE:
            values = values - values[0]
        if values.dtype.kind not in "iuf":
            values = self._parsed(k, values.dropna().astype(str)).reindex(values.index)
        return np.asarray(values, dtype=None if values.dtype.kind == "M" else np.float64)

    def place(self, sample: int) -> str:
        """Return the line of a sample, counted from 1 as editors do."""
        return f"line {next(islice(self._rows(), sample, None))[0]}"

    @cached_property
    def _frame(self) -> Any:
        """All values as a data frame; columns that hold no plain numbers are texts."""
        import pandas as pd

        try:
            with warnings.catch_warnings():
                # Newer versions read all digits by default, and warn of the argument.
                warnings.simplefilter("ignore")
                return pd.read_csv(
                    _Lines(line for _, line in self._rows()),
                    sep=self.delimiter or r"\s+",
                    decimal="," if self.comma else ".",
                    header=None,
                    names=range(len(self.names)),
                    index_col=False,
                    na_values=[case(text) for text in _MISSING for case in _CASES],
                    keep_default_na=False,
                    skipinitialspace=True,
                    float_precision="round_trip",
                )
        except _DAMAGE as cause:
            raise DataError(f"cannot be read ({cause}).") from None

    def _parsed(self, k: int, texts: Any) -> Any:
        """Return texts as numbers, or as dates and times in UTC."""
        import pandas as pd

        texts, kind = texts.str.strip(), "a number"
        if all(map(_DATE.fullmatch, texts[:_LOOKED_AT])):
            kind, iso = "a date and time", texts.str.removesuffix("UTC").str.strip()
            iso = iso.str.replace(",", ".", regex=False)
            stamps = pd.to_datetime(iso, utc=True, format="ISO8601", errors="coerce")
            parsed = stamps.dt.tz_localize(None)
        else:
            parsed = texts.map(self._number).astype(float)
            if self.comma:
                # A point beside commas marks thousands, and is no part of a number.
                parsed = parsed.mask(texts.str.contains(".", regex=False))
        bad = parsed.isna()
        if not bad.any():
            return parsed
        sample, name = int(texts.index[bad][0]), printable(self.names[k])
        word = texts[sample]
        said = f"{self.place(sample)}: '{name}' holds '{printable(word[:40])}'"
        if bad[:_LOOKED_AT].all():
            raise NoNumbersError(f"{said}, not {kind}.")
        if self.comma and "." in word:
            raise DataError(f"{said} where other decimals have commas.")
        hint = "; decimals need a point" if _DECIMAL_COMMA.fullmatch(word) else ""
        raise DataError(f"{said}, not {kind}{hint}.")

    def _number(self, text: str) -> float | None:
        """Return the number that a text is, if it is one."""
        if self.comma and _DECIMAL_COMMA.fullmatch(text):
            text = text.replace(",", ".")
        try:
            return float(text)
        except ValueError:
            return None

    def _rows(self) -> Iterator[tuple[int, str]]:
        """Yield the lines with values and their numbers, checked to have as many as columns."""
        count, delimiter = len(self.names), self.delimiter
        most = memory_limit() // (8 * count)
        for number, line in enumerate(_lines(self.path, self.encoding), 1):
            if number < self._first or not _is_row(line):
                continue
            if number - self._first > most:
                raise DataError(
                    f"has more than {most:,} rows, which do not fit the memory "
                    "limit for one log; cut it into parts, or thin it."
                )
            if delimiter is None or '"' in line:
                held = len(_fields(line, delimiter))
            else:
                held = line.count(delimiter) + 1
            if held != count:
                hint = "; repair or delete that line"
                if delimiter == "," and held > count:
                    hint = "; where commas are decimal marks, separate columns by semicolons"
                raise DataError(f"line {number} has {held} values for {count} columns{hint}.")
            yield number, line


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a text file, compressed or not, as bytes."""
    unpack: Any = gzip.open if path.suffix.lower() == ".gz" else open
    try:
        with unpack(path, "rb") as stream:
            yield stream
    except _DAMAGE as cause:
        raise DataError(f"not a readable text file ({cause}).") from None


def _encoding(path: Path) -> str:
    """Return UTF-8 or UTF-16 where the bytes are such, else what Windows writes."""
    with _opened(path) as stream:
        start = stream.read(_SNIFFED)
    if start.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    try:
        # A character may be cut at the end.
        codecs.getincrementaldecoder("utf-8")().decode(start)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _lines(path: Path, encoding: str) -> Iterator[str]:
    """Yield lines that are not endless."""
    with _opened(path) as raw:
        stream = io.TextIOWrapper(raw, encoding=encoding, errors="replace", newline="")
        for line in iter(partial(stream.readline, _LONGEST_LINE), ""):
            if len(line) == _LONGEST_LINE:
                raise DataError(
                    f"has a line of more than {_LONGEST_LINE:,} characters, which is no line of "
                    "column names or of values."
                )
            yield line


def _is_row(line: str) -> bool:
    """Tell whether a line is neither blank nor a comment."""
    return not (line.isspace() or line.startswith(_COMMENTS))


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


def is_folder_of_matrices(folder: Path) -> bool:
    """Tell whether a folder holds text files that may be matrices."""
    return any(path.suffix.lower() in _SUFFIXES for path in folder.iterdir())


def load_matrices(folder: Path) -> LogTable:
    """List the text matrices of a folder, by the names of their files.

    The longer side of each matrix is time, whichever way it is written.

    Raises
    ------
    DataError
        When two files have the same name but for their suffix.
    """
    files: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in _SUFFIXES or not path.is_file():
            continue
        name = printable(path.stem)
        if name in files:
            raise DataError(f"{files[name].name} and {path.name} have the same name.")
        files[name] = path
    return LogTable({name: partial(_matrix, path) for name, path in files.items()})


def _matrix(path: Path) -> NDArray[Any]:
    """Return samples × channels of one file."""
    # A row may hold a channel, and be as long as the log.
    check_memory(path, _MOST_GROWTH * path.stat().st_size)
    try:
        with path.open(encoding="utf-8") as stream:
            delimiter = _delimiter(stream.read(_SNIFFED))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # An empty file is refused below.
            matrix = np.loadtxt(path, delimiter=delimiter, ndmin=2, encoding="utf-8")
    except (OSError, ValueError) as cause:
        line = (str(cause).splitlines() or [type(cause).__name__])[0]
        raise DataError(f"{path}: is no matrix of numbers ({printable(line)}).") from None
    rows, columns = matrix.shape
    if not matrix.size:
        raise DataError(f"{path}: is no matrix of numbers (it holds none).")
    if rows == columns:
        raise DataError(
            f"{path}: is {rows} × {columns} numbers, so that it is not known which side is time."
        )
    return np.ascontiguousarray(matrix.T) if columns > rows else matrix
