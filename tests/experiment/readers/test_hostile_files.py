"""Damaged logs of every format: read, or refused with an error of ours, nothing else.

Longer runs: ``SDPID_FUZZ=5000 pytest tests/experiment/readers/test_fuzz.py``.
"""

import bz2
import gzip
import io
import os
import re
import shutil
import struct
import warnings
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

import sdpid
from sdpid.errors import DataError, SdpidError
from sdpid.experiment.readers.formats.loaders import LOADERS, MATRICES, SANDBOXED
from tests.helpers.bags import write_bag
from tests.helpers.damage import damaged
from tests.helpers.refusals import refuses

# Damaged files of each kind.
COUNT = int(os.environ.get("SDPID_FUZZ", "40"))
# Of formats that are read in a child process, which takes a moment to start.
COUNT_IN_SANDBOX = 1 + COUNT // 6
N = 30
RNG = np.random.default_rng(11)
T = 0.25 * np.arange(N)
Q, TAU, DQ = (RNG.standard_normal((N, 2)) for _ in range(3))
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
