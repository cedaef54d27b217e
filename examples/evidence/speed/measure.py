"""Measure; nothing is asserted.

    python examples/evidence/speed/measure.py [--parts PART ...] [--repeat 5] --out results

Times depend on the machine, so all are ratios to a reference timed in the same repeat: the
median over the repeats, and the smallest and the largest. Linear algebra has as many threads as
OPENBLAS_NUM_THREADS says. Each part writes a table of its name. Without a part all are measured,
FIGAROH where an environment with it is given.
"""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Callable, Iterable
from importlib.metadata import version
from pathlib import Path

# Some samples and small problems are those of the tests.
sys.path += map(str, (Path(__file__).resolve().parents[k] for k in (1, 3)))

import commands
import contacts
import fleet
import kernels
import peers
import resolves
import small_problems
import solvers
import whole_job
from harness import Bench, Row, table
from study import Study

from sdpid._common.tables import Table

PARTS: dict[str, Callable[[Bench], Iterable[Row] | Table]] = {
    "kernels": kernels.measure,
    "contacts": contacts.measure,
    "solvers": solvers.measure,
    "resolves": resolves.measure,
    "job": whole_job.measure,
    "commands": commands.measure,
    "hour": fleet.hour,
    "cluster": fleet.scaling,
    "small_problems": small_problems.measure,
    "peers": peers.measure,
}


def main() -> None:
    """Measure parts, and print and write their tables."""
    study = Study(
        __doc__,
        data=True,
        quick={"repeat": 1},
        parts=([*PARTS], "what is measured"),
        repeat=(5, "fewer have no spread worth printing"),
        figaroh_python=(None, "interpreter of an environment with figaroh"),
        before=(None, "checkout of earlier code, for commands"),
    )
    before = study.before and Path(study.before)
    data = study.data if study.data.is_dir() else None
    bench = Bench(study.repeat, study.quick, data, study.figaroh_python, before)
    libraries = ("numpy", "scipy", "pin", "clarabel", "numba")
    used = ", ".join(f"{name} {version(name)}" for name in libraries)
    threads = os.environ.get("OPENBLAS_NUM_THREADS", "?")
    print(f"Python {platform.python_version()} on {platform.machine()}, {used}")
    print(f"{os.cpu_count()} cores, OpenBLAS threads {threads}, {study.repeat} repeats")
    for name in study.parts:
        found = PARTS[name](bench)
        result = found if isinstance(found, Table) else table(list(found))
        if result.rows:
            study.write(f"{name}.csv", result.header, result.rows)


if __name__ == "__main__":
    main()
