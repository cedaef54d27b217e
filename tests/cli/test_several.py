"""The command with several logs, folds, intervals and other filters."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

import sdpid
from sdpid._common.progress import progress
from tests.helpers.commands import printed, ran, refused, run, told, with_results
from tests.helpers.crawl import crawl
from tests.helpers.forged import contents, edit_json
from tests.helpers.legged import quadruped
from tests.helpers.runs import recorded


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a robot, its log, the results of a run, and three logs more."""
    folder = with_results(tmp_path_factory.mktemp("runs"))
    for seed in (1, 2, 3):
        recorded(seed).to_csv(folder / f"run{seed}.csv")
    return folder


def identified(folder: Path, out: str, *more: Any) -> Path:
    """Run `sdpid identify` of the first log, and return the folder of results."""
    arm = ("--robot", folder / "arm.urdf", "--out", folder / out, "--no-figures")
    done = ran("identify", folder / "run1.csv", *more, *arm)
    (folder / out / "told.txt").write_text(done.stdout)
    return folder / out


def test_several_logs(folder: Path) -> None:
    more = ("--validation", folder / "run3.csv", "--folds", 3, "--order", 3, "--json")
    out = identified(folder, "out", folder / "run2.csv", *more)
    found = json.loads((out / "told.txt").read_text())
    assert found["certified"] is True
    assert found["validation"]["relative_residual"] < 0.02
    assert found["cross_validation"]["by"] == "time"
    assert len(found["cross_validation"]["folds"]) == 3
    assert found["intervals"]["method"] == "gauss_markov"
    for words in ("2 pieces joined", "has the median of their cut-offs", "filter of order 3"):
        assert any(words in note for note in found["notes"])
    assert "3 blocks of time held out in turn" in " ".join(found["verdict"])
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "Cross-validation" in page
    assert "block 3 of 3" in page
    assert json.loads((out / "result.json").read_text())["cross_validation"]


def test_in_words_and_without_intervals(folder: Path) -> None:
    out = identified(folder, "b", "--no-intervals", "--folds", 2, "-v", "--consistency", "none")
    assert not (out / "identified.urdf").exists()
    assert (out / "certificate.json").exists()
    told = (out / "told.txt").read_text()
    assert "2 blocks of time held out in turn" in told
    assert "block 2 of 2" in told
    assert "intervals" not in told
    assert "lower" not in (out / "parameters.csv").read_text()


def test_other_intervals(folder: Path) -> None:
    out = identified(folder, "c", "--interval-method", "profile")
    found = json.loads((out / "result.json").read_text())["intervals"]
    labels = {entry["label"] for entry in found["parameters"]}
    assert "from data" in labels
    assert len(labels) > 1


def test_one_bar_at_a_time() -> None:
    with progress(2, "outer", enabled=True) as outer:
        outer(1)
        with progress(2, "inner", enabled=True) as inner:
            assert inner(1) is None
            assert inner.__closure__ is None
        outer(1)
    with progress(1, "next", enabled=True) as bar:
        assert bar.__closure__ is not None


# ---- The command with logs of a robot on legs.


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a log of a robot that walks."""
    path: Path = tmp_path_factory.mktemp("walk") / "walk.parquet"
    crawl().log().to_parquet(path)
    return path


def test_certify_takes_parameters_of_a_robot_on_legs(walk: Path, tmp_path: Path) -> None:
    """Of a robot by name and by URDF, and parameters from that URDF, whose base is fixed in it."""
    urdf = tmp_path / "solo.urdf"
    urdf.write_text(quadruped().urdf)
    for robot in ("solo12", urdf):
        done = run("certify", urdf, "--log", walk, "--robot", robot, "--json")
        assert done.exit_code in (0, 3), done.output
        assert json.loads(done.stdout)["feasible"] is not None


def test_validate_says_what_joints_and_base_miss(walk: Path) -> None:
    shown = printed("validate", walk, "--robot", "solo12", "--cutoff", "20")
    assert "base, force in N" in shown
    assert "root_joint" not in shown
    found = told("validate", walk, "--robot", "solo12")
    assert found["relative_residual"] < 0.02
    assert found["floating"]["force"] < 0.1
    assert next(iter(found["joints"])) == "FL_HAA"


# ``sdpid sample``: robots from the folder of a run, or one line and a status.


def test_robots_of_a_results_folder(folder: Path, tmp_path: Path) -> None:
    results, out, again = folder / "results", tmp_path / "robots", tmp_path / "again"
    before = contents(results)
    content = told("sample", results, "-n", 3, "--out", out, "--urdf", "--mjcf")
    robots = contents(out)
    assert {Path(file).name for file in content["files"]} == {*robots}
    assert {"robot_0003.urdf", "robot_0003.xml", "mean.xml", "ranges.json"} < {*robots}
    assert all(sdpid.audit_urdf(path).passed for path in out.glob("*.urdf"))
    assert set(content["ranges"]["bodies"]) == {"upper", "fore"}
    assert content["number"] == 3
    # The file of the run names the folder of results; nothing is written there.
    assert contents(results) == before
    config = ("--config", results / "run.toml", "-n", 3, "--out", again, "-q")
    assert ran("sample", *config).output == ""
    drawn = {name for name in robots if name.startswith("robot_") and name.endswith(".urdf")}
    assert all(contents(again)[name] == robots[name] for name in drawn)
    # A single robot has no ranges to speak of.
    other = " ".join(printed("sample", results, "-n", 1, "--out", again, "--seed", 1).split())
    for words in ("1 robots drawn with seed 1", "ranges of one robot have no width"):
        assert words in other
    assert "draw 40 or more" in other
    assert contents(again)["robot_0001.urdf"] != robots["robot_0001.urdf"]


def test_a_run_that_gives_other_parameters_now(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder / "results", tmp_path / "results")
    for name in ("arm.urdf", "log.npz"):
        shutil.copy(folder / name, tmp_path / name)

    def heavier(content: Any) -> None:
        for entry in content["standard"].values():
            entry["value"] *= 1.2

    edit_json(tmp_path / "results" / "parameters.json", heavier)
    done = run("sample", tmp_path / "results", "--out", tmp_path / "robots")
    words = "the run, made again, predicts efforts that differ by", "at most 1e-05 is rounding"
    refused(done, 2, *words)
    assert not (tmp_path / "robots").exists()
