"""Mappings beside logs, units joint by joint, and the motors' side."""

import gzip
import re
from pathlib import Path

import numpy as np
import pytest

from sdpid._common.files import load_toml
from sdpid.cli.options import Reading
from sdpid.errors import DataError
from sdpid.experiment.readers.mapping import read_mapping
from sdpid.experiment.readers.read import read_described, read_recording
from sdpid.experiment.recording.motor_side import MotorSide
from tests.helpers.refusals import refuses

N = 8
RNG = np.random.default_rng(7)
T = 0.5 * np.arange(N)
Q, DQ, TAU = (RNG.standard_normal((N, 3)) for _ in range(3))
# Motor turns a joint turn, the last two joints coupled.
R = np.array([[100.0, 0.0, 0.0], [0.0, -50.0, 0.0], [0.0, 32.0, 32.0]])
OFFSETS = np.array([0.0, -1.5, 0.5])
CONSTANTS = np.array([0.1, 0.2, 0.3])


def motor_log(folder: Path) -> Path:
    """Write what encoders in degrees and amplifiers in mA would have logged."""
    file = folder / "run.csv"
    enc = np.degrees((Q - OFFSETS) @ R.T)
    speed = DQ @ R.T * 60.0 / (2.0 * np.pi)
    current = TAU @ np.linalg.inv(R) / CONSTANTS * 1e3
    header = ["tick", *(f"{key}{j}" for key in ("enc", "n", "cur") for j in (1, 2, 3))]
    rows = np.column_stack([T * 1e6, enc, speed, current])
    np.savetxt(file, rows, header=",".join(header), comments="", delimiter=",", fmt="%.17g")
    return file


MAPPING = """
joint_names = ["base", "wrist", "hand"]
period = 2.0
[columns]
time = "tick"
position = "enc"
velocity = ["n1", "n2", "n3"]
effort = "cur"
[units]
time = "us"
position = "deg"
velocity = "rpm"
effort = "mA"
[motors]
position_matrix = [[100, 0, 0], [0, -50, 0], [0, 32, 32]]
offsets = [0, -1.5, 0.5]
torque_constants = [0.1, 0.2, 0.3]
"""


def test_a_mapping_beside_the_log(tmp_path: Path):
    file = motor_log(tmp_path)
    refuses(DataError, "position is missing", read_recording, file)
    (tmp_path / "run.toml").write_text(MAPPING)
    reading = read_described(file)
    log = reading.recording
    np.testing.assert_allclose(log.time, T, atol=1e-12)
    np.testing.assert_allclose(log.position, Q, atol=1e-12)
    np.testing.assert_allclose(log.velocity, DQ, atol=1e-12)
    np.testing.assert_allclose(log.effort, TAU, atol=1e-12)
    assert log.joint_names == ("base", "wrist", "hand")
    assert log.period_layout == (0, 4, 2)
    assert reading.mapping == str(tmp_path / "run.toml")
    assert reading.sources["effort"] == "cur1 ... cur3 in mA, motor side"
    # Arguments win, and the file beside the log can be ignored.
    assert read_recording(file, joint_names=["x", "y", "z"]).names == ("x", "y", "z")
    assert read_recording(file, columns={"velocity": None}).velocity is None
    refuses(DataError, "position is missing", read_recording, file, mapping=False)
    other = tmp_path / "other.toml"
    other.write_text(MAPPING.replace('effort = "mA"', 'effort = "A"'))
    np.testing.assert_allclose(read_recording(file, mapping=other).effort, 1e3 * TAU, atol=1e-9)


@pytest.mark.parametrize("name", ["run.csv.gz", "run.2.txt.gz", "RUN.TSV.GZ"])
def test_a_mapping_beside_a_compressed_log(tmp_path: Path, name: str):
    plain = motor_log(tmp_path)
    file, beside = tmp_path / name, tmp_path / f"{name[:-7]}.toml"
    file.write_bytes(gzip.compress(plain.read_bytes()))
    beside.write_text(MAPPING)
    reading = read_described(file)
    np.testing.assert_allclose(reading.recording.effort, TAU, atol=1e-12)
    assert reading.mapping == str(beside)
    # Commands know it as a file that they read.
    assert beside in Reading().files([file])


def test_the_mapping_of_the_documentation(tmp_path: Path):
    page = Path(__file__).resolve().parents[3] / "docs/guides/logs.md"
    blocks = re.findall(r"^```toml\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S)
    text, floating, held = blocks
    (tmp_path / "run.toml").write_text(text, encoding="utf-8")
    header = [*(f"enc{j}" for j in range(1, 7)), *(f"i{j}" for j in range(1, 7))]
    rows = RNG.standard_normal((N, 12))
    file = tmp_path / "run.csv"
    np.savetxt(file, rows, header=";".join(header), comments="", delimiter=";", fmt="%.17g")
    log = read_recording(file)
    assert log.names[3] == "roll"
    assert log.rate_hz == pytest.approx(5000.0)
    np.testing.assert_allclose(log.position[:, 3], np.radians(rows[:, 3]) / -48)
    np.testing.assert_allclose(log.effort[:, 3], rows[:, 9] * 1e-3 * 0.08 * -48)
    # The keys that are commented out are right as well.
    open_text = re.sub(r"^# (?!applies_to)(?=\w+ = )", "", text, flags=re.M)
    assert {"topic", "period"} <= set(read_mapping(load_toml(_written(tmp_path, open_text))))
    tables = {"rate_hz", "base", "imu", "contacts"}
    assert set(read_mapping(_written(tmp_path, floating))) == tables
    assert set(read_mapping(_written(tmp_path, held))["base"]) == {"held", "orientation"}


def _written(folder: Path, text: str) -> Path:
    (folder / "other.toml").write_text(text, encoding="utf-8")
    return folder / "other.toml"


def test_gears_signs_and_sides():
    side = MotorSide.from_gears([10.0, 20.0], [1, -1], offsets=[0.0, 1.0])
    np.testing.assert_array_equal(side.to_joints("position", np.array([[10.0, 20.0]])), [[1, 0]])
    np.testing.assert_array_equal(side.to_joints("velocity", np.array([[10.0, 20.0]])), [[1, -1]])
    np.testing.assert_array_equal(side.to_joints("effort", np.array([[1.0, 1.0]])), [[10, -20]])
    # Power is the same on both sides, for a coupled gear too.
    coupled = MotorSide(position_matrix=R)
    rates, efforts = coupled.to_joints("velocity", DQ), coupled.to_joints("effort", TAU)
    np.testing.assert_allclose((rates * efforts).sum(axis=1), (DQ * TAU).sum(axis=1), rtol=1e-12)
    sensors = MotorSide(position_matrix=R, applies_to=("position", "velocity"))
    assert sensors.to_joints("effort", TAU) is TAU


def test_units_joint_by_joint_and_rates(tmp_path: Path):
    file = tmp_path / "log.npz"
    np.savez(file, q=Q, tau=TAU)
    units = {"position": ["deg", "rad", "mm"], "effort": ["N.m", "mNm", "N"]}
    log = read_recording(file, units=units, rate_hz=2.0)
    np.testing.assert_allclose(log.position, Q * [np.pi / 180, 1.0, 1e-3], rtol=1e-15)
    np.testing.assert_array_equal(log.time, T)
    assert read_recording(file, mapping={"rate_hz": 4}).rate_hz == pytest.approx(4.0)


def test_ranges_of_columns_without_names(tmp_path: Path):
    file = tmp_path / "log.csv"
    np.savetxt(file, np.column_stack([T, Q, TAU]), delimiter=",")
    columns = {"time": 1, "position": "2:4", "effort": ["5:6", 7]}
    np.testing.assert_array_equal(read_recording(file, columns=columns).effort, TAU)


def test_the_coupled_wrist_of_a_real_robot(data_folder: Path):
    file = data_folder / "staubli_tx40/tx40_rows_0_24750.npz"
    ratios = np.diag([32.0, 32.0, 45.0, -48.0, 45.0, 32.0])
    ratios[5, 4] = 32.0
    log = read_recording(
        file,
        columns={"position": "q_motor", "effort": "tau_motor"},
        motors={"position_matrix": ratios, "offsets": [0, -np.pi / 2, np.pi / 2, 0, 0, 0]},
    )
    expected = read_recording(file)
    np.testing.assert_allclose(log.position, expected.position, atol=1e-12)
    np.testing.assert_allclose(log.effort, expected.effort, atol=1e-12)
