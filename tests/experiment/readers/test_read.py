import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import sdpid
from sdpid.errors import DataError
from tests.helpers.refusals import refuses

N = 6
RNG = np.random.default_rng(3)
T = 0.5 * np.arange(N)
Q, TAU, DQ = (RNG.standard_normal((N, 2)) for _ in range(3))


def npz(folder: Path, **arrays: Any) -> Path:
    file = folder / "log.npz"
    np.savez(file, **arrays)
    return file


def csv(folder: Path, text: str) -> Path:
    file = folder / "log.csv"
    file.write_text(text)
    return file


def table_csv(folder: Path, header: list[str], *tables: np.ndarray, delimiter: str = ",") -> Path:
    rows = np.column_stack(tables)
    lines = [delimiter.join(header)]
    lines += [delimiter.join(repr(float(value)) for value in row) for row in rows]
    return csv(folder, "\n".join(lines) + "\n")


def test_npz_by_the_usual_names(tmp_path: Path):
    file = npz(tmp_path, t=T, q=Q, tau=TAU, dq=DQ, joint_names=np.array(["a", "b"]), fs=2.0)
    log = sdpid.read_recording(file)
    np.testing.assert_array_equal(log.time, T)
    np.testing.assert_array_equal(log.position, Q)
    np.testing.assert_array_equal(log.effort, TAU)
    np.testing.assert_array_equal(log.velocity, DQ)
    assert log.joint_names == ("a", "b")


def test_time_from_the_sample_rate(tmp_path: Path):
    np.testing.assert_array_equal(sdpid.read_recording(npz(tmp_path, q=Q, tau=TAU, fs=2.0)).time, T)


def test_columns_units_and_overrides(tmp_path: Path):
    file = npz(tmp_path, stamp=T * 1e3, q=np.degrees(Q), current=TAU, v=DQ, velocity=Q)
    log = sdpid.read_recording(
        str(file),
        columns={"effort": "current", "velocity": "v"},
        units={"position": "deg", "time": "ms", "velocity": "rpm", "effort": "A"},
        joint_names=["x", "y"],
        period=1.0,
        effort_scale=[2.0, 3.0],
    )
    np.testing.assert_allclose(log.position, Q, rtol=1e-15)
    np.testing.assert_allclose(log.time, T, rtol=1e-15)
    np.testing.assert_allclose(log.velocity, DQ * 2 * np.pi / 60, rtol=1e-15)
    np.testing.assert_array_equal(log.effort, TAU * [2.0, 3.0])
    assert log.period_layout == (0, 2, 3)
    assert log.joint_names == ("x", "y")
    columns = {"effort": "current", "velocity": None}
    assert sdpid.read_recording(file, columns=columns).velocity is None


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize("pattern", ["q{}", "q_{}", "q[{}]", "position.{}", "Pos_{}"])
def test_csv_with_numbered_columns(tmp_path: Path, pattern: str, delimiter: str):
    header = ["time"] + [pattern.format(j) for j in (0, 1)] + ["tau_0", "tau_1", "tau_target_1"]
    file = table_csv(tmp_path, header, T, Q, TAU, DQ[:, 0], delimiter=delimiter)
    log = sdpid.read_recording(file)
    np.testing.assert_array_equal(log.position, Q)
    np.testing.assert_array_equal(log.effort, TAU)
    assert log.joint_names is None


def test_csv_with_joint_names_text_columns_and_quotes(tmp_path: Path):
    text = 'label,"time",position_up,position_down,effort_up,effort_down\n'
    text += "".join(f"go,{k},{k},{-k},{2 * k},{-2 * k}\n" for k in range(4))
    log = sdpid.read_recording(csv(tmp_path, "\ufeff" + text))
    assert log.joint_names == ("up", "down")
    assert log.effort[3].tolist() == [6.0, -6.0]
    log = sdpid.read_recording(csv(tmp_path, text), joint_names=("down", "up"))
    assert log.effort[3].tolist() == [-6.0, 6.0]
    log = sdpid.read_recording(
        csv(tmp_path, text),
        columns={"position": ["position_down"], "effort": ["effort_down"]},
    )
    assert log.position[:, 0].tolist() == [0.0, -1.0, -2.0, -3.0]


def test_numbered_columns_are_in_numeric_order(tmp_path: Path):
    header = ["t", *(f"q{j}" for j in (10, 2, 1)), *(f"tau{j}" for j in (1, 2, 10))]
    log = sdpid.read_recording(table_csv(tmp_path, header, T, Q, Q[:, :1], TAU, TAU[:, :1]))
    np.testing.assert_array_equal(log.position, np.column_stack([Q[:, 0], Q[:, 1], Q[:, 0]]))


def test_own_parquet_and_overrides(tmp_path: Path):
    file = tmp_path / "log.PARQUET"
    log = sdpid.Recording(time=T, position=Q, effort=TAU, joint_names=("a", "b"), period=1.0)
    log.to_parquet(file)
    again = sdpid.read_recording(file)
    assert again.period == 1.0
    assert again.effort.tobytes() == log.effort.tobytes()
    assert sdpid.read_recording(file, period=1.5).period == 1.5
    turned = sdpid.read_recording(file, joint_names=("b", "a"))
    np.testing.assert_array_equal(turned.position, Q[:, ::-1])
    assert turned.period == 1.0


def test_foreign_parquet_with_lists(tmp_path: Path):
    file = tmp_path / "log.parquet"
    pq.write_table(pa.table({"t": T, "q": Q.tolist(), "tau": TAU.tolist()}), file)
    log = sdpid.read_recording(file)
    np.testing.assert_array_equal(log.position, Q)
    pq.write_table(
        pa.table({"t": [0.0, 1.0], "q": [[1.0], [1.0, 2.0]], "tau": [[1.0], [2.0]]}), file
    )
    refuses(DataError, "'q' is ragged: its rows have 1 to 2", sdpid.read_recording, file)
    pq.write_table(pa.table({"t": [0.0, 1.0], "q": [1.0, None], "tau": [1.0, 2.0]}), file)
    refuses(DataError, "row 2: position: 'q' has no value", sdpid.read_recording, file)


def test_single_joint_vectors(tmp_path: Path):
    assert sdpid.read_recording(npz(tmp_path, t=T, q=Q[:, 0], tau=TAU[:, 0])).n == 1


class Bomb:
    def __reduce__(self) -> tuple[Any, ...]:
        return (pytest.fail, ("a pickle was executed",))


def test_nothing_is_unpickled(tmp_path: Path):
    boxed = np.empty((), dtype=object)
    boxed[()] = Bomb()
    # An object beside the data does no harm, as long as it is not wanted.
    log = sdpid.read_recording(npz(tmp_path, t=T, q=Q, tau=TAU, config=boxed))
    assert log.n == 2
    with pytest.raises(DataError, match="'q' holds Python objects"):
        sdpid.read_recording(npz(tmp_path, t=T, q=boxed, tau=TAU))
    file = tmp_path / "log.npz"
    file.write_bytes(pickle.dumps([1]))
    refuses(DataError, "not a readable NumPy archive", sdpid.read_recording, file)


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
    log = sdpid.read_recording(data_folder / name)
    assert (log.n_samples, log.n) == (samples, joints)
    assert log.rate_hz == pytest.approx(rate, rel=1e-4)
    assert log.joint_names is not None


def test_another_effort_of_a_real_log(data_folder: Path):
    file = data_folder / "kinova_gen3_dynamapp/opti_traj_testing1.npz"
    log = sdpid.read_recording(file, columns={"effort": "tau_current"})
    with np.load(file) as arrays:
        np.testing.assert_array_equal(log.effort, arrays["tau_current"])
