"""The command with several logs, folds, intervals and other filters."""

import json
from pathlib import Path

import numpy as np
import pytest

from sdpid._common import progress as _progress
from tests.experiment.processing.floating.crawl import crawl
from tests.helpers.arm_files import ARM_URDF
from tests.helpers.commands import ran, refused, run
from tests.helpers.legged import quadruped
from tests.helpers.runs import recorded


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a URDF and three CSV files."""
    folder = tmp_path_factory.mktemp("runs")
    (folder / "arm.urdf").write_text(ARM_URDF)
    for seed in (1, 2, 3):
        log = recorded(seed)
        table = np.column_stack([log.time, log.position, log.effort])
        header = "time,position_a,position_b,effort_a,effort_b"
        np.savetxt(folder / f"run{seed}.csv", table, delimiter=",", header=header, comments="")
    return folder


def test_several_logs(folder: Path) -> None:
    logs = [folder / f"run{i}.csv" for i in (1, 2, 3)]
    out = folder / "out"
    done = ran(
        *("identify", *logs[:2], "--robot", folder / "arm.urdf", "--out", out, "--no-figures"),
        *("--validation", logs[2], "--folds", 3, "--filter", "bessel", "--json"),
    )
    found = json.loads(done.stdout)
    assert found["certified"] is True
    assert found["validation"]["relative_residual"] < 0.02
    assert found["cross_validation"]["by"] == "time"
    assert len(found["cross_validation"]["folds"]) == 3
    assert found["intervals"]["method"] == "gauss_markov"
    assert any("2 pieces joined" in note for note in found["notes"])
    assert any("has the median of their cut-offs" in note for note in found["notes"])
    assert any("Bessel filter" in note for note in found["notes"])
    assert "3 blocks of time held out in turn" in " ".join(found["verdict"])
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "Cross-validation" in page
    assert "block 3 of 3" in page
    assert json.loads((out / "result.json").read_text())["cross_validation"]


def test_in_words_and_without_intervals(folder: Path) -> None:
    done = ran(
        *("identify", folder / "run1.csv", "--robot", folder / "arm.urdf", "--out", folder / "b"),
        *("--no-figures", "--no-intervals", "--folds", 2, "--derivative", "central6", "-v"),
    )
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


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--filter", "brick"), "filter"),
        (("--derivative", "none"), "derivative"),
        (("--folds", "1"), "folds is 1"),
        (("--period", "5"), "has a period"),
    ],
)
def test_what_is_refused(folder: Path, options: tuple[str, ...], words: str) -> None:
    logs = [folder / "run1.csv", folder / "run2.csv"]
    done = run("identify", *logs, "--robot", folder / "arm.urdf", "--out", folder / "d", *options)
    refused(done, 2, words)
    assert not (folder / "d").exists()


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
    found = json.loads(run("validate", log, "--robot", "solo12", "--json").stdout)
    assert found["relative_residual"] < 0.02
    assert found["floating"]["force"] < 0.1
    assert next(iter(found["joints"])) == "FL_HAA"
