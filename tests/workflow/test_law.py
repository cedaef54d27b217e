"""Identification without efforts: a known law, its delay, drives fitted to positions, files."""

from __future__ import annotations

import json

import mujoco
import numpy as np
import pytest

import sdpid
from sdpid.errors import DataError
from tests.estimation.test_positions import (
    DRIVES,
    KD,
    KP,
    LEG,
    LEGS,
    H,
    N,
    commanded,
    drives,
    followed,
    links_of_legs,
)
from tests.helpers.commands import run

PD = sdpid.controllers.PD
LAW = PD(kp=KP, kd=KD)


@pytest.fixture(scope="module")
def legs(tmp_path_factory):
    """Two legs whose knees rub more on one side, their log without efforts, and the file."""
    path = tmp_path_factory.mktemp("law") / "legs.xml"
    path.write_text(LEGS.format(legs=LEG.format("l", 0.1, DRIVES) + LEG.format("r", -0.1, DRIVES)))
    robot = sdpid.load_robot(path)
    time, command = commanded(9.0)
    rollout = followed(time, command, command).rollout(links_of_legs(robot))
    start = np.stack([command[0], np.zeros(N)])
    truth = drives(delay=0.005, slope=np.array([0.0, 0.2, 0.0, -0.2]))
    position = rollout.positions(rollout.run(truth, start))
    position += 1e-4 * np.random.default_rng(0).standard_normal(position.shape)
    log = sdpid.Recording(
        time=time, position=position, reference=command, joint_names=robot.joint_names
    )
    return path, log


@pytest.fixture(scope="module")
def result(legs):
    return sdpid.identify(*legs, law=LAW)


def test_drives_and_delay_are_found(result):
    found = result.drives
    assert found.kinds == ("armature", "damping", "friction", "slope")
    assert found.complete
    assert result.certificate.passed
    low, high = found.delay_interval
    assert low <= 0.005 <= high
    assert high - low < 1e-3
    assert found.rms < 1.05e-4 < found.rms_reduced
    np.testing.assert_allclose(found.rich["slope"], [0.0, 0.2, 0.0, -0.2], atol=0.02)
    np.testing.assert_allclose(found.reduced["damping"], 0.3, atol=0.02)
    intervals = found.intervals()
    ends = [intervals[f"damping{j + 1}"][1:] for j in range(N)]
    assert sum(low <= 0.3 <= high for low, high in ends) >= N - 1
    for value, own, _ in found.sharp().values():
        assert 0.0 < own < 0.1 * value
    assert "steps" in found.notes[0]
    assert "changes with position" in found.given_up


@pytest.mark.parametrize("tendons", [False, True])
def test_files_play_what_was_fitted(legs, result, tmp_path, tendons):
    _, log = legs
    notes = []
    result.save(tmp_path / "o", tendons=tendons, report=notes.append)
    told = json.loads((tmp_path / "o" / "result.json").read_text())
    assert told["delay_s"] == pytest.approx(0.005, abs=5e-4)
    assert set(told["law"]["drives"]["reduced"]["lhip"]) >= {"armature", "damping", "friction"}
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "o" / "identified.xml"))
    assert (model.ntendon > 0) == tendons
    data = mujoco.MjData(model)
    data.qpos[:] = log.reference[0]
    played = [data.qpos.copy()]
    for k in range(int(log.duration / H)):
        row = max(np.searchsorted(log.time, k * H - told["delay_s"] + 1e-9, side="right") - 1, 0)
        data.qfrc_applied[:] = KP * (log.reference[row] - data.qpos) - KD * data.qvel
        mujoco.mj_step(model, data)
        played.append(data.qpos.copy())
    grid = H * np.arange(len(played))
    at = np.stack([np.interp(log.time, grid, x) for x in np.array(played).T], axis=1)
    error = float(np.sqrt(np.mean((at - log.position)[60:] ** 2)))
    assert error < (1.5e-3 if tendons else 1.2 * result.drives.rms_reduced + 1e-3)
    assert ("tendons" in " ".join(notes)) == tendons


def test_a_wrong_delay_is_named(legs):
    path, log = legs
    found = sdpid.identify(path, log, law=PD(kp=KP, kd=KD, delay=0.0)).drives
    assert not found.delay_found
    assert "the delay given, 0 ms, does not suit the log" in found.warnings[0]
    right = sdpid.identify(path, log, law=PD(kp=KP, kd=KD, delay=0.005)).drives
    assert right.warnings == ()
    assert right.delay_in_words == "5 ms as given"


def test_kp_is_found_as_masses_tell(legs):
    found = sdpid.identify(*legs, law=PD(kp=None, kd=KD))
    assert "masses" in found.notes[0]
    np.testing.assert_allclose(found.drives.rich["kp"], KP, rtol=0.2)


def test_command(legs, tmp_path):
    path, log = legs
    log.to_parquet(tmp_path / "run.parquet")
    (tmp_path / "law.toml").write_text(f"kp = {KP}\nkd = [{KD}, {KD}, {KD}, {KD}]\n")
    law = ["--law", str(tmp_path / "law.toml"), "--delay", "0.005", "--for", "mujoco"]
    files = [str(tmp_path / "run.parquet"), "--robot", str(path), "--out", str(tmp_path / "o")]
    done = run("identify", *files, *law)
    assert done.exit_code == 0, done.output
    assert "5 ms as given" in done.stdout
    assert "mrad rms of rollouts" in done.stdout
    assert json.loads((tmp_path / "o" / "result.json").read_text())["delay_s"] == 0.005
    assert 'id="drives"' in (tmp_path / "o" / "report.html").read_text()
    for options, message in (
        ([], "no effort was measured; give the law"),
        (["--kp", "20"], "--kp: is of a law; give --law pd"),
        (["--law", "pd", "--kp", "20"], "kd is missing"),
        (["--law", "nowhere.toml"], "is no file, and no law but pd is known"),
    ):
        done = run("identify", *files, *options)
        assert done.exit_code == 2
        assert message in " ".join(done.output.split())


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"law": PD(kp=KP, kd=KD), "friction": ("coulomb",)}, "have no place beside it"),
        ({"law": PD(kp=np.full(3, KP), kd=KD)}, "gains of 3 joints, the robot has 4"),
        ({"law": 3}, "give sdpid.controllers.PD"),
        ({"law": LAW, "target": "moon"}, "use one of mujoco, isaac, urdf"),
        ({"target": "mujoco"}, "under a known law; give law="),
        ({}, "no effort was measured"),
    ],
)
def test_refusals(legs, how, message):
    with pytest.raises(DataError, match=message):
        sdpid.identify(*legs, **how)


def test_logs_without_commands_are_refused(legs):
    path, log = legs
    effort = sdpid.Recording(time=log.time, position=log.position, effort=log.position)
    with pytest.raises(DataError, match="has no commanded positions"):
        sdpid.identify(path, effort, law=LAW)
    with pytest.raises(DataError, match="needs time, position and effort, or commanded"):
        sdpid.Recording(time=log.time, position=log.position)
    with pytest.raises(DataError, match=r"delay is 2\.0; give seconds from 0 to 0\.1"):
        PD(kp=1.0, kd=1.0, delay=2.0)
