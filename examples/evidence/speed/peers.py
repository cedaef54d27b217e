"""From a log to a result, beside FIGAROH: the record of a Staubli TX40 (docs/evidence/data.md).

FIGAROH needs an environment of its own (``pip install figaroh==1.0.2``). Both sides read the same
24750 rows from the NPZ and the robot from the same URDF, and every measurement is a fresh process;
the sides take turns. sdpid's job ends with a certified optimum of the semidefinite program, with
its default settings and the terms of this robot's drives (`sdpid, identify` adds the unconstrained
fit, intervals of all parameters, and residuals); FIGAROH's ends with its unconstrained fit and its
own report of it, with the settings of its example for this robot (sides.py).

FIGAROH 1.0.2 looks at its fit again at the end, with a regressor that it builds without the
columns of the wrist, and fails there. That step is left out where they are present, to FIGAROH's
advantage; as a third way, its fit runs as it is without those columns (`FIGAROH, without the
wrist`), which costs accuracy at joints 5 and 6.

Four times are compared: the second job in a process (nothing is imported or loaded for the first
time), on the clock and of the processor; the first job (what is imported on first use counts); and
from the start of the process to the first result (interpreter and imports count).
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from harness import Bench, Row, apart
from sides import SIDES, twice

TIMES = {
    "second": "second job in a process",
    "processor": "second job, processor time",
    "first": "first job in a process",
    "whole": "start of the process to the result",
}


def measure(bench: Bench) -> Iterator[Row]:
    """Yield the others' times as ratios to sdpid's."""
    if bench.figaroh_python is None or bench.data is None:
        print("left out: needs --figaroh-python and --data")
        return
    folder = bench.data / "staubli_tx40"
    files = [str(folder / "tx40_rows_0_24750.npz"), str(folder / "tx40.urdf")]

    def side(name: str) -> dict[str, Any]:
        python = sys.executable if "sdpid" in name else bench.figaroh_python
        return apart(twice, name, time.time(), *files, python=python)

    # Once before: numba compiles into its cache, and files are read from disk.
    found = bench.in_turn({name: partial(side, name) for name in SIDES})
    for name, runs in found.items():
        print(name, *(f"{library} {number}" for library, number in runs[0]["versions"].items()))
    ours = found.pop("sdpid")
    for name, runs in found.items():
        for key, what in TIMES.items():
            seconds, reference = (np.array([run[key] for run in each]) for each in (runs, ours))
            yield Row.of(f"{name}: {what}", seconds, "sdpid, certified", reference)
