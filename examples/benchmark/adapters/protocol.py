"""What every tool of the benchmark is given, and what it answers: files, and NumPy alone.

A tool runs in a process of its own, with the interpreter of its own environment:

    python <tool>.py task.npz method answer.npz

It fits, predicts efforts at rows of positions, velocities and accelerations whose efforts it is
not given, and may say which bodies it found. Everything else is judged from its predictions.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import platform
import resource
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

# A fit that took less processor time than this is done once more, and the second one is timed:
# the first one in a process loads libraries.
SHORT_S = 5.0


@dataclass(frozen=True)
class Rows:
    """Rows (K, n) of the equation of motion; `effort` is None where it is to be predicted."""

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    effort: np.ndarray | None = None

    @classmethod
    def of(cls, stored: Any, prefix: str) -> Rows:
        """Return the rows that are stored under a prefix."""
        names = ("position", "velocity", "acceleration", "effort")
        found = [stored.get(f"{prefix}_{n}") for n in names]
        return cls(*found)


@dataclass(frozen=True)
class Task:
    """What a tool is given.

    Attributes
    ----------
    name : str
        The record.
    urdf : str
        The robot's description: the text of a URDF without shapes, or a file of it.
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

    def write(self, path: Path) -> None:
        """Store it without pickles."""
        arrays: dict[str, Any] = {f"log_{k}": v for k, v in self.log.items()}
        for prefix, rows in (("common", self.common), ("asked", self.asked)):
            arrays |= {f"{prefix}_{k}": v for k, v in vars(rows).items() if v is not None}
        words = {k: getattr(self, k) for k in ("name", "urdf", "joints", "wrist")}
        words |= {"rate_hz": self.rate_hz, "cutoff_hz": self.cutoff_hz}
        np.savez(path, words=np.array(json.dumps(words)), **arrays)

    @classmethod
    def read(cls, path: Path) -> Task:
        """Read what `write` stored."""
        with np.load(path, allow_pickle=False) as stored:
            words = json.loads(str(stored["words"]))
            log = {k[4:]: stored[k] for k in stored.files if k.startswith("log_")}
            common, asked = Rows.of(stored, "common"), Rows.of(stored, "asked")
        words["joints"], words["wrist"] = tuple(words["joints"]), tuple(words["wrist"])
        return cls(log=log, common=common, asked=asked, **words)


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


def main(methods: Mapping[str, Method], libraries: tuple[str, ...]) -> int:
    """Answer one task by one method; the answer says what failed, if something did."""
    task_file, name, answer_file = sys.argv[1:]
    task = Task.read(Path(task_file))
    if task.urdf.lstrip().startswith("<"):
        # A file of its own: tools may write beside it.
        urdf = Path(answer_file).with_suffix(".urdf").resolve()
        urdf.write_text(task.urdf, encoding="utf-8")
        task = replace(task, urdf=str(urdf))
    versions = {"python": platform.python_version()}
    for library in (*libraries, "numpy"):
        with contextlib.suppress(PackageNotFoundError):
            versions[library] = version(library)
    said: dict[str, Any] = {"versions": versions, "failure": "", "status": ""}
    arrays: dict[str, np.ndarray] = {}
    try:
        # What tools print is theirs; only a failure is kept.
        with contextlib.redirect_stdout(io.StringIO()):
            answer, wall, used = _timed(methods[name], task)
            if used < SHORT_S:
                answer, wall, used = _timed(methods[name], task)
            said |= {"wall_s": wall, "cpu_s": used, "status": answer.status}
            said["facts"] = dict(answer.facts)
            arrays["predicted"] = np.asarray(answer.predict(task.asked))
        if answer.bodies is not None:
            arrays["bodies"] = np.asarray(answer.bodies)
    except (Exception, SystemExit) as wrong:
        words = str(wrong).strip().splitlines() or [""]
        said["failure"] = f"{type(wrong).__name__}: {words[0]}"
        traceback.print_exc()
    np.savez(answer_file, said=np.array(json.dumps(said)), **arrays)
    sys.stdout.flush()
    # Libraries with threads of their own may not end by themselves.
    os._exit(0)
