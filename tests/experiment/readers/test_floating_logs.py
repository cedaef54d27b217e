"""Logs of robots with a floating base: poses, IMUs and feet, found by name or as told."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sdpid.errors import DataError, ExportError
from sdpid.experiment.readers.read import read_described, read_recording
from sdpid.experiment.recording.recording import Recording
from tests.experiment.recording.test_floating import log
from tests.helpers.bags import JOINTS, write_bag
from tests.helpers.refusals import refuses
from tests.helpers.studies import study

N = 40
T = 0.01 * np.arange(N)


def require_same(found: Recording, wanted: Recording) -> None:
    """Check every array of base and contacts."""
    a, b = found.base, wanted.base
    np.testing.assert_allclose(a.orientation, b.orientation, atol=1e-15)
    np.testing.assert_array_equal(a.position, b.position)
    np.testing.assert_array_equal(a.angular_velocity, b.angular_velocity)
    assert (a.velocity_frame, a.linear_velocity) == (b.velocity_frame, None)
    np.testing.assert_array_equal(a.imu.accelerometer, b.imu.accelerometer)
    np.testing.assert_array_equal(a.imu.translation, b.imu.translation)
    feet, wished = found.contacts, wanted.contacts
    assert (feet.frames, feet.kind) == (wished.frames, wished.kind)
    for name in ("down", "forces", "offset"):
        np.testing.assert_array_equal(getattr(feet, name), getattr(wished, name))


def test_parquet_files_keep_everything(tmp_path: Path) -> None:
    log().to_parquet(tmp_path / "run.parquet")
    require_same(read_recording(tmp_path / "run.parquet"), log())


def test_csv_files_keep_what_is_no_setting(tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    log().to_csv(file)
    require_same(read_recording(file), log())
    plain = Recording(time=T, position=log().position, effort=log().effort)
    plain.with_held_base("trunk").to_csv(file)
    contacts = read_recording(file).contacts
    assert (contacts.frames, contacts.kind) == (("trunk",), ("plane",))
    # A mapping that was written with a log goes with it; one of other hands stays.
    plain.to_csv(file)
    assert read_recording(file).contacts is None
    (tmp_path / "run.toml").write_text("[units]\nposition = 'deg'\n")
    with pytest.raises(ExportError, match=r"run\.toml: is a mapping of another log"):
        log().to_csv(file)
    (tmp_path / "run.toml").unlink()
    log().to_csv(file)
    turned = read_recording(file, contacts={"frames": ["right", "left"], "kind": "plane"})
    assert turned.contacts.frames == ("right", "left")
    assert turned.contacts.kind == ("plane", "plane")
    np.testing.assert_array_equal(turned.contacts.down, log().contacts.down[:, ::-1])
    np.testing.assert_array_equal(turned.contacts.forces, log().contacts.forces[:, ::-1])
    assert read_recording(file, columns={"base_orientation": None}, mapping=False).base is None


def arrays(**changes: Any) -> dict[str, Any]:
    """Return the arrays of a file, quaternions w first."""
    base = log().base
    return {
        "t": T,
        "q": log().position,
        "tau": log().effort,
        "base_quat": np.roll(base.orientation, 1, axis=1),
        "base_ang_vel": np.degrees(base.angular_velocity),
        "feet": 30.0 * log().contacts.down,
        **changes,
    }


TOLD = {
    "columns": {"contact": "feet"},
    "base": {"quaternion": "wxyz", "velocity_frame": "base"},
    "contacts": {"frames": ["left", "right"], "threshold": 20.0},
    "units": {"base_angular_velocity": "deg/s"},
}


def test_arrays_are_read_as_told(tmp_path: Path) -> None:
    np.savez(tmp_path / "run.npz", **arrays())
    found = read_recording(tmp_path / "run.npz", **TOLD)
    np.testing.assert_allclose(found.base.orientation, log().base.orientation, atol=1e-15)
    np.testing.assert_allclose(found.base.angular_velocity, log().base.angular_velocity)
    assert found.base.velocity_frame == "base"
    np.testing.assert_array_equal(found.contacts.down, log().contacts.down)
    part = read_recording(tmp_path / "run.npz", **TOLD, rows=(11, 30))
    assert part.n_samples == part.base.n_samples == part.contacts.n_samples == 20
    assert part.time[0] == T[10]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"base": {}}, "the order of its quaternions is not known; say base="),
        ({"base": {"quaternion": "zyxw"}}, "expected one of xyzw, wxyz"),
        ({"base": {"held": "trunk"}}, "held at 'trunk', and the log has the motion of one"),
        ({"base": {"held": True}}, "base.held: is True, expected the name of the link"),
        ({"base": {"held": "trunk", "topic": "/odom"}}, "'trunk', and topic is about one that"),
        ({"base": {"orientation": [0, 0, 0, 1]}}, "say which link was, held ="),
        ({"base": {"quat": "xyzw"}}, "base: quat is not known; known are quaternion"),
        ({"contacts": {}}, "say which frame of the robot each column is of"),
        ({"contacts": {"frames": ["left"]}}, "has 2 columns, expected 1 for each of the 1 frames"),
        ({"columns": {"base_orientation": "pose"}}, "'pose' for base_orientation is not there"),
        ({"columns": {"gyroscope": "tau"}}, "gyroscope: has 2 columns, expected 3"),
        ({"columns": {"position": "q[2:3]"}}, "asks for columns 2 to 3 of an array"),
        ({"rows": (5, 100)}, "rows: asks for row 100, the log has 40"),
        ({"rows": (0, 10)}, "rows: is .*, expected the first and the last row"),
    ],
)
def test_what_is_not_told_or_not_there_is_refused(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    np.savez(tmp_path / "run.npz", **arrays())
    refuses(DataError, message, read_recording, tmp_path / "run.npz", **{**TOLD, **changes})


def test_a_mapping_says_that_the_base_was_held(tmp_path: Path) -> None:
    file, tilted = tmp_path / "hung.csv", [0.0, 0.6, 0.0, 0.8]
    alone = Recording(time=T, position=log().position, effort=log().effort)
    alone.to_csv(file)
    assert read_recording(file).base is None
    (tmp_path / "hung.toml").write_text(
        f'[base]\nheld = "trunk"\norientation = {tilted}\n', encoding="utf-8"
    )
    found = read_described(file)
    assert found.sources["base"] == "held at trunk"
    wanted = alone.with_held_base("trunk", orientation=tilted)
    for one in (found.recording, read_recording(file, mapping=False, base=held(tilted))):
        np.testing.assert_array_equal(one.base.orientation, wanted.base.orientation)
        assert (one.contacts.frames, one.contacts.kind) == (("trunk",), ("plane",))
        assert one.contacts.down.all()
        # What a saved run reads its log with.
        assert one.source.options["base"] == held(tilted)


def held(orientation: list[float]) -> dict[str, Any]:
    return {"held": "trunk", "orientation": orientation}


def test_velocities_of_unknown_axes_are_left_out_with_a_word(tmp_path: Path) -> None:
    np.savez(tmp_path / "run.npz", **arrays())
    told = {**TOLD, "base": {"quaternion": "wxyz"}}
    found = read_described(tmp_path / "run.npz", **told)
    assert found.recording.base.angular_velocity is None
    assert "its axes are not known" in found.sources["base_angular_velocity"]
    told["columns"] = {"contact": "feet", "base_angular_velocity": "base_ang_vel"}
    with pytest.raises(DataError, match="velocity_frame: is None, expected 'world' or 'base'"):
        read_recording(tmp_path / "run.npz", **told)


@pytest.mark.parametrize(("prefix", "told"), [("imu_quat", True), ("tcp_orientation", False)])
def test_quaternions_by_another_name_are_pointed_out(
    tmp_path: Path, prefix: str, told: bool
) -> None:
    joints = {"time": np.arange(N) / 200.0, "q1": log().position[:, 0], "tau1": log().effort[:, 0]}
    quaternions = {f"{prefix}_{part}": np.full(N, 0.5) for part in "wxyz"}
    table = np.column_stack([*joints.values(), *quaternions.values()])
    file = tmp_path / "run.csv"
    header = ",".join([*joints, *quaternions])
    np.savetxt(file, table, header=header, delimiter=",", comments="")
    found = read_described(file)
    assert found.recording.base is None
    assert (f"--column base_orientation={prefix}" in str(found.sources)) == told
    if told:
        columns = {"base_orientation": prefix}
        assert read_recording(file, columns=columns).base is not None


def test_missing_values_of_the_base_are_dropped_or_refused(tmp_path: Path) -> None:
    given = arrays()
    given["base_quat"][7] = np.nan
    np.savez(tmp_path / "run.npz", **given)
    with pytest.raises(DataError, match=r"row 8: base_orientation: 'base_quat\[1\]' has no value"):
        read_recording(tmp_path / "run.npz", **TOLD)
    with pytest.raises(DataError, match="fills only what belongs to joints"):
        read_recording(tmp_path / "run.npz", **TOLD, missing="interpolate")
    found = read_recording(tmp_path / "run.npz", **TOLD, missing="drop")
    assert found.base.n_samples == found.contacts.n_samples == N - 1


def test_folders_of_matrices_have_channels_in_rows_or_columns(tmp_path: Path) -> None:
    given = arrays(base_quat=arrays()["base_quat"].T, q=np.hstack([log().position] * 2))
    for name, values in given.items():
        np.savetxt(tmp_path / f"{name}.dat", values, delimiter="\t", fmt="%.17g")
    columns = {**TOLD["columns"], "position": "q[3:4]"}
    found = read_recording(tmp_path, **{**TOLD, "columns": columns})
    np.testing.assert_array_equal(found.position, log().position)
    np.testing.assert_allclose(found.base.orientation, log().base.orientation, atol=1e-15)
    np.savetxt(tmp_path / "tau.dat", np.eye(3))
    with pytest.raises(DataError, match="3 × 3 numbers, so that it is not known which side"):
        read_recording(tmp_path, **TOLD)


@pytest.mark.parametrize("kind", ["mcap", "ros1"])
def test_odometry_and_imu_of_bags_come_to_the_stamps_of_the_joints(
    tmp_path: Path, kind: str
) -> None:
    turns = Rotation.from_rotvec(np.linspace(0.0, 1.0, N)[:, None] * [0.2, 0.5, -0.8])
    slope = np.linspace(0.0, 1.0, N)[:, None]
    rows = np.hstack([slope + np.arange(3.0), turns.as_quat(), slope * np.arange(1.0, 7.0)])
    q, v, tau = log().position, log().effort, log().effort
    file = write_bag(tmp_path / "bag", kind, T, q, v, tau, base=rows)
    with pytest.raises(DataError, match=r"base_orientation: .*has no value"):
        read_recording(file)  # The last joint state is later than the last odometry.
    found = read_recording(file, missing="drop", imu={"translation": [0.1, 0.0, 0.0]})
    assert (found.n_samples, found.joint_names) == (N - 1, JOINTS)
    base = found.base
    np.testing.assert_allclose(base.orientation, turns.as_quat()[:-1], atol=1e-12)
    np.testing.assert_allclose(base.position, rows[:-1, :3], atol=1e-12)
    np.testing.assert_allclose(base.imu.gyroscope, rows[:-1, 10:], atol=1e-12)
    assert base.velocity_frame == "base"
    with pytest.raises(DataError, match=r"no topic /pose with .*Odometry; there is /odom"):
        read_recording(file, base={"topic": "/pose"})


def test_solo12_simulated_elsewhere(data_folder: Path) -> None:
    folder = data_folder / "solo12_simulated"
    read = study("solo12_public").read
    stand, jump = read(folder, "stand"), read(folder, "jump")
    assert repr(stand) == "Recording(2000 samples, 12 joints, 200 Hz, floating base, 4 contacts)"
    assert stand.contacts.down.all()
    assert 0.4 < jump.contacts.down.mean() < 0.6
    # Velocities are in the base's axes: in the world's the pose differs by five times as much.
    speed = np.gradient(jump.base.position, 0.01, axis=0)
    turned = np.einsum("kij,kj->ki", jump.base.rotations, jump.base.linear_velocity)
    assert np.sqrt(np.mean((turned - speed) ** 2)) < 0.015
    assert np.sqrt(np.mean((jump.base.linear_velocity - speed) ** 2)) > 0.05
