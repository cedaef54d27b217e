"""What readers find and refuse, mappings beside logs, currents, and commanded positions."""

import gzip
import re
from itertools import cycle, product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import sdpid
from sdpid.cli.logs import LOG, READING
from sdpid.errors import DataError
from sdpid.experiment.plant.simulate import load_drives
from sdpid.experiment.preparation.prepare import samples_of
from sdpid.experiment.readers.mapping import read_mapping
from sdpid.experiment.readers.names import QUANTITIES, UNITS
from sdpid.experiment.readers.read import read_described, read_recording
from sdpid.experiment.readers.scaled import scaled
from sdpid.experiment.recording.gaps import unwrapped
from sdpid.experiment.recording.motor_side import MotorSide
from sdpid.experiment.recording.recording import CHANNELS, Recording
from tests.helpers import logs
from tests.helpers.commands import given
from tests.helpers.logs import numbered, write_csv, write_npz
from tests.helpers.refusals import refuses

N = 8
RNG = np.random.default_rng(7)
T = 0.5 * np.arange(N)
Q, DQ, TAU = (RNG.standard_normal((N, 3)) for _ in range(3))
TABLES = {"time": T, "position": Q, "effort": TAU, "velocity": DQ}
GEARS = {"gear_ratios": [1, 2, 3]}
NAMES = ["up", "down", "side"]


def changed(values: np.ndarray, row: int, value: float) -> np.ndarray:
    values = values.copy()
    values[row] = value
    return values


# What differs from a log that is read: arrays, the text of a CSV file or of a mapping, or
# arguments.
REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"columns": {"effort": "x"}}, "'x' for effort is not there"),
    ({"columns": {"effort": ["x"]}}, "x for effort is not there"),
    ({"columns": {"torque": "tau"}}, "columns: torque is not a quantity"),
    ({"units": {"position": "grad"}}, "grad is not known for position; known are rad, deg"),
    ({"units": {"effort": "A"}}, "currents in A, which need gains: let `sdpid gains`"),
    *(
        ({"units": units}, r"units\.\w+ is .*, expected a text")
        for units in ({"time": ["s"]}, {"position": 3}, {"position": [["rad"]]})
    ),
    ({"missing": "guess"}, "missing is 'guess', expected one of refuse, drop"),
    ({"misssing": "drop"}, "misssing is no argument"),
    ({"topic": "/states"}, r"topic is for ROS bags; this is a file \.npz"),
    ({"stored": True}, "stored=True keeps the values of Parquet files on disk; this is a file"),
    ({"mapping": True}, "no mapping beside it"),
    ({"motors": GEARS, "effort_scale": [1, 1, 1]}, "effort_scale is of the joints' side"),
    ({"motors": {}}, "give either gear_ratios"),
    ({"motors": {**GEARS, "signs": [1, 2, 1]}}, "expected 1 or -1"),
    ({"motors": {"gear_ratios": [1, 0, 3]}}, "cannot be inverted"),
    ({"motors": {"gear_ratios": [1, 2]}}, "motors is for 2 columns"),
    ({"motors": {**GEARS, "offsets": [1, 2]}}, r"offsets: has shape \(2,\)"),
    ({"motors": {**GEARS, "offset": [1, 2, 3]}}, "offset is not known"),
    ({"motors": {**GEARS, "applies_to": "effort"}}, "applies_to"),
    ({"motors": {**GEARS, "applies_to": [["effort"]]}}, "applies_to: is .*, expected some of"),
    ({"motors": {"position_matrix": [[1, 2, 3]]}}, "position_matrix: has shape"),
    ({"motors": {"position_matrix": 3}}, "position_matrix: has 0 axes"),
    ({"motors": {**GEARS, "torque_constants": [1, 1, 1]}, "currents": True}, "leave one out"),
    ({"effort_scale": [1, 0, 1]}, "expected 3 non-zero factors, one for each joint"),
    ({"arrays": {"tau": None, "I": TAU}}, r"effort is missing: none of effort, .*: t, q, I"),
    ({"arrays": {"t": None}}, "time is missing"),
    ({"arrays": {"t": None, "fs": -2.0}}, r"log\.npz: the sample rate is -2"),
    ({"arrays": {"t": np.ones((2, 4))}}, r"time: has the shape \(2, 4\)"),
    ({"arrays": {"t": T.astype(str)}}, "time: holds <U.*, expected numbers"),
    ({"arrays": {"t": changed(T, 6, T[5])}}, r"log\.npz: time repeats at row 7: 2\.5 s after 2"),
    ({"arrays": {"q": np.ones((N, 1, 3))}}, r"position: has the shape \(8, 1, 3\)"),
    ({"arrays": {"joint_names": np.arange(3)}}, "joint_names: holds int64, expected text"),
    ({"arrays": {"dq": DQ.T}}, r"velocity: has shape \(3, 8\), expected \(8, 3\)"),
    ({"arrays": {"q": changed(Q, 3, np.inf)}}, "row 4: position: .* is inf, not finite"),
    ({"toml": "colums = 1"}, "colums is not known; known are columns"),
    ({"toml": "columns = 1"}, r"expected a table \[columns\]"),
    ({"toml": "[units]\nposition = ['deg', 'deg']"}, "2 units for position"),
    ({"toml": "joint_names = 'a'"}, "joint_names is 'a'"),
    ({"toml": "period = 'x'"}, "period is 'x'"),
    ({"toml": "topic = 3"}, "topic is 3"),
    ({"toml": "[motors]\ngear = 3"}, "log.toml: motors: gear is not known"),
    ({"toml": "x = "}, "not a TOML file"),
    ({"csv": "t,q,tau\n0,1,2\n1,oops,2\n"}, "line 3: 'q' holds 'oops', not a number"),
    ({"csv": "0,1,2\n1,1,2\n"}, "first line must name the columns"),
    ({"csv": "t,q1,i1 [A]\n0,1,2\n"}, r"i1 \[A\] look like currents: give gains="),
    ({"csv": "t,q,tau\n"}, "has no header and no data"),
    ({"csv": "t,q,q\n0,1,2\n"}, "3 column names, 2 of them distinct"),
    ({"csv": "t,q,tau\n0,1\n"}, "3 column names for 2 values in line 2"),
    ({"csv": "t,q1,tau1\n0,1,2\n1,,2\n"}, r"line 3: position: 'q1' has no value \(NaN\), as in 1"),
    ({"csv": "t;q1;tau1\n0;1.5;2\n1;1,5;2\n"}, "'q1' holds '1.5' where other decimals have commas"),
    ({"csv": "t,q1,tau1\n0,1,2\n1,2\n"}, "line 3 has 2 values for 3 columns"),
    ({"csv": "t,q_a,q_b,tau_a,tau_c\n0,1,2,1,2\n"}, "effort are of joints a, c"),
    ({"file": "log.xyz"}, r"supported are \.bag, \.csv, \.csv\.gz, \.db3.*, folder\."),
    ({"file": "absent.npz"}, "no such file"),
]


@pytest.mark.parametrize(("change", "words"), REFUSED)
def test_what_is_refused(tmp_path: Path, change: dict[str, Any], words: str):
    kinds = ("arrays", "toml", "csv", "file")
    how = {name: value for name, value in change.items() if name not in kinds}
    file = write_npz(
        tmp_path / "log.npz", **{"t": T, "q": Q, "tau": TAU, **change.get("arrays", {})}
    )
    if "toml" in change:
        (tmp_path / "log.toml").write_text(change["toml"])
    if "csv" in change:
        file = tmp_path / "log.csv"
        file.write_text(change["csv"])
    refuses(DataError, words, read_recording, tmp_path / change.get("file", file), **how)


# Mappings beside logs, units joint by joint, and the motors' side.


# Motor turns a joint turn, the last two joints coupled.
R = np.array([[100.0, 0.0, 0.0], [0.0, -50.0, 0.0], [0.0, 32.0, 32.0]])
OFFSETS = np.array([0.0, -1.5, 0.5])
CONSTANTS = np.array([0.1, 0.2, 0.3])
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


def motor_log(folder: Path) -> Path:
    """Write what encoders in degrees and amplifiers in mA would have logged."""
    enc = np.degrees((Q - OFFSETS) @ R.T)
    speed = DQ @ R.T * 60.0 / (2.0 * np.pi)
    current = TAU @ np.linalg.inv(R) / CONSTANTS * 1e3
    names = ["tick", *numbered("enc{}", "n{}", "cur{}", n=3)]
    return write_csv(folder / "run.csv", names, T * 1e6, enc, speed, current)


@pytest.mark.parametrize("name", ["run.csv", "run.csv.gz", "run.2.txt.gz", "RUN.TSV.GZ"])
def test_a_mapping_beside_the_log(tmp_path: Path, name: str):
    plain = motor_log(tmp_path)
    file, beside = (
        tmp_path / name,
        tmp_path / f"{re.sub(r'[.]...([.]gz)?$', '', name, flags=re.I)}.toml",
    )
    if file != plain:
        file.write_bytes(gzip.compress(plain.read_bytes()))
    refuses(DataError, "position is missing", read_recording, file)
    beside.write_text(MAPPING)
    reading = read_described(file)
    log = reading.recording
    for quantity, wanted in TABLES.items():
        np.testing.assert_allclose(getattr(log, quantity), wanted, atol=1e-12)
    assert log.joint_names == ("base", "wrist", "hand")
    assert log.period_layout == (0, 4, 2)
    assert reading.mapping == str(beside)
    assert reading.sources["effort"] == "cur1 ... cur3 in mA, motor side"
    # Commands know it as a file that they read.
    assert beside in given(LOG, READING, log=file).inputs()
    # Arguments win, and the file beside the log can be ignored.
    assert read_recording(file, joint_names=["x", "y", "z"]).names == ("x", "y", "z")
    assert read_recording(file, columns={"velocity": None}).velocity is None
    refuses(DataError, "position is missing", read_recording, file, mapping=False)
    other = tmp_path / "other.toml"
    other.write_text(MAPPING.replace('effort = "mA"', 'effort = "A"'))
    np.testing.assert_allclose(read_recording(file, mapping=other).effort, 1e3 * TAU, atol=1e-9)


def test_the_mapping_of_the_documentation(tmp_path: Path):
    page = Path(__file__).resolve().parents[2] / "docs/guides/logs.md"
    blocks = re.findall(r"^```toml\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S)

    def written(name: str, text: str) -> Path:
        (tmp_path / name).write_text(text, encoding="utf-8")
        return tmp_path / name

    written("run.toml", blocks[0])
    rows = RNG.standard_normal((N, 12))
    log = read_recording(
        write_csv(tmp_path / "run.csv", numbered("enc{}", "i{}", n=6), rows, mark=";")
    )
    assert log.names[3] == "roll"
    assert log.rate_hz == pytest.approx(5000.0)
    np.testing.assert_allclose(log.position[:, 3], np.radians(rows[:, 3]) / -48)
    np.testing.assert_allclose(log.effort[:, 3], rows[:, 9] * 1e-3 * 0.08 * -48)
    # The keys that are commented out are right as well.
    open_text = re.sub(r"^# (?!applies_to)(?=\w+ = )", "", blocks[0], flags=re.M)
    wanted = ({"topic", "period"}, {"rate_hz", "base", "imu", "contacts"}, {"base"})
    for text, keys in zip((open_text, *blocks[1:]), wanted, strict=True):
        found = read_mapping(written("other.toml", text))
        assert keys <= set(found)
    assert set(found["base"]) == {"held", "orientation"}


def test_gears_signs_and_sides():
    side = MotorSide.from_gears([10.0, 20.0], [1, -1], offsets=[0.0, 1.0])
    rows = {"position": ([10, 20], [1, 0]), "velocity": ([10, 20], [1, -1])}
    for quantity, (row, wanted) in {**rows, "effort": ([1, 1], [10, -20])}.items():
        np.testing.assert_array_equal(side.to_joints(quantity, np.array([row])), [wanted])
    # Power is the same on both sides, for a coupled gear too.
    coupled = MotorSide(position_matrix=R)
    rates, efforts = coupled.to_joints("velocity", DQ), coupled.to_joints("effort", TAU)
    np.testing.assert_allclose((rates * efforts).sum(axis=1), (DQ * TAU).sum(axis=1), rtol=1e-12)
    sensors = MotorSide(position_matrix=R, applies_to=("position", "velocity"))
    assert sensors.to_joints("effort", TAU) is TAU


def test_units_joint_by_joint_rates_and_joints_without_effort(tmp_path: Path):
    file = write_npz(tmp_path / "log.npz", q=Q, tau=TAU)
    units = {"position": ["deg", "rad", "mm"], "effort": ["N.m", "mNm", "N"]}
    log = read_recording(file, units=units, rate_hz=2.0)
    np.testing.assert_allclose(log.position, Q * [np.pi / 180, 1.0, 1e-3], rtol=1e-15)
    np.testing.assert_array_equal(log.time, T)
    assert read_recording(file, mapping={"rate_hz": 4}).rate_hz == pytest.approx(4.0)
    file = write_npz(tmp_path / "log.npz", t=T, q=Q, tau=TAU * [1.0, np.nan, 1.0])
    found = read_recording(file, without_effort=["2"]).effort
    np.testing.assert_array_equal(found, TAU * [1.0, 0.0, 1.0])


def test_a_joint_whose_effort_has_no_column(tmp_path: Path):
    columns = {f"position_{name}": values for name, values in zip("abc", Q.T, strict=True)}
    columns |= {"time": T, "effort_c": TAU[:, 2], "effort_a": TAU[:, 0]}
    file = write_npz(tmp_path / "log.npz", **columns)
    found = read_recording(file, without_effort=["b"]).effort
    np.testing.assert_array_equal(found, TAU * [1.0, 0.0, 1.0])
    with pytest.raises(DataError, match=r"'effort of b' has no value in any row.*without_effort="):
        read_recording(file)


def test_the_coupled_wrist_of_a_real_robot(data_folder: Path):
    file = data_folder / "staubli_tx40/tx40_rows_0_24750.npz"
    ratios = np.diag([32.0, 32.0, 45.0, -48.0, 45.0, 32.0])
    ratios[5, 4] = 32.0
    motors = {"position_matrix": ratios, "offsets": [0, -np.pi / 2, np.pi / 2, 0, 0, 0]}
    columns = {"position": "q_motor", "effort": "tau_motor"}
    log, expected = read_recording(file, columns=columns, motors=motors), read_recording(file)
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
    # Names may have another prefix; without names the gains' order counts.
    prefixed = scaled(currents(("ur_joint1", "ur_joint2", "ur_joint3")), GAINS)
    np.testing.assert_array_equal(prefixed.effort, torques.effort)
    np.testing.assert_array_equal(scaled(currents(None), GAINS).effort, log.effort * [3, 1, 2])
    for given_log, gains, words in (
        (torques, GAINS, "turned into torques by gains already"),
        (currents(("hip", "knee", "heel")), GAINS, "none for hip, knee, heel"),
        (log, [1.0, 2.0], "gains: are 2, expected 3"),
        (currents(None), sdpid.DriveGains(joint_names=["a"], gains=[1.0]), "log has 3 columns"),
    ):
        refuses(DataError, words, scaled, given_log, gains)
    robot = sdpid.load_robot("denso_vp6242")
    words = "payload, without_load: efforts are currents in A"
    refuses(DataError, words, sdpid.identify_payload, robot, torques, log)


def test_gains_follow_picked_joints() -> None:
    robot = sdpid.load_robot("denso_vp6242")
    names = np.array([*robot.joint_names, "gripper"])[[4, 0, 1, 2, 3, 5, 6]]
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
    others = [samples, samples_of(robot, scaled(log, gains.gains))]
    refuses(DataError, "others than those of the first", sdpid.Samples.join, others)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_files_keep_currents_as_currents(tmp_path: Path, suffix: str) -> None:
    log, path = currents(), tmp_path / f"run{suffix}"
    (log.to_csv if suffix == ".csv" else log.to_parquet)(path)
    refuses(DataError, "look like currents: give gains=", read_recording, path)
    again = read_recording(path, currents=True)
    assert again.currents
    np.testing.assert_array_equal(again.effort, log.effort)
    turned = read_recording(path, gains=GAINS, effort_scale=[1.0, -1.0, 1.0])
    np.testing.assert_array_equal(turned.effort[:, 1], -2.0 * log.effort[:, 1])
    for how, words in (
        ({"effort_scale": [1.0, 2.0, 3.0]}, "makes torques of currents"),
        ({"units": {"effort": "N.m"}}, r"gains are for currents in A, but the unit .* is N\.m"),
        ({"currents": True}, "asks for currents"),
    ):
        refuses(DataError, words, read_recording, path, gains=GAINS, **how)
    GAINS.to_toml(tmp_path / "gains.toml")
    (tmp_path / "run.toml").write_text('gains = "gains.toml"\n')
    read = read_recording(path)
    np.testing.assert_array_equal(read.effort, scaled(log, GAINS).effort)
    # How it was read reads the same again, without the file of the gains.
    (tmp_path / "gains.toml").unlink()
    repeated = read_recording(path, mapping=False, **read.source.options)
    np.testing.assert_array_equal(repeated.effort, read.effort)
    assert repeated.gains.same_errors(read.gains)
    assert repeated.gains.source == read.gains.source


# What is found by the usual names, whatever writes it.


ZERO = 0.0 * logs.Q
# The columns of a log that is read as T, Q, TAU and DQ; how the file is written and read; whether
# there are velocities, and the names of the joints.
FRANKA = ("q", "q_d", "dq", "dq_d", "ddq_d", "tau_J", "tau_J_d", "tau_ext_hat_filtered", "O_T_EE")
OF_FRANKA = (logs.T, logs.Q, ZERO, logs.DQ, ZERO, ZERO, logs.TAU, ZERO, ZERO, logs.Q)
UR = [f"{k}_{j}" for k in ("target_q", "actual_q", "actual_qd", "actual_current") for j in (0, 1)]
OF_UR = (logs.T, ZERO, logs.Q, logs.DQ, logs.TAU / [10.0, 12.0])
PANDAS = ("position_deg", "velocity", "torque", "target_position")
OF_PANDAS = (logs.T, np.degrees(logs.Q[:, ::-1]), logs.DQ[:, ::-1], logs.TAU[:, ::-1], ZERO)
BRACKETS = ["Time [ms]", *numbered("Joint {} [deg]", "Joint {} [deg/s]")]
BRACKETS += ["Torque 1 (Nm)", "Torque 2 (mNm)"]
MIXED = (logs.T * 1e3, np.degrees(logs.Q), np.degrees(logs.DQ), logs.TAU * [1.0, 1e3])
BARE = ["Time", *numbered("Joint {}", "Speed {}", "Torque {}")]
NUMBERS = {"time": 1, "position": "2:3", "effort": ["4:4", 5], "velocity": [6, 7]}
IN_AMPERES, SCALED = (logs.T, logs.Q, logs.TAU / [10.0, 0.012]), {"effort_scale": [10.0, 12.0]}
READ, MOVING = (logs.T, logs.Q, logs.TAU), (logs.T, logs.Q, logs.TAU, logs.DQ)
TURNED = (logs.T, logs.Q[:, ::-1], logs.TAU, logs.T)
TWO, JOINTS = ("up", "down"), ("joint_1", "joint_2")
DECIMALS = ["t", *numbered("q{}", "tau{}")]
LABELS = ["position_up", "position_down", "effort_up", "effort_down"]
ENDINGS = [f"{joint}_{key}" for key in ("position_deg", "joint_position") for joint in TWO]

FOUND: list[tuple[list[str], tuple[Any, ...], dict[str, Any], bool, Any]] = [
    # Numbers in numeric order, and without those of commands.
    (["t", *("q10", "q2", "tau_2", "tau_10", "tau_target_2")], TURNED, {}, False, None),
    (["t", *(f"{key}_{j}" for key in FRANKA for j in (0, 1))], OF_FRANKA, {}, True, None),
    (["t", *(f"joint_{j}_{k}" for k in PANDAS for j in (2, 1))], OF_PANDAS, {}, True, JOINTS),
    (["t", *LABELS, "effort_model"], (*READ, logs.T), {}, False, TWO),
    # The longest of the endings that are known.
    (["t", *ENDINGS, "up_tau", "down_tau"], (logs.T, ZERO, logs.Q, logs.TAU), {}, False, TWO),
    # Units.
    *((BRACKETS, MIXED, {"mark": mark}, True, None) for mark in (",", ";", "\t")),
    ([*BARE[:-1], "Torque 2\nms,°,°,deg/s,deg/s,Nm,mNm"], MIXED, {}, True, None),
    (["t", "q1", "q2", "current1 [A]", "current2 [mA]"], IN_AMPERES, SCALED, False, None),
    (["t", *UR], OF_UR, SCALED, True, None),
    (["t", *UR], OF_UR, {"columns": {"effort": "actual_current"}, **SCALED}, True, None),
    # Decimal commas, and no names.
    *((DECIMALS, READ, {"mark": mark, "decimal": ","}, False, None) for mark in ";\t "),
    ([], MOVING, {"columns": NUMBERS}, True, None),
    ([], MOVING, {"mapping": {"columns": NUMBERS}}, True, None),
]


# How a column is called by a name of its quantity and the number or the name of a joint.
STYLES = ["{key}{n}", "{key}_{n}", "{key}[{n}]", "{key}.{n}", "{key} {n} [{unit}]"]
STYLES += ["{key}_{joint}", "{joint}_{key}", "/arm/{joint}/{key}"]


@pytest.mark.parametrize("quantity", CHANNELS)
def test_every_usual_name_and_every_style_is_found(quantity: str):
    tables = dict(zip(CHANNELS, (logs.Q, logs.TAU, logs.DQ, logs.Q, logs.TAU, logs.Q), strict=True))
    names = QUANTITIES[quantity].names
    for name, style in [*zip(names, cycle(STYLES)), *product(names[:1], STYLES)]:
        columns = {"t": logs.T}
        for channel, table in tables.items():
            key, unit = name if channel == quantity else channel, next(iter(UNITS[channel]))
            for n, joint in enumerate(TWO):
                columns[style.format(key=key, n=n, joint=joint, unit=unit)] = table[:, n]
        log = read_recording(pd.DataFrame(columns))
        logs.close(log, velocity=True, joints=TWO if "joint" in style else None)
        np.testing.assert_array_equal(log.reference, logs.Q)
        np.testing.assert_array_equal(log.link_position, logs.Q)


@pytest.mark.parametrize(("names", "tables", "how", "velocity", "joints"), FOUND)
def test_columns_are_found(
    tmp_path: Path, names: list[str], tables: Any, how: dict[str, Any], velocity: bool, joints: Any
):
    written = {key: how[key] for key in ("mark", "decimal") if key in how}
    file = write_csv(tmp_path / "log.csv", names, *tables, **written)
    reading = read_described(file, **{key: how[key] for key in how if key not in written})
    logs.close(reading.recording, velocity=velocity, joints=joints)
    if names is BRACKETS:
        assert reading.sources["effort"] == "Torque 1 (Nm) ... Torque 2 (mNm) in Nm/mNm"


# Commanded positions: found where their names are clear, and kept by everything.


STEPS = 300
SLOW = 0.01 * np.arange(STEPS)
MOVED = np.sin(np.outer(SLOW, [1.0, 1.7]))
REF = np.sin(np.outer(SLOW + 0.02, [1.0, 1.7]))
TORQUE = np.random.default_rng(5).standard_normal((STEPS, 2))
PLAIN = numbered("q_{}", "tau_{}")


def beside(*names: str) -> list[str]:
    return [*PLAIN, *numbered(*names)]


def test_references_of_arrays(tmp_path: Path):
    arrays = {"t": SLOW, "q": MOVED, "tau": TORQUE, "q_d": REF}
    found = read_recording(write_npz(tmp_path / "log.npz", **arrays))
    np.testing.assert_array_equal(found.reference, REF)
    # Columns of another name may be it as well, those of the same name are no others.
    for name, only in (("q_ref", False), ("q_d", True)):
        beside = {f"{name}_{j}": REF[:, j] for j in (0, 1)}
        reading = read_described(write_npz(tmp_path / "log.npz", **arrays, **beside))
        assert (reading.recording.reference is not None) == only
        assert only or "it could be q_d or q_ref_0" in reading.sources["reference"]


LABELED = [f"{each}_{q}" for q in ("position", "effort") for each in ("lift", "elbow")]
COMMANDED = numbered("Joint {} [deg]", "Torque {} (Nm)", "Command {} [deg]")
BESIDE = beside("q_ref_{}")
AT_MOTORS = {"gear_ratios": [10.0, -20.0], "offsets": [0.5, 0.0]}
OF_POSITIONS = {"gear_ratios": [10.0, 20.0], "applies_to": ["position"]}


BOTH = np.hstack([REF, REF])
# Names beside those of positions and efforts, columns under them, how they are read, what is found,
# and why nothing is.
REFERENCES: list[tuple[list[str], Any, dict[str, Any], Any, str | None]] = [
    ([*LABELED, "elbow_target_position", "lift_target_position"], REF[:, ::-1], {}, REF, None),
    (BESIDE, REF, {"columns": {"reference": None}}, None, None),
    # A reference has the unit of the position, unless it says otherwise.
    (COMMANDED, REF, {}, np.radians(REF), None),
    (BESIDE, REF, {"units": {"position": "deg"}}, np.radians(REF), None),
    (BESIDE, REF, {"units": {"position": "deg", "reference": "rad"}}, REF, None),
    (BESIDE, REF, {"motors": AT_MOTORS}, REF / [10.0, -20.0] + [0.5, 0.0], None),
    (BESIDE, REF, {"motors": OF_POSITIONS}, REF, None),
    # A joint called d has no reference.
    (["q_c", "q_d", "tau_c", "tau_d"], np.empty((STEPS, 0)), {}, None, None),
    # A derivative by its values, and by the second derivative beside it.
    (beside("q_d_{}"), np.cos(np.outer(SLOW, [1.0, 1.7])), {}, None, "may be a derivative"),
    (beside("q_d_{}", "q_dd_{}"), BOTH, {}, None, None),
    *((beside(name), REF, {}, None, None) for name in ("command_{}", "target_{}", "target_qd_{}")),
    *((beside(name), REF, {}, None, None) for name in ("qd_des_{}", "tau_ref_{}")),
    *((beside(name), REF, {}, None, None) for name in ("Command {} [A]", "position_error_{}")),
    (beside("q_ref_{}", "target_q_{}"), BOTH, {}, None, "it could be "),
    (BESIDE, np.where(SLOW[:, None] > 1.0, np.nan, REF), {}, None, "lacks values"),
]


@pytest.mark.parametrize(("names", "table", "how", "wanted", "why"), REFERENCES)
def test_references_are_found_and_what_may_be_something_else_is_left_out(
    tmp_path: Path, names: list[str], table: Any, how: dict[str, Any], wanted: Any, why: str | None
):
    file = write_csv(tmp_path / "log.csv", ["t", *names], SLOW, MOVED, TORQUE, table)
    reading = read_described(file, **how)
    assert (reading.recording.reference is None) == (wanted is None)
    assert wanted is not None or ("reference" in reading.sources) == (why is not None)
    assert why is None or why in reading.sources["reference"]
    if why is not None:
        arrays = pd.read_csv(file).drop(columns=names[2:4])
        refuses(
            DataError, f"effort is missing: .* They were left out: .*{why}", read_recording, arrays
        )
    if wanted is not None:
        np.testing.assert_allclose(reading.recording.reference, wanted, rtol=1e-15)
    elif names[:4] == PLAIN and not how:
        # It is taken where it is named.
        how = {"columns": {"reference": names[4:6]}, "units": {"reference": "rad"}}
        if np.isfinite(table).all():
            np.testing.assert_array_equal(read_recording(file, **how).reference, table[:, :2])
        else:
            refuses(DataError, "reference", read_recording, file, **how)


def test_wrapped_references_follow_positions():
    angle, ahead = 3.0 * np.outer(SLOW, [1.0, 0.3]), 3.0 * np.outer(SLOW + 0.03, [1.0, 0.3])

    def wrapped(values: np.ndarray) -> np.ndarray:
        return np.mod(values + np.pi, 2.0 * np.pi) - np.pi

    # Both wrapped, or whole turns off and only one of them wrapped.
    for positions, reference in ((wrapped(angle), wrapped(ahead)), (angle, ahead + 4.0 * np.pi)):
        log = Recording(time=SLOW, position=positions, effort=TORQUE, reference=reference)
        np.testing.assert_allclose(unwrapped(log)[0].reference, ahead, atol=1e-12)
    # In degrees nothing is known of turns.
    log = Recording(time=SLOW, position=angle, effort=TORQUE, reference=np.degrees(ahead))
    assert unwrapped(log)[0] is log


def test_simulated_references_are_what_the_controller_followed():
    robot = sdpid.load_robot("denso_vp6242")
    log = sdpid.simulate(robot, seed=1, noise=False)
    drives = load_drives(robot.name)
    speed = (log.position[2:] - log.position[:-2]) / (2.0 * log.step)
    behind = log.reference[1:-1] - log.position[1:-1]
    torque = drives.velocity_gain * (drives.proportional_gain * behind - speed)
    off = np.sqrt(np.mean((torque - log.effort[1:-1]) ** 2, axis=0))
    assert np.all(off < 2e-3 * log.effort.std(axis=0))
