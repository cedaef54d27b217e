"""Readers against files that other programs and libraries wrote."""

import bz2
import gzip
import io
import os
import re
import shutil
import struct
import sys
import warnings
import zipfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

import sdpid
from sdpid.errors import DataError, MissingExtraError, SdpidError
from sdpid.experiment.readers.formats.loaders import LOADERS, MATRICES, SANDBOXED
from sdpid.experiment.readers.read import read_described, read_recording
from sdpid.experiment.recording.recording import Recording
from tests.helpers.bags import JOINTS, write_bag
from tests.helpers.damage import damaged
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
    refuses(MissingExtraError, rf"with: pip install .*'{wanted}>=", LOADERS[suffix], file)


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


# Damaged logs of every format: read, or refused with an error of ours, nothing else. Longer runs:
# ``SDPID_FUZZ=5000 pytest tests/experiment/test_formats.py``.


# Damaged files of each kind.
COUNT = int(os.environ.get("SDPID_FUZZ", "40"))
# Of formats that are read in a child process, which takes a moment to start.
COUNT_IN_SANDBOX = 1 + COUNT // 6
TOML = b"""joint_names = ["a", "b"]
period = 2.5
start = 0.0
periods = 3
[columns]
velocity = "none"
position = "q"
[units]
position = "deg"
effort = ["A", "mA"]
[motors]
position_matrix = [[32, 0], [1.5, -48]]
offsets = [0.0, 1.0]
torque_constants = [0.1, 0.2]
"""


def write_csv(folder: Path) -> Path:
    frame = pd.DataFrame({"t": T, "q1": Q[:, 0], "q2": Q[:, 1], "tau1": TAU[:, 0]})
    frame.assign(tau2=TAU[:, 1]).to_csv(folder / "log.csv", index=False)
    return folder / "log.csv"


def write_toml(folder: Path) -> Path:
    np.savez(folder / "log.npz", t=T, q=Q, tau=TAU)
    (folder / "log.toml").write_bytes(TOML)
    return folder / "log.toml"


def write_npz(folder: Path, packed: bool = True) -> Path:
    save = np.savez_compressed if packed else np.savez
    save(folder / "log.npz", t=T, q=Q, tau=TAU, joint_names=["a", "b"], period=2.5)
    return folder / "log.npz"


def write_mat(folder: Path, version: str) -> Path:
    content = {"t": T, "tau": TAU, "joint_names": np.array(["up", "down"], dtype=object)}
    file = folder / "log.mat"
    if version == "4":
        savemat(file, {"t": T, "q": Q, "tau": TAU}, format="4")
    else:
        inside = {"log": {"q": Q, "dq": DQ}}
        savemat(file, content | inside, do_compression=version == "7")
    return file


def write_h5(folder: Path) -> Path:
    with h5py.File(folder / "log.h5", "w") as out:
        out.create_dataset("arm/q", data=Q, compression="gzip", chunks=(8, 2))
        out["arm/tau"], out["t"] = TAU, T
        out["arm"].attrs["joint_names"] = ["a", "b"]
    return folder / "log.h5"


def write_table(folder: Path, own: bool) -> Path:
    file = folder / "log.parquet"
    if own:
        sdpid.Recording(
            time=T, position=Q, effort=TAU, velocity=DQ, joint_names=("a", "b")
        ).to_parquet(file)
    else:
        pd.DataFrame({"t": T, "q": Q.tolist(), "tau": TAU.tolist()}).to_parquet(file)
    return file


def write_feather(folder: Path) -> Path:
    pd.read_csv(write_csv(folder)).to_feather(folder / "log.feather")
    return folder / "log.feather"


WRITERS = {
    "csv": write_csv,
    "toml": write_toml,
    "npz": write_npz,
    "npz plain": lambda folder: write_npz(folder, packed=False),
    "mat 4": lambda folder: write_mat(folder, "4"),
    "mat 5": lambda folder: write_mat(folder, "5"),
    "mat 7": lambda folder: write_mat(folder, "7"),
    "hdf5": write_h5,
    "feather": write_feather,
    "parquet": lambda folder: write_table(folder, own=False),
    "own parquet": lambda folder: write_table(folder, own=True),
    "db3": lambda folder: write_bag(folder / "bag", "db3", T, Q, DQ, TAU),
    "mcap": lambda folder: write_bag(folder / "bag", "mcap", T, Q, DQ, TAU),
    "ros1": lambda folder: write_bag(folder / "bag", "ros1", T, Q, DQ, TAU),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_damaged_logs_are_read_or_refused(tmp_path: Path, kind: str):
    file = WRITERS[kind](tmp_path)
    log = tmp_path / "log.npz" if kind == "toml" else file
    content = file.read_bytes()
    count = COUNT_IN_SANDBOX if log.suffix in SANDBOXED else COUNT
    rng = np.random.default_rng([COUNT, *kind.encode()])
    with warnings.catch_warnings():
        # Libraries may warn of what they find in a damaged file; that is not ours.
        warnings.simplefilter("ignore")
        assert sdpid.read_recording(log).n == 2
        refused = 0
        for _ in range(count):
            file.write_bytes(damaged(content, rng, kind in ("csv", "toml")))
            try:
                sdpid.read_recording(log)
            except SdpidError:
                refused += 1
    assert 0 < refused <= count
    shutil.rmtree(tmp_path)
    print(f"{kind}: {refused} of {count} damaged files refused, the others read")


@pytest.mark.parametrize("suffix", sorted(set(LOADERS) - {".gz", MATRICES}))
def test_garbage_is_a_data_error(tmp_path: Path, suffix: str):
    file = tmp_path / f"log{suffix}"
    contents = [np.random.default_rng(0).bytes(500), b"", b"\x00" * 64, b"a,b\n1\n", b"1,2\n3,4\n"]
    # A child process for each takes a moment.
    for content in contents[: 1 if suffix in SANDBOXED else None]:
        file.write_bytes(content)
        refuses(DataError, r"log\.", sdpid.read_recording, file)


@pytest.mark.parametrize("content", [np.random.default_rng(0).bytes(500), b"", b"1,2\n3\n"])
def test_garbage_in_a_folder_of_matrices_is_a_data_error(tmp_path: Path, content: bytes):
    for name in ("t", "q", "tau"):
        (tmp_path / f"{name}.dat").write_bytes(content)
    refuses(DataError, r"\.dat: is", sdpid.read_recording, tmp_path)


MAGIC = b"\x89MCAP0\r\n"
HUGE = 1 << 36


def text(words: str) -> bytes:
    return struct.pack("<I", len(words)) + words.encode()


def record(kind: int, body: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(body)) + body


def chunk(claimed: int, name: str, data: bytes) -> bytes:
    """A chunk of an MCAP file, which claims to unpack to a number of bytes."""
    body = struct.pack("<QQQI", 0, 1, claimed, 0) + text(name) + struct.pack("<Q", len(data)) + data
    return record(6, body)


def packed(name: str, size: int) -> bytes:
    """Zeros, compressed."""
    if name == "bz2":
        return bz2.compress(bytes(size))
    if name == "lz4":
        import lz4.frame

        return lz4.frame.compress(bytes(size))
    from rosbags.rosbag2.reader import zstd

    return zstd.compress(bytes(size))


def ros1_chunk(name: str, size: int) -> bytes:
    """A ROS 1 bag of one chunk, which claims 1000 bytes."""
    data = packed(name, size)
    fields = (b"op=\x05", b"compression=" + name.encode(), b"size=" + struct.pack("<I", 1000))
    header = b"".join(struct.pack("<I", len(field)) + field for field in fields)
    parts = (struct.pack("<I", len(header)), header, struct.pack("<I", len(data)), data)
    return b"#ROSBAG V2.0\n" + b"".join(parts)


def mcap(*records: bytes) -> bytes:
    return MAGIC + record(1, text("ros2") + text("")) + b"".join(records) + MAGIC


# Files that did harm to a reader once: they unpack to more than they say, or than memory holds.
BOMBS = {
    "more than it says.mcap": lambda: mcap(chunk(1000, "zstd", packed("zstd", 1 << 28))),
    "says too much.mcap": lambda: mcap(chunk(HUGE, "lz4", packed("lz4", 1000))),
    "an index that points elsewhere.mcap": lambda: mcap(
        record(8, struct.pack("<QQQQIQ", 0, 1, 17, 100, 0, 0) + text("zstd") + bytes(16))
    ),
    "a summary that is none.mcap": lambda: mcap(record(2, struct.pack("<QQI", 12, 0, 0))),
    "bz2.bag": lambda: ros1_chunk("bz2", 1 << 26),
    "lz4.bag": lambda: ros1_chunk("lz4", 1 << 26),
    "nested metadata.parquet": lambda: nested_metadata(),
    "bomb.csv.gz": lambda: gzip.compress(b"t,q1,tau1\n" + b"1,2,3" * 1_000_000),
    "deep names.mat": lambda: b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"\xff" * 64,
}


def nested_metadata() -> bytes:
    out = io.BytesIO()
    table = pa.table({"time": T, "position_1": T, "effort_1": T})
    pq.write_table(table.replace_schema_metadata({b"sdpid": b"[" * 100_000}), out)
    return out.getvalue()


@pytest.mark.parametrize("name", BOMBS)
def test_files_that_did_harm_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
):
    monkeypatch.setattr("sdpid._common.sandbox._MOST_MEMORY", 100_000_000)
    (tmp_path / name).write_bytes(BOMBS[name]())
    refuses(DataError, re.escape(name), sdpid.read_recording, tmp_path / name)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no FIFOs")
def test_a_fifo_is_no_log(tmp_path: Path):
    for name in ("log.csv", "log.toml"):
        os.mkfifo(tmp_path / name)
    refuses(DataError, r"log\.csv: is no regular file", sdpid.read_recording, tmp_path / "log.csv")
    np.savez(tmp_path / "log.npz", t=T, q=Q, tau=TAU)
    with pytest.raises(DataError, match=r"log\.toml: it is no regular file"):
        sdpid.read_recording(tmp_path / "log.npz", mapping=tmp_path / "log.toml")


@pytest.mark.parametrize(
    ("mode", "plugin"),
    [("NONE", "MCAP"), ("FILE", "SQLITE3"), ("MESSAGE", "SQLITE3"), ("STORAGE", "MCAP")],
)
def test_honest_compressed_bags_are_read(tmp_path: Path, mode: str, plugin: str):
    """Written by the library, compressed in every way that it knows."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    state, header = store.types["sensor_msgs/msg/JointState"], store.types["std_msgs/msg/Header"]
    stamp = store.types["builtin_interfaces/msg/Time"]
    writer = Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin[plugin])
    if mode != "NONE":
        writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer as out:
        where = out.add_connection("/joint_states", state.__msgtype__, typestore=store)
        for k in range(50):
            row = np.array([0.1 * k, 0.2])
            message = state(header(stamp(k, 0), ""), ["a", "b"], row, row, row)
            out.write(where, k * 10**9, store.serialize_cdr(message, state.__msgtype__))
    assert sdpid.read_recording(tmp_path / "bag").position.shape == (50, 2)
