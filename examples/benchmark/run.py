"""Compare sdpid with other tools on the same records: errors, consistency, time, failures.

    python examples/benchmark/run.py --out results --data /path/to/data --peers /path/to/peers
        [--arm NAME] [--tool NAME] [--quick]

Each method of each tool gets a task in a process of its own: the training part of a record as it
was recorded, the same part filtered alike for all, and rows at which to predict efforts, without
those that were measured there. A method fits its own rows (what the tool makes of the log) or the
common rows, with Coulomb and viscous friction and offsets. All are scored on the same held-out
rows. Rules and results: docs/evidence/benchmark.md.

Without `--peers`, or with `--quick`, only sdpid runs. In the folder of peers each tool has
an environment, which is made from peers/<tool>/requirements.txt where it is missing; FloBaRoID,
which is no package, also needs its checkout there (`FloBaRoID`). Records that are missing are left
out; without any, a small simulated one stands for them.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from judge import Verdict, judge  # noqa: E402
from records import TRAINED, Record, records, without_data  # noqa: E402

from sdpid._common.tables import Table  # noqa: E402

TIMEOUT_S = 3600.0
COMMON, OWN = "common", "own"


@dataclass(frozen=True)
class Entry:
    """A method of a tool.

    Attributes
    ----------
    tool, method : str
        Whose, and its name there.
    rows : str
        What it fits: the common rows, or its own.
    bound : str
        Our program whose proven bound holds for its problem too; none where it solves another.
    wrist : bool
        Whether it knows the terms of two joints that share motors.
    arms : tuple of str
        Where it runs; everywhere by default.
    """

    tool: str
    method: str
    rows: str = COMMON
    bound: str = ""
    wrist: bool = True
    arms: tuple[str, ...] = ()


ENTRIES = (
    Entry("sdpid", "defaults", OWN),
    Entry("sdpid", "SDP", bound="SDP"),
    Entry("sdpid", "SDP, free friction", bound="SDP, free friction"),
    Entry("sdpid", "SDP 6×6, tanh", bound="SDP 6×6, tanh", wrist=False),
    Entry("sdpid", "SDP, tanh"),
    Entry("sdpid", "SDP, weights and prior"),
    Entry("sdpid", "least squares"),
    Entry("sdpid", "least squares, tanh"),
    Entry("sdpid", "ridge"),
    Entry("sdpid", "SLSQP", bound="SDP"),
    Entry("sdpid", "log-Cholesky", bound="SDP"),
    Entry("figaroh", "own rows, least squares", OWN),
    Entry("figaroh", "own rows, weighted", OWN),
    Entry("figaroh", "own rows, physical fit", OWN),
    Entry("figaroh", "least squares"),
    Entry("figaroh", "weighted"),
    Entry("figaroh", "physical fit", bound="SDP, free friction"),
    Entry("flobaroid", "own rows, least squares", OWN, wrist=False),
    Entry("flobaroid", "own rows, SDP", OWN, wrist=False),
    Entry("flobaroid", "least squares", wrist=False),
    Entry("flobaroid", "SDP", wrist=False),
    Entry("flobaroid", "SDP, no beliefs", bound="SDP 6×6, tanh", wrist=False),
    # Minutes each.
    Entry("mujoco_sysid", "inverse dynamics", bound="SDP", wrist=False, arms=("UR10", "Panda")),
)
QUICK = ("defaults", "SDP", "least squares")
NAMES = {
    "sdpid": "sdpid",
    "figaroh": "FIGAROH",
    "flobaroid": "FloBaRoID",
    "mujoco_sysid": "mujoco.sysid",
}
# The oldest Python that a tool asks for, where the running one may be older.
PYTHONS = {"flobaroid": ("python3.13", "python3.14")}


def interpreter(tool: str, peers: Path | None) -> str | None:
    """Return the interpreter of a tool, whose environment is made where it is missing."""
    if tool == "sdpid":
        return sys.executable
    if peers is None:
        return None
    if tool == "flobaroid" and not (peers / "FloBaRoID" / "identifier.py").is_file():
        print(f"FloBaRoID: left out, no checkout at {peers / 'FloBaRoID'}")
        return None
    folder = peers / tool
    python = folder / "bin" / "python"
    if not python.is_file():
        wanted = PYTHONS.get(tool, ())
        first = next(filter(None, map(shutil.which, wanted)), None) if wanted else sys.executable
        if first is None:
            print(f"{NAMES[tool]}: left out, it needs {' or '.join(wanted)}")
            return None
        needed = HERE / "peers" / tool / "requirements.txt"
        subprocess.run([first, "-m", "venv", folder], check=True)
        subprocess.run([python, "-m", "pip", "install", "-q", "-r", needed], check=True)
    return str(python)


def answered(
    python: str, entry: Entry, record: Record, folder: Path, peers: Path | None
) -> tuple[dict[str, Any], np.ndarray | None, np.ndarray | None]:
    """Return what a method says, predicts and returns as bodies; answers that are there stay."""
    name = f"{record.arm} {entry.tool} {entry.method}".replace(" ", "_")
    answer = folder / f"{name}.npz"
    task = folder / f"{record.arm}.task.npz"
    if not answer.is_file():
        record.task.write(task)
        environment = dict(os.environ)
        if entry.tool != "sdpid":
            environment.pop("PYTHONPATH", None)
        environment |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1")
        environment["FLOBAROID"] = str((peers or Path()) / "FloBaRoID")
        script = HERE / "adapters" / f"{entry.tool}_tool.py"
        command = [python, str(script), str(task), entry.method, str(answer)]
        try:
            done = subprocess.run(
                command, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S
            )
            if words := done.stdout + done.stderr:
                (folder / f"{name}.txt").write_text(words, encoding="utf-8")
            failure = f"process ended with {done.returncode}"
        except subprocess.TimeoutExpired:
            failure = f"not done after {TIMEOUT_S:.0f} s"
        if not answer.is_file():
            return {"failure": failure, "versions": {}}, None, None
    with np.load(answer, allow_pickle=False) as stored:
        said = json.loads(str(stored["said"]))
        predicted = stored.get("predicted")
        bodies = stored.get("bodies")
    return said, predicted, bodies


HEADER = (
    "arm",
    "tool",
    "method",
    "rows",
    *Verdict.__dataclass_fields__,
    "over_bound_percent",
    "cpu_s",
    "wall_s",
    "status",
    "failure",
)


def rows(
    record: Record, pythons: dict[str, str], folder: Path, peers: Path | None, quick: bool
) -> Iterator[tuple[object, ...]]:
    """Yield a row for every method."""
    bounds: dict[str, float] = {}
    for entry in ENTRIES:
        if entry.tool not in pythons or (quick and entry.method not in QUICK):
            continue
        if (record.task.wrist and not entry.wrist) or (entry.arms and record.arm not in entry.arms):
            continue
        said, predicted, bodies = answered(pythons[entry.tool], entry, record, folder, peers)
        failure, verdict = said["failure"], None
        if predicted is not None:
            try:
                verdict = judge(record, predicted, bodies)
            except ValueError as wrong:
                failure = str(wrong)
        facts = said.get("facts", {})
        if "bound" in facts:
            bounds[entry.method] = facts["bound"]
        over = None
        if verdict is not None and entry.bound in bounds:
            over = 100.0 * (verdict.cost / bounds[entry.bound] - 1.0)
        judged = (None,) * len(Verdict.__dataclass_fields__)
        yield (
            record.arm,
            NAMES[entry.tool],
            entry.method.removeprefix("own rows, "),
            entry.rows,
            *(judged if verdict is None else asdict(verdict).values()),
            over,
            said.get("cpu_s"),
            said.get("wall_s"),
            said.get("status", ""),
            failure,
        )


def versions(folder: Path) -> Table:
    """Return the libraries that answers name, one row a tool."""
    found: dict[str, dict[str, str]] = {}
    for answer in sorted(folder.glob("*.npz")):
        if answer.name.endswith(".task.npz"):
            continue
        with np.load(answer, allow_pickle=False) as stored:
            said = json.loads(str(stored["said"]))
        tool = next(t for t in NAMES if f"_{t}_" in answer.name)
        found.setdefault(tool, said["versions"])
    lines = [
        (NAMES[tool], ", ".join(f"{k} {v}" for k, v in libraries.items()))
        for tool, libraries in found.items()
    ]
    return Table(("tool", "versions"), tuple(lines))


def table(done: list[tuple[object, ...]], column: str) -> Table:
    """Return one column of all results, one row a method and one column an arm."""
    at = HEADER.index(column)
    arms = list(dict.fromkeys(str(row[0]) for row in done))
    keys = list(dict.fromkeys(row[1:4] for row in done))
    cells = {(row[0], *row[1:4]): row[at] for row in done}
    lines = [(*key, *(cells.get((arm, *key)) for arm in arms)) for key in keys]
    return Table(("tool", "method", "rows", *arms), tuple(lines))


SHOWN = ("held_out", "moving", "over_bound_percent", "cpu_s")


def summary(done: list[tuple[object, ...]]) -> Table:
    """Return what holds on how many records, one row a method."""
    header = (
        "tool",
        "method",
        "rows",
        "records",
        "failures",
        "bodies",
        "positive",
        "links",
        "mass_matrix_positive",
        "driving_joints",
        "worst_over_bound_percent",
        "median_cpu_s",
    )
    lines = []
    for key in dict.fromkeys(row[1:4] for row in done):
        found = [dict(zip(HEADER, row, strict=True)) for row in done if row[1:4] == key]
        good = [row for row in found if row["held_out"] is not None]

        def values(name: str, good: list[dict[str, Any]] = good) -> list[float]:
            return [row[name] for row in good if row[name] is not None]

        sums = [
            sum(values(k)) if values("links") else None for k in ("bodies", "positive", "links")
        ]
        over, cpu = values("over_bound_percent"), values("cpu_s")
        lines.append(
            (
                *key,
                len(found),
                len(found) - len(good),
                *sums,
                sum(value > 0.0 for value in values("least_eigenvalue")),
                sum(values("driving")),
                max(over) if over else None,
                float(np.median(cpu)) if cpu else None,
            )
        )
    return Table(header, tuple(lines))


def failures(done: list[tuple[object, ...]]) -> Table:
    """Return what did not end with an estimate, with its message."""
    at = HEADER.index("failure")
    return Table(("arm", *HEADER[1:4], "message"), tuple((*r[:4], r[at]) for r in done if r[at]))


def main() -> int:
    """Run every method on every record and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--data", type=Path, default=os.environ.get("SDPID_DATA"))
    parser.add_argument("--peers", type=Path, help="folder of the peers' environments")
    parser.add_argument("--arm", action="append", choices=tuple(TRAINED.values()))
    parser.add_argument("--tool", action="append", choices=tuple(NAMES))
    parser.add_argument("--quick", action="store_true", help="one record, sdpid alone")
    options = parser.parse_args()
    folder = options.out / "answers"
    folder.mkdir(parents=True, exist_ok=True)
    tools = ["sdpid"] if options.quick else options.tool or list(NAMES)
    peers = None if options.peers is None else options.peers.resolve()
    pythons = {tool: found for tool in tools if (found := interpreter(tool, peers))}
    arms = options.arm or (["Panda"] if options.quick else list(TRAINED.values()))
    found = records(options.data, arms) or [without_data()]
    done: list[tuple[object, ...]] = []
    start = time.perf_counter()
    for record in found:
        for cells in rows(record, pythons, folder, peers, options.quick):
            done.append(cells)
            print(Table(HEADER, (cells,)).text(3).splitlines()[1], flush=True)
        Table(HEADER, tuple(done)).write(options.out / "methods.csv")
    for column in SHOWN:
        table(done, column).write(options.out / f"{column}.csv")
    summary(done).write(options.out / "summary.csv")
    failures(done).write(options.out / "failures.csv")
    versions(folder).write(options.out / "versions.csv")
    print(f"\n{table(done, 'held_out').text(3)}\n{time.perf_counter() - start:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
