"""How far the costs of rows that are made again are from the first, and how long that takes.

Every record of docs/evidence/data.md with default settings: made again on the same processor, by
the kernels of another one, and of a log of which one effort is changed by 0.1 %.

    python examples/evidence/replay.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from data_sets import ROBOTS, SETS

import sdpid
from sdpid._common.tables import Table

QUICK = ("panda_unisa",)
HEADER = (
    *("log", "rows", "same", "other", "changed"),
    *("passed", "identify_cpu_s", "verify_cpu_s", "times"),
)

# Kernels that every x86 has, and no recent one takes.
OTHER = "Nehalem"
ELSEWHERE = (
    "import sys, sdpid; print(sdpid.verify(sys.argv[1], data=sys.argv[2], robot=sys.argv[3])"
    ".log.distance)"
)


def row(robot: Path, path: Path, name: str) -> tuple[object, ...]:
    """Return the numbers of one record."""
    # Libraries and compiled kernels are loaded before times are taken.
    sdpid.identify(robot, path, effects="none")
    start = time.process_time()
    result = sdpid.identify(robot, path)
    identified = time.process_time() - start
    with tempfile.TemporaryDirectory() as folder:
        result.save(folder, figures=False)
        start = time.process_time()
        found = sdpid.verify(folder, data=path, robot=robot)
        verified = time.process_time() - start
        for problem in found.problems:
            print(problem, flush=True)
        command = [sys.executable, "-c", ELSEWHERE, folder, str(path), str(robot)]
        environment = {**os.environ, "OPENBLAS_CORETYPE": OTHER}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        log = sdpid.read_recording(path)
        effort = np.array(log.effort)
        at = np.unravel_index(np.argmax(np.abs(effort)), effort.shape)
        effort[at] *= 1.001
        changed = sdpid.verify(folder, data=replace(log, effort=effort), robot=robot)
    assert found.log is not None
    assert changed.log is not None
    return (
        name,
        result.problem.n_rows,
        found.log.distance,
        float(done.stdout),
        changed.log.distance,
        found.passed,
        identified,
        verified,
        verified / identified,
    )


def main() -> int:
    """Print the table and write it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=os.environ.get("SDPID_DATA"))
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--quick", action="store_true", help="one log")
    options = parser.parse_args()
    found = []
    for name in QUICK if options.quick else tuple(SETS):
        if options.data is None or not (options.data / name).is_dir():
            where = "SDPID_DATA is not set" if options.data is None else f"not in {options.data}"
            print(f"{name}: skipped, {where}; docs/evidence/data.md says where it comes from")
            continue
        for record in SETS[name].records:
            robot = options.data / name / SETS[name].urdf
            log = options.data / name / f"{record}.npz"
            found.append(row(robot, log, f"{ROBOTS[name]}, {record}"))
            print(Table(HEADER, (found[-1],)).text(3).splitlines()[1], flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    Table(HEADER, tuple(found)).write(options.out / "replay.csv")
    return 0


if __name__ == "__main__":
    sys.exit(main())
