"""What has changed between a table that is kept and the same table made anew."""

from __future__ import annotations

import re
from dataclasses import dataclass

from studies import Grid, Table

# A number within a cell: a sign, digits, a fraction, an exponent.
_NUMBER = re.compile(r"[-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?", re.IGNORECASE)


@dataclass(frozen=True)
class Change:
    """One cell, row or column that is another now."""

    where: str
    old: str
    new: str

    def __str__(self) -> str:
        return f"{self.where}: {self.old or '(nothing)'} → {self.new or '(nothing)'}"


def changes(table: Table, old: Grid, new: Grid) -> list[Change]:
    """Return what is beyond the table's tolerances; columns of times do not count."""
    if old.header != new.header:
        return [Change("columns", ", ".join(old.header), ", ".join(new.header))]
    before, after = _by_key(table, old), _by_key(table, new)
    found = [Change(key, "a row", "") for key in before if key not in after]
    found += [Change(key, "", "a row") for key in after if key not in before]
    for key in before:
        for column, was, now in zip(old.header, before[key], after.get(key, ()), strict=False):
            tolerance = table.tolerances.get(column, table.tolerance)
            if column not in table.time and not same(was, now, tolerance):
                found.append(Change(f"{key}, {column}", was, now))
    return found


def same(old: str, new: str, tolerance: float) -> bool:
    """Return whether two cells are the same text with numbers that differ by `tolerance` at most.

    The difference is relative to the smaller number; zero equals zero only.
    """
    if _NUMBER.sub("#", old) != _NUMBER.sub("#", new):
        return False
    pairs = zip(_numbers(old), _numbers(new), strict=True)
    return all(_near(was, now, tolerance) for was, now in pairs)


def _near(was: float, now: float, tolerance: float) -> bool:
    if was * now < 0.0:
        return False
    low, high = sorted((abs(was), abs(now)))
    return high - low <= tolerance * low


def _numbers(cell: str) -> list[float]:
    return [float(text.replace("−", "-")) for text in _NUMBER.findall(cell)]


def _by_key(table: Table, grid: Grid) -> dict[str, tuple[str, ...]]:
    """Return rows by their key; where keys repeat, or there is none, by their number too."""
    columns = [grid.column(name) for name in table.key]
    rows: dict[str, tuple[str, ...]] = {}
    for number, row in enumerate(grid.rows, 1):
        key = ", ".join(row[column] for column in columns)
        rows[f"row {number}" if not key else key if key not in rows else f"{key} ({number})"] = row
    return rows
