"""The studies behind these pages, the tables that are kept of them, and numbers from these tables.

studies.toml names every study with its command, and every table with the file that the command
writes, when it was made, at which commit and on which machine. The tables stand in
tables/<study>/<table>.csv.
"""

from __future__ import annotations

import csv
import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sdpid._common.files import load_toml

HERE = Path(__file__).resolve().parent

# Relative difference of two numbers that is no change where a table states no other.
TOLERANCE = 0.02
# A format at the end of a reference, such as .2f or .1%.
_FORMAT = re.compile(r"[,+]?(\.\d+)?[defg%]")
_REDUCED: Mapping[str, Callable[[list[float]], float]] = {
    "max": max,
    "min": min,
    "sum": sum,
    "count": lambda values: float(len(values)),
}


class EvidenceError(ValueError):
    """A table, row or column that does not exist, or is not the only one."""


@dataclass(frozen=True)
class Grid:
    """A table of texts: a header, and rows as long as it."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def column(self, name: str) -> int:
        """Return the number of a column.

        Raises
        ------
        EvidenceError
            When there is none of that name, or more than one.
        """
        if self.header.count(name) != 1:
            columns = ", ".join(self.header)
            raise EvidenceError(f"{self.header.count(name)} columns {name!r} among: {columns}.")
        return self.header.index(name)

    def where(self, chosen: Mapping[str, str]) -> tuple[tuple[str, ...], ...]:
        """Return the rows with the cells of `chosen`; without them where a name ends in !."""
        asked = [
            (self.column(name.rstrip("!")), text, name[-1] != "!") for name, text in chosen.items()
        ]
        return tuple(r for r in self.rows if all((r[c] == text) == yes for c, text, yes in asked))

    def write(self, path: Path) -> None:
        """Write as CSV."""
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([self.header, *self.rows])


@dataclass(frozen=True)
class Table:
    """One table that a study writes, and what is known of the copy that is kept.

    Attributes
    ----------
    file : str
        What the command writes, within its folder: a CSV file, or ``page.md#2`` for the second
        table of a Markdown file.
    key : tuple of str
        Columns that tell a row from the others; without any, rows are compared in their order.
    tolerance : float
        Relative difference of numbers that is no change; 9 lets them be ten times as large.
    tolerances : dict of str to float
        The same for some columns.
    time : tuple of str
        Columns of times, which are never compared.
    date, commit, machine, made : str
        When, of which commit, where and how the kept copy was made.
    """

    study: str
    name: str
    file: str
    path: Path
    key: tuple[str, ...] = ()
    tolerance: float = TOLERANCE
    tolerances: Mapping[str, float] = field(default_factory=dict)
    time: tuple[str, ...] = ()
    date: str = ""
    commit: str = ""
    machine: str = ""
    made: str = ""

    def read(self) -> Grid:
        """Return the kept copy."""
        return read_grid(self.path)


@dataclass(frozen=True)
class Study:
    """A command and the tables that it makes; ``{out}`` and ``{data}`` stand for folders."""

    name: str
    title: str
    command: str
    tables: Mapping[str, Table]
    page: str = ""
    minutes: float | None = None
    quick: str = "--quick"
    note: str = ""

    @property
    def needs_data(self) -> bool:
        """Whether the command reads the public records."""
        return "{data}" in self.command

    def shown_command(self) -> str:
        """Return the command as a reader would type it."""
        return self.command.format(out="results", data="DATA")


def load_studies(folder: Path = HERE) -> dict[str, Study]:
    """Return every study of a folder's studies.toml by name."""
    studies = {}
    for name, entry in load_toml(folder / "studies.toml").items():
        kept = {
            table: Table(
                study=name,
                name=table,
                path=folder / "tables" / name / f"{table}.csv",
                **{key: _frozen(value) for key, value in fields.items()},
            )
            for table, fields in entry.pop("tables").items()
        }
        studies[name] = Study(name=name, tables=kept, **entry)
    return studies


def find_table(studies: Mapping[str, Study], reference: str) -> Table:
    """Return the table of a reference ``study/table``.

    Raises
    ------
    EvidenceError
        When there is no such study or table.
    """
    study, _, table = reference.partition("/")
    if study not in studies:
        raise EvidenceError(f"{reference}: there is no study {study!r} in studies.toml.")
    if table not in studies[study].tables:
        known = ", ".join(studies[study].tables)
        raise EvidenceError(f"{reference}: study {study!r} has the tables {known}.")
    return studies[study].tables[table]


def measured(studies: Mapping[str, Study], reference: str) -> str:
    """Return a number as text: ``study/table column=cell ... column [format]``.

    The column may be ``max:column``, ``min:``, ``sum:`` or ``count:`` of it over the rows that are
    left, which without one of these must be one. ``column!=cell`` leaves rows out. Names with
    spaces stand in quotes.

    Raises
    ------
    EvidenceError
        When the table, the row or the column does not exist or is not the only one.
    """
    words = shlex.split(reference)
    spec = words.pop() if len(words) > 2 and _FORMAT.fullmatch(words[-1]) else ""
    chosen = dict(word.split("=", 1) for word in words[1:-1] if "=" in word)
    if len(words) < 2 or len(chosen) != len(words) - 2:
        raise EvidenceError(f"{reference}: want study/table column=cell ... column [format].")
    grid = find_table(studies, words[0]).read()
    reduce, _, column = (
        words[-1].rpartition(":") if words[-1] not in grid.header else ("", "", words[-1])
    )
    rows = grid.where(chosen)
    cells = [row[grid.column(column)] for row in rows]
    if reduce:
        return _formatted(_reduced(reference, reduce, cells), spec)
    if len(cells) != 1:
        raise EvidenceError(f"{reference}: {len(cells)} rows, not one.")
    return _formatted(cells[0], spec)


def _reduced(reference: str, reduce: str, cells: Sequence[str]) -> str:
    """Return what is left of several cells; empty ones do not count."""
    values = [float(cell) for cell in cells if cell]
    if reduce not in _REDUCED or not values:
        raise EvidenceError(f"{reference}: {reduce!r} of {len(values)} numbers.")
    return f"{_REDUCED[reduce](values):.15g}"


def _formatted(cell: str, spec: str) -> str:
    """Return a cell in a format, with a true minus sign and short exponents."""
    if spec.endswith("d"):
        text = format(int(float(cell)), spec)
    else:
        text = format(float(cell), spec) if spec else cell
    if spec.endswith("%"):
        text = f"{text[:-1]} %"
    text = re.sub(r"(?<=\d)e([-+])0*(?=\d)", lambda e: f"e{e[1].strip('+')}", text)
    return re.sub(r"^-(?=\d)", "−", text)


def shown(cell: str, spec: str = "") -> str:
    """Return a cell as pages show it: numbers with three digits where no format is given."""
    try:
        value = float(cell)
    except ValueError:
        return cell
    if spec or len(cell.lstrip("-").replace(".", "").lstrip("0")) > 4:
        return _formatted(
            cell, spec or (".3g" if value != int(value) or abs(value) > 1e6 else ".0f")
        )
    return _formatted(cell, "")


def read_grid(path: Path) -> Grid:
    """Return a CSV file, or the table of a Markdown file that ``page.md#2`` names.

    Raises
    ------
    EvidenceError
        When the file is missing, or has no such table.
    """
    name, _, number = path.name.partition("#")
    file = path.with_name(name)
    if not file.is_file():
        raise EvidenceError(f"{name} is missing.")
    if not number:
        with file.open(encoding="utf-8", newline="") as text:
            rows = [tuple(row) for row in csv.reader(text) if row]
        return Grid(rows[0], tuple(rows[1:]))
    found = list(markdown_tables(file.read_text(encoding="utf-8")))
    if not 1 <= int(number) <= len(found):
        raise EvidenceError(f"{name} has {len(found)} tables, not {number}.")
    return found[int(number) - 1]


def markdown_tables(text: str) -> Iterator[Grid]:
    """Yield the pipe tables of a Markdown text, emphasis left out."""
    lines: list[tuple[str, ...]] = []
    for line in [*text.splitlines(), ""]:
        if line.startswith("|"):
            cells = line.strip().strip("|").split("|") if line.count("|") > 1 else []
            lines.append(tuple(cell.strip().replace("**", "").replace("−", "-") for cell in cells))
        elif lines:
            yield Grid(lines[0], tuple(lines[2:]))
            lines = []


def _frozen(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value
