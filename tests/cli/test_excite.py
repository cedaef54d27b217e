"""`sdpid excite`: what it writes and prints, how it ends, and that its plan can be made again."""

import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid._common.files import load_toml
from sdpid.cli.excite import SURROUNDINGS, obstacles
from sdpid.excitation.geometry.obstacles import Mesh
from sdpid.experiment.trajectory.reading import read_trajectory
from tests.helpers.arm_files import ARM_URDF
from tests.helpers.commands import given, printed, python, ran, refused, run, told
from tests.helpers.logs import write_csv

LIMITS = """
[a]
acceleration = 5.0
[b]
acceleration = 8.0
[arm]
jerk = 200.0
clearance = 0.02
[[table]]
height = -0.5
"""
OPTIONS = ("--duration", 4, "--starts", 1, "--seed", 3, "--no-figures")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a robot, limits, and a plan."""
    made = tmp_path_factory.mktemp("excite")
    (made / "arm.urdf").write_text(ARM_URDF)
    (made / "limits.toml").write_text(LIMITS)
    files = ("arm.urdf", "--limits", made / "limits.toml", "--out", made / "plan")
    done = ran("excite", made / files[0], *files[1:], "--wall", "-x=0.7", *OPTIONS)
    assert done.stderr == ""
    (made / "told.txt").write_text(done.stdout)
    return made


def test_it_writes_and_says_what_to_run(folder: Path) -> None:
    names = {path.name for path in (folder / "plan").iterdir()}
    assert {"trajectory.csv", "trajectory.toml", "plan.toml", "plan.json"} <= names
    told = (folder / "told.txt").read_text()
    assert {"run", "safe"} <= {line.split(":")[0] for line in told.splitlines()}
    assert "Every limit holds at every instant" in told
    limits = json.loads((folder / "plan" / "plan.json").read_text())["limits"]
    assert limits["ok"] is True
    checked = [row["subject"] for row in limits["rows"] if row["kind"] == "distance"]
    assert {"fore – table", "fore – wall -x"} <= {*checked}
    bound = {row["subject"]: row["limit"] for row in limits["rows"] if row["kind"] == "jerk"}
    assert bound == {"a": 200.0, "b": 200.0}


def test_a_first_safe_motion_and_how_to_search_on(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.modules["sdpid.cli.excite"], "_QUICK", 2.0)
    monkeypatch.chdir(tmp_path)
    told = printed("excite", folder / "arm.urdf", "--quick", "--duration", 4, "--out", "plan")
    assert "safe: Every limit holds at every instant: " in told
    assert told.endswith("excite --config plan/plan.toml --no-quick searches on\n")
    assert load_toml("plan/plan.toml")["quick"] is True
    notes = json.loads(Path("plan/plan.json").read_text())["notes"]
    assert "its time limit" in " ".join(notes)


def test_the_written_file_makes_the_plan_again(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bit for bit, from another folder."""
    config = folder / "plan" / "plan.toml"
    expected = {"robot": "../arm.urdf", "limits": "../limits.toml", "for": "all"}
    assert load_toml(config).items() >= expected.items()
    monkeypatch.chdir(tmp_path)
    again = told("excite", "--config", config, "--out", "again")
    for name in ("trajectory.csv", "trajectory.toml"):
        assert (folder / "plan" / name).read_bytes() == Path("again", name).read_bytes()
    assert again["limits"]["ok"] is True
    assert {Path(file).name for file in again["files"]} >= {"trajectory.csv", "plan.json"}


def test_any_trajectory_is_checked(folder: Path, tmp_path: Path) -> None:
    """A plan holds its limits; faster it does not, and the excess is named."""
    plan, fast = folder / "plan" / "trajectory.csv", tmp_path / "fast.csv"
    checked = ("excite", folder / "arm.urdf", "--limits", folder / "limits.toml", "--check")
    assert "every limit holds at every instant" in printed(*checked, plan)
    motion = read_trajectory(plan, ("a", "b"))
    t = np.linspace(0.0, motion.period, 401)
    write_csv(fast, ("time", "position_a", "position_b"), t / 3.0, motion.series.evaluate(t))
    done = run(*checked, fast)
    refused(done, 3, "fast.csv", "acceleration", "above the limit")
    assert "broken" in done.stdout
    done = run(*checked, fast, "--json")
    assert done.exit_code == 3
    assert json.loads(done.stdout)["ok"] is False
    assert run(*checked, fast, "-q").stdout == ""


def test_obstacles_may_stand_in_the_file_of_limits(tmp_path: Path) -> None:
    """Every kind of them counts, and meshes are looked up beside the file."""
    (tmp_path / "limits.toml").write_text(
        "[arm]\nclearance = 0.02\n[[table]]\n[[wall]]\ndistance = 1.0\ndirection = 'x'\n"
        "[[plane]]\npoint = [0, 0, 2]\nnormal = [0, 0, -1]\n[[box]]\nsize = [1, 1, 1]\n"
        "[[mesh]]\npath = 'part.stl'\n"
    )
    *found, mesh = obstacles(given(SURROUNDINGS, limits=tmp_path / "limits.toml"))
    assert [type(each).__name__ for each in found] == ["Plane", "Plane", "Plane", "Box"]
    assert isinstance(mesh, Mesh)
    assert Path(mesh.path) == tmp_path / "part.stl"


INTERRUPTED = """
import os, signal, time
import sdpid.excitation.design.design as design
from sdpid import cli
from tests.helpers.plans import small_plan
plan = small_plan()
def stopped(*arguments, **options):
    try:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(300.0)
    except KeyboardInterrupt:
        return plan
design.design_excitation = stopped
cli.main()
"""


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
@pytest.mark.usefixtures("interruptible")
def test_ctrl_c_writes_the_best_so_far(folder: Path, tmp_path: Path) -> None:
    """An interrupt of the search reaches it, and the plan that it returns is written."""
    script, out = tmp_path / "stopped.py", tmp_path / "plan"
    script.write_text(INTERRUPTED)
    command = (script, "excite", folder / "arm.urdf", "--no-figures", "--out", out)
    done = python(*command, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)})
    assert done.returncode == 0, done.stderr
    assert (out / "trajectory.csv").is_file()


def test_a_robot_that_stands(tmp_path: Path) -> None:
    out = tmp_path / "plan"
    done = ran("excite", "solo12", "--stand", "--duration", "2", "--steps", "3",
               "--no-figures", "--grip", "0.4", "--out", out)  # fmt: skip
    assert "of 130 base parameters known ten times as well as before" in done.output
    assert {file.name for file in out.iterdir()} == {"trajectory.csv", "plan.toml", "plan.json"}
    log = tmp_path / "run.csv"
    done = ran("simulate", "solo12", "--motion", out / "trajectory.csv", "--out", log)
    assert sdpid.read_recording(log).contacts is not None


def test_a_time_limit_is_that_of_the_whole_command(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []

    def design(*_: Any, time_limit: float, **__: Any) -> Any:
        seen.append(time_limit)
        raise sdpid.errors.DataError("seen")

    monkeypatch.setattr("sdpid.excitation.design.design.design_excitation", design)
    monkeypatch.setattr("time.process_time", lambda: 1.5)
    for limit in (60, 10, -1):
        run("excite", folder / "arm.urdf", "--out", folder / "other", "--time-limit", limit)
    long, short, wrong = seen
    # Starting and the plan's files take some of it.
    assert 20.0 < long <= 60.0 - 2.5
    assert 2.0 <= short <= 10.0 - 2.5
    assert wrong == -1.0
