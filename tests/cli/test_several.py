"""The command with several logs, folds, intervals and other filters."""

import json
import shutil
from pathlib import Path

import pytest

import sdpid
from sdpid._common import progress as _progress
from tests.helpers.arm_files import ARM_URDF, write_arm
from tests.helpers.commands import ran, refused, run, told
from tests.helpers.crawl import crawl
from tests.helpers.legged import quadruped
from tests.helpers.runs import recorded


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a URDF and three CSV files."""
    folder = tmp_path_factory.mktemp("runs")
    (folder / "arm.urdf").write_text(ARM_URDF)
    for seed in (1, 2, 3):
        recorded(seed).to_csv(folder / f"run{seed}.csv")
    return folder


def test_several_logs(folder: Path) -> None:
    logs = [folder / f"run{i}.csv" for i in (1, 2, 3)]
    out = folder / "out"
    done = ran(
        *("identify", *logs[:2], "--robot", folder / "arm.urdf", "--out", out, "--no-figures"),
        *("--validation", logs[2], "--folds", 3, "--order", 3, "--json"),
    )
    found = json.loads(done.stdout)
    assert found["certified"] is True
    assert found["validation"]["relative_residual"] < 0.02
    assert found["cross_validation"]["by"] == "time"
    assert len(found["cross_validation"]["folds"]) == 3
    assert found["intervals"]["method"] == "gauss_markov"
    assert any("2 pieces joined" in note for note in found["notes"])
    assert any("has the median of their cut-offs" in note for note in found["notes"])
    assert any("filter of order 3" in note for note in found["notes"])
    assert "3 blocks of time held out in turn" in " ".join(found["verdict"])
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "Cross-validation" in page
    assert "block 3 of 3" in page
    assert json.loads((out / "result.json").read_text())["cross_validation"]


def test_in_words_and_without_intervals(folder: Path) -> None:
    done = ran(
        *("identify", folder / "run1.csv", "--robot", folder / "arm.urdf", "--out", folder / "b"),
        *("--no-figures", "--no-intervals", "--folds", 2, "-v", "--consistency", "none"),
    )
    assert not (folder / "b" / "identified.urdf").exists()
    assert (folder / "b" / "certificate.json").exists()
    assert "2 blocks of time held out in turn" in done.stdout
    assert "block 2 of 2" in done.stdout
    assert "intervals" not in done.stdout
    assert "lower" not in (folder / "b" / "parameters.csv").read_text()


def test_other_intervals(folder: Path) -> None:
    done = ran(
        *("identify", folder / "run1.csv", "--robot", folder / "arm.urdf", "--out", folder / "c"),
        *("--no-figures", "--interval-method", "profile", "--json"),
    )
    labels = {entry["label"] for entry in json.loads(done.stdout)["intervals"]["parameters"]}
    assert "from data" in labels
    assert len(labels) > 1


def test_one_bar_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    with _progress.progress(2, "outer", enabled=True) as outer:
        outer(1)
        with _progress.progress(2, "inner", enabled=True) as inner:
            assert inner(1) is None
            assert inner.__closure__ is None
        outer(1)
    with _progress.progress(1, "next", enabled=True) as bar:
        assert bar.__closure__ is not None


# ---- The command with logs of a robot on legs.


def test_certify_takes_parameters_of_a_robot_on_legs(tmp_path: Path) -> None:
    """Of a robot by name and by URDF, and parameters from that URDF, whose base is fixed in it."""
    log, urdf = tmp_path / "walk.parquet", tmp_path / "solo.urdf"
    crawl().log().to_parquet(log)
    urdf.write_text(quadruped().urdf)
    for robot in ("solo12", urdf):
        done = run("certify", urdf, "--log", log, "--robot", robot, "--json")
        assert done.exit_code in (0, 3), done.output
        assert json.loads(done.stdout)["feasible"] is not None


def test_validate_says_what_joints_and_base_miss(tmp_path: Path) -> None:
    log = tmp_path / "walk.parquet"
    crawl().log().to_parquet(log)
    done = run("validate", log, "--robot", "solo12", "--cutoff", "20")
    assert done.exit_code == 0, done.output
    assert "base, force in N" in done.output
    assert "root_joint" not in done.output
    found = told("validate", log, "--robot", "solo12")
    assert found["relative_residual"] < 0.02
    assert found["floating"]["force"] < 0.1
    assert next(iter(found["joints"])) == "FL_HAA"


# ``sdpid sample``: robots from the folder of a run, or one line and a status.


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a robot, its log, and the results of a run."""
    made = tmp_path_factory.mktemp("arm")
    write_arm(made, joint_names=["a", "b"])
    arguments = (made / "log.npz", "--robot", made / "arm.urdf", "--out", made / "results")
    ran("identify", *arguments, "--no-figures", "--no-intervals", "--effects", "none")
    return made


def test_robots_of_a_results_folder(made: Path, tmp_path: Path) -> None:
    results, out = made / "results", tmp_path / "robots"
    before = {path.name: path.read_bytes() for path in results.iterdir()}
    arguments = ("sample", results, "-n", 3, "--out", out, "--urdf", "--mjcf")
    done = ran(*arguments, "--json")
    content = json.loads(done.stdout)
    names = {Path(file).name for file in content["files"]}
    assert names == {path.name for path in out.iterdir()}
    assert {"robot_0003.urdf", "robot_0003.xml", "mean.xml", "ranges.json"} < names
    assert all(sdpid.audit_urdf(path).passed for path in out.glob("*.urdf"))
    assert set(content["ranges"]["bodies"]) == {"upper", "fore"}
    assert content["number"] == 3
    # The file of the run names the folder of results; nothing is written there.
    assert {path.name: path.read_bytes() for path in results.iterdir()} == before
    again = tmp_path / "again"
    done = run("sample", "--config", results / "run.toml", "-n", 3, "--out", again, "-q")
    assert (done.exit_code, done.output) == (0, "")
    for path in out.glob("robot_*.urdf"):
        assert (again / path.name).read_bytes() == path.read_bytes()
    # A single robot has no ranges to speak of.
    other = ran("sample", results, "-n", 1, "--out", again, "--seed", 1)
    assert "1 robots drawn with seed 1" in other.stdout
    assert "ranges of one robot have no width" in other.stdout
    assert "draw 40 or more" in " ".join(other.stdout.split())
    assert (again / "robot_0001.urdf").read_bytes() != (out / "robot_0001.urdf").read_bytes()


def test_a_run_that_gives_other_parameters_now(made: Path, tmp_path: Path) -> None:
    results = tmp_path / "results"
    shutil.copytree(made / "results", results)
    for name in ("arm.urdf", "log.npz"):
        shutil.copy(made / name, tmp_path / name)
    content = json.loads((results / "parameters.json").read_text())
    for entry in content["standard"].values():
        entry["value"] *= 1.2
    (results / "parameters.json").write_text(json.dumps(content))
    done = run("sample", results, "--out", tmp_path / "robots")
    words = "the run, made again, predicts efforts that differ by", "at most 1e-05 is rounding"
    refused(done, 2, *words)
    assert not (tmp_path / "robots").exists()
