"""Measure; nothing is asserted.

    python examples/evidence/speed/measure.py [PART ...] [--repeat 5] --out results

Times depend on the machine, so all are ratios to a reference timed in the same repeat: the
median over the repeats, and the smallest and the largest. Linear algebra has as many threads as
OPENBLAS_NUM_THREADS says. Each part writes a table of its name. Without a part all are measured,
FIGAROH where an environment with it is given.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
from collections.abc import Callable, Iterable
from importlib.metadata import version
from pathlib import Path

# Some samples and small problems are those of the tests.
sys.path.append(str(Path(__file__).resolve().parents[3]))

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

from sdpid._common.tables import Table

# Fewer have no spread worth printing.
LEAST_REPEATS = 5

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


def main() -> int:
    """Measure parts, and print and write their tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("part", nargs="*", help=f"of {', '.join(PARTS)} (default all)")
    parser.add_argument("--repeat", type=int, default=LEAST_REPEATS, help="at least 5 (default)")
    parser.add_argument("--quick", action="store_true", help="once, and all small")
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--data", type=Path, default=os.environ.get("SDPID_DATA"))
    parser.add_argument("--figaroh-python", help="interpreter of an environment with figaroh")
    parser.add_argument("--before", type=Path, help="checkout of earlier code, for commands")
    options = parser.parse_args()
    if unknown := set(options.part) - set(PARTS):
        parser.error(f"no part {', '.join(sorted(unknown))}; there are {', '.join(PARTS)}.")
    if options.repeat < LEAST_REPEATS:
        parser.error(f"--repeat: is {options.repeat}; at least {LEAST_REPEATS} give a spread.")
    repeats = 1 if options.quick else options.repeat
    bench = Bench(repeats, options.quick, options.data, options.figaroh_python, options.before)
    libraries = ("numpy", "scipy", "pin", "clarabel", "numba")
    used = ", ".join(f"{name} {version(name)}" for name in libraries)
    threads = os.environ.get("OPENBLAS_NUM_THREADS", "?")
    print(f"Python {platform.python_version()} on {platform.machine()}, {used}")
    print(f"{os.cpu_count()} cores, OpenBLAS threads {threads}, {repeats} repeats")
    options.out.mkdir(parents=True, exist_ok=True)
    for name in options.part or PARTS:
        print(f"\n{name}", flush=True)
        found = PARTS[name](bench)
        result = found if isinstance(found, Table) else table(list(found))
        if result.rows:
            print(result.text(digits=3), flush=True)
            result.write(options.out / f"{name}.csv")
    return 0


if __name__ == "__main__":
    sys.exit(main())
