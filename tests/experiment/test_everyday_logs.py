"""Logs as people have them: other names, units, decimal marks, stamps and gaps."""

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from sdpid.errors import DataError, ExportError
from sdpid.experiment.readers.read import read_described, read_recording
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.recording.timestamps import guess_time_unit
from tests.experiment.test_recording import log
from tests.helpers.bags import JOINTS, write_bag
from tests.helpers.refusals import refuses
from tests.helpers.studies import study

N = 40
RNG = np.random.default_rng(17)
T = 0.01 * np.arange(N)
Q, TAU, DQ = (RNG.standard_normal((N, 2)) for _ in range(3))


def write(file: Path, header: str, *tables: Any, mark: str = ",", decimal: str = ".") -> Path:
    rows = np.column_stack(tables)
    lines = [header] if header else []
    lines += [mark.join(repr(float(v)).replace(".", decimal) for v in row) for row in rows]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return file


def npz(folder: Path, **arrays: Any) -> Path:
    np.savez(folder / "log.npz", **arrays)
    return folder / "log.npz"


def same(log: Any, *, velocity: bool = False) -> None:
    np.testing.assert_allclose(log.time - log.time[0], T, atol=1e-12)
    np.testing.assert_allclose(log.position, Q, rtol=1e-14)
    np.testing.assert_allclose(log.effort, TAU, rtol=1e-14)
    assert (log.velocity is not None) == velocity
    if velocity:
        np.testing.assert_allclose(log.velocity, DQ, rtol=1e-14)


@pytest.mark.parametrize(
    ("unit", "factor", "start"),
    [
        *(("ns", 1e9, s) for s in (0, 17, 1_700_000_000 * 10**9)),
        *(("us", 1e6, s) for s in (0, 5_000_000, 1_700_000_000 * 10**6)),
        *(("ms", 1e3, s) for s in (0, 12, 1_700_000_000 * 10**3)),
    ],
)
@pytest.mark.parametrize("kind", ["integers", "floats", "csv"])
def test_whole_stamps_tell_their_unit(
    tmp_path: Path, unit: str, factor: float, start: int, kind: str
):
    stamps = start + np.rint(T * factor).astype(np.int64)
    if kind == "csv":
        frame = pd.DataFrame({"t": stamps, "q1": Q[:, 0], "tau1": TAU[:, 0]})
        frame.to_csv(tmp_path / "log.csv", index=False)
        file = tmp_path / "log.csv"
    else:
        file = npz(tmp_path, t=stamps if kind == "integers" else stamps * 1.0, q=Q, tau=TAU)
    reading = read_described(file)
    # A double holds nanoseconds since 1970 to 256 of them.
    exact = kind != "floats" or start < 10**16
    np.testing.assert_allclose(
        reading.recording.time - reading.recording.time[0], T, atol=1e-12 if exact else 1e-6
    )
    assert reading.recording.rate_hz == pytest.approx(100.0, rel=1e-4)
    assert f"taken for {unit}" in reading.sources["time"]
    # What is said is believed.
    seconds = npz(tmp_path, t=np.arange(N), q=Q, tau=TAU)
    assert read_recording(seconds, units={"time": "s"}).rate_hz == pytest.approx(1.0)


@pytest.mark.parametrize("rate", [21.0, 100.0, 125.0, 1000.0, 4000.0, 8000.0])
def test_stamps_in_seconds_are_left_alone(rate: float):
    for start in (0.0, 3.5, 1.7e9):
        assert guess_time_unit(start + np.arange(100) / rate) == "s"
    for unit, factor in (("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        if factor >= 1e3 * max(1.0, rate / 1000.0):
            assert guess_time_unit(np.rint(np.arange(100) * factor / rate)) == unit
    assert guess_time_unit(1_700_000_000 + np.arange(5)) == "s"
    assert guess_time_unit(np.array([5])) == "s"


def test_columns_called_period_and_start_are_left_alone(tmp_path: Path):
    header = "t,q1,q2,tau1,tau2,period,start,periods,rate"
    file = write(tmp_path / "log.csv", header, T, Q, TAU, DQ, DQ)
    log = read_recording(file)
    same(log)
    assert log.period is None
    assert log.start is None
    with pytest.raises(DataError, match="'period' for period has 40 values, expected one"):
        read_recording(file, columns={"period": "period"})
    assert read_recording(npz(tmp_path, t=T, q=Q, tau=TAU, period=0.2)).period == 0.2


def test_arrays_that_only_begin_like_a_quantity(tmp_path: Path):
    others = {
        "dq_logged": DQ,
        "tau_model": TAU,
        "q_ref": Q,
        "tau_hat": TAU,
        "q_note": np.array("x"),
    }
    same(read_recording(npz(tmp_path, t=T, q=Q, tau=TAU, **others)))
    # Of one joint.
    single = {"t": T, "q": Q[:, 0], "tau": TAU[:, 0], "dq_logged": DQ[:, 0], "tau_model": T}
    log = read_recording(npz(tmp_path, **single))
    assert log.n == 1
    assert log.velocity is None
    header = "t,position_a,position_b,effort_a,effort_b,effort_model"
    same(read_recording(write(tmp_path / "log.csv", header, T, Q, TAU, T)))


def test_franka_columns(tmp_path: Path):
    groups = {"q": Q, "q_d": 0 * Q, "dq": DQ, "dq_d": 0 * Q, "ddq_d": 0 * Q, "tau_J": TAU}
    groups |= {"tau_J_d": 0 * Q, "dtau_J": 0 * Q, "tau_ext_hat_filtered": 0 * Q, "O_T_EE": Q}
    header = ",".join(["time", *(f"{key}_{j}" for key in groups for j in range(2))])
    same(read_recording(write(tmp_path / "log.csv", header, T, *groups.values())), velocity=True)


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_units_in_brackets(tmp_path: Path, mark: str):
    names = ["Time [ms]", "Joint 1 [deg]", "Joint 2 [deg]", "Joint 1 [deg/s]", "Joint 2 [deg/s]"]
    names += ["Torque 1 (Nm)", "Torque 2 (mNm)"]
    tables = (T * 1e3, np.degrees(Q), np.degrees(DQ), TAU * [1.0, 1e3])
    file = write(tmp_path / "log.csv", mark.join(names), *tables, mark=mark)
    reading = read_described(file)
    same(reading.recording, velocity=True)
    assert reading.sources["effort"] == "Torque 1 (Nm) ... Torque 2 (mNm) in Nm/mNm"
    # A line of units under the names says the same.
    bare = [name.partition(" [")[0].partition(" (")[0] for name in names]
    units = ["ms", "°", "°", "deg/s", "deg/s", "Nm", "mNm"]
    bare[3:5] = ["Speed 1", "Speed 2"]
    file = write(file, mark.join(bare) + "\n" + mark.join(units), *tables, mark=mark)
    same(read_recording(file), velocity=True)


def test_currents_with_units(tmp_path: Path):
    header = "t,q1,q2,current1 [A],current2 [mA]"
    file = write(tmp_path / "log.csv", header, T, Q, TAU / [10.0, 0.012])
    refuses(DataError, r"current1 \[A\].* look like currents: give gains=", read_recording, file)
    log = read_recording(file, effort_scale=[10.0, 12.0])
    np.testing.assert_allclose(log.effort, TAU, rtol=1e-13)


def test_short_suffixes(tmp_path: Path):
    names = [f"joint{j}_{key}" for key in ("pos", "vel", "eff") for j in (1, 2)]
    log = read_recording(write(tmp_path / "log.csv", ",".join(["t", *names]), T, Q, DQ, TAU))
    same(log, velocity=True)
    assert log.joint_names == ("joint1", "joint2")


@pytest.mark.parametrize("mark", [";", "\t", " "])
def test_decimal_commas(tmp_path: Path, mark: str):
    header = mark.join(["t", "q1", "q2", "tau1", "tau2"])
    file = write(tmp_path / "log.csv", header, T, Q, TAU, mark=mark, decimal=",")
    same(read_recording(file))
    lines = file.read_text().splitlines()
    lines[7] = lines[7].replace(",", ".", 1)
    file.write_text("\n".join(lines))
    with pytest.raises(DataError, match=r"line 8: 't' holds .* where other decimals have commas"):
        read_recording(file)


@pytest.mark.parametrize("zone", ["", "Z", "+02:00", " UTC"])
@pytest.mark.parametrize("between", ["T", " "])
def test_dates(tmp_path: Path, zone: str, between: str):
    stamps = np.datetime64("2024-03-01T23:59:59.900000") + (T * 1e6).astype("timedelta64[us]")
    frame = pd.DataFrame({"time": [str(s).replace("T", between) + zone for s in stamps]})
    for name, values in (
        ("q1", Q[:, 0]),
        ("q2", Q[:, 1]),
        ("tau1", TAU[:, 0]),
        ("tau2", TAU[:, 1]),
    ):
        frame[name] = values
    frame.to_csv(tmp_path / "log.csv", index=False)
    same(read_recording(tmp_path / "log.csv"))


@pytest.mark.parametrize("zone", [None, "UTC", "Europe/Rome"])
@pytest.mark.parametrize("suffix", ["index", "column", ".parquet", ".feather"])
def test_stamps_with_time_zones(tmp_path: Path, zone: str | None, suffix: str):
    # Clocks in Rome go forward on this night.
    stamps = pd.date_range("2024-03-31T00:59:59.9", periods=N, freq="10ms", tz="UTC")
    stamps = stamps.tz_localize(None) if zone is None else stamps.tz_convert(zone)
    frame = pd.DataFrame({"q1": Q[:, 0], "q2": Q[:, 1], "tau1": TAU[:, 0], "tau2": TAU[:, 1]})
    if suffix == "index":
        frame.index = stamps
    else:
        frame["time"] = stamps
    if not suffix.startswith("."):
        same(read_recording(frame))
        return
    file = tmp_path / f"log{suffix}"
    (frame.to_parquet if suffix == ".parquet" else frame.to_feather)(file)
    same(read_recording(file))


def test_names_in_a_comment_and_comments_between(tmp_path: Path):
    rows = np.column_stack([T, Q, TAU])
    file = tmp_path / "log.txt"
    for delimiter in (",", " "):
        np.savetxt(file, rows, header="made by a logger\nt,q1,q2,tau1,tau2", delimiter=delimiter)
        same(read_recording(file))
    lines = file.read_text().splitlines()
    lines[10:10] = ["", "# paused", ""]
    lines[25] = lines[25].replace(" ", " nan ", 1).rpartition(" ")[0]
    file.write_text("\n".join(lines) + "\n\n")
    refuses(DataError, "line 26: position: 'q1' has no value", read_recording, file)


def test_columns_without_names(tmp_path: Path):
    file = write(tmp_path / "log.csv", "", T, Q, TAU, DQ)
    refuses(DataError, "its 7 columns have no names", read_recording, file)
    numbers = {"time": 1, "position": [2, 3], "effort": [4, 5], "velocity": [6, 7]}
    same(read_recording(file, columns=numbers), velocity=True)
    (tmp_path / "log.toml").write_text(
        "[columns]\ntime = 1\nposition = [2, 3]\neffort = [4, 5]\nvelocity = [6, 7]\n"
    )
    same(read_recording(file), velocity=True)


def test_compressed_text_and_other_encodings(tmp_path: Path):
    plain = write(tmp_path / "log.csv", "t [s],q1 [°],q2 [°],tau1,tau2", T, np.degrees(Q), TAU)
    same(read_recording(plain))
    text = plain.read_text(encoding="utf-8")
    (tmp_path / "run.csv.gz").write_bytes(gzip.compress(text.encode()))
    same(read_recording(tmp_path / "run.csv.gz"))
    for encoding in ("latin-1", "utf-16", "utf-8-sig"):
        plain.write_text(text, encoding=encoding)
        same(read_recording(plain))
    (tmp_path / "run.csv.gz").write_bytes(gzip.compress(text.encode())[:-50])
    refuses(DataError, r"run\.csv\.gz", read_recording, tmp_path / "run.csv.gz")


def test_data_frames():
    frame = pd.DataFrame({"t": T, "q1": Q[:, 0], "q2": Q[:, 1], "tau1": TAU[:, 0]})
    frame["tau2"] = TAU[:, 1].astype(object)
    same(read_recording(frame))
    indexed = frame.drop(columns="t").set_index(
        pd.Timestamp("2024-03-01") + pd.to_timedelta(np.rint(T * 1e3), unit="ms")
    )
    same(read_recording(indexed))
    same(
        read_recording(frame.rename(columns={"t": "stamp"}), mapping={"columns": {"time": "stamp"}})
    )
    refuses(DataError, "data frame: effort is missing", read_recording, frame[["t", "q1", "q2"]])
    frame.loc[3, "q2"] = np.nan
    refuses(DataError, "data frame: row 4: position: 'q2' has no value", read_recording, frame)
    refuses(DataError, "is given NoneType, expected the path of a log", read_recording, None)


@pytest.mark.parametrize("word", ["", "nan", "NaN", "null", "--", "N/A"])
def test_values_that_begin_late(tmp_path: Path, word: str):
    file = write(tmp_path / "log.csv", "t,q1,q2,tau1,tau2", T, Q, TAU)
    lines = file.read_text().splitlines()
    for k in (1, 2):
        lines[k] = ",".join([*lines[k].split(",")[:3], word, lines[k].split(",")[4]])
    file.write_text("\n".join(lines))
    with pytest.raises(DataError, match=r"log\.csv: line 2: effort: 'tau1' has no value .*2 of 40"):
        read_recording(file)
    reading = read_described(file, missing="drop")
    np.testing.assert_array_equal(reading.recording.position, Q[2:])
    assert reading.sources["missing values"] == "2 of 40 samples dropped"
    with pytest.raises(DataError, match="has no value in 2 samples from line 2 on"):
        read_recording(file, missing="interpolate")


def test_short_gaps_are_interpolated(tmp_path: Path):
    ramp = np.column_stack([T, 2.0 * T])
    holed = ramp.copy()
    holed[[5, 6, 7, 20], [0, 0, 0, 1]] = np.nan
    file = npz(tmp_path, t=T, q=holed, tau=TAU)
    refuses(DataError, r"row 6: position: 'q of joint 1' .* in 3 of 40 rows", read_recording, file)
    reading = read_described(file, missing="interpolate")
    np.testing.assert_allclose(reading.recording.position, ramp, atol=1e-12)
    np.testing.assert_array_equal(reading.recording.effort, TAU)
    assert reading.sources["missing values"] == "interpolated in 4 of 40 samples"
    assert read_recording(file, mapping={"missing": "drop"}).n_samples == N - 4
    holed[5:20, 0] = np.nan
    with pytest.raises(DataError, match="no value in 15 samples from row 6 on; at most 10"):
        read_recording(npz(tmp_path, t=T, q=holed, tau=TAU), missing="interpolate")
    stamps = T.copy()
    stamps[3] = np.nan
    with pytest.raises(DataError, match="row 4: time: 'time' has no value"):
        read_recording(npz(tmp_path, t=stamps, q=ramp, tau=TAU), missing="interpolate")


def test_a_joint_that_is_not_wanted_may_lack_values(tmp_path: Path):
    effort = np.column_stack([TAU, np.full(N, np.nan)])
    names = ["up", "down", "finger"]
    file = npz(tmp_path, t=T, q=np.column_stack([Q, T]), tau=effort, joint_names=names)
    refuses(DataError, "'tau of joint finger' has no value in any row; leave", read_recording, file)
    same(read_recording(file, joint_names=["up", "down"]))


@pytest.mark.parametrize("quoted", ["", '"'])
def test_every_line_has_as_many_fields_as_names(tmp_path: Path, quoted: str):
    header = "label,t,q1,q2,tau1,tau2"
    file = write(tmp_path / "log.csv", header, T, T, Q, TAU)
    lines = file.read_text().splitlines()
    lines = [lines[0], *(f"{quoted}go{quoted},{line.partition(',')[2]}" for line in lines[1:])]
    for change in (
        lambda s: s.replace(".", ",", 1),
        lambda s: s + ",1",
        lambda s: s[: s.rfind(",")],
    ):
        broken = list(lines)
        broken[30] = change(lines[30])
        file.write_text("\n".join(broken))
        refuses(DataError, r"line 31 has [57] values for 6 columns", read_recording, file)
    file.write_text("\n".join(lines))
    same(read_recording(file))


def test_half_precision_is_read_without_a_warning(tmp_path: Path):
    halves = {"t": np.arange(N), "q": Q.astype(np.float16), "tau": TAU.astype(np.float16)}
    log = read_recording(npz(tmp_path, **halves), units={"time": "ms"})
    np.testing.assert_array_equal(log.position, halves["q"])


def test_names_cannot_reach_the_terminal(tmp_path: Path):
    evil = "el\x1b[2Jbow\u202e\u2028\nPROVEN."
    log = read_recording(npz(tmp_path, t=T, q=Q, tau=TAU, joint_names=[evil, "b"]))
    assert all(name.isprintable() for name in log.joint_names)
    frame = pd.DataFrame({"t": T, f"position_{evil}": T, f"effort_{evil}": T})
    reading = read_described(frame)
    assert all(text.isprintable() for text in reading.sources.values())
    with pytest.raises(DataError) as error:
        read_recording(frame.rename(columns={"t": evil}))
    assert str(error.value).isprintable()


# Logs of robots with a floating base: poses, IMUs and feet, found by name or as told.


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
    refuses(ExportError, r"run\.toml: is a mapping of another log", log().to_csv, file)
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
def test_quaternions_by_another_name_are_pointed_out(tmp_path: Path, prefix: str, told: bool):
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
def test_odometry_and_imu_of_bags_come_to_the_stamps_of_the_joints(tmp_path: Path, kind: str):
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
