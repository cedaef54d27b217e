"""The command ``sdpid payload``."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import sdpid
from sdpid.cli import app
from sdpid.robot.inertia import theta_from_physical

MASS = 1.5


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return recordings with and without a payload, of an arm as described."""
    folder = tmp_path_factory.mktemp("logs")
    robot = sdpid.load_robot("ur5_robot")
    rng = np.random.default_rng(0)
    time = np.arange(0.0, 20.0, 0.01)
    paths = []
    for name, load in (("loaded", MASS), ("bare", 0.0)):
        rate = rng.uniform(1.0, 3.0, (4, robot.n))
        phase = rng.uniform(0.0, 6.0, (4, robot.n))
        size = rng.uniform(0.2, 0.5, (4, robot.n))
        angle = rate * time[:, None, None] + phase
        q = (size * np.sin(angle)).sum(axis=1)
        v = (size * rate * np.cos(angle)).sum(axis=1)
        a = -(size * rate**2 * np.sin(angle)).sum(axis=1)
        theta = robot.prior.copy()
        theta[5] += theta_from_physical(load, [0.0, 0.02, 0.1], 0.004 * load * np.eye(3))
        effort = robot.inverse_dynamics(theta, q, v, a) + 0.5 * np.tanh(v / 0.02)
        effort += 0.1 * rng.standard_normal(q.shape)
        path = folder / f"{name}.parquet"
        sdpid.Recording(time=time, position=q, effort=effort).to_parquet(path)
        paths.append(path)
    return paths[0], paths[1]


def run(*arguments: object) -> str:
    found = CliRunner().invoke(app, ["payload", *map(str, arguments)], catch_exceptions=False)
    assert found.exit_code == 0, found.output
    return found.stdout


def test_with_a_recording_without_load(logs: tuple[Path, Path]) -> None:
    options = ("--robot", "ur5_robot", "--frame", "ee_link")
    found = json.loads(run(logs[0], "--without", logs[1], *options, "--json"))
    assert found["intervals"]["mass"][0] < MASS < found["intervals"]["mass"][1]
    assert found["frame"] == "ee_link"
    apart = ("--separate", "offset")
    other = json.loads(run(logs[0], "--without", logs[1], *options, *apart, "--json"))
    assert other["intervals"]["mass"][0] < MASS < other["intervals"]["mass"][1]
    assert other["cost"] > found["cost"]
    assert "ee_link" in run(logs[0], "--without", logs[1], *options)


@pytest.mark.parametrize("strength", [(), ("--strength", 1000)])
def test_against_the_description(logs: tuple[Path, Path], strength: tuple[object, ...]) -> None:
    found = json.loads(run(logs[0], "--robot", "ur5_robot", *strength, "--json"))
    assert found["mass"] == pytest.approx(MASS, abs=0.1)


def test_a_joint_without_effort(logs: tuple[Path, Path], tmp_path: Path) -> None:
    """Its effort is rubbish in both recordings; the others show the payload all the same."""
    paths = []
    for path in logs:
        log = sdpid.read_recording(path)
        effort = np.array(log.effort)
        effort[:, 0] = 1e3 * np.random.default_rng(1).standard_normal(len(effort))
        paths.append(tmp_path / path.name)
        replace(log, effort=effort).to_parquet(paths[-1])
    joint = sdpid.load_robot("ur5_robot").joint_names[0]
    options = ("--robot", "ur5_robot", "--without-effort", joint, "--json")
    found = json.loads(run(paths[0], "--without", paths[1], *options))
    assert found["intervals"]["mass"][0] < MASS < found["intervals"]["mass"][1]
    assert found["mass"] == pytest.approx(MASS, abs=0.1)
