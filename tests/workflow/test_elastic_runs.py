"""Runs on logs of two encoders: what `identify` finds of gears, and which files it writes."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sdpid
from sdpid.errors import DataError
from tests.helpers.commands import printed, refused, run
from tests.helpers.elastic import DELAY, ROTORS, STIFFNESS, arm, log
from tests.helpers.refusals import refuses


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return the files of a robot and of a log with positions of links."""
    folder = tmp_path_factory.mktemp("elastic")
    urdf, path = folder / "arm.urdf", folder / "run.parquet"
    assert arm().urdf is not None
    urdf.write_text(arm().urdf, encoding="utf-8")
    log(1).to_parquet(path)
    return urdf, path


def test_a_run_writes_what_it_finds_of_gears(files: tuple[Path, Path], tmp_path: Path):
    urdf, path = files
    out = tmp_path / "out"
    rotors = ",".join(map(str, ROTORS))
    said = printed(
        *("identify", path, "--robot", urdf, "--out", out, "--rotor-inertia", rotors, "--elastic")
    )
    (line,) = [each for each in said.splitlines() if each.startswith("elasticity: ")]
    assert "links' encoders late by 3 ± " in line
    assert "stiffness of joint_1 2e+04 (" in line
    assert "none told of joint_3" in line
    kept = json.loads((out / "elasticity.json").read_text())
    assert kept["stiffness"][2] is None
    np.testing.assert_allclose(kept["stiffness"][:2], STIFFNESS[:2], rtol=0.01)
    np.testing.assert_allclose(kept["delay_s"], DELAY, atol=1e-5)
    with (out / "elasticity.csv").open(encoding="utf-8") as table:
        rows = list(csv.DictReader(table))
    assert [row["joint"] for row in rows] == list(arm().joint_names)
    assert float(rows[1]["stiffness, N·m/rad"]) == kept["stiffness"][1]
    assert rows[2]["stiffness, N·m/rad"] == ""
    assert 'name="joint_1_gear"' in (out / "identified_elastic.xml").read_text()
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("deflection over the torque through the gear") == 3
    assert json.loads((out / "result.json").read_text())["elasticity"] == kept
    listed = json.loads((out / "manifest.json").read_text())["files"]
    assert {"elasticity.json", "elasticity.csv", "identified_elastic.xml"} <= set(listed)
    printed("verify", out)


def test_what_was_not_found_is_said(files: tuple[Path, Path], tmp_path: Path):
    urdf, _ = files
    blind = tmp_path / "blind.parquet"
    replace(log(1), link_position=None).to_parquet(blind)
    common = ("identify", blind, "--robot", urdf, "--out", tmp_path / "out")
    refused(run(*common, "--rotor-inertia", "1,1,1"), 2, "rotor_inertia", "positions of links")
    said = printed(*common, "--elastic", "--tendons")
    assert "no identified_elastic.xml: nothing was found" in said
    assert "no tendons in identified.xml: nothing was found of friction over position" in said
    assert "--effects position" in said
    assert not (tmp_path / "out" / "elasticity.json").exists()


def test_links_that_repeat_motors_are_noted():
    same = replace(log(1), link_position=log(1).position)
    result = sdpid.identify(arm(), same, intervals=False)
    assert result.elasticity is None
    assert any(note.startswith("no elasticity: ") for note in result.notes)
    refuses(
        DataError,
        "no joint has a second encoder",
        lambda: sdpid.identify(arm(), same, intervals=False, rotor_inertia=ROTORS),
    )
