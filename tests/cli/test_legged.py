"""The command with logs of a robot on legs."""

import json
from pathlib import Path

from tests.cli.test_cli import run
from tests.experiment.processing.floating.crawl import crawl
from tests.helpers.legged import quadruped


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
