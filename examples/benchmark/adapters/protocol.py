"""What every tool of the benchmark is given, and what it answers: folders of CSV files.

A tool runs in a process of its own, with the interpreter of its own environment:

    python <tool>_tool.py TASK METHOD ANSWER

TASK is a folder with `robot.urdf` (without shapes), `task.json` (see `Task`), `log.csv` (the
training part as it was recorded: time in s, positions in rad, efforts in N·m and, where recorded,
velocities), `common.csv` (the same part, filtered as for every tool, with velocities and
accelerations) and `asked.csv`: positions, velocities and accelerations whose efforts are asked
for. Into the folder ANSWER it writes `efforts.csv`, a column a joint, and may write `bodies.csv`,
a row a link (see `Answer`). In Python `main` reads and writes all of it; a program in another
language does it itself. Everything is judged from these two files.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import platform
import resource
import shutil
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

# A fit that took less processor time than this is done once more, and the second one is timed:
# the first one in a process loads libraries.
SHORT_S = 5.0
# All digits of a double.
EXACT = "%.17g"
MOTION = ("position", "velocity", "acceleration")


@dataclass(frozen=True)
class Rows:
    """Rows (K, n) of the equation of motion; `effort` is None where it is to be predicted."""

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    effort: np.ndarray | None = None


@dataclass(frozen=True)
class Task:
    """What a tool is given.

    Attributes
    ----------
    name : str
        The record.
    urdf : str
        The robot's description: its text where a task is made, its file where it is read.
    joints : tuple of str
        Its joints in the order of the columns.
    rate_hz, cutoff_hz : float
        Of the recording, and of the filter of the common rows.
    log : dict
        The training part as it was recorded: time (N,), position, effort (N, n) and, where
        recorded, velocity.
    common : Rows
        The training part, filtered as for every tool.
    asked : Rows
        Where to predict.
    wrist : tuple of str
        Two joints that share motors, if the record has such.
    """

    name: str
    urdf: str
    joints: tuple[str, ...]
    rate_hz: float
    cutoff_hz: float
    log: dict[str, np.ndarray]
    common: Rows
    asked: Rows
    wrist: tuple[str, ...] = ()

    def write(self, folder: Path) -> None:
        """Write the folder that a tool is given."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "robot.urdf").write_text(self.urdf, encoding="utf-8")
        words = {k: getattr(self, k) for k in ("name", "joints", "wrist", "rate_hz", "cutoff_hz")}
        (folder / "task.json").write_text(json.dumps(words, indent=1), encoding="utf-8")
        for name in ("log", "common", "asked"):
            given = getattr(self, name)
            columns = given if name == "log" else vars(given)
            self._write_table(folder / f"{name}.csv", columns)

    def _write_table(self, path: Path, columns: Mapping[str, np.ndarray | None]) -> None:
        kept = {kind: np.asarray(v) for kind, v in columns.items() if v is not None}
        header = []
        for kind, values in kept.items():
            header += [f"{kind}_{j}" for j in self.joints] if values.ndim > 1 else [kind]
        np.savetxt(
            path,
            np.column_stack([*kept.values()]),
            EXACT,
            delimiter=",",
            header=",".join(header),
            comments="",
        )

    @classmethod
    def read(cls, folder: Path) -> Task:
        """Read what `write` wrote."""
        words = json.loads((folder / "task.json").read_text(encoding="utf-8"))
        words["joints"], words["wrist"] = tuple(words["joints"]), tuple(words["wrist"])
        tables = {name: _table(folder / f"{name}.csv") for name in ("log", "common", "asked")}
        return cls(
            urdf=str(folder / "robot.urdf"),
            log=tables["log"],
            common=Rows(**tables["common"]),
            asked=Rows(**tables["asked"]),
            **words,
        )


def _table(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a table by their kind, those of the joints together."""
    with path.open(encoding="utf-8") as file:
        kinds = [name.partition("_")[0] for name in file.readline().strip().split(",")]
        values = np.loadtxt(file, delimiter=",", ndmin=2)
    found = {kind: values[:, [k == kind for k in kinds]] for kind in dict.fromkeys(kinds)}
    if "time" in found:
        found["time"] = found["time"][:, 0]
    return found


@dataclass(frozen=True)
class Answer:
    """What a tool found.

    Attributes
    ----------
    predict : callable
        From rows to their efforts (K, n).
    bodies : ndarray, shape (links, 10), optional
        Mass, first moments and inertia about the frame's origin: m, mx, my, mz, Ixx, Ixy, Iyy,
        Ixz, Iyz, Izz. None where the tool returns base parameters alone.
    status : str
        What the tool itself says of the fit, where it says something.
    facts : dict
        Numbers to keep: lower bound, iterations.
    """

    predict: Callable[[Rows], np.ndarray]
    bodies: np.ndarray | None = None
    status: str = ""
    facts: Mapping[str, float] = field(default_factory=dict)


Method = Callable[[Task], Answer]


def inside(task: Task, cutoff_hz: float) -> slice:
    """Return the samples of the log that a filter's transients at the ends do not reach.

    A part of a record begins and ends in motion. FIGAROH's example leaves out 20 samples at either
    end; two periods of the cut-off are more.
    """
    border = max(20, round(2.0 * task.rate_hz / cutoff_hz))
    return slice(border, len(task.log["time"]) - border)


def _used() -> float:
    """Return processor seconds of this process and of those that it started."""
    each = [resource.getrusage(w) for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(use.ru_utime + use.ru_stime for use in each)


def _timed(method: Method, task: Task) -> tuple[Answer, float, float]:
    start, used = time.perf_counter(), _used()
    answer = method(task)
    return answer, time.perf_counter() - start, _used() - used


def main(methods: Mapping[str, Method], libraries: tuple[str, ...] = ()) -> None:
    """Answer one task by one method; the answer says what failed, if something did."""
    given, name, answered = Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3])
    # Tools may write beside the description.
    for file in given.iterdir():
        shutil.copy(file, answered)
    task = Task.read(answered.resolve())
    versions = {"python": platform.python_version()}
    for library in (*libraries, "numpy"):
        with contextlib.suppress(PackageNotFoundError):
            # What runs; a checkout may be newer than what is installed.
            loaded = sys.modules.get(library)
            versions[library] = getattr(loaded, "__version__", None) or version(library)
    said: dict[str, Any] = {"versions": versions, "failure": "", "status": ""}
    try:
        if name not in methods:
            raise LookupError(f"there is no {name!r} among {', '.join(methods)}")
        # What tools print is theirs; only a failure is kept.
        with contextlib.redirect_stdout(io.StringIO()):
            answer, wall, used = _timed(methods[name], task)
            if used < SHORT_S:
                answer, wall, used = _timed(methods[name], task)
            said |= {"wall_s": wall, "cpu_s": used, "status": answer.status}
            said["facts"] = dict(answer.facts)
            efforts = np.asarray(answer.predict(task.asked))
        np.savetxt(answered / "efforts.csv", efforts, EXACT, delimiter=",")
        if answer.bodies is not None:
            np.savetxt(answered / "bodies.csv", answer.bodies, EXACT, delimiter=",")
    except (Exception, SystemExit) as wrong:
        words = str(wrong).strip().splitlines() or [""]
        said["failure"] = f"{type(wrong).__name__}: {words[0]}"
        traceback.print_exc()
    (answered / "said.json").write_text(json.dumps(said), encoding="utf-8")
    sys.stdout.flush()
    # Libraries with threads of their own may not end by themselves.
    os._exit(0)
