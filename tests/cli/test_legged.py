"""The command with logs of a robot on legs."""

from __future__ import annotations

import json
from pathlib import Path

from tests.cli.test_cli import run
from tests.experiment.processing.floating.crawl import crawl


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
