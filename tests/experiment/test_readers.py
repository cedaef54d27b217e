"""What readers find and refuse, mappings beside logs, currents, and commanded positions."""

import gzip
import pickle
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import sdpid
from sdpid._common.files import load_toml
from sdpid.cli.logs import LOG, READING
from sdpid.errors import DataError
from sdpid.experiment.preparation.prepare import samples_of
from sdpid.experiment.readers.mapping import read_mapping
from sdpid.experiment.readers.read import read_described, read_recording
from sdpid.experiment.readers.scaled import scaled
from sdpid.experiment.recording.gaps import continuous, unwrapped
from sdpid.experiment.recording.joints import match_joints
from sdpid.experiment.recording.motor_side import MotorSide
from sdpid.experiment.recording.recording import Recording
from tests.helpers.commands import given
from tests.helpers.refusals import refuses

N = 8
RNG = np.random.default_rng(7)
T = 0.5 * np.arange(N)
Q, DQ, TAU = (RNG.standard_normal((N, 3)) for _ in range(3))
GEARS = {"gear_ratios": [1, 2, 3]}
NAMES = ["up", "down", "side"]


def changed(values: np.ndarray, row: int, value: float) -> np.ndarray:
    values = values.copy()
    values[row] = value
    return values


ARGUMENTS: list[tuple[dict[str, Any], str]] = [
    ({"columns": {"effort": "x"}}, "'x' for effort is not there"),
    ({"columns": {"effort": ["x"]}}, "x for effort is not there"),
    ({"columns": {"time": "x"}}, "'x' for time is not there"),
    ({"columns": {"torque": "tau"}}, "columns: torque is not a quantity"),
    ({"units": {"position": "grad"}}, "'grad' is not known for position; known are rad, deg"),
    ({"units": {"effort": "A"}}, "currents in A, which need gains: let `sdpid gains`"),
    *(
        (given, r"units\.\w+ is .*, expected a text")
        for units in ({"time": ["s"]}, {"position": 3}, {"position": [["rad"]]})
        for given in ({"units": units}, {"mapping": {"units": units}})
    ),
    ({"missing": "guess"}, "missing is 'guess', expected one of refuse, drop"),
    ({"misssing": "drop"}, "misssing is no argument"),
    ({"topic": "/states"}, "topic is for ROS bags"),
    ({"mapping": True}, "no mapping beside it"),
    ({"motors": GEARS, "effort_scale": [1, 1, 1]}, "effort_scale is of the joints' side"),
    ({"motors": {}}, "give either gear_ratios"),
    ({"motors": {**GEARS, "position_matrix": np.eye(3)}}, "give either gear_ratios"),
    ({"motors": {**GEARS, "signs": [1, 2, 1]}}, "expected 1 or -1"),
    ({"motors": {"gear_ratios": [1, 0, 3]}}, "cannot be inverted"),
    ({"motors": {"gear_ratios": [1, "x", 3]}}, "real numbers"),
    ({"motors": {"gear_ratios": [1, 2]}}, "motors is for 2 columns"),
    ({"motors": {**GEARS, "offsets": [1, 2]}}, r"offsets: has shape \(2,\)"),
    ({"motors": {**GEARS, "offset": [1, 2, 3]}}, "offset is not known"),
    ({"motors": {**GEARS, "applies_to": "effort"}}, "applies_to"),
    ({"motors": {"position_matrix": [[1, 2, 3]]}}, "position_matrix: has shape"),
    ({"motors": {"position_matrix": 3}}, "position_matrix: has 0 axes"),
]

ARRAYS: list[tuple[dict[str, Any], str]] = [
    ({"tau": None, "I": TAU}, r"effort is missing: none of effort, tau.*Found: t, q, I"),
    ({"t": None}, "time is missing"),
    ({"t": None, "fs": -2.0}, "sample rate"),
    ({"t": changed(T, 6, T[5])}, r"log\.npz: time repeats at row 7: 2\.5 s after 2\.5 s"),
    ({"dq": DQ.T, "joint_names": NAMES}, r"velocity: has shape \(3, 8\), expected \(8, 3\)"),
    ({"q": changed(Q, 3, np.inf)}, "row 4: position: .* is inf, not finite"),
]

MAPPINGS = [
    ("colums = 1", "colums is not known; known are columns"),
    ("columns = 1", r"expected a table \[columns\]"),
    ("[columns]\ntorque = 'x'", "torque is not a quantity"),
    ("[units]\nposition = 3", "units.position is 3"),
    ("[units]\nposition = ['deg', 'deg']", "2 units for position"),
    ("joint_names = 'a'", "joint_names is 'a'"),
    ("period = 'x'", "period is 'x'"),
    ("topic = 3", "topic is 3"),
    ("[units]\ntime = ['rad']", r"units.time is \['rad'\]"),
    ("[motors]\ngear = 3", "log.toml: motors: gear is not known"),
    ("x = ", "not a TOML file"),
]

TEXTS = [
    ("t,q,tau\n0,1,2\n1,oops,2\n", "line 3: 'q' holds 'oops', not a number"),
    ("0,1,2\n1,1,2\n", "first line must name the columns"),
    ("t,q1,tau1\n0,1,2\n1,,2\n", r"line 3: position: 'q1' has no value \(NaN\), as in 1 of 2 rows"),
    ("t;q1;tau1\n0;1.5;2\n1;1,5;2\n", "'q1' holds '1.5' where other decimals have commas"),
    ("t,q1,tau1\n0,1,2\n1,2\n", "line 3 has 2 values for 3 columns"),
    (
        "t,position_a,position_b,effort_a,effort_c\n0,1,2,1,2\n1,1,2,1,2\n",
        "effort are of joints a, c",
    ),
]


@pytest.mark.parametrize(("given", "words"), ARGUMENTS)
def test_arguments(tmp_path: Path, given: dict[str, Any], words: str):
    np.savez(tmp_path / "log.npz", t=T, q=Q, tau=TAU)
    refuses(DataError, words, read_recording, tmp_path / "log.npz", **given)


@pytest.mark.parametrize(("changes", "words"), ARRAYS)
def test_arrays(tmp_path: Path, changes: dict[str, Any], words: str):
    arrays = {"t": T, "q": Q, "tau": TAU} | changes
    np.savez(tmp_path / "log.npz", **{k: v for k, v in arrays.items() if v is not None})
    refuses(DataError, words, read_recording, tmp_path / "log.npz")


@pytest.mark.parametrize(("text", "words"), MAPPINGS)
def test_mappings(tmp_path: Path, text: str, words: str):
    np.savez(tmp_path / "log.npz", t=T, q=Q, tau=TAU)
    (tmp_path / "log.toml").write_text(text)
    refuses(DataError, words, read_recording, tmp_path / "log.npz")


@pytest.mark.parametrize(("text", "words"), TEXTS)
def test_texts(tmp_path: Path, text: str, words: str):
    (tmp_path / "log.csv").write_text(text)
    refuses(DataError, words, read_recording, tmp_path / "log.csv")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("log.xyz", r"supported are \.bag, \.csv, \.csv\.gz, \.db3.*, folder\."),
        ("absent.npz", "no such file"),
    ],
)
def test_files(tmp_path: Path, name: str, words: str):
    refuses(DataError, words, read_recording, tmp_path / name)


# Mappings beside logs, units joint by joint, and the motors' side.


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
    assert beside in given(LOG, READING, log=file).inputs()


def test_the_mapping_of_the_documentation(tmp_path: Path):
    page = Path(__file__).resolve().parents[2] / "docs/guides/logs.md"
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


# Currents and gains: what a recording of currents may be used for, and who finds which gain.


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
    samples = samples_of(robot, scaled(log, gains))
    assert samples.gains.joint_names == robot.joint_names
    np.testing.assert_array_equal(samples.gains.gains, [2.0, 3.0, 4.0, 5.0, 1.0, 6.0])
    np.testing.assert_array_equal(samples.gains.covariance, np.diag(samples.gains.gains) / 1e4)
    assert samples.between(0, 50).gains is samples.gains
    with pytest.raises(DataError, match="others than those of the first"):
        sdpid.Samples.join([samples, samples_of(robot, scaled(log, gains.gains))])


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


# What is found by the usual names, whatever writes it.


def table_csv(folder: Path, header: list[str], *tables: np.ndarray, delimiter: str = ",") -> Path:
    file, rows = folder / "log.csv", np.column_stack(tables)
    text = delimiter.join(header)
    np.savetxt(file, rows, header=text, delimiter=delimiter, comments="", fmt="%.17g")
    return file


def test_npz_by_the_usual_names(tmp_path: Path):
    file = tmp_path / "log.npz"
    np.savez(file, t=T, q=Q, tau=TAU, dq=DQ, joint_names=np.array(NAMES))
    log = read_recording(file)
    for name, wanted in {"time": T, "position": Q, "effort": TAU, "velocity": DQ}.items():
        np.testing.assert_array_equal(getattr(log, name), wanted)
    assert log.joint_names == tuple(NAMES)
    # Time from the sample rate, and vectors of a single joint.
    np.savez(file, q=Q[:, 0], tau=TAU[:, 0], fs=2.0)
    reading = read_described(file)
    np.testing.assert_array_equal(reading.recording.time, T)
    assert reading.recording.n == 1
    assert reading.sources["time"] == "sample rate, 2 Hz"


@pytest.mark.parametrize(
    ("pattern", "delimiter"),
    [("q{}", ","), ("q_{}", ";"), ("q[{}]", "\t"), ("position.{}", ","), ("Pos_{}", ";")],
)
def test_csv_with_numbered_columns(tmp_path: Path, pattern: str, delimiter: str):
    # In numeric order, and without those of commands.
    header = ["time", *map(pattern.format, (10, 2, 1)), "tau_2", "tau_1", "tau_10"]
    tables = T, Q, TAU, DQ[:, 0]
    file = table_csv(tmp_path, [*header, "tau_target_1"], *tables, delimiter=delimiter)
    log = read_recording(file)
    np.testing.assert_array_equal(log.position, Q[:, ::-1])
    np.testing.assert_array_equal(log.effort, TAU[:, [1, 0, 2]])
    assert log.joint_names is None


def test_csv_with_joint_names_text_columns_and_quotes(tmp_path: Path):
    text = 'label,"time",position_up,position_down,effort_up,effort_down\n'
    text += "".join(f"go,{k},{k},{-k},{2 * k},{-2 * k}\n" for k in range(4))
    file = tmp_path / "log.csv"
    file.write_text("\ufeff" + text, encoding="utf-8")
    log = read_recording(file)
    assert log.joint_names == ("up", "down")
    assert log.effort[3].tolist() == [6.0, -6.0]
    log = read_recording(file, joint_names=("down", "up"))
    assert log.effort[3].tolist() == [-6.0, 6.0]
    log = read_recording(file, columns={"position": ["position_down"], "effort": ["effort_down"]})
    assert log.position[:, 0].tolist() == [0.0, -1.0, -2.0, -3.0]


def test_own_parquet_and_overrides(tmp_path: Path):
    file = tmp_path / "log.PARQUET"
    log = Recording(time=T, position=Q, effort=TAU, joint_names=tuple(NAMES), period=1.0)
    log.to_parquet(file)
    again = read_recording(file)
    assert again.period == 1.0
    assert again.effort.tobytes() == log.effort.tobytes()
    assert read_recording(file, period=2.0).period == 2.0
    turned = read_recording(file, joint_names=NAMES[::-1])
    np.testing.assert_array_equal(turned.position, Q[:, ::-1])
    assert turned.period == 1.0


def test_foreign_parquet_with_lists(tmp_path: Path):
    file = tmp_path / "log.parquet"
    pq.write_table(pa.table({"t": T, "q": Q.tolist(), "tau": TAU.tolist()}), file)
    log = read_recording(file)
    np.testing.assert_array_equal(log.position, Q)
    pq.write_table(
        pa.table({"t": [0.0, 1.0], "q": [[1.0], [1.0, 2.0]], "tau": [[1.0], [2.0]]}), file
    )
    refuses(DataError, "'q' is ragged: its rows have 1 to 2", read_recording, file)
    pq.write_table(pa.table({"t": [0.0, 1.0], "q": [1.0, None], "tau": [1.0, 2.0]}), file)
    refuses(DataError, "row 2: position: 'q' has no value", read_recording, file)


class Bomb:
    def __reduce__(self) -> tuple[Any, ...]:
        return (pytest.fail, ("a pickle was executed",))


def test_nothing_is_unpickled(tmp_path: Path):
    boxed = np.empty((), dtype=object)
    boxed[()] = Bomb()
    # An object beside the data does no harm, as long as it is not wanted.
    file = tmp_path / "log.npz"
    np.savez(file, t=T, q=Q, tau=TAU, config=boxed)
    assert read_recording(file).n == 3
    np.savez(file, t=T, q=boxed, tau=TAU)
    refuses(DataError, "'q' holds Python objects", read_recording, file)
    file.write_bytes(pickle.dumps([1]))
    refuses(DataError, "not a readable NumPy archive", read_recording, file)


ROBOTS = {
    "kinova_gen3_dynamapp/opti_traj_testing1.npz": (4741, 7, 1000.0),
    "kuka_lwr4plus/measurements_1.npz": (5027, 7, 200.0),
    "panda_unisa/panda_exciting.npz": (727, 7, 30.0),
    "staubli_tx40/tx40_rows_0_24750.npz": (24750, 6, 5000.0),
    "ur10_unisa/ur10_exciting.npz": (3441, 6, 125.0),
}


@pytest.mark.parametrize("name", ROBOTS)
def test_real_logs(data_folder: Path, name: str):
    samples, joints, rate = ROBOTS[name]
    log = read_recording(data_folder / name)
    assert (log.n_samples, log.n) == (samples, joints)
    assert log.rate_hz == pytest.approx(rate, rel=1e-4)
    assert log.joint_names is not None


# Commanded positions: found where their names are clear, and kept by everything.


STEPS = 300
SLOW = 0.01 * np.arange(STEPS)
MOVED = np.sin(np.outer(SLOW, [1.0, 1.7]))
REF = np.sin(np.outer(SLOW + 0.02, [1.0, 1.7]))
TORQUE = np.random.default_rng(5).standard_normal((STEPS, 2))


def with_reference(folder: Path, names: list[str], *tables: Any) -> Path:
    file = folder / "log.csv"
    rows = np.column_stack([SLOW, MOVED, TORQUE, *tables])
    np.savetxt(file, rows, delimiter=",", header=",".join(["t", *names]), comments="", fmt="%.17g")
    return file


def pair(template: str) -> list[str]:
    return [template.format(j) for j in (1, 2)]


@pytest.mark.parametrize(
    "name",
    [
        *("q_d_{}", "q_d[{}]", "q_des_{}", "target_q_{}", "position_reference_{}", "reference_{}"),
        *("ref_pos_{}", "q_cmd{}", "joint_position_command_{}", "q_setpoint_{}"),
    ],
)
def test_numbered_references_are_found(tmp_path: Path, name: str):
    names = [*pair("q_{}"), *pair("tau_{}"), *pair("dq_d_{}"), *pair("tau_J_d_{}"), *pair(name)]
    log = read_recording(with_reference(tmp_path, names, 0 * MOVED, 0 * MOVED, REF))
    np.testing.assert_array_equal(log.reference, REF)
    np.testing.assert_array_equal(log.position, MOVED)
    assert log.velocity is None


def test_references_by_joints_units_and_arrays(tmp_path: Path):
    labels = ("lift", "elbow")
    names = [f"{each}_{q}" for q in ("position", "effort") for each in labels]
    file = with_reference(
        tmp_path, [*names, "elbow_target_position", "lift_target_position"], REF[:, ::-1]
    )
    np.testing.assert_array_equal(read_recording(file).reference, REF)
    assert read_recording(file, columns={"reference": None}).reference is None
    # A reference has the unit of the position, unless it says otherwise.
    names = [*pair("Joint {} [deg]"), *pair("Torque {} (Nm)"), *pair("Command {} [deg]")]
    file = with_reference(tmp_path, names, REF)
    np.testing.assert_allclose(read_recording(file).reference, np.radians(REF))
    names = [*pair("q_{}"), *pair("tau_{}"), *pair("q_ref_{}")]
    file = with_reference(tmp_path, names, REF)
    log = read_recording(file, units={"position": "deg"})
    np.testing.assert_allclose(log.reference, np.radians(REF))
    log = read_recording(file, units={"position": "deg", "reference": "rad"})
    np.testing.assert_array_equal(log.reference, REF)
    log = read_recording(file, motors={"gear_ratios": [10.0, -20.0], "offsets": [0.5, 0.0]})
    np.testing.assert_allclose(log.reference, REF / [10.0, -20.0] + [0.5, 0.0])
    motors = {"gear_ratios": [10.0, 20.0], "applies_to": ["position"]}
    np.testing.assert_array_equal(read_recording(file, motors=motors).reference, REF)
    np.savez(tmp_path / "log.npz", t=SLOW, q=MOVED, tau=TORQUE, q_d=REF)
    np.testing.assert_array_equal(read_recording(tmp_path / "log.npz").reference, REF)


@pytest.mark.parametrize(
    ("names", "table", "why"),
    [
        # A derivative by its values, and by the second derivative beside it.
        (pair("q_d_{}"), np.cos(np.outer(SLOW, [1.0, 1.7])), "may be a derivative"),
        ([*pair("q_d_{}"), *pair("q_dd_{}")], np.hstack([REF, REF]), None),
        (pair("command_{}"), REF, None),
        (pair("target_{}"), REF, None),
        (pair("target_qd_{}"), REF, None),
        (pair("qd_des_{}"), REF, None),
        (pair("tau_ref_{}"), REF, None),
        (pair("Command {} [A]"), REF, None),
        (pair("position_error_{}"), REF, None),
        ([*pair("q_ref_{}"), *pair("target_q_{}")], np.hstack([REF, REF]), "it could be "),
        (pair("q_ref_{}"), np.where(SLOW[:, None] > 1.0, np.nan, REF), "lacks values"),
    ],
)
def test_what_may_be_something_else_is_left_out(
    tmp_path: Path, names: list[str], table: np.ndarray, why: str | None
):
    file = with_reference(tmp_path, [*pair("q_{}"), *pair("tau_{}"), *names], table)
    reading = read_described(file)
    assert reading.recording.reference is None
    if why is None:
        assert "reference" not in reading.sources
    else:
        assert why in reading.sources["reference"]
    if np.isfinite(table).all():
        units = {"reference": "rad"}
        log = read_recording(file, columns={"reference": names[:2]}, units=units)
        np.testing.assert_array_equal(log.reference, table[:, :2])
    else:
        refuses(DataError, "reference", read_recording, file, columns={"reference": names[:2]})


def test_positions_of_a_joint_called_d_are_no_reference(tmp_path: Path):
    names = ["q_c", "q_d", "tau_c", "tau_d"]
    log = read_recording(with_reference(tmp_path, names))
    assert log.joint_names == ("c", "d")
    assert log.reference is None


@pytest.mark.parametrize("stored", [False, True])
def test_a_recording_keeps_its_reference(tmp_path: Path, stored: bool):
    log = Recording(
        time=SLOW, position=MOVED, effort=TORQUE, reference=REF, joint_names=("lift", "elbow")
    )
    assert repr(log) == "Recording(300 samples, 2 joints, 100 Hz, with reference)"
    assert "with reference" in log._repr_html_()
    log.to_csv(tmp_path / "log.csv")
    log.to_parquet(tmp_path / "log.parquet")
    np.testing.assert_array_equal(read_recording(tmp_path / "log.csv").reference, REF)
    log = read_recording(tmp_path / "log.parquet", stored=stored)
    np.testing.assert_array_equal(log.reference, REF)
    picked = read_recording(tmp_path / "log.parquet", joint_names=["elbow"], stored=stored)
    np.testing.assert_array_equal(picked.reference, REF[:, 1:])
    with pytest.raises(DataError, match=r"reference: has shape \(300, 1\), expected \(300, 2\)"):
        replace(log, reference=REF[:, :1])
    # The robot's order, gaps and late stamps.
    robot = SimpleNamespace(n=2, n_base=0, name="arm", joint_names=("elbow", "lift"), passive=())
    np.testing.assert_array_equal(match_joints(cast(Any, robot), log).reference, REF[:, ::-1])
    gap = np.delete(np.arange(STEPS), np.s_[100:150])
    kept = {"time": SLOW[gap], "position": MOVED[gap], "effort": TORQUE[gap], "reference": REF[gap]}
    pieces, _ = continuous(Recording(**kept))
    assert len(pieces) == 2
    np.testing.assert_array_equal(np.concatenate([each.reference for each in pieces]), REF[gap])


def test_wrapped_references_follow_positions():
    angle, ahead = 3.0 * np.outer(SLOW, [1.0, 0.3]), 3.0 * np.outer(SLOW + 0.03, [1.0, 0.3])

    def wrapped(values: np.ndarray) -> np.ndarray:
        return np.mod(values + np.pi, 2.0 * np.pi) - np.pi

    log = Recording(time=SLOW, position=wrapped(angle), effort=TORQUE, reference=wrapped(ahead))
    found, _ = unwrapped(log)
    np.testing.assert_allclose(found.reference, ahead, atol=1e-12)
    # Whole turns off, and only one of them wrapped.
    log = Recording(time=SLOW, position=angle, effort=TORQUE, reference=ahead + 4.0 * np.pi)
    np.testing.assert_allclose(unwrapped(log)[0].reference, ahead, atol=1e-12)
    # In degrees nothing is known of turns.
    log = Recording(time=SLOW, position=angle, effort=TORQUE, reference=np.degrees(ahead))
    assert unwrapped(log)[0] is log


def test_simulated_references_are_what_the_controller_followed():
    robot = sdpid.load_robot("denso_vp6242")
    from sdpid.experiment.plant.drives import load_drives

    log = sdpid.simulate(robot, seed=1, noise=False)
    drives = load_drives(robot.name)
    speed = (log.position[2:] - log.position[:-2]) / (2.0 * log.step)
    behind = log.reference[1:-1] - log.position[1:-1]
    torque = drives.velocity_gain * (drives.proportional_gain * behind - speed)
    off = np.sqrt(np.mean((torque - log.effort[1:-1]) ** 2, axis=0))
    assert np.all(off < 2e-3 * log.effort.std(axis=0))
