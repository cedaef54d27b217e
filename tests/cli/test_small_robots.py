"""Every command on the smallest robots: one joint, no limits, a joint without effort."""

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import sdpid
from sdpid.cli import app
from tests.helpers.small_robots import LOAD, MASS, SMALL

GAIN = 5.0


def run(*arguments: object, status: int = 0) -> Any:
    """Return what a command prints as JSON, or its error."""
    done = CliRunner().invoke(app, [*map(str, arguments), "--json"], catch_exceptions=False)
    assert done.exit_code == status, done.output
    return json.loads(done.stdout) if status == 0 else done.stderr


@pytest.fixture(scope="module", params=SMALL)
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a robot, three of its logs, and results, named after the robot."""
    small, made = SMALL[request.param], tmp_path_factory.mktemp("small") / request.param
    made.mkdir()
    (made / "robot.urdf").write_text(small.urdf)
    for seed, name in enumerate(("run", "other")):
        small.log(seed).to_csv(made / f"{name}.csv")
    small.log(2, load=LOAD).to_csv(made / "loaded.csv")
    options = ("--validation", made / "other.csv", "--out", made / "out", "--no-figures")
    found = run("identify", made / "run.csv", *options, *measured(made))
    assert found["certified"]
    # The noise is 0.01 N·m of efforts of 2 to 40.
    assert found["validation"]["relative_residual"] < 0.01
    return made


def of(folder: Path) -> tuple[object, ...]:
    return ("--robot", folder / "robot.urdf")


def measured(folder: Path) -> tuple[object, ...]:
    """Return the options that name the robot, and its joints without effort."""
    silent = SMALL[folder.name].without_effort
    return (*of(folder), "--without-effort", ",".join(silent)) if silent else of(folder)


def test_what_is_identified_is_verified_and_predicts(folder: Path) -> None:
    found = run("verify", folder / "out", "--data", folder / "run.csv", *of(folder))
    assert found["passed"]
    robot = ("--robot", folder / "out" / "identified.urdf")
    left_out = measured(folder)[2:]
    found = run("validate", folder / "other.csv", *robot, *left_out)
    assert found["relative_residual"] < 0.02


def test_audit(folder: Path) -> None:
    assert run("audit", folder / "robot.urdf")["passed"]
    table = run("audit", folder / "out" / "base_parameters.csv", *of(folder))
    assert table["verdict"] == "realisable"


def test_excite(folder: Path) -> None:
    pytest.importorskip("casadi", reason="needs the extra excite")
    found = run(
        "excite",
        folder / "robot.urdf",
        "--duration",
        4,
        "--starts",
        1,
        "--out",
        folder / "plan",
        "--no-figures",
    )
    assert found["limits"]["ok"]


def test_simulate(folder: Path) -> None:
    motion = ("--period", 6.5, "--periods", 1)
    made = run("simulate", folder / "robot.urdf", "--out", folder / "made.csv", *motion)
    log = sdpid.read_recording(folder / "made.csv")
    assert made["samples"] == log.n_samples
    assert log.effort.shape == (log.n_samples, len(log.names))


def test_payload(folder: Path) -> None:
    for known in ((), ("--without", folder / "run.csv")):
        found = run("payload", folder / "loaded.csv", *known, *measured(folder))
        low, high = found["intervals"]["mass"]
        assert low < MASS < high


def test_gains(folder: Path) -> None:
    small = SMALL[folder.name]
    small.log(3, gain=GAIN).to_csv(folder / "bare_currents.csv")
    small.log(4, load=LOAD, gain=GAIN).to_csv(folder / "loaded_currents.csv")
    arguments = (
        *("gains", "--without", folder / "bare_currents.csv"),
        *("--with", folder / "loaded_currents.csv", *of(folder), "--load", MASS),
        *("--load-com", "0,0.02,0.1", "--load-inertia", "0.006,0,0,0.006,0,0.006"),
        *("--out", folder / "gains.toml"),
    )
    if small.without_effort:
        assert "the current of high is zero in every recording" in run(*arguments, status=2)
        return
    found = run(*arguments)["gains"]["gains"]
    assert found == pytest.approx([GAIN] * len(found), rel=0.02)
