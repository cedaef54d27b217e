"""Gains and payloads on the command line, and every command on the smallest robots."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid.robot.inertia import theta_from_physical
from tests.helpers.arm_files import write_arm
from tests.helpers.commands import printed, told
from tests.helpers.forged import edit_json, reseal, set_to
from tests.helpers.motions import sines
from tests.helpers.small_robots import LOAD as BODY
from tests.helpers.small_robots import MASS as WEIGHT
from tests.helpers.small_robots import SMALL
from tests.helpers.world import GAINS as TRUE
from tests.helpers.world import LOAD, write_world

GAINS = np.array([10.0, 5.0])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with an arm, a log of its currents, gains, and a result."""
    folder = tmp_path_factory.mktemp("currents")
    time, q, effort = write_arm(folder)
    given = {"time": time, "position": q, "joint_names": ("a", "b"), "currents": True}
    sdpid.Recording(**given, effort=effort / GAINS).to_csv(folder / "run.csv")
    known = np.diag((0.05 * GAINS[::-1]) ** 2)
    sdpid.DriveGains(
        joint_names=("b", "a"), gains=GAINS[::-1], covariance=known, basis="a load of 2 kg"
    ).to_toml(folder / "gains.toml")
    out = ("--gains", folder / "gains.toml", "--out", folder / "out", "--no-figures", "-q")
    printed("identify", folder / "run.csv", "--robot", folder / "arm.urdf", *out)
    return folder


@pytest.mark.parametrize(
    ("unit", "said"),
    [
        ((), "look like currents: give gains="),
        (
            ("--column", "effort=current_a,current_b", "--unit", "effort=A"),
            "currents in A, which need gains: let `sdpid gains`",
        ),
    ],
)
def test_currents_without_gains_are_refused(folder: Path, unit: tuple[str, ...], said: str) -> None:
    robot = ("--robot", folder / "arm.urdf")
    assert said in printed("identify", folder / "run.csv", *robot, *unit, status=2)


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
    said = printed("verify", out, "--data", folder / "run.csv", "--robot", folder / "arm.urdf")
    assert '"name": "gains.toml"' in said
    assert '"joint_names": ["b", "a"], "gains": [5.0, 10.0]' in said
    assert "PROVEN" in said.splitlines()[-1]


def test_other_gains_in_the_recipe_are_no_proof(folder: Path, tmp_path: Path) -> None:
    """Who changes the gains that a result states changes its rows."""
    out = shutil.copytree(folder / "out", tmp_path / "out")
    path = ("recipe", "logs", 0, "reading", "gains", "gains")
    edit_json(out / "manifest.json", set_to([5.0, 9.9], *path))
    reseal(out)
    said = printed("verify", out, "--data", folder / "run.csv", status=1)
    assert "rows: A, rhs and floor of the certificate are not of the rows of this log" in said


def test_gains_of_a_known_load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From currents to gains by a file of options, and to the load that made them."""
    monkeypatch.chdir(tmp_path)
    write_world(tmp_path)
    Path("gains_of.toml").write_text(
        'robot = "arm.urdf"\nwithout = "currents.csv"\nwith = "currents_loaded.csv"\n'
        f'load = {LOAD}\neffects = "none"\n'
    )
    said = printed("gains", "--config", "gains_of.toml", "--out", "found.toml")
    assert "drive gains, by a load of 2 kg (95 % intervals)" in said
    found = sdpid.DriveGains.from_toml("found.toml")
    assert set(found.sources) == {"currents.csv", "currents_loaded.csv"}
    low, high = found.intervals(0.999).T
    assert np.all((low < TRUE) & (high > TRUE))
    more = ("--load-com", "0.2,0,0.08", "--frame", "tool0", "--load-error", "0.02")
    known = ("--known", f"joint_1={TRUE[0]}", "--out", "known.toml")
    plain = told("gains", "--config", "gains_of.toml", *more, *known)
    assert plain["gains"]["gains"][0] == TRUE[0]
    assert plain["gains"]["common_factor"] == 0.0
    assert plain["file"] == "known.toml"
    logs = ("currents_loaded.csv", "--without", "currents.csv", "--gains", "found.toml")
    load = told("payload", *logs, "--robot", "arm.urdf")
    assert holds(LOAD, load)
    assert load["gains_share"]["mass"] > 0.01


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--load 2 --load-com 1,2", "--load-com 1,2: has 2 numbers, expected 3"),
        ("--load 2 --known a=x", "--known a x: expected numbers"),
        ("--load 2", "load: there is no recording with load; give it"),
        ("--out run.csv", "run.csv"),
    ],
)
def test_what_cannot_be_meant_is_told(
    folder: Path, options: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    before = {*folder.iterdir()}
    given = ("gains", "--robot", "arm.urdf", "--without", "run.csv", *options.split())
    assert said in printed(*given, status=2)
    assert {*folder.iterdir()} == before


def test_info_says_where_torques_come_from(folder: Path) -> None:
    said = printed("info", folder / "run.csv", "--gains", folder / "gains.toml")
    assert "gains: gains.toml, by a load of 2 kg: standard errors of 5 %" in said


# ---- The command ``sdpid payload``.


MASS = 1.5


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return recordings with and without a payload, of an arm as described."""
    folder = tmp_path_factory.mktemp("logs")
    robot, rng = sdpid.load_robot("ur5_robot"), np.random.default_rng(0)
    time = np.arange(0.0, 20.0, 0.01)
    paths = folder / "loaded.parquet", folder / "bare.parquet"
    for path, load in zip(paths, (MASS, 0.0), strict=True):
        rate, phase, size = (
            rng.uniform(*ends, (4, robot.n)) for ends in ((1.0, 3.0), (0.0, 6.0), (0.2, 0.5))
        )
        q, v, a = sines(time, rate, phase, size)
        theta = robot.prior.copy()
        theta[5] += theta_from_physical(load, [0.0, 0.02, 0.1], 0.004 * load * np.eye(3))
        effort = robot.inverse_dynamics(theta, q, v, a) + 0.5 * np.tanh(v / 0.02)
        effort += 0.1 * rng.standard_normal(q.shape)
        sdpid.Recording(time=time, position=q, effort=effort).to_parquet(path)
    return paths


def holds(mass: float, found: dict[str, Any]) -> bool:
    """Whether the interval of a payload's mass has the true one."""
    low, high = found["intervals"]["mass"]
    return bool(low < mass < high)


def test_with_a_recording_without_load(logs: tuple[Path, Path]) -> None:
    given = ("payload", logs[0], "--without", logs[1], "--robot", "ur5_robot", "--frame", "ee_link")
    found, other = told(*given), told(*given, "--separate", "offset")
    assert holds(MASS, found)
    assert holds(MASS, other)
    assert found["frame"] == "ee_link"
    assert other["cost"] > found["cost"]
    assert "ee_link" in printed(*given)


@pytest.mark.parametrize("strength", [(), ("--strength", 1000)])
def test_against_the_description(logs: tuple[Path, Path], strength: tuple[object, ...]) -> None:
    found = told("payload", logs[0], "--robot", "ur5_robot", *strength)
    assert found["mass"] == pytest.approx(MASS, abs=0.1)


def test_a_joint_without_effort(logs: tuple[Path, Path], tmp_path: Path) -> None:
    """Its effort is rubbish in both recordings; the others show the payload all the same."""
    paths = [tmp_path / path.name for path in logs]
    for path, wrong in zip(logs, paths, strict=True):
        log = sdpid.read_recording(path)
        effort = np.array(log.effort)
        effort[:, 0] = 1e3 * np.random.default_rng(1).standard_normal(len(effort))
        replace(log, effort=effort).to_parquet(wrong)
    joint = sdpid.load_robot("ur5_robot").joint_names[0]
    options = ("--robot", "ur5_robot", "--without-effort", joint)
    found = told("payload", paths[0], "--without", paths[1], *options)
    assert holds(MASS, found)
    assert found["mass"] == pytest.approx(MASS, abs=0.1)


# ---- Every command on the smallest robots: one joint, no limits, a joint without effort.


GAIN = 5.0


@pytest.fixture(scope="module", params=SMALL)
def small(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a robot, three of its logs, and results, named after the robot."""
    chosen, made = SMALL[request.param], tmp_path_factory.mktemp("small") / request.param
    made.mkdir()
    (made / "robot.urdf").write_text(chosen.urdf)
    for seed, name in enumerate(("run", "other")):
        chosen.log(seed).to_csv(made / f"{name}.csv")
    chosen.log(2, load=BODY).to_csv(made / "loaded.csv")
    options = ("--validation", made / "other.csv", "--out", made / "out", "--no-figures")
    found = told("identify", made / "run.csv", *options, *measured(made))
    assert found["certified"]
    # The noise is 0.01 N·m of efforts of 2 to 40.
    assert found["validation"]["relative_residual"] < 0.01
    return made


def of(small: Path) -> tuple[object, ...]:
    return ("--robot", small / "robot.urdf")


def measured(small: Path) -> tuple[object, ...]:
    """Return the options that name the robot, and its joints without effort."""
    silent = SMALL[small.name].without_effort
    return (*of(small), "--without-effort", ",".join(silent)) if silent else of(small)


def test_what_is_identified_is_verified_and_predicts(small: Path) -> None:
    assert told("verify", small / "out", "--data", small / "run.csv", *of(small))["passed"]
    robot = ("--robot", small / "out" / "identified.urdf", *measured(small)[2:])
    assert told("validate", small / "other.csv", *robot)["relative_residual"] < 0.02


def test_audit(small: Path) -> None:
    assert told("audit", small / "robot.urdf")["passed"]
    table = told("audit", small / "out" / "base_parameters.csv", *of(small))
    assert table["verdict"] == "realisable"


def test_excite(small: Path) -> None:
    pytest.importorskip("casadi", reason="needs the extra excite")
    options = ("--duration", 4, "--starts", 1, "--out", small / "plan", "--no-figures")
    assert told("excite", small / "robot.urdf", *options)["limits"]["ok"]


def test_simulate(small: Path) -> None:
    motion = ("--period", 6.5, "--periods", 1)
    made = told("simulate", small / "robot.urdf", "--out", small / "made.csv", *motion)
    log = sdpid.read_recording(small / "made.csv")
    assert made["samples"] == log.n_samples
    assert log.effort.shape == (log.n_samples, len(log.names))


def test_payload(small: Path) -> None:
    for known in ((), ("--without", small / "run.csv")):
        assert holds(WEIGHT, told("payload", small / "loaded.csv", *known, *measured(small)))


def test_gains(small: Path) -> None:
    chosen = SMALL[small.name]
    chosen.log(3, gain=GAIN).to_csv(small / "bare_currents.csv")
    chosen.log(4, load=BODY, gain=GAIN).to_csv(small / "loaded_currents.csv")
    arguments = (
        *("gains", "--without", small / "bare_currents.csv"),
        *("--with", small / "loaded_currents.csv", *of(small), "--load", WEIGHT),
        *("--load-com", "0,0.02,0.1", "--load-inertia", "0.006,0,0,0.006,0,0.006"),
        *("--out", small / "gains.toml"),
    )
    if chosen.without_effort:
        assert "the current of high is zero in every recording" in printed(*arguments, status=2)
        return
    found = told(*arguments)["gains"]["gains"]
    assert found == pytest.approx([GAIN] * len(found), rel=0.02)
