"""How a study runs: its options, its cases one after the other, its tables.

A study says its options by their defaults, and yields the rows of one case at a time:

    study = Study(__doc__, quick={"seeds": 1}, seeds=(40, "simulated arms"))
    study.rows("errors.csv", ("seed", "error"), range(study.seeds), rows_of)

The rows of every case are kept beside the tables as they come, so that a study which was stopped
goes on where it was; those of cases that it has are not computed again with the same options.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from joblib import Parallel, delayed

from sdpid._common.progress import progress
from sdpid._common.tables import Table, plain

Case = TypeVar("Case")
Row = Sequence[object]


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
        cases: Iterable[Case],
        rows_of: Callable[[Case], Iterable[Row]],
        *,
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
        cases : iterable
            What is run one after the other; known again by their text.
        rows_of : callable
            Yields the rows of a case.
        digits : int, optional
            To which numbers are rounded; by default to none.
        jobs : int, optional
            How many run at a time.
        """
        kept, wanted = self.out / f"{file}.cases.jsonl", list(cases)
        asked = json.dumps({k: str(v) for k, v in vars(self).items() if k != "out"})
        done: dict[str, list[Row]] = {}
        if kept.is_file() and kept.read_text(encoding="utf-8").startswith(f"{asked}\n"):
            done = dict(map(json.loads, kept.read_text(encoding="utf-8").splitlines()[1:]))
        else:
            kept.write_text(f"{asked}\n", encoding="utf-8")
        left = [case for case in wanted if str(case) not in done]
        work = Parallel(n_jobs=jobs, return_as="generator")(
            delayed(_rows)(rows_of, case) for case in left
        )
        with progress(len(left), file) as advance, kept.open("a", encoding="utf-8") as lines:
            for case, found in zip(left, work, strict=True):
                done[str(case)] = found
                print(json.dumps([str(case), found]), file=lines, flush=True)
                for row in found:
                    print(*row, flush=True)
                advance(1)
        rows = [row for case in wanted for row in done[str(case)]]
        self.write(file, columns, rows, digits=digits)
        return [dict(zip(columns, row, strict=True)) for row in rows]

    def write(
        self, file: str, columns: Sequence[str], rows: Iterable[Row], digits: int | None = None
    ) -> None:
        """Write a table and print it."""
        cells = (map(_rounded(digits), plain(list(row))) for row in rows)
        table = Table(tuple(columns), tuple(map(tuple, cells)))
        table.write(self.out / file)
        print(f"\n{file}\n{table.text()}", flush=True)


def _rounded(digits: int | None) -> Callable[[object], object]:
    """Return what rounds numbers to so many digits."""
    return lambda cell: float(f"{cell:.{digits}g}") if digits and isinstance(cell, float) else cell


def _rows(rows_of: Callable[[Case], Iterable[Row]], case: Case) -> list[Row]:
    return [plain(list(row)) for row in rows_of(case)]


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
        yield key, {name: np.array([_number(row[name]) for row in own]) for name in own[0]}


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


def _number(value: object) -> object:
    return np.nan if value is None else value
