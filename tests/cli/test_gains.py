"""Currents and a file of gains on the command line: from the log to the proof."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import sdpid
from sdpid.cli import app
from tests.helpers.arm_files import ARM_URDF, arm_log
from tests.helpers.world import GAINS as TRUE
from tests.helpers.world import LOAD, write_world

GAINS = np.array([10.0, 5.0])


def run(*arguments: object, status: int = 0) -> str:
    found = CliRunner().invoke(app, list(map(str, arguments)), catch_exceptions=False)
    assert found.exit_code == status, found.output
    return found.stdout if status == 0 else found.output


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with an arm, a log of its currents, gains, and a result."""
    folder = tmp_path_factory.mktemp("currents")
    (folder / "arm.urdf").write_text(ARM_URDF, encoding="utf-8")
    time, q, effort = arm_log(folder / "arm.urdf")
    log = sdpid.Recording(
        time=time, position=q, effort=effort / GAINS, joint_names=("a", "b"), currents=True
    )
    log.to_csv(folder / "run.csv")
    gains = sdpid.DriveGains(
        joint_names=("b", "a"),
        gains=GAINS[::-1],
        covariance=np.diag((0.05 * GAINS[::-1]) ** 2),
        basis="a load of 2 kg",
    )
    gains.to_toml(folder / "gains.toml")
    arm = ("--robot", folder / "arm.urdf")
    out = ("--gains", folder / "gains.toml", "--out", folder / "out", "--no-figures", "-q")
    run("identify", folder / "run.csv", *arm, *out)
    return folder


def test_currents_without_gains_are_refused(folder: Path) -> None:
    said = run("identify", folder / "run.csv", "--robot", folder / "arm.urdf", status=2)
    assert "look like currents: give gains=" in said
    unit = ("--column", "effort=current_a,current_b", "--unit", "effort=A")
    said = run("identify", folder / "run.csv", "--robot", folder / "arm.urdf", *unit, status=2)
    assert "currents in A, which need gains: let `sdpid gains`" in said


def test_gains_are_kept_shown_and_proven(folder: Path) -> None:
    out = folder / "out"
    inputs = json.loads((out / "manifest.json").read_text())["inputs"]
    assert [each["name"] for each in inputs if each["role"] == "gains"] == ["gains.toml"]
    result = json.loads((out / "result.json").read_text())
    assert result["problem"]["gains"]["gains"] == GAINS.tolist()
    assert any("gains that are known to 5 % (one standard error)" in s for s in result["verdict"])
    shares = {each["name"]: each["gains_share"] for each in result["intervals"]["parameters"]}
    assert max(shares.values()) > 0.9
    report = (out / "report.html").read_text()
    assert "Gains that made efforts of currents: gains.toml, by a load of 2 kg" in report
    assert 'gains = "' in (out / "run.toml").read_text()
    said = run("verify", out, "--data", folder / "run.csv", "--robot", folder / "arm.urdf")
    assert "gains.toml: b 5.0, a 10.0 N.m/A" in said
    assert "PROVEN" in said.splitlines()[-1]


def test_other_gains_in_the_recipe_are_no_proof(folder: Path) -> None:
    """Who changes the gains that a result states changes its rows."""
    from sdpid.verifier.manifest import sealed

    path = folder / "out" / "manifest.json"
    content: dict[str, Any] = json.loads(path.read_text())
    kept = path.read_text()
    content["recipe"]["logs"][0]["reading"]["gains"]["gains"] = [5.0, 9.9]
    del content["sha256"]
    path.write_text(json.dumps(sealed(content)))
    try:
        said = run("verify", folder / "out", "--data", folder / "run.csv", status=1)
    finally:
        path.write_text(kept)
    assert "rows: A, rhs and floor of the certificate are not of the rows of this log" in said


def test_gains_of_a_known_load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From currents to gains by a file of options, and to the load that made them."""
    monkeypatch.chdir(tmp_path)
    write_world(tmp_path)
    Path("gains_of.toml").write_text(
        'robot = "arm.urdf"\nwithout = "currents.csv"\nwith = "currents_loaded.csv"\n'
        f'load = {LOAD}\neffects = "none"\n'
    )
    said = run("gains", "--config", "gains_of.toml", "--out", "found.toml")
    assert "drive gains, by a load of 2 kg (95 % intervals)" in said
    found = sdpid.DriveGains.from_toml("found.toml")
    assert set(found.sources) == {"currents.csv", "currents_loaded.csv"}
    low, high = found.intervals(0.999).T
    assert np.all((low < TRUE) & (high > TRUE))
    more = ("--load-com", "0.2,0,0.08", "--frame", "tool0", "--load-error", "0.02")
    more += ("--known", f"joint_1={TRUE[0]}", "--out", "known.toml", "--json")
    plain = json.loads(run("gains", "--config", "gains_of.toml", *more))
    assert plain["gains"]["gains"][0] == TRUE[0]
    assert plain["gains"]["common_factor"] == 0.0
    assert plain["file"] == "known.toml"
    logs = ("currents_loaded.csv", "--without", "currents.csv", "--gains", "found.toml")
    load = json.loads(run("payload", *logs, "--robot", "arm.urdf", "--json"))
    assert load["intervals"]["mass"][0] < LOAD < load["intervals"]["mass"][1]
    assert load["gains_share"]["mass"] > 0.01


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--load", "2", "--load-com", "1,2"), "--load-com 1,2: has 2 numbers, expected 3"),
        (("--load-error", "0.1"), "--load-error: of a load without a mass; give --load"),
        (("--load", "2", "--known", "a=x"), "--known x: expected numbers"),
        (("--load", "2"), "load: there is no recording with load; give it"),
        (("--out", "run.csv"), "run.csv"),
    ],
)
def test_what_cannot_be_meant_is_told(
    folder: Path, options: tuple[str, ...], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    before = {path.name for path in folder.iterdir()}
    shown = run("gains", "--robot", "arm.urdf", "--without", "run.csv", *options, status=2)
    assert said in shown
    assert {path.name for path in folder.iterdir()} == before


def test_info_says_where_torques_come_from(folder: Path) -> None:
    said = run("info", folder / "run.csv", "--gains", folder / "gains.toml")
    assert "gains: gains.toml, by a load of 2 kg: standard errors of 5 %" in said
