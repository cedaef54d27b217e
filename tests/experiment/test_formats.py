"""Logs of every format, as other programs write them and as people have them."""

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
from scipy.spatial.transform import Rotation

import sdpid
from sdpid.errors import DataError, ExportError, MissingExtraError, SdpidError
from sdpid.experiment.readers.formats.loaders import BY_SUFFIX
from sdpid.experiment.readers.read import read_described, read_recording
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.recording.timestamps import guess_time_unit
from tests.experiment.test_recording import log
from tests.helpers.bags import JOINTS, write_bag
from tests.helpers.damage import damaged
from tests.helpers.refusals import refuses
from tests.helpers.studies import study

N = 40
RNG = np.random.default_rng(5)
T = 0.25 * np.arange(N)
Q, TAU, DQ = (RNG.standard_normal((N, 2)) for _ in range(3))
FRAME = pd.DataFrame(np.hstack([Q, TAU]), columns=["q1", "q2", "tau1", "tau2"])


def same(log: Recording, *, velocity: bool = True) -> None:
    np.testing.assert_array_equal(log.time, T)
    np.testing.assert_array_equal(log.position, Q)
    np.testing.assert_array_equal(log.effort, TAU)
    if velocity:
        np.testing.assert_array_equal(log.velocity, DQ)


def test_mat_of_what_cannot_be_read(tmp_path: Path):
    file = tmp_path / "log.mat"
    cell = np.empty(2, dtype=object)
    cell[:] = [T, Q]
    savemat(file, {"t": T, "q": cell, "tau": TAU})
    refuses(DataError, "'q' is a cell array", read_recording, file)
    savemat(file, {"t": T, "q": 1j * Q, "tau": TAU})
    refuses(DataError, "position: 'q' holds complex", read_recording, file)


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


def test_hdf5_joint_by_joint_tables_and_doubt(tmp_path: Path):
    file = tmp_path / "log.hdf5"
    with h5py.File(file, "w") as out:
        for j, name in enumerate(("up", "down")):
            out[f"joints/{name}/position"] = Q[:, j]
            out[f"joints/{name}/effort"] = TAU[:, j]
        out["t"] = T
    sources = read_described(file).sources
    assert sources["position"] == "joints/down/position ... joints/up/position"
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
    refuses(MissingExtraError, rf"with: pip install .*'{wanted}>=", BY_SUFFIX[suffix].load, file)


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
    words = r"'q' claims 200,000,000 × 2 values, 3\.2 GB|reading array data|cannot reshape array of"
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
# Of formats that are read in a child process, which takes half a second to start.
COUNT_IN_SANDBOX = 1 + COUNT // 10
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
    FRAME.assign(t=T).to_csv(folder / "log.csv", index=False)
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
    content = {"t": T, "tau": TAU, "joint_names": np.array(["a", "b"], dtype=object)}
    file = folder / "log.mat"
    if version == "4":
        savemat(file, {"t": T, "q": Q, "tau": TAU}, format="4")
    else:
        inside = {"log": {"q": Q, "dq": DQ}}
        savemat(file, content | inside, do_compression=version == "7")
    return file


def write_mat_73(folder: Path) -> Path:
    matlab_73(folder / "log.mat", t=T[:, None], q=Q, qd=DQ, tau=TAU, joint_names=["a", "b"])
    return folder / "log.mat"


def write_h5(folder: Path) -> Path:
    with h5py.File(folder / "log.h5", "w") as out:
        out.create_dataset("arm/q", data=Q, compression="gzip", chunks=(8, 2))
        out["arm/tau"], out["arm/velocity"] = TAU, DQ
        out["arm"].attrs["joint_names"] = ["a", "b"]
        out.attrs["fs"] = 4.0
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
    "mat 7.3": write_mat_73,
    "hdf5": write_h5,
    "feather": write_feather,
    "parquet": lambda folder: write_table(folder, own=False),
    "own parquet": lambda folder: write_table(folder, own=True),
    "db3": lambda folder: write_bag(folder / "bag", "db3", T, Q, DQ, TAU),
    "mcap": lambda folder: write_bag(folder / "bag", "mcap", T, Q, DQ, TAU),
    "ros1": lambda folder: write_bag(folder / "bag", "ros1", T, Q, DQ, TAU),
}


# Kinds without velocities, and those without names of joints.
STILL = ("csv", "toml", "npz", "npz plain", "mat 4", "feather", "parquet")
UNNAMED = ("csv", "mat 4", "feather", "parquet")


@pytest.mark.parametrize(
    "kind", [kind for kind in WRITERS if kind not in ("toml", "db3", "mcap", "ros1")]
)
def test_every_format_is_read(tmp_path: Path, kind: str):
    log = read_recording(WRITERS[kind](tmp_path))
    same(log, velocity=kind not in STILL)
    assert log.joint_names == (None if kind in UNNAMED else ("a", "b"))


@pytest.mark.parametrize("kind", WRITERS)
def test_damaged_logs_are_read_or_refused(tmp_path: Path, kind: str):
    file = WRITERS[kind](tmp_path)
    log = tmp_path / "log.npz" if kind == "toml" else file
    content = file.read_bytes()
    count = COUNT_IN_SANDBOX if BY_SUFFIX[log.suffix].sandboxed else COUNT
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


@pytest.mark.parametrize("suffix", sorted(BY_SUFFIX))
def test_garbage_is_a_data_error(tmp_path: Path, suffix: str):
    file = tmp_path / f"log{suffix}"
    contents = [np.random.default_rng(0).bytes(500), b"", b"\x00" * 64, b"a,b\n1\n", b"1,2\n3,4\n"]
    # A child process for each takes a moment.
    for content in contents[: 1 if BY_SUFFIX[suffix].sandboxed else None]:
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


# Logs as people have them: other names, units, decimal marks, stamps and gaps.


TIME = 0.01 * np.arange(N)


def write(file: Path, header: str, *tables: Any, mark: str = ",", decimal: str = ".") -> Path:
    rows = np.column_stack(tables)
    lines = [header] if header else []
    lines += [mark.join(repr(float(v)).replace(".", decimal) for v in row) for row in rows]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return file


def npz(folder: Path, **arrays: Any) -> Path:
    np.savez(folder / "log.npz", **arrays)
    return folder / "log.npz"


def close(log: Any, *, velocity: bool = False) -> None:
    np.testing.assert_allclose(log.time - log.time[0], TIME, atol=1e-12)
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
    stamps = start + np.rint(TIME * factor).astype(np.int64)
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
        reading.recording.time - reading.recording.time[0], TIME, atol=1e-12 if exact else 1e-6
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
    file = write(tmp_path / "log.csv", header, TIME, Q, TAU, DQ, DQ)
    log = read_recording(file)
    close(log)
    assert log.period is None
    assert log.start is None
    with pytest.raises(DataError, match="'period' for period has 40 values, expected one"):
        read_recording(file, columns={"period": "period"})
    assert read_recording(npz(tmp_path, t=TIME, q=Q, tau=TAU, period=0.2)).period == 0.2


def test_arrays_that_only_begin_like_a_quantity(tmp_path: Path):
    others = {
        "dq_logged": DQ,
        "tau_model": TAU,
        "q_ref": Q,
        "tau_hat": TAU,
        "q_note": np.array("x"),
    }
    close(read_recording(npz(tmp_path, t=TIME, q=Q, tau=TAU, **others)))
    # Of one joint.
    single = {"t": TIME, "q": Q[:, 0], "tau": TAU[:, 0], "dq_logged": DQ[:, 0], "tau_model": TIME}
    log = read_recording(npz(tmp_path, **single))
    assert log.n == 1
    assert log.velocity is None
    header = "t,position_a,position_b,effort_a,effort_b,effort_model"
    close(read_recording(write(tmp_path / "log.csv", header, TIME, Q, TAU, TIME)))


ZERO = 0.0 * Q
FRANKA = {"q": Q, "q_d": ZERO, "dq": DQ, "dq_d": ZERO, "ddq_d": ZERO, "tau_J": TAU, "tau_J_d": ZERO}
FRANKA |= {"dtau_J": ZERO, "tau_ext_hat_filtered": ZERO, "O_T_EE": Q}
# Names of columns, their tables, and the joints.
HEADERS: dict[str, tuple[list[str], tuple[np.ndarray, ...], tuple[str, ...] | None]] = {
    "franka": ([f"{key}_{j}" for key in FRANKA for j in range(2)], tuple(FRANKA.values()), None),
    "short suffixes": (
        [f"joint{j}_{key}" for key in ("pos", "vel", "eff") for j in (1, 2)],
        (Q, DQ, TAU),
        ("joint1", "joint2"),
    ),
}


@pytest.mark.parametrize("kind", HEADERS)
def test_usual_names(tmp_path: Path, kind: str):
    names, tables, joints = HEADERS[kind]
    log = read_recording(write(tmp_path / "log.csv", ",".join(["time", *names]), TIME, *tables))
    close(log, velocity=True)
    assert log.joint_names == joints


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_units_in_brackets(tmp_path: Path, mark: str):
    names = ["Time [ms]", "Joint 1 [deg]", "Joint 2 [deg]", "Joint 1 [deg/s]", "Joint 2 [deg/s]"]
    names += ["Torque 1 (Nm)", "Torque 2 (mNm)"]
    tables = (TIME * 1e3, np.degrees(Q), np.degrees(DQ), TAU * [1.0, 1e3])
    file = write(tmp_path / "log.csv", mark.join(names), *tables, mark=mark)
    reading = read_described(file)
    close(reading.recording, velocity=True)
    assert reading.sources["effort"] == "Torque 1 (Nm) ... Torque 2 (mNm) in Nm/mNm"
    # A line of units under the names says the same.
    bare = [name.partition(" [")[0].partition(" (")[0] for name in names]
    units = ["ms", "°", "°", "deg/s", "deg/s", "Nm", "mNm"]
    bare[3:5] = ["Speed 1", "Speed 2"]
    file = write(file, mark.join(bare) + "\n" + mark.join(units), *tables, mark=mark)
    close(read_recording(file), velocity=True)


def test_currents_with_units(tmp_path: Path):
    header = "t,q1,q2,current1 [A],current2 [mA]"
    file = write(tmp_path / "log.csv", header, TIME, Q, TAU / [10.0, 0.012])
    refuses(DataError, r"current1 \[A\].* look like currents: give gains=", read_recording, file)
    log = read_recording(file, effort_scale=[10.0, 12.0])
    np.testing.assert_allclose(log.effort, TAU, rtol=1e-13)


@pytest.mark.parametrize("mark", [";", "\t", " "])
def test_decimal_commas(tmp_path: Path, mark: str):
    header = mark.join(["t", "q1", "q2", "tau1", "tau2"])
    file = write(tmp_path / "log.csv", header, TIME, Q, TAU, mark=mark, decimal=",")
    close(read_recording(file))
    lines = file.read_text().splitlines()
    lines[7] = lines[7].replace(",", ".", 1)
    file.write_text("\n".join(lines))
    with pytest.raises(DataError, match=r"line 8: 't' holds .* where other decimals have commas"):
        read_recording(file)


@pytest.mark.parametrize("zone", ["", "Z", "+02:00", " UTC"])
@pytest.mark.parametrize("between", ["T", " "])
def test_dates(tmp_path: Path, zone: str, between: str):
    stamps = np.datetime64("2024-03-01T23:59:59.900000") + (TIME * 1e6).astype("timedelta64[us]")
    frame = FRAME.assign(time=[str(s).replace("T", between) + zone for s in stamps])
    frame.to_csv(tmp_path / "log.csv", index=False)
    close(read_recording(tmp_path / "log.csv"))


def test_columns_of_one_name_in_a_data_frame():
    frame = pd.concat([FRAME.assign(time=TIME), FRAME[["tau1"]]], axis=1)
    refuses(DataError, "several columns of one name", read_recording, frame)


def test_dates_of_whole_seconds_are_no_milliseconds(tmp_path: Path):
    stamps = [f"2024-03-01 00:{k // 60:02d}:{k % 60:02d}" for k in range(N)]
    frame = FRAME.assign(time=["", *stamps[1:]])
    frame.to_csv(tmp_path / "log.csv", index=False)
    found = read_recording(tmp_path / "log.csv", missing="drop")
    np.testing.assert_allclose(found.time, np.arange(N - 1.0), atol=1e-12)
    frame = FRAME.assign(time=[pd.NaT, *pd.to_datetime(stamps[1:])])
    found = read_recording(frame, missing="drop")
    np.testing.assert_allclose(found.time, np.arange(N - 1.0), atol=1e-12)


@pytest.mark.parametrize("zone", [None, "UTC", "Europe/Rome"])
@pytest.mark.parametrize("suffix", ["index", "column", ".parquet", ".feather"])
def test_stamps_with_time_zones(tmp_path: Path, zone: str | None, suffix: str):
    # Clocks in Rome go forward on this night.
    stamps = pd.date_range("2024-03-31T00:59:59.9", periods=N, freq="10ms", tz="UTC")
    stamps = stamps.tz_localize(None) if zone is None else stamps.tz_convert(zone)
    frame = FRAME.set_axis(stamps) if suffix == "index" else FRAME.assign(time=stamps)
    if not suffix.startswith("."):
        close(read_recording(frame))
        return
    file = tmp_path / f"log{suffix}"
    (frame.to_parquet if suffix == ".parquet" else frame.to_feather)(file)
    close(read_recording(file))


def test_names_in_a_comment_and_comments_between(tmp_path: Path):
    rows = np.column_stack([TIME, Q, TAU])
    file = tmp_path / "log.txt"
    for delimiter in (",", " "):
        np.savetxt(file, rows, header="made by a logger\nt,q1,q2,tau1,tau2", delimiter=delimiter)
        close(read_recording(file))
    lines = file.read_text().splitlines()
    lines[10:10] = ["", "# paused", ""]
    lines[25] = lines[25].replace(" ", " nan ", 1).rpartition(" ")[0]
    file.write_text("\n".join(lines) + "\n\n")
    refuses(DataError, "line 26: position: 'q1' has no value", read_recording, file)


def test_columns_without_names(tmp_path: Path):
    file = write(tmp_path / "log.csv", "", TIME, Q, TAU, DQ)
    refuses(DataError, "its 7 columns have no names", read_recording, file)
    numbers = {"time": 1, "position": [2, 3], "effort": [4, 5], "velocity": [6, 7]}
    close(read_recording(file, columns=numbers), velocity=True)
    (tmp_path / "log.toml").write_text(
        "[columns]\ntime = 1\nposition = [2, 3]\neffort = [4, 5]\nvelocity = [6, 7]\n"
    )
    close(read_recording(file), velocity=True)


def test_compressed_text_and_other_encodings(tmp_path: Path):
    plain = write(tmp_path / "log.csv", "t [s],q1 [°],q2 [°],tau1,tau2", TIME, np.degrees(Q), TAU)
    close(read_recording(plain))
    text = plain.read_text(encoding="utf-8")
    (tmp_path / "run.csv.gz").write_bytes(gzip.compress(text.encode()))
    close(read_recording(tmp_path / "run.csv.gz"))
    for encoding in ("latin-1", "utf-16", "utf-8-sig"):
        plain.write_text(text, encoding=encoding)
        close(read_recording(plain))
    (tmp_path / "run.csv.gz").write_bytes(gzip.compress(text.encode())[:-50])
    refuses(DataError, r"run\.csv\.gz", read_recording, tmp_path / "run.csv.gz")


def test_data_frames():
    frame = FRAME.assign(t=TIME, tau2=TAU[:, 1].astype(object))
    close(read_recording(frame))
    indexed = frame.drop(columns="t").set_index(
        pd.Timestamp("2024-03-01") + pd.to_timedelta(np.rint(TIME * 1e3), unit="ms")
    )
    close(read_recording(indexed))
    renamed = frame.rename(columns={"t": "stamp"})
    close(read_recording(renamed, mapping={"columns": {"time": "stamp"}}))
    refuses(DataError, "data frame: effort is missing", read_recording, frame[["t", "q1", "q2"]])
    frame.loc[3, "q2"] = np.nan
    refuses(DataError, "data frame: row 4: position: 'q2' has no value", read_recording, frame)
    refuses(DataError, "is given NoneType, expected the path of a log", read_recording, None)


@pytest.mark.parametrize("word", ["", "nan", "NaN", "-nan", "null", "--", "N/A"])
def test_values_that_begin_late(tmp_path: Path, word: str):
    file = write(tmp_path / "log.csv", "t,q1,q2,tau1,tau2", TIME, Q, TAU)
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
    ramp = np.column_stack([TIME, 2.0 * TIME])
    holed = ramp.copy()
    holed[[5, 6, 7, 20], [0, 0, 0, 1]] = np.nan
    file = npz(tmp_path, t=TIME, q=holed, tau=TAU)
    refuses(DataError, r"row 6: position: 'q of joint 1' .* in 3 of 40 rows", read_recording, file)
    reading = read_described(file, missing="interpolate")
    np.testing.assert_allclose(reading.recording.position, ramp, atol=1e-12)
    np.testing.assert_array_equal(reading.recording.effort, TAU)
    assert reading.sources["missing values"] == "interpolated in 4 of 40 samples"
    assert read_recording(file, mapping={"missing": "drop"}).n_samples == N - 4
    holed[5:20, 0] = np.nan
    with pytest.raises(DataError, match="no value in 15 samples from row 6 on; at most 10"):
        read_recording(npz(tmp_path, t=TIME, q=holed, tau=TAU), missing="interpolate")
    stamps = TIME.copy()
    stamps[3] = np.nan
    with pytest.raises(DataError, match="row 4: time: 'time' has no value"):
        read_recording(npz(tmp_path, t=stamps, q=ramp, tau=TAU), missing="interpolate")


def test_a_joint_that_is_not_wanted_may_lack_values(tmp_path: Path):
    effort = np.column_stack([TAU, np.full(N, np.nan)])
    names = ["up", "down", "finger"]
    file = npz(tmp_path, t=TIME, q=np.column_stack([Q, TIME]), tau=effort, joint_names=names)
    refuses(DataError, "'tau of joint finger' has no value in any row; leave", read_recording, file)
    close(read_recording(file, joint_names=["up", "down"]))


@pytest.mark.parametrize("quoted", ["", '"'])
def test_every_line_has_as_many_fields_as_names(tmp_path: Path, quoted: str):
    header = "label,t,q1,q2,tau1,tau2"
    file = write(tmp_path / "log.csv", header, TIME, TIME, Q, TAU)
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
    close(read_recording(file))


def test_half_precision_is_read_without_a_warning(tmp_path: Path):
    halves = {"t": np.arange(N), "q": Q.astype(np.float16), "tau": TAU.astype(np.float16)}
    log = read_recording(npz(tmp_path, **halves), units={"time": "ms"})
    np.testing.assert_array_equal(log.position, halves["q"])


def test_names_cannot_reach_the_terminal(tmp_path: Path):
    evil = "el\x1b[2Jbow\u202e\u2028\nPROVEN."
    log = read_recording(npz(tmp_path, t=TIME, q=Q, tau=TAU, joint_names=[evil, "b"]))
    assert all(name.isprintable() for name in log.joint_names)
    frame = pd.DataFrame({"t": TIME, f"position_{evil}": TIME, f"effort_{evil}": TIME})
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
    plain = Recording(time=TIME, position=log().position, effort=log().effort)
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
        "t": TIME,
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
    assert part.time[0] == TIME[10]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"base": {}}, "the order of its quaternions is not known; say base="),
        ({"base": {"quaternion": "zyxw"}}, "expected one of xyzw, wxyz"),
        ({"base": {"held": "trunk"}}, "held at 'trunk', and the log has the motion of one"),
        ({"base": {"held": True}}, "base.held is True, expected the name of the link"),
        ({"base": {"held": "trunk", "topic": "/odom"}}, "'trunk', and topic is about one that"),
        ({"base": {"orientation": [0, 0, 0, 1]}}, "say which link was, held ="),
        ({"base": {"quat": "xyzw"}}, "base: quat is not known; known are quaternion"),
        ({"contacts": {}}, "say which frame of the robot each column is of"),
        ({"contacts": {"frames": ["left"]}}, "has 2 columns, expected 1 for each of the 1 frames"),
        ({"columns": {"base_orientation": "pose"}}, "'pose' for base_orientation is not there"),
        ({"columns": {"gyroscope": "tau"}}, "gyroscope: has 2 columns, expected 3"),
        ({"columns": {"position": "q[2:3]"}}, "asks for columns 2 to 3 of an array"),
        ({"rows": (5, 100)}, "rows: asks for row 100, the log has 40"),
        ({"rows": (0, 10)}, "rows is .*, expected the first and the last row"),
    ],
)
def test_what_is_not_told_or_not_there_is_refused(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    np.savez(tmp_path / "run.npz", **arrays())
    refuses(DataError, message, read_recording, tmp_path / "run.npz", **{**TOLD, **changes})


def test_a_mapping_says_that_the_base_was_held(tmp_path: Path) -> None:
    file, tilted = tmp_path / "hung.csv", [0.0, 0.6, 0.0, 0.8]
    alone = Recording(time=TIME, position=log().position, effort=log().effort)
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
    file = write_bag(tmp_path / "bag", kind, TIME, q, v, tau, base=rows)
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
