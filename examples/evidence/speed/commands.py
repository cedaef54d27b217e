"""Commands as users run them, beside the same commands of an earlier checkout (`--before`).

Each is a whole process, from its start to its end: interpreter and imports count. Memory is the
most that the process had. The report is timed inside a process that has identified.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
from harness import Bench, apart

from sdpid._common.tables import Table

ROOT = Path(__file__).resolve().parents[3]
COLUMNS = ("what", "unit", "now", "least", "most", "before", "ratio", "repeats")

MEASURED = {
    "first": ("to the first line of the result", "s"),
    "all": ("to the end", "s"),
    "processor": ("processor time", "s"),
    "memory": ("memory", "MB"),
}


def measure(bench: Bench) -> Table:
    """Time `sdpid identify` on the UR10's record, and its report."""
    folder = bench.data / "ur10_unisa"
    if not folder.is_dir():
        return Table(COLUMNS, ())
    checkouts = {"now": ROOT} | ({"before": Path(bench.before)} if bench.before else {})
    files = [str(folder / "ur10_exciting.npz"), str(folder / "ur10.urdf")]
    command = ["-m", "sdpid", "identify", files[0], "--robot", files[1], "--out", "results"]
    runs = {name: partial(process, command, path) for name, path in checkouts.items()}
    found = bench.in_turn(runs)
    rows = []
    for key, (what, unit) in MEASURED.items():
        each = {name: [run[key] for run in of] for name, of in found.items()}
        rows.append(_row(f"identify, UR10: {what}", unit, each))
    # Python imports a checkout, wherever it is started.
    reports = {
        name: partial(
            *(apart, report, *files),
            environment={"PYTHONPATH": str(path), "PYTHONSAFEPATH": "1"},
        )
        for name, path in checkouts.items()
    }
    rows.append(_row("identify, UR10: the report alone", "s", bench.in_turn(reports)))
    return Table(COLUMNS, tuple(rows))


def _row(what: str, unit: str, found: dict[str, list[float]]) -> tuple[object, ...]:
    now, before = np.array(found["now"]), np.array(found.get("before", np.nan))
    own = float(np.median(now)), float(now.min()), float(now.max())
    return what, unit, *own, np.median(before), np.median(before / now), len(now)


def process(arguments: list[str], checkout: Path) -> dict[str, float]:
    """Return what a process of a checkout's code takes, in s, and its memory in MB."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "PYTHONPATH": str(checkout), "PYTHONUNBUFFERED": "1"}
        begin, first = time.perf_counter(), 0.0
        child = subprocess.Popen(
            [sys.executable, *arguments],
            cwd=folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert child.stdout is not None
        for line in child.stdout:
            if not first and line.strip():
                first = time.perf_counter() - begin
        _, child.returncode, usage = os.wait4(child.pid, 0)
        child.stdout.close()
        if child.returncode:
            raise SystemExit(f"{' '.join(arguments)} in {checkout}: {child.returncode}")
        return {
            "first": first,
            "all": time.perf_counter() - begin,
            # With those of its own children, where it waits for them.
            "processor": usage.ru_utime + usage.ru_stime,
            "memory": usage.ru_maxrss / 1024,
        }


def report(log: str, robot: str) -> float:
    """Return the seconds that the report of an identification takes, its imports included."""
    import sdpid
    from sdpid.output.report.report import write_report

    result = sdpid.identify(robot, log)
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        write_report(result, Path(folder) / "report.html")
        return time.perf_counter() - begin
