"""Clocks, and ratios of things that were timed side by side."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.tables import Table

# What is shorter than this (s) is called again until it is not: one tick of another process
# would be a large part of it.
LEAST = 0.02


@dataclass(frozen=True, kw_only=True)
class Row:
    """One line: median seconds, and the ratio to its reference with its spread."""

    what: str
    seconds: float
    ratio: float
    least: float
    most: float
    against: str
    against_seconds: float
    repeats: int
    gap: float | None = None
    violation: float | None = None
    status: str | None = None

    @classmethod
    def of(
        cls,
        what: str,
        seconds: Array,
        against: str,
        reference: Array,
        *,
        gap: float | None = None,
        violation: float | None = None,
        status: str | None = None,
    ) -> Row:
        """Build from the seconds of each repeat, those of the reference from the same ones."""
        ratios = seconds / reference
        return cls(
            what=what,
            seconds=float(np.median(seconds)),
            ratio=float(np.median(ratios)),
            least=float(ratios.min()),
            most=float(ratios.max()),
            against=against,
            against_seconds=float(np.median(reference)),
            repeats=len(ratios),
            gap=gap,
            violation=violation,
            status=status,
        )


def table(rows: Sequence[Row]) -> Table:
    """Return the rows as a table."""
    names = tuple(field.name for field in fields(Row))
    return Table(names, tuple(tuple(getattr(row, name) for name in names) for row in rows))


def print_table(program: str, measure: Callable[[int], Iterable[Row]]) -> int:
    """Print the rows of a benchmark, measured as often as its command line says."""
    parser = argparse.ArgumentParser(prog=f"python -m {program}")
    parser.add_argument("--repeat", type=int, default=5, help="at least 5 (default)")
    parser.add_argument("--csv", type=Path, help="write the table here as well")
    options = parser.parse_args()
    if options.repeat < 5:
        parser.error(f"--repeat: is {options.repeat}; at least 5 give a spread.")
    found = table(list(measure(options.repeat)))
    print(found.text(digits=3))
    if options.csv is not None:
        found.write(options.csv)
    return 0


def peak() -> int:
    """Return the most bytes that this process had in memory; `getrusage` says the parent's too."""
    for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) * 1024
    raise RuntimeError("/proc/self/status: has no VmHWM; this needs Linux.")


def clock(action: Callable[[], object]) -> float:
    """Return the seconds of one call, the mean of as many as take `LEAST` together."""
    calls, begin = 0, time.perf_counter()
    while True:
        action()
        calls += 1
        elapsed = time.perf_counter() - begin
        if elapsed >= LEAST:
            return elapsed / calls


def side_by_side(actions: Sequence[Callable[[], object]], repeats: int) -> Array:
    """Return the seconds (actions, repeats): all in turn in each repeat, each first in its turn.

    Each is called once before, so that imports and caches are not counted.
    """
    for action in actions:
        action()
    out = np.empty((len(actions), repeats))
    for repeat in range(repeats):
        for step in range(len(actions)):
            i = (repeat + step) % len(actions)
            out[i, repeat] = clock(actions[i])
    return out
