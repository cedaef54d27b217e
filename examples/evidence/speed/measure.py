"""Measure; nothing is asserted.

    python examples/evidence/speed/measure.py [--parts PART ...] [--repeat 5] --out results

Times depend on the machine, so all are ratios to a reference timed in the same repeat: the
median over the repeats, and the smallest and the largest. Linear algebra has as many threads as
OPENBLAS_NUM_THREADS says. Each part writes a table of its name. Without a part all are measured.
Other tools' times are in docs/evidence/benchmark.md.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterable
from importlib.metadata import version

import commands
import jobs
import kernels
import solvers
from harness import RATIOS, Bench

from sdpid._common.tables import Table

PARTS: dict[str, Callable[[Bench], Iterable[tuple[object, ...]] | Table]] = {
    "kernels": kernels.measure,
    "contacts": kernels.contacts,
    "solvers": solvers.measure,
    "job": jobs.whole,
    "commands": commands.measure,
    "hour": jobs.hour,
    "cluster": jobs.scaling,
    "small_problems": solvers.small_problems,
}


def main() -> None:
    """Measure parts, and print and write their tables."""
    bench = Bench(
        __doc__,
        data=True,
        quick={"repeat": 1},
        parts=([*PARTS], "what is measured"),
        repeat=(5, "fewer have no spread worth printing"),
        before=(None, "checkout of earlier code, for commands"),
    )
    libraries = ("numpy", "scipy", "pin", "clarabel", "numba")
    used = ", ".join(f"{name} {version(name)}" for name in libraries)
    threads = os.environ.get("OPENBLAS_NUM_THREADS", "?")
    print(f"Python {platform.python_version()} on {platform.machine()}, {used}")
    print(f"{os.cpu_count()} cores, OpenBLAS threads {threads}, {bench.repeat} repeats")
    for name in bench.parts:
        found = PARTS[name](bench)
        result = found if isinstance(found, Table) else Table(RATIOS, tuple(found))
        if result.rows:
            bench.write(f"{name}.csv", result.header, result.rows)


if __name__ == "__main__":
    main()
