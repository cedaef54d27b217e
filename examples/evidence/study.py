"""How a study runs: its options, its cases one after the other, its tables.

A study says its options by their defaults, and yields the rows of one case at a time:

    study = Study(__doc__, quick={"seeds": 1}, seeds=(40, "simulated arms"), robots=[*ROBOTS])
    found = study.rows(
        "each.csv", ("robot", "seed", "error"), errors_of, study.robots, range(study.seeds)
    )
    study.summary("errors.csv", found, ("robot",), {"median": "median error", "worst": "max error"})

The rows of every case are kept beside the tables as they come, so that a study which was stopped
goes on where it was; those of cases that it has are not computed again with the same options.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from sdpid._common.progress import progress
from sdpid._common.tables import Table, plain

# What a case yields: rows, in the order of the table's columns.
Rows = Iterator[Sequence[object]]

# What a summary says of the numbers of a group, those that are missing left away.
SUMMARIES: dict[str, Callable[[np.ndarray], object]] = {
    "count": len,
    "sum": np.sum,
    "min": np.min,
    "max": np.max,
    "mean": np.mean,
    "median": np.median,
    "percent": lambda values: 100.0 * np.mean(values),
}


class Study:
    """A study with what was asked of it: its options are attributes.

    Parameters
    ----------
    doc : str
        The docstring of its module, whose first line is shown by ``--help``.
    quick : mapping, optional
        Values of options with ``--quick``, which shows that the study runs.
    data : bool, optional
        Whether it reads public records, whose folder is `data`: ``--data``, or `SDPID_DATA`.
    **options : object or (object, str)
        Further options: defaults, and their help. A list takes any number of values, False is a
        switch.
    """

    out: Path
    data: Path
    quick: bool

    def __init__(
        self,
        doc: str | None,
        *,
        quick: Mapping[str, object] | None = None,
        data: bool = False,
        **options: Any,
    ) -> None:
        parser = argparse.ArgumentParser(description=(doc or "").splitlines()[0])
        parser.add_argument("--out", type=Path, default=Path("results"), help="folder of tables")
        parser.add_argument("--quick", action="store_true", help="small, to see that it runs")
        if data:
            folder = os.environ.get("SDPID_DATA", "../shared/data")
            parser.add_argument("--data", type=Path, default=folder, help="of public records")
        for name, given in options.items():
            default, text = given if isinstance(given, tuple) else (given, None)
            how: dict[str, Any] = {"default": default, "help": text}
            if default is False:
                how["action"] = "store_true"
            elif isinstance(default, list):
                how |= {"nargs": "*", "type": type(default[0]) if default else str}
            elif default is not None:
                how["type"] = type(default)
            parser.add_argument(f"--{name.replace('_', '-')}", **how)
        asked = parser.parse_args()
        if asked.quick:
            # What is named beside --quick is kept.
            parser.set_defaults(**(quick or {}))
            asked = parser.parse_args()
        vars(self).update(vars(asked))
        self.out.mkdir(parents=True, exist_ok=True)

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"the study has no option {name!r}")

    def rows(
        self,
        file: str,
        columns: Sequence[str],
        rows_of: Callable[..., Iterable[Sequence[object]]],
        *axes: Iterable[Any],
        digits: int | None = None,
        jobs: int = 1,
    ) -> list[dict[str, Any]]:
        """Write the rows of all cases as a table, and return them by the names of columns.

        Parameters
        ----------
        file : str
            Of the table.
        columns : sequence of str
            Its header.
        rows_of : callable
            Yields the rows of a case. Rows that are too short begin with their case.
        *axes : iterable
            Arguments of `rows_of`, of which each with each is a case, one after the other; a tuple
            stands for several. Cases are known again by their text.
        digits : int, optional
            To which numbers are rounded; by default to none.
        jobs : int, optional
            How many run at a time.
        """
        kept, wanted = self.out / f"{file}.cases.jsonl", dict[str, tuple[Any, ...]]()
        for each in itertools.product(*axes):
            case = tuple(x for part in each for x in (part if isinstance(part, tuple) else [part]))
            wanted[", ".join(map(str, case))] = case
        asked = json.dumps({k: str(v) for k, v in vars(self).items() if k != "out"})
        done: dict[str, list[Sequence[object]]] = {}
        if kept.is_file() and kept.read_text(encoding="utf-8").startswith(f"{asked}\n"):
            done = dict(map(json.loads, kept.read_text(encoding="utf-8").splitlines()[1:]))
        else:
            kept.write_text(f"{asked}\n", encoding="utf-8")
        left = [name for name in wanted if name not in done]
        work = Parallel(n_jobs=jobs, return_as="generator")(
            delayed(_rows)(rows_of, wanted[name], len(columns)) for name in left
        )
        with progress(len(left), file) as advance, kept.open("a", encoding="utf-8") as lines:
            for name, found in zip(left, work, strict=True):
                done[name] = found
                print(json.dumps([name, found]), file=lines, flush=True)
                for row in found:
                    print(*row, flush=True)
                advance(1)
        rows = [row for name in wanted for row in done[name]]
        return self.write(file, columns, rows, digits)

    def summary(
        self,
        file: str,
        rows: Iterable[Mapping[str, Any]],
        by: Sequence[str],
        columns: Mapping[str, str | Callable[[dict[str, Any]], object]],
        digits: int | None = None,
    ) -> list[dict[str, Any]]:
        """Write a row for each group of rows that are the same in the columns `by`.

        Further columns are one of `SUMMARIES` of a column (``"median error"``), or a function of
        the group's columns.
        """
        found = [
            (*key, *(_told(own, how) for how in columns.values()))
            for key, own in grouped(rows, *by)
        ]
        return self.write(file, (*by, *columns), found, digits)

    def write(
        self,
        file: str,
        columns: Sequence[str],
        rows: Iterable[Sequence[object]],
        digits: int | None = None,
    ) -> list[dict[str, Any]]:
        """Write a table, print it, and return its rows by the names of columns, not rounded."""
        lines = [plain(list(row)) for row in rows]
        shown = (tuple(_rounded(cell, digits) for cell in line) for line in lines)
        table = Table(tuple(columns), tuple(shown))
        table.write(self.out / file)
        print(f"\n{file}\n{table.text()}", flush=True)
        return [dict(zip(columns, line, strict=True)) for line in lines]


def _rounded(cell: object, digits: int | None) -> object:
    """Return a number to so many digits."""
    return float(f"{cell:.{digits}g}") if digits and isinstance(cell, float) else cell


def _rows(
    rows_of: Callable[..., Iterable[Sequence[object]]], case: tuple[Any, ...], width: int
) -> list[Sequence[object]]:
    """Return the rows of a case, which stands before those that are too short."""
    named = [each if isinstance(each, (bool, int, float, str)) else str(each) for each in case]
    return [[*named[: width - len(row)], *plain(list(row))] for row in map(list, rows_of(*case))]


def grouped(
    rows: Iterable[Mapping[str, Any]], *names: str
) -> Iterator[tuple[tuple[Any, ...], dict[str, Any]]]:
    """Yield the rows that have the same values of some columns: these values, and the columns.

    Columns of numbers are arrays; what is missing is NaN.
    """
    groups: dict[tuple[Any, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault(tuple(row[name] for name in names), []).append(row)
    for key, own in groups.items():
        yield (
            key,
            {
                name: np.array([np.nan if row[name] is None else row[name] for row in own])
                for name in own[0]
            },
        )


def known(values: np.ndarray) -> np.ndarray:
    """Return the numbers that are not missing."""
    values = values.astype(float) if values.dtype == object else values
    return values[~np.isnan(values)] if values.dtype.kind == "f" else values


def _told(own: dict[str, Any], how: str | Callable[[dict[str, Any]], object]) -> object:
    """Return what a summary says of a group, or nothing where nothing is known."""
    if callable(how):
        return how(own)
    kind, _, name = how.partition(" ")
    values = known(own[name])
    return SUMMARIES[kind](values) if kind == "count" or len(values) else None


def pivot(
    rows: Iterable[Mapping[str, Any]], line: str, column: str, cell: Callable[..., object]
) -> tuple[list[str], list[list[object]]]:
    """Return header and rows of a table with a line and a column for each value of two columns.

    A cell is made of its row, and empty where there is none.
    """
    found = {(row[line], row[column]): cell(row) for row in rows}
    columns = [*dict.fromkeys(each for _, each in found)]
    lines = [*dict.fromkeys(each for each, _ in found)]
    return [line, *columns], [[each, *(found.get((each, c)) for c in columns)] for each in lines]
