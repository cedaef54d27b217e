"""Currents and gains: what a recording of currents may be used for, and who finds which gain."""

from pathlib import Path

import numpy as np
import pytest

import sdpid
from sdpid.errors import DataError
from sdpid.experiment.preparation.for_robot import prepare
from sdpid.experiment.readers.scaled import scaled
from sdpid.experiment.recording.recording import Recording
from tests.helpers.refusals import refuses

GAINS = sdpid.DriveGains(
    joint_names=("joint3", "joint1", "joint2"), gains=[3.0, 1.0, 2.0], covariance=0.01 * np.eye(3)
)


def currents(names: tuple[str, ...] | None = ("joint1", "joint2", "joint3")) -> Recording:
    time = np.linspace(0.0, 1.0, 200)
    table = np.sin(np.outer(time, [1.0, 2.0, 3.0]))
    return Recording(time=time, position=table, effort=table, joint_names=names, currents=True)


def test_gains_are_found_by_name() -> None:
    log = currents()
    assert "efforts in A" in repr(log)
    assert "rms effort, A" in log._repr_html_()
    torques = scaled(log, GAINS)
    assert not torques.currents
    assert "in A" not in repr(torques)
    assert torques.gains.joint_names == log.joint_names
    np.testing.assert_array_equal(torques.effort, log.effort * [1.0, 2.0, 3.0])
    refuses(DataError, "turned into torques by gains already", scaled, torques, GAINS)


def test_a_payload_names_the_recording_without_gains() -> None:
    robot = sdpid.load_robot("denso_vp6242")
    with pytest.raises(DataError, match="payload, without_load: efforts are currents in A"):
        sdpid.identify_payload(robot, scaled(currents(), GAINS), currents())


def test_names_of_joints_may_have_another_prefix() -> None:
    assert scaled(currents(("ur_joint1", "ur_joint2", "ur_joint3")), GAINS).effort[-1, 2] == (
        pytest.approx(3.0 * np.sin(3.0))
    )
    refuses(DataError, "none for hip, knee, heel", scaled, currents(("hip", "knee", "heel")), GAINS)


def test_gains_follow_picked_joints() -> None:
    robot = sdpid.load_robot("denso_vp6242")
    order = [4, 0, 1, 2, 3, 5, 6]
    names = np.array([*robot.joint_names, "gripper"])[order]
    rng = np.random.default_rng(0)
    time = np.arange(0.0, 6.0, 0.01)
    table = np.sin(np.outer(time, rng.uniform(1.0, 3.0, 7)))
    gains = sdpid.DriveGains(
        joint_names=names, gains=np.arange(1.0, 8.0), covariance=np.diag(np.arange(1.0, 8.0)) / 1e4
    )
    log = Recording(time=time, position=table, effort=table, joint_names=names, currents=True)
    refuses(DataError, "sdpid gains", sdpid.process, log)
    samples = prepare(robot, scaled(log, gains))
    assert samples.gains.joint_names == robot.joint_names
    np.testing.assert_array_equal(samples.gains.gains, [2.0, 3.0, 4.0, 5.0, 1.0, 6.0])
    np.testing.assert_array_equal(samples.gains.covariance, np.diag(samples.gains.gains) / 1e4)
    assert samples.between(0, 50).gains is samples.gains
    with pytest.raises(DataError, match="others than those of the first"):
        sdpid.Samples.join([samples, prepare(robot, scaled(log, gains.gains))])


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_files_keep_currents_as_currents(tmp_path: Path, suffix: str) -> None:
    log, path = currents(), tmp_path / f"run{suffix}"
    (log.to_csv if suffix == ".csv" else log.to_parquet)(path)
    refuses(DataError, "look like currents: give gains=", sdpid.read_recording, path)
    again = sdpid.read_recording(path, currents=True)
    assert again.currents
    np.testing.assert_array_equal(again.effort, log.effort)
    GAINS.to_toml(tmp_path / "gains.toml")
    (tmp_path / "run.toml").write_text('gains = "gains.toml"\n')
    read = sdpid.read_recording(path)
    np.testing.assert_array_equal(read.effort, scaled(log, GAINS).effort)
    # How it was read reads the same again, without the file of the gains.
    (tmp_path / "gains.toml").unlink()
    repeated = sdpid.read_recording(path, mapping=False, **read.source.options)
    np.testing.assert_array_equal(repeated.effort, read.effort)
    assert repeated.gains.same_errors(read.gains)
    assert repeated.gains.source == read.gains.source


def test_what_cannot_be_meant_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    currents().to_csv(path)
    with pytest.raises(DataError, match="makes torques of currents"):
        sdpid.read_recording(path, gains=GAINS, effort_scale=[1.0, 2.0, 3.0])
    turned = sdpid.read_recording(path, gains=GAINS, effort_scale=[1.0, -1.0, 1.0])
    np.testing.assert_array_equal(turned.effort[:, 1], -2.0 * currents().effort[:, 1])
    with pytest.raises(DataError, match=r"gains are for currents in A, but the unit .* is N\.m"):
        sdpid.read_recording(path, gains=GAINS, units={"effort": "N.m"})
    refuses(DataError, "asks for currents", sdpid.read_recording, path, gains=GAINS, currents=True)
