"""The judge of examples/benchmark finds what is wrong with an answer, and tools can join it."""

from __future__ import annotations

import csv
import importlib.util
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import sdpid

FOLDER = Path(__file__).resolve().parent.parent / "examples" / "benchmark"
PLACES = [str(FOLDER), str(FOLDER / "adapters"), str(FOLDER.parent / "evidence")]


@pytest.fixture(scope="module")
def record() -> Any:
    """The simulated record of a quick run without data."""
    sys.path[:0] = PLACES
    try:
        import records

        yield records.without_data()
    finally:
        for place in PLACES:
            sys.path.remove(place)


def _robot_and_bodies(record: Any) -> tuple[Any, np.ndarray]:
    from records import simulated_bodies

    robot = sdpid.load_robot(record.task.urdf)
    return robot, simulated_bodies(robot.n_links)


def _efforts(record: Any, coulomb: np.ndarray) -> np.ndarray:
    """Return the efforts of the simulated robot at the asked rows."""
    robot, bodies = _robot_and_bodies(record)
    rows = record.task.asked
    v = rows.velocity
    links = robot.inverse_dynamics(bodies.ravel(), rows.position, v, rows.acceleration)
    return np.asarray(links + coulomb * np.sign(v) + 0.5 * v)


def test_a_true_answer_passes(record: Any) -> None:
    from judge import judge

    robot, bodies = _robot_and_bodies(record)
    found = judge(record, _efforts(record, np.ones(6)), bodies)
    noise = 100.0 * 0.05 * np.sqrt(record.truth.size) / np.linalg.norm(record.truth)
    assert found.held_out == pytest.approx(noise, rel=0.1)
    assert (found.bodies, found.positive, found.links) == (6, 6, 6)
    assert found.driving == 0
    theta, none = bodies.ravel(), np.zeros((1, 6))
    exact = []
    for q in record.task.asked.position[record.parts["masses"]][:: 6 + 1]:
        at_rest = robot.inverse_dynamics(theta, q[None], none, none)
        columns = [robot.inverse_dynamics(theta, q[None], none, e[None]) for e in np.eye(6)]
        exact.append(np.linalg.eigvalsh(np.vstack(columns) - at_rest)[0])
    assert found.least_eigenvalue == pytest.approx(min(exact), rel=1e-6)


def test_wrong_answers_are_seen(record: Any) -> None:
    from judge import judge

    _, bodies = _robot_and_bodies(record)
    bodies[2, 4] += 10.0  # no mass distribution has one moment above the sum of the others
    bodies[4, 0] = -1.0
    driven = np.ones(6)
    driven[3] = -1.0
    efforts = _efforts(record, driven)
    found = judge(record, efforts, bodies)
    assert found.driving == 1
    assert (found.bodies, found.positive) == (4, 5)
    # An answer whose inertia at joint 1 is negative.
    masses = record.parts["masses"]
    negative = efforts.copy()
    negative[masses, 0] -= 1e3 * record.task.asked.acceleration[masses, 0]
    assert judge(record, negative, None).least_eigenvalue < 0.0
    efforts[3, 2] = np.nan
    with pytest.raises(ValueError, match="finite"):
        judge(record, efforts, None)
    with pytest.raises(ValueError, match="asked was"):
        judge(record, efforts[1:], None)


def test_a_task_survives_its_files(record: Any, tmp_path: Path) -> None:
    from protocol import Task

    record.task.write(tmp_path)
    found = Task.read(tmp_path)
    assert found.joints == record.task.joints
    assert found.asked.effort is None
    np.testing.assert_array_equal(found.common.effort, record.task.common.effort)
    np.testing.assert_array_equal(found.log["time"], record.task.log["time"])


def test_the_split_is_the_one_that_is_written_down(record: Any, data_folder: Path) -> None:
    import records

    path = FOLDER.parents[1] / "docs" / "evidence" / "tables" / "benchmark" / "split.csv"
    with path.open(encoding="utf-8") as file:
        kept = {row.pop("arm"): row for row in csv.DictReader(file)}
    assert {*kept} == {*records.TRAINED.values()}
    for found in records.records(data_folder, ["Panda", "Gen3"]):
        assert {k: str(v) for k, v in found.split.items()} == kept[str(found)]


def test_the_tool_that_the_page_shows(record: Any, tmp_path: Path) -> None:
    from judge import judge
    from least_squares_tool import least_squares
    from protocol import Task

    shown = Path("examples", "benchmark", "adapters", "least_squares_tool.py")
    page = (FOLDER.parents[1] / "docs" / "evidence" / "benchmark.md").read_text(encoding="utf-8")
    assert str(shown) in page
    assert len((FOLDER.parents[1] / shown).read_text(encoding="utf-8").splitlines()) <= 40
    record.task.write(tmp_path)
    answer = least_squares(Task.read(tmp_path))
    found = judge(record, np.asarray(answer.predict(record.task.asked)), answer.bodies)
    noise = 100.0 * 0.05 * np.sqrt(record.truth.size) / np.linalg.norm(record.truth)
    assert found.held_out == pytest.approx(noise, rel=0.1)
    # Without the inequality no link of the minimum norm is a body.
    assert (found.bodies, found.links) == (0, 6)


ZEROS = """#!/bin/sh
# /// script
# [tool.benchmark]
# name = "zeros"
# methods = ["none"]
# wrist = true
# ///
awk 'NR > 1 { print "0,0,0,0,0,0" }' "$1/asked.csv" > "$3/efforts.csv"
"""


@pytest.fixture
def command(record: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The module of the benchmark's command."""
    spec = importlib.util.spec_from_file_location("benchmark_command", FOLDER / "__main__.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    monkeypatch.syspath_prepend(str(FOLDER))
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("header", "line", "left_out"),
    [
        ("", "", ""),
        ("", "exit 3", "process ended with 3"),
        ("", "while :; do :; done", "stopped after 1 s"),
        ('dependencies = ["numpy"]', "", "no --peers"),
    ],
    ids=["answers", "fails", "takes too long", "has no environment"],
)
def test_a_program_joins(
    command: Any,
    record: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    header: str,
    line: str,
    left_out: str,
) -> None:
    monkeypatch.setattr(command, "LIMIT_S", 1)
    script = tmp_path / "zeros.sh"
    text = ZEROS.replace("script\n", f"script\n# {header}\n").replace("awk", f"{line}\nawk", 1)
    script.write_text(text, encoding="utf-8")
    script.chmod(0o755)
    study = SimpleNamespace(methods=[], out=tmp_path)
    (row,) = command.rows(study, [command.Tool.of(str(script))], None, record)
    found = dict(zip(command.COLUMNS[1:], row, strict=True))
    assert found["tool"] == "zeros"
    assert left_out in found["left_out"]
    assert found["held_out"] == (None if left_out else pytest.approx(100.0))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "no such file, nor one of the adapters: .*least_squares"),
        ("awk", "no header of lines"),
        (ZEROS.replace("methods", "method"), r"needs \[tool.benchmark\] with name and methods"),
        (ZEROS.replace("[tool", "[[tool"), r"needs \[tool.benchmark\]"),
    ],
    ids=["no file", "no header", "no methods", "no TOML"],
)
def test_a_header_that_is_wrong_is_told(
    command: Any, tmp_path: Path, text: str | None, words: str
) -> None:
    script = tmp_path / "mine.sh"
    if text is not None:
        script.write_text(text, encoding="utf-8")
    with pytest.raises(SystemExit, match=words):
        command.Tool.of(str(script))
