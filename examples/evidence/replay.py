"""How far the costs of rows that are made again are from the first, and how long that takes.

Every record of docs/evidence/data.md with default settings: made again on the same processor, by
the kernels of another one, and of a log of which one effort is changed by 0.1 %.

    python examples/evidence/replay.py --data /path/to/data --out results

The folder of the data may also be named by the environment variable SDPID_DATA.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from data_sets import QUICK, SETS, records_of
from study import Study

import sdpid

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


def main() -> None:
    """Write the table."""
    study = Study(__doc__, data=True, quick={"sets": [*QUICK]}, sets=[*SETS])
    cases = [
        (arm.urdf, path, f"{arm}, {record}")
        for arm in records_of(study.data, study.sets)
        for record, path in arm.paths.items()
    ]
    study.rows("replay.csv", HEADER, cases, lambda case: [row(*case)])


if __name__ == "__main__":
    main()
