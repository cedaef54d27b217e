"""Readers against files that other programs and libraries wrote."""

import io
import sys
import zipfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from sdpid.errors import DataError, MissingExtraError
from sdpid.experiment.readers.formats.loaders import LOADERS
from sdpid.experiment.readers.read import read_described, read_recording
from sdpid.experiment.recording.recording import Recording
from tests.helpers.bags import JOINTS, write_bag
from tests.helpers.refusals import refuses

N = 40
RNG = np.random.default_rng(5)
T = 0.25 * np.arange(N)
Q, TAU, DQ = (RNG.standard_normal((N, 2)) for _ in range(3))


def same(log: Recording, *, velocity: bool = True) -> None:
    np.testing.assert_array_equal(log.time, T)
    np.testing.assert_array_equal(log.position, Q)
    np.testing.assert_array_equal(log.effort, TAU)
    if velocity:
        np.testing.assert_array_equal(log.velocity, DQ)


@pytest.mark.parametrize("compressed", [False, True])
def test_mat_by_scipy(tmp_path: Path, compressed: bool):
    file = tmp_path / "log.mat"
    names = np.array(["up", "down"], dtype=object)
    content = {"t": T[:, None], "q": Q, "qd": DQ, "tau": TAU, "joint_names": names, "fs": 4.0}
    savemat(file, content, do_compression=compressed)
    log = read_recording(file)
    same(log)
    assert log.joint_names == ("up", "down")
    savemat(file, {"data": {"time": T, "q": Q, "tau": TAU, "inner": {"qd": DQ}}})
    same(read_recording(file))
    savemat(file, {"t": T, "q": Q, "tau": TAU}, format="4")
    same(read_recording(file), velocity=False)


def test_mat_of_what_cannot_be_read(tmp_path: Path):
    file = tmp_path / "log.mat"
    cell = np.empty(2, dtype=object)
    cell[:] = [T, Q]
    savemat(file, {"t": T, "q": cell, "tau": TAU})
    refuses(DataError, "'q' is a cell array", read_recording, file)
    savemat(file, {"t": T, "q": 1j * Q, "tau": TAU})
    refuses(DataError, "position: holds complex", read_recording, file)


def matlab_73(file: Path, **arrays: Any) -> None:
    """Write as MATLAB does: reversed axes, classes in attributes, cells by reference."""
    with h5py.File(file, "w", userblock_size=512) as out:
        for name, value in arrays.items():
            if isinstance(value, list):
                cells = []
                for k, text in enumerate(value):
                    codes = np.array([[ord(c)] for c in text], dtype=np.uint16)
                    node = out.create_dataset(f"#refs#/{k}", data=codes)
                    node.attrs["MATLAB_class"] = np.bytes_("char")
                    cells.append(node.ref)
                node = out.create_dataset(name, data=np.array([cells]).T, dtype=h5py.ref_dtype)
                node.attrs["MATLAB_class"] = np.bytes_("cell")
            else:
                node = out.create_dataset(name, data=np.atleast_2d(value).T)
                node.attrs["MATLAB_class"] = np.bytes_("double")
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    with file.open("r+b") as raw:
        raw.write(head)


def test_mat_73_by_h5py(tmp_path: Path):
    file = tmp_path / "log.mat"
    matlab_73(file, t=T[:, None], q=Q, qd=DQ, tau=TAU, joint_names=["up", "down"])
    log = read_recording(file)
    same(log)
    assert log.joint_names == ("up", "down")


def test_hdf5_by_h5py(tmp_path: Path):
    file = tmp_path / "log.h5"
    with h5py.File(file, "w") as out:
        group = out.create_group("robot/arm")
        group.create_dataset("position", data=Q, compression="gzip", chunks=(8, 2))
        group.create_dataset("velocity", data=DQ)
        group.create_dataset("effort", data=TAU)
        group.attrs["joint_names"] = ["up", "down"]
        out.attrs["fs"] = 4.0
    log = read_recording(file)
    same(log)
    assert log.joint_names == ("up", "down")
    sources = read_described(file).sources
    assert sources["position"] == "robot/arm/position"
    assert sources["time"] == "sample rate, 4 Hz"


def test_hdf5_joint_by_joint_tables_and_doubt(tmp_path: Path):
    file = tmp_path / "log.hdf5"
    with h5py.File(file, "w") as out:
        for j, name in enumerate(("up", "down")):
            out[f"joints/{name}/position"] = Q[:, j]
            out[f"joints/{name}/effort"] = TAU[:, j]
        out["t"] = T
    # The library lists groups by the alphabet.
    assert read_recording(file).joint_names == ("down", "up")
    log = read_recording(file, joint_names=["up", "down"])
    np.testing.assert_array_equal(log.effort, TAU)
    table = np.zeros(N, dtype=[("t", float), ("q_1", float), ("q_2", float), ("tau", float, (2,))])
    table["t"], table["q_1"], table["q_2"], table["tau"] = T, Q[:, 0], Q[:, 1], TAU
    with h5py.File(file, "w") as out:
        out["log"] = table
    same(read_recording(file), velocity=False)
    with h5py.File(file, "w") as out:
        for run in ("first", "second"):
            out[f"{run}/t"], out[f"{run}/q"], out[f"{run}/tau"] = T, Q, TAU
    refuses(DataError, "position is there more than once: first/q, second/q", read_recording, file)
    where = {"time": "second/t", "position": "second/q", "effort": "second/tau"}
    same(read_recording(file, columns=where), velocity=False)


def test_hdf5_of_other_files_is_refused(tmp_path: Path):
    file = tmp_path / "log.h5"
    with h5py.File(file, "w") as out:
        out["t"], out["tau"] = T, TAU
        out.create_dataset("q", (N, 2), "f8", external=[(str(tmp_path / "raw"), 0, N * 16)])
    refuses(DataError, "'q' is kept in another file", read_recording, file)


def test_parquet_and_csv_by_pandas(tmp_path: Path):
    frame = pd.DataFrame({"time": pd.to_datetime(1_700_000_000 * 10**9 + (T * 1e9).astype(int))})
    for j in (2, 1):
        frame[f"joint_{j}_position_deg"] = np.degrees(Q[:, j - 1])
        frame[f"joint_{j}_velocity"] = DQ[:, j - 1]
        frame[f"joint_{j}_torque"] = TAU[:, j - 1]
        frame[f"joint_{j}_target_position"] = 0.0
    file = tmp_path / "log.parquet"
    frame.to_parquet(file)
    log = read_recording(file)
    np.testing.assert_allclose(log.time, T, atol=1e-12)
    np.testing.assert_allclose(log.position, Q, rtol=1e-14)
    np.testing.assert_array_equal(log.velocity, DQ)
    assert log.joint_names == ("joint_1", "joint_2")
    frame["time"] = T
    frame.to_csv(tmp_path / "log.csv", index=False)
    np.testing.assert_allclose(read_recording(tmp_path / "log.csv").position, Q, rtol=1e-14)


def test_csv_as_a_ur_controller_writes_it(tmp_path: Path):
    names = ["timestamp", *(f"{key}_{j}" for key in ("target_q", "actual_q") for j in range(2))]
    names += [f"{key}_{j}" for key in ("actual_qd", "actual_current") for j in range(2)]
    rows = np.column_stack([T, 0 * Q, Q, DQ, TAU])
    file = tmp_path / "log.csv"
    np.savetxt(file, rows, header=" ".join(names), comments="", fmt="%.17g")
    with pytest.raises(DataError, match="actual_current_0, actual_current_1 look like currents"):
        read_recording(file)
    how = {"columns": {"effort": "actual_current"}, "units": {"effort": "mA"}}
    log = read_recording(file, **how, effort_scale=[10.0, 12.0])
    np.testing.assert_array_equal(log.position, Q)
    np.testing.assert_array_equal(log.velocity, DQ)
    np.testing.assert_allclose(log.effort, TAU * 1e-3 * [10.0, 12.0], rtol=1e-15)


@pytest.mark.parametrize("kind", ["db3", "mcap", "folder", "ros1"])
def test_ros_bags_by_rosbags(tmp_path: Path, kind: str):
    file = write_bag(tmp_path / "bag", kind, T, Q, DQ, TAU)
    log = read_recording(file)
    np.testing.assert_allclose(log.time, T, atol=1e-9)
    np.testing.assert_array_equal(log.position, Q)
    np.testing.assert_array_equal(log.velocity, DQ)
    np.testing.assert_array_equal(log.effort, TAU)
    assert log.joint_names == JOINTS
    turned = read_recording(file, joint_names=JOINTS[::-1], topic="/joint_states")
    np.testing.assert_array_equal(turned.position, Q[:, ::-1])
    late = read_recording(file, columns={"time": "bag_time"})
    np.testing.assert_allclose(late.time, 2.0 * T, atol=1e-9)


def test_ros_bags_of_several_sources(tmp_path: Path):
    file = write_bag(tmp_path / "bag", "mcap", T, Q, DQ, TAU, gripper=True)
    refuses(DataError, "several sets of joints: up, down; finger", read_recording, file)
    np.testing.assert_array_equal(read_recording(file, joint_names=JOINTS).position, Q)
    refuses(DataError, "message 1 lacks thumb", read_recording, file, joint_names=("up", "thumb"))
    with pytest.raises(DataError, match=r"no topic /states.*there is /joint_states"):
        read_recording(file, topic="/states")
    file = write_bag(tmp_path / "ragged", "mcap", T, Q, DQ, TAU, ragged=7)
    refuses(DataError, "message 8 has 0 entries of effort for 2 joints", read_recording, file)
    refuses(DataError, r"without metadata\.yaml.*without text files", read_recording, tmp_path)


@pytest.mark.parametrize(
    ("suffix", "wanted"), [(".h5", "h5py"), (".mcap", "rosbags"), (".bag", "rosbags")]
)
def test_missing_packages_are_named_with_what_installs_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, wanted: str
):
    for module in ("h5py", "rosbags", "rosbags.highlevel"):
        monkeypatch.setitem(sys.modules, module, None)
    file = tmp_path / f"log{suffix}"
    file.write_bytes(b"0")
    with pytest.raises(MissingExtraError, match=rf"with: pip install .*'{wanted}>="):
        LOADERS[suffix](file)


def test_several_logs_at_once(tmp_path: Path):
    np.savez(tmp_path / "1.npz", t=T, q=Q, tau=TAU)
    np.savez(tmp_path / "2.npz", t=T, q=Q[:, :1], tau=TAU[:, :1])
    first = tmp_path / "1.npz"
    assert [log.n_samples for log in read_recording([first, first])] == [N, N]
    refuses(DataError, r"2\.npz: has the joints 1", read_recording, [first, tmp_path / "2.npz"])


def test_joints_of_arrays_are_ordered_by_name(tmp_path: Path):
    file = tmp_path / "log.npz"
    np.savez(file, t=T, q=Q, tau=TAU, joint_names=["up", "down"], effort_scale=[1.0, 2.0])
    log = read_recording(file, joint_names=["down", "up"])
    np.testing.assert_array_equal(log.position, Q[:, ::-1])
    np.testing.assert_array_equal(log.effort, TAU[:, ::-1] * [2.0, 1.0])
    assert read_recording(file, joint_names=["down"]).n == 1
    assert read_recording(file, joint_names=["x", "y"]).joint_names == ("x", "y")
    with pytest.raises(DataError, match="joint_names are up, side, the file has up, down"):
        read_recording(file, joint_names=["up", "side"])


ROWS = 200_000_000


def claim_npz(file: Path) -> None:
    np.savez(file, t=T, tau=TAU)
    claim = np.lib.format.header_data_from_array_1_0(Q) | {"shape": (ROWS, 2)}
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, claim)
    with zipfile.ZipFile(file, "a") as archive:
        archive.writestr("q.npy", header.getvalue() + bytes(64))


def claim_h5(file: Path) -> None:
    with h5py.File(file, "w") as out:
        out["t"], out["tau"] = T, TAU
        out.create_dataset("q", (ROWS, 2), "f8", chunks=(1024, 2))


def claim_mat(file: Path) -> None:
    savemat(file, {"t": T, "tau": TAU, "q": Q})
    raw = bytearray(file.read_bytes())
    # Dimensions are an element of two int32, before the one with the name.
    place = raw.rindex(N.to_bytes(4, "little") + (2).to_bytes(4, "little"))
    raw[place : place + 4] = ROWS.to_bytes(4, "little")
    file.write_bytes(raw)


@pytest.mark.parametrize("claim", [claim_npz, claim_h5, claim_mat])
def test_claims_of_headers_do_not_take_memory(tmp_path: Path, claim: Any):
    file = tmp_path / f"log.{claim.__name__.removeprefix('claim_')}"
    claim(file)
    words = r"'q' claims 200,000,000 × 2 values, 3\.2 GB|cannot reshape array of size 80 into"
    refuses(DataError, words, read_recording, file)


@pytest.mark.parametrize("suffix", [".parquet", ".own.parquet", ".npz"])
def test_logs_beyond_memory_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
):
    monkeypatch.setattr("sdpid._common.sandbox._MOST_MEMORY", 30_000)
    rows = 2000
    t, q = np.arange(rows), np.zeros((rows, 2))
    file = tmp_path / f"log{suffix}"
    if suffix == ".own.parquet":
        Recording(time=t, position=q, effort=q).to_parquet(file)
    elif suffix == ".parquet":
        pd.DataFrame({"t": t, "q1": t, "q2": t, "tau1": t, "tau2": t}).to_parquet(file)
    else:
        np.savez_compressed(file, t=t, q=q, tau=q)
    refuses(DataError, r"more than the limit of 0\.03 MB; cut the log", read_recording, file)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not limit memory")
@pytest.mark.parametrize("suffix", [".mat", ".h5"])
def test_the_sandbox_limits_the_memory_of_a_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
):
    # Libraries take 80 MB, the arrays as much again.
    monkeypatch.setattr("sdpid._common.sandbox._BASE_MEMORY", 80_000_000)
    monkeypatch.setattr("sdpid._common.sandbox._MOST_MEMORY", 30_000_000)
    rows = 2_000_000
    t, q, file = np.arange(rows), np.zeros((rows, 2)), tmp_path / f"log{suffix}"
    if suffix == ".mat":
        savemat(file, {"t": t, "q": q, "tau": q}, do_compression=True)
    else:
        with h5py.File(file, "w") as out:
            out["t"], out["q"], out["tau"] = t, q, q
    refuses(DataError, r"needs more memory than the limit of 0\.03 GB", read_recording, file)
