"""The folder of a plan: every file, or none, and no one else's."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sdpid
from sdpid._common.files import load_toml
from sdpid._common.staging import digest
from sdpid.errors import ExportError
from sdpid.excitation.geometry.obstacles import obstacles_from_toml
from sdpid.excitation.limits.limits import Limits
from sdpid.excitation.search.ipopt import INTERRUPTED
from sdpid.experiment.trajectory.reading import read_trajectory
from sdpid.output.plans import write
from sdpid.output.plans.write import write_plan
from tests.helpers.plans import AROUND, LIMITS, small_plan
from tests.helpers.refusals import refuses

FILES = {
    "trajectory.csv",
    "trajectory.parquet",
    "trajectory.toml",
    "coefficients.json",
    "joint_trajectory.yaml",
    "report.html",
    "limits.toml",
    "obstacles.toml",
    "plan.toml",
    "plan.json",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("pyarrow")
    pytest.importorskip("jinja2")
    out = tmp_path_factory.mktemp("plans") / "new" / "plan"
    told: list[str] = []
    files = write_plan(small_plan(), out, report=told.append, figures=False)
    assert {file.name for file in files} == FILES
    assert told == [
        "no excitation.script: arms of Universal Robots have 6 turning joints, this robot has "
        "others",
    ]
    return out


def test_the_files_are_there_and_listed(folder: Path) -> None:
    assert {path.name for path in folder.iterdir()} == FILES
    listed = json.loads((folder / "plan.json").read_text())["files"]
    assert {name: each["sha256"] for name, each in listed.items()} == {
        name: digest(folder / name) for name in FILES - {"plan.json"}
    }


def test_the_motion_is_that_of_the_plan(folder: Path) -> None:
    """Whatever form it is read from, at other times too."""
    own = small_plan().trajectory
    again = sdpid.Trajectory.from_toml(folder / "trajectory.toml")
    assert np.array_equal(again.series.control_points, own.series.control_points)  # type: ignore[attr-defined]
    time = np.linspace(0.0, own.period, 997)
    for name in ("trajectory.csv", "trajectory.parquet"):
        read = read_trajectory(folder / name, own.joint_names)
        assert read.series.duration == pytest.approx(own.duration, abs=1e-12)
        for order, near in enumerate((1e-9, 1e-7, 1e-4)):
            found = read.series.evaluate(time, derivative=order)
            assert np.allclose(found, own.series.evaluate(time, derivative=order), atol=near)


def test_the_results_are_told(folder: Path) -> None:
    plan, told = small_plan(), json.loads((folder / "plan.json").read_text())
    assert told["robot"] == "arm"
    assert told["joint_names"] == ["a", "b"]
    assert told["limits"]["ok"] is True
    assert {row["kind"] for row in told["limits"]["rows"]} >= {"position", "velocity", "torque"}
    assert told["condition_number"] == plan.condition_number
    assert list(told["standard_errors"]) == list(plan.names)
    assert told["expected"]["sentences"] == list(plan.expected.sentences())
    assert told["assumed"] == list(plan.limits.notes)
    assert told["settings"]["seed"] == 3


def test_limits_and_obstacles_are_those_given(folder: Path) -> None:
    config = load_toml(folder / "plan.toml")
    assert (config["limits"], config["obstacles"]) == ("limits.toml", "obstacles.toml")
    assert config["friction"] == ["coulomb", "viscous", "offset"]
    assert "robot" not in config  # it was given in memory
    robot = small_plan().robot
    one, other = (each.of(robot) for each in (LIMITS, Limits.from_toml(folder / "limits.toml")))
    assert np.array_equal(one.acceleration, other.acceleration)
    assert np.array_equal(one.jerk, other.jerk)
    assert one.clearance == other.clearance
    assert obstacles_from_toml(folder / "obstacles.toml") == AROUND


def test_a_search_that_ended_early_says_so(tmp_path: Path) -> None:
    """Options do not make the same plan again where time ended the search."""
    plan = small_plan()
    write_plan(plan, tmp_path, figures=False)
    assert "another run" not in (tmp_path / "plan.toml").read_text()
    timed = replace(plan, settings={**plan.settings, "time_limit": 3.0})
    stopped = replace(plan, history=({**plan.history[0], "status": INTERRUPTED},))
    for each, word in ((timed, "time limit"), (stopped, "interrupted")):
        write_plan(each, tmp_path, figures=False)
        assert word in (tmp_path / "plan.toml").read_text().splitlines()[0]
        load_toml(tmp_path / "plan.toml")


@pytest.mark.parametrize("name", ["report.html", "trajectory.csv", "plan.json", "limits.toml"])
def test_files_that_no_plan_wrote_are_not_replaced(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("mine")
    with pytest.raises(ExportError, match=f"{name}, which no run like this wrote"):
        write_plan(small_plan(), tmp_path, figures=False)
    assert [file.name for file in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == "mine"


def test_a_plan_replaces_a_plan_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    first = write_plan(small_plan(), tmp_path, figures=False)
    content = {path.name: path.read_bytes() for path in first}
    second = write_plan(small_plan(), tmp_path, figures=False)
    assert {path.name: path.read_bytes() for path in second} == content
    assert (tmp_path / "mine.txt").read_text() == "mine"
    # With options of a command there are no limits.toml and obstacles.toml: those of before go.
    write_plan(small_plan(), tmp_path, figures=False, config="seed = 1\n")
    assert not (tmp_path / "limits.toml").exists()
    (tmp_path / "plan.toml").write_text("# my own\n")
    refuses(ExportError, "which no run wrote", write_plan, small_plan(), tmp_path, figures=False)
    assert (tmp_path / "plan.toml").read_text() == "# my own\n"


def test_what_is_not_installed_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(write.importlib.util, "find_spec", lambda name: None)
    told: list[str] = []
    names = {path.name for path in write_plan(small_plan(), tmp_path, report=told.append)}
    assert FILES - names == {"trajectory.parquet", "report.html"}
    assert any("pip install 'jinja2>=" in each for each in told)
    assert any("'pyarrow>=" in each for each in told)


def test_a_plan_without_collisions(tmp_path: Path) -> None:
    pytest.importorskip("jinja2")
    plan = replace(small_plan(), collision=None)
    names = {path.name for path in write_plan(plan, tmp_path)}
    assert "report.html" in names
    assert "no collisions were checked" in (tmp_path / "report.html").read_text()


def test_nothing_half_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(write, "write_joint_trajectory", fail)
    with pytest.raises(ExportError, match="No space left"):
        write_plan(small_plan(), tmp_path / "plan", figures=False)
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").write_text("")
    refuses(ExportError, "it is a file", write_plan, small_plan(), tmp_path / "file")


def test_it_can_be_rehearsed(folder: Path) -> None:
    """The simulated robot follows the motion of the file."""
    pytest.importorskip("mujoco")
    motion = sdpid.Trajectory.from_toml(folder / "trajectory.toml")
    log = sdpid.simulate(small_plan().robot, motion, seed=1)
    assert log.n_samples >= motion.n_samples
