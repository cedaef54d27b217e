"""Compare sdpid with other tools on the same records: errors, consistency, time, failures.

    python examples/benchmark/run.py --out results --data /path/to/data --peers /path/to/peers
        [--arms NAME ...] [--tools NAME ...] [--quick]

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

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from judge import Verdict, judge  # noqa: E402
from records import TRAINED, Record, records, without_data  # noqa: E402
from study import Rows, Study, known  # noqa: E402

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


METHOD = ("tool", "method", "rows")
HEADER = (
    *("arm", *METHOD, *Verdict.__dataclass_fields__),
    *("over_bound_percent", "cpu_s", "wall_s", "status", "failure"),
)


def rows(
    pythons: dict[str, str], folder: Path, peers: Path | None, quick: bool, record: Record
) -> Rows:
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
            *(NAMES[entry.tool], entry.method.removeprefix("own rows, "), entry.rows),
            *(judged if verdict is None else asdict(verdict).values()),
            *(over, said.get("cpu_s"), said.get("wall_s"), said.get("status", ""), failure),
        )


def versions(folder: Path) -> Rows:
    """Yield the libraries that answers name, one row a tool."""
    found: dict[str, dict[str, str]] = {}
    for answer in sorted(folder.glob("*.npz")):
        if answer.name.endswith(".task.npz"):
            continue
        with np.load(answer, allow_pickle=False) as stored:
            said = json.loads(str(stored["said"]))
        tool = next(t for t in NAMES if f"_{t}_" in answer.name)
        found.setdefault(tool, said["versions"])
    for tool, libraries in found.items():
        yield NAMES[tool], ", ".join(f"{k} {v}" for k, v in libraries.items())


Column = Callable[[dict[str, Any]], object]


def of_arm(column: str, arm: str) -> Column:
    """Return what takes one column of the row of an arm."""
    return lambda own: next(iter(own[column][own["arm"] == arm]), None)


def good(column: str, told: Column) -> Column:
    """Return what says something of a column where there is an estimate."""
    return lambda own: told(known(own[column][~np.isnan(own["held_out"].astype(float))]))


def whole(column: str) -> Column:
    """Return what counts links, where a tool returns any."""
    return lambda own: int(known(own[column]).sum()) if len(known(own["links"])) else None


# What holds on how many records.
SUMMARY: dict[str, Any] = {
    "records": "count arm",
    "failures": lambda own: int(np.isnan(own["held_out"].astype(float)).sum()),
    **{each: whole(each) for each in ("bodies", "positive", "links")},
    "mass_matrix_positive": good("least_eigenvalue", lambda each: int((each > 0.0).sum())),
    "driving_joints": good("driving", lambda each: int(each.sum())),
    "worst_over_bound_percent": "max over_bound_percent",
    "median_cpu_s": good("cpu_s", lambda each: np.median(each) if len(each) else None),
}


def main() -> None:
    """Run every method on every record and write the tables."""
    study = Study(
        __doc__,
        quick={"tools": ["sdpid"], "arms": ["Panda"]},
        data=True,
        peers=(None, "folder of the peers' environments"),
        tools=[*NAMES],
        arms=[*TRAINED.values()],
    )
    folder = study.out / "answers"
    folder.mkdir(exist_ok=True)
    peers = None if study.peers is None else Path(study.peers).resolve()
    pythons = {tool: found for tool in study.tools if (found := interpreter(tool, peers))}
    found = records(study.data, study.arms) or [without_data()]
    rows_of = partial(rows, pythons, folder, peers, study.quick)
    done = study.rows("methods.csv", HEADER, rows_of, found)
    for column in ("held_out", "moving", "over_bound_percent", "cpu_s"):
        arms = {record.arm: of_arm(column, record.arm) for record in found}
        study.summary(f"{column}.csv", done, METHOD, arms)
    study.summary("summary.csv", done, METHOD, SUMMARY)
    failed = (
        [*(row[name] for name in HEADER[:4]), row["failure"]] for row in done if row["failure"]
    )
    study.write("failures.csv", (*HEADER[:4], "message"), failed)
    study.write("versions.csv", ("tool", "versions"), versions(folder))


if __name__ == "__main__":
    main()
