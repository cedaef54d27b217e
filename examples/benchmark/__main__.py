"""Compare tools on the same records: efforts missed, physical consistency, time, failures.

    python examples/benchmark --out results --data /path/to/data --peers /path/to/peers
        [--arms NAME ...] [--tools NAME ...] [--methods NAME ...] [--quick]

Each method of each tool gets a task in a process of its own: the training part of a record as it
was recorded, the same part filtered alike for all, and rows at which to predict efforts, without
those that were measured there. A method fits its own rows (what the tool makes of the log) or the
common rows, with Coulomb and viscous friction and offsets. All are scored on the same held-out
rows. Rules, results and how a tool joins: docs/evidence/benchmark.md.

A tool is a file `adapters/NAME_tool.py`, or any file that --tools names; its header says its
methods and its libraries. These are installed in an environment of its own in the folder of peers.
What is left out, and why, is printed and stands in `left_out.csv`. Without any record a small
simulated one stands for them.
"""

from __future__ import annotations

import json
import os
import re
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from judge import Verdict, judge  # noqa: E402
from records import TRAINED, Record, records, without_data  # noqa: E402
from study import Rows, Study, known  # noqa: E402

from sdpid._common.files import tomllib  # noqa: E402

ADAPTERS = HERE / "adapters"
TOOLS = ("sdpid", "least_squares", "figaroh", "flobaroid", "mujoco_sysid")
# What a method may take: processor time, and time on a machine with other work.
LIMIT_S, PATIENCE = 300, 4
HEADER = re.compile(r"^# /// script\n(.*?)^# ///$", re.MULTILINE | re.DOTALL)
OWN = "own rows, "
# No later minor version of Python 3 is looked for.
NEWEST = 20


class LeftOutError(Exception):
    """A tool, or a method on a record, that is not run."""


@dataclass(frozen=True)
class Tool:
    """A tool as the header of its adapter describes it.

    Attributes
    ----------
    script : Path
        Its adapter.
    name : str
        What it is called.
    methods : list of str
        What it offers; those that begin with `OWN` fit rows of their own.
    bounds : dict of str
        By method, our program whose proven bound holds for its problem too.
    wrist : bool
        Whether it knows the terms of two joints that share motors.
    checkout : str
        Repository whose checkout it needs in the folder of peers.
    python : int
        The least minor version of Python 3 that it asks for.
    dependencies : list of str
        Of its environment; without any it runs in that of the benchmark.
    """

    script: Path
    name: str
    methods: list[str]
    bounds: dict[str, str] = field(default_factory=dict)
    wrist: bool = False
    checkout: str = ""
    python: int = 10
    dependencies: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        return self.name

    @classmethod
    def of(cls, name: str) -> Tool:
        """Read the header of an adapter, which stands in the form of PEP 723."""
        script = Path(name) if Path(name).is_file() else ADAPTERS / f"{name}_tool.py"
        if not script.is_file():
            known = ", ".join(
                each.stem.removesuffix("_tool") for each in ADAPTERS.glob("*_tool.py")
            )
            raise SystemExit(f"--tools {name}: no such file, nor one of the adapters: {known}")
        found = HEADER.search(script.read_text(encoding="utf-8"))
        if found is None:
            raise SystemExit(f"{script}: no header of lines between '# /// script' and '# ///'")
        lines = (line.removeprefix("#").removeprefix(" ") for line in found[1].splitlines())
        try:
            return cls._said(script.resolve(), tomllib.loads("\n".join(lines)))
        except (ValueError, KeyError, TypeError) as wrong:
            needed = "needs [tool.benchmark] with name and methods, as least_squares_tool.py has"
            raise SystemExit(f"{script}: its header {needed} ({wrong})") from None

    @classmethod
    def _said(cls, script: Path, said: dict[str, Any]) -> Tool:
        python = int(said.get("requires-python", ">=3.10").removeprefix(">=3."))
        needed = said.get("dependencies", [])
        return cls(script, python=python, dependencies=needed, **said["tool"]["benchmark"])

    def interpreter(self, peers: Path | None) -> str:
        """Return its interpreter; its environment is made where it is missing."""
        if not self.dependencies:
            return sys.executable
        if peers is None:
            raise LeftOutError("no --peers, where its environment would be")
        if self.checkout and not self.folder(peers).is_dir():
            raise LeftOutError(f"no checkout of {self.checkout} at {self.folder(peers)}")
        place = peers / self.script.stem.removesuffix("_tool")
        python = place / "bin" / "python"
        if not python.is_file():
            self._make(place)
        return str(python)

    def _make(self, place: Path) -> None:
        """Make its environment; half of one is taken away again."""
        others = [f"python3.{minor}" for minor in range(self.python, NEWEST)]
        new = sys.version_info.minor >= self.python
        # A name on the path may stand for a version that is not there.
        for first in filter(None, [sys.executable] if new else map(shutil.which, others)):
            if subprocess.run([first, "-m", "venv", place]).returncode == 0:
                break
        else:
            raise LeftOutError(f"no Python 3.{self.python} or later makes an environment")
        pip = [place / "bin" / "python", "-m", "pip", "install", "-q", *self.dependencies]
        done = subprocess.run(pip, capture_output=True, text=True)
        if done.returncode:
            shutil.rmtree(place)
            told = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
            raise LeftOutError(f"its libraries cannot be installed: {' '.join(told[-1:])}")

    def folder(self, peers: Path) -> Path:
        """Return where its checkout is expected."""
        return peers / self.checkout.partition(" ")[0].rpartition("/")[2]


def limited() -> None:
    """Limit a tool's processor time."""
    resource.setrlimit(resource.RLIMIT_CPU, (LIMIT_S, LIMIT_S))


def answered(tool: Tool, method: str, record: Record, out: Path, peers: Path | None) -> Path:
    """Return the folder of an answer; one that is there stays."""
    answer = out / "answers" / f"{record} {tool} {method}".replace(" ", "_")
    if answer.is_dir():
        return answer
    python = tool.interpreter(peers)
    task = out / "tasks" / str(record)
    record.task.write(task)
    answer.mkdir(parents=True)
    environment = dict(os.environ)
    if tool.dependencies:
        environment.pop("PYTHONPATH", None)
    places = [str(ADAPTERS), environment.get("PYTHONPATH", "")]
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, places))
    environment |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1")
    environment["CHECKOUT"] = str(tool.folder(peers or Path()))
    runs = [python] if tool.script.suffix == ".py" else []
    command = [*runs, str(tool.script), str(task), method, str(answer)]
    failure = f"stopped after {LIMIT_S} s"
    try:
        done = subprocess.run(
            command,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=PATIENCE * LIMIT_S,
            preexec_fn=limited,
        )
        if done.stdout:
            (answer / "printed.txt").write_text(done.stdout, encoding="utf-8")
        if done.returncode > 0:
            failure = f"process ended with {done.returncode}"
    except subprocess.TimeoutExpired:
        pass
    if not (answer / "said.json").is_file():
        told = "" if (answer / "efforts.csv").is_file() else failure
        (answer / "said.json").write_text(json.dumps({"failure": told}), encoding="utf-8")
    return answer


def read(file: Path) -> np.ndarray | None:
    """Return a table of an answer, if there is one."""
    return np.loadtxt(file, delimiter=",", ndmin=2) if file.is_file() else None


METHOD = ("tool", "method", "rows")
COLUMNS = (
    *("arm", *METHOD, *Verdict.__dataclass_fields__),
    *("over_bound_percent", "cpu_s", "wall_s", "status", "left_out"),
)


def rows(study: Any, tools: list[Tool], peers: Path | None, record: Record) -> Rows:
    """Yield a row for every method."""
    bounds: dict[str, float] = {}
    for tool in tools:
        for method in tool.methods:
            if study.methods and method not in study.methods:
                continue
            said, verdict = {"failure": ""}, None
            try:
                if record.task.wrist and not tool.wrist:
                    raise LeftOutError("has no terms of a coupled wrist")
                answer = answered(tool, method, record, study.out, peers)
                said = json.loads((answer / "said.json").read_text(encoding="utf-8"))
                predicted = read(answer / "efforts.csv")
                if predicted is not None:
                    verdict = judge(record, predicted, read(answer / "bodies.csv"))
            except (LeftOutError, ValueError) as wrong:
                said["failure"] = str(wrong)
            facts = said.get("facts", {})
            if "bound" in facts:
                bounds[method] = facts["bound"]
            bound, over = bounds.get(tool.bounds.get(method, "")), None
            if verdict is not None and bound is not None:
                over = 100.0 * (verdict.cost / bound - 1.0)
            judged = (None,) * len(Verdict.__dataclass_fields__)
            fits = "own" if method.startswith(OWN) else "common"
            yield (
                *(str(tool), method.removeprefix(OWN), fits),
                *(judged if verdict is None else asdict(verdict).values()),
                *(over, said.get("cpu_s"), said.get("wall_s"), said.get("status", "")),
                said["failure"],
            )


def versions(folder: Path, tools: list[Tool]) -> Rows:
    """Yield the libraries that answers name, one row a tool."""
    for tool in tools:
        for said in sorted(folder.glob(f"*_{tool}_*/said.json".replace(" ", "_"))):
            if found := json.loads(said.read_text(encoding="utf-8")).get("versions"):
                yield str(tool), ", ".join(f"{k} {v}" for k, v in found.items())
                break


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
    "answers": good("held_out", len),
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
        quick={
            "tools": [*TOOLS[:2]],
            "arms": ["Panda"],
            "methods": ["own rows, defaults", "SDP", "least squares"],
        },
        data=True,
        peers=(None, "folder of the tools' environments"),
        tools=([*TOOLS], "names of adapters, or files"),
        arms=[*TRAINED.values()],
        methods=([], "only these"),
    )
    peers = None if study.peers is None else Path(study.peers).resolve()
    tools = [Tool.of(name) for name in study.tools]
    found = records(study.data, study.arms) or [without_data()]
    split = ((str(record), *record.split.values()) for record in found)
    study.write("split.csv", ("arm", *found[0].split), split)
    done = study.rows("methods.csv", COLUMNS, partial(rows, study, tools, peers), found)
    arms = {str(record): of_arm("held_out", str(record)) for record in found}
    study.summary("held_out.csv", done, METHOD, arms | SUMMARY)
    left = ([row[name] for name in (*COLUMNS[:4], "left_out")] for row in done if row["left_out"])
    study.write("left_out.csv", (*COLUMNS[:4], "why"), left)
    study.write("versions.csv", ("tool", "versions"), versions(study.out / "answers", tools))


if __name__ == "__main__":
    main()
