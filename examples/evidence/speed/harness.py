"""How everything here is timed: in turn with what it is compared with, as ratios.

A part is a function of a `Bench`. It yields rows of `RATIOS`, or returns a table of its own.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

# Rows are written by a study, and some samples and small problems are those of the tests.
sys.path.append(str(Path(__file__).resolve().parents[1]))
sys.path.append(str(Path(__file__).resolve().parents[3]))

from study import Study

HERE = Path(__file__).resolve().parent
# What is shorter than this (s) is called again until it is not: one tick of another process
# would be a large part of it.
LEAST = 0.02
ONE_THREAD = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)  # fmt: skip
RATIOS = ("what", "ratio", "least", "most", "against", "seconds")

T = TypeVar("T")


class Bench(Study):
    """Measurements: their options are how often, how large, and what they are compared with."""

    def size(self, full: T, small: T) -> T:
        """Return a size: the full one, or a small one to see that all runs."""
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
        for repeat in range(self.repeat):
            first = repeat % len(names)
            for name in names[first:] + names[:first]:
                found[name].append(actions[name]())
        return found

    def seconds(self, **actions: Callable[[], object]) -> dict[str, np.ndarray]:
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


def ratio(what: str, seconds: Any, against: str, reference: Any) -> tuple[object, ...]:
    """Return a row: the ratio to a reference, from the seconds of each repeat, and its spread."""
    ratios = seconds / reference
    spread = np.median(ratios), ratios.min(), ratios.max()
    return what, *spread, against, np.median(seconds)


class Laps:
    """Seconds on the clock, stage by stage."""

    def __init__(self) -> None:
        self.stages: dict[str, float] = {}
        self._last = time.perf_counter()

    def end(self, stage: str) -> None:
        """End a stage."""
        now = time.perf_counter()
        self.stages[stage], self._last = now - self._last, now


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
