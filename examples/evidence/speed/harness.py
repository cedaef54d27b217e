"""How everything here is timed: in turn with what it is compared with, as ratios.

A part is a function of a `Bench`. It yields rows, or returns a table of its own.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.tables import Table

HERE = Path(__file__).resolve().parent

# What is shorter than this (s) is called again until it is not: one tick of another process
# would be a large part of it.
LEAST = 0.02

T = TypeVar("T")


@dataclass(frozen=True)
class Bench:
    """How often things are measured and how large they are.

    Attributes
    ----------
    repeats : int
        How often.
    quick : bool
        Whether all is small, to see that it runs.
    data : Path, optional
        The folder of the public records.
    figaroh_python : str, optional
        The interpreter of an environment with FIGAROH.
    before : Path, optional
        A checkout of earlier code, which commands are compared with.
    """

    repeats: int
    quick: bool = False
    data: Path | None = None
    figaroh_python: str | None = None
    before: Path | None = None

    def size(self, full: T, small: T) -> T:
        """Return a size: the full one, or a small one."""
        return small if self.quick else full

    def in_turn(self, actions: Mapping[str, Callable[[], T]]) -> dict[str, list[T]]:
        """Return what each action returned in each repeat: all in turn, each first in its turn.

        Each is called once before, so that imports and caches are not counted.
        """
        if not self.quick:
            for action in actions.values():
                action()
        names = list(actions)
        found: dict[str, list[T]] = {name: [] for name in names}
        for repeat in range(self.repeats):
            first = repeat % len(names)
            for name in names[first:] + names[:first]:
                found[name].append(actions[name]())
        return found

    def seconds(self, **actions: Callable[[], object]) -> dict[str, Array]:
        """Return the seconds of each action in each repeat."""

        def clock(action: Callable[[], object]) -> Callable[[], float]:
            return lambda: timed(action, LEAST)[0]

        found = self.in_turn({name: clock(action) for name, action in actions.items()})
        return {name: np.array(each) for name, each in found.items()}


def timed(action: Callable[[], T], least: float = 0.0) -> tuple[float, T]:
    """Return the result of a call, after its seconds: the mean of as many as take `least`."""
    calls, begin = 0, time.perf_counter()
    while True:
        found = action()
        calls += 1
        elapsed = time.perf_counter() - begin
        if elapsed >= least:
            return elapsed / calls, found


class Laps:
    """Seconds on the clock and of the processor (2,), stage by stage."""

    def __init__(self) -> None:
        self.stages: dict[str, list[float]] = {}
        self._last = np.array([time.perf_counter(), time.process_time()])

    def end(self, stage: str) -> None:
        """End a stage."""
        now = np.array([time.perf_counter(), time.process_time()])
        self.stages[stage] = (now - self._last).tolist()
        self._last = now


def peak() -> int:
    """Return the most bytes that this process had in memory; `getrusage` says the parent's too."""
    for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) * 1024
    raise RuntimeError("/proc/self/status: has no VmHWM; this needs Linux.")


def apart(
    function: Callable[..., T],
    *arguments: object,
    python: str = sys.executable,
    environment: Mapping[str, str] | None = None,
) -> T:
    """Return what a function of a module here returns in a fresh process, by way of JSON.

    Linear algebra has one thread there, unless the environment says otherwise. Another interpreter
    finds nothing but its own libraries and this folder, which comes last.
    """
    module, name = Path(function.__code__.co_filename).stem, function.__name__
    code = (
        f"import json, sys; sys.path.append({str(HERE)!r}); import {module}; "
        f"print(json.dumps({module}.{name}(*json.loads(sys.argv[1]))))"
    )
    one_thread = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    alone = ["-I"] if python != sys.executable else []
    done = subprocess.run(
        [python, *alone, "-c", code, json.dumps(arguments)],
        capture_output=True,
        text=True,
        check=False,
        env=one_thread | dict(os.environ) | dict(environment or {}),
    )
    if done.returncode:
        raise SystemExit(f"{module}.{name} failed in {python}:\n{done.stderr}")
    found: T = json.loads(done.stdout.splitlines()[-1])
    return found


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
    def of(cls, what: str, seconds: Array, against: str, reference: Array, **facts: Any) -> Row:
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
            **facts,
        )


def table(rows: Sequence[Row]) -> Table:
    """Return the rows as a table."""
    names = tuple(field.name for field in fields(Row))
    return Table(names, tuple(tuple(getattr(row, name) for name in names) for row in rows))
