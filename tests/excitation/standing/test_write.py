"""The folder of a plan for a robot that stands."""

import json
from pathlib import Path

import numpy as np

import sdpid
from sdpid.errors import DataError
from sdpid.excitation.standing.write import write_standing
from sdpid.experiment.trajectory.whole_body import WholeBodyMotion
from tests.helpers.refusals import refuses
from tests.helpers.standing import standing_plan


def test_a_plan_is_written_and_read(tmp_path: Path) -> None:
    plan = standing_plan()
    files = write_standing(plan, tmp_path / "plan")
    assert {file.name for file in files} >= {"trajectory.csv", "plan.json"}
    read = WholeBodyMotion.from_csv(tmp_path / "plan" / "trajectory.csv")
    for name in ("time", "position", "effort", "base_orientation", "down", "forces"):
        np.testing.assert_array_equal(getattr(read, name), getattr(plan.motion, name))
    content = json.loads((tmp_path / "plan" / "plan.json").read_text(encoding="utf-8"))
    assert content["limits"]["ok"]
    assert len(content["base_parameters"]) == plan.base.count
    log = sdpid.read_recording(tmp_path / "plan" / "trajectory.csv")
    assert log.base is not None
    assert log.contacts is not None
    (tmp_path / "bad.csv").write_text("time,position_a\n0,1\n", encoding="utf-8")
    refuses(DataError, "has no column 'velocity_a'", WholeBodyMotion.from_csv, tmp_path / "bad.csv")
