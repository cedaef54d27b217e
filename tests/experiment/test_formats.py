"""Logs of every format, as other programs write them and as people have them."""

import bz2
import gzip
import io
import os
import re
import struct
import sys
import warnings
import zipfile
from collections.abc import Callable
from functools import partial
from itertools import product
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

from sdpid.errors import DataError, ExportError, MissingExtraError, SdpidError
from sdpid.experiment.readers.formats.loaders import BY_SUFFIX
from sdpid.experiment.readers.formats.text_file import load_matrices
from sdpid.experiment.readers.read import read_described, read_recording
from sdpid.experiment.recording.recording import Recording, guess_time_unit
from tests.experiment.test_recording import log
from tests.helpers.bags import JOINTS, write_bag
from tests.helpers.damage import damaged
from tests.helpers.logs import DQ, TAU, Q, T, close, numbered, write_csv, write_npz
from tests.helpers.refusals import refuses
from tests.helpers.studies import study
from tests.helpers.torch_files import Stored, write_torch

N = len(T)
NAMES = numbered("q{}", "tau{}")
FRAME = pd.DataFrame(np.hstack([Q, TAU]), columns=NAMES)
ARRAYS = {"t": T, "q": Q, "tau": TAU}


# Functions that write a log of each format to a folder, and return its path.


Writer = Callable[[Path], Path]
AB = ("a", "b")


def npz(**changes: Any) -> Writer:
    return lambda folder: write_npz(folder / "log.npz", **{**ARRAYS, **changes})


def mat(how: dict[str, Any] | None = None, **changes: Any) -> Writer:
    def write(folder: Path) -> Path:
        arrays = {name: one for name, one in {**ARRAYS, **changes}.items() if one is not None}
        savemat(folder / "log.mat", arrays, **how or {})
        return folder / "log.mat"

    return write


def h5(content: Callable[[h5py.File], None], name: str = "log.h5", **how: Any) -> Writer:
    def write(folder: Path) -> Path:
        with h5py.File(folder / name, "w", **how) as out:
            content(out)
        return folder / name

    return write


def parquet(**changes: Any) -> Writer:
    def write(folder: Path) -> Path:
        lists = {"t": T, "q": Q.tolist(), "tau": TAU.tolist()} | changes
        given = {name: one for name, one in lists.items() if one is not None}
        pq.write_table(pa.table(given), folder / "log.parquet")
        return folder / "log.parquet"

    return write


def own_parquet(folder: Path, metadata: str | None = None, **changes: Any) -> Path:
    """Write a file of ours, whose metadata may say something else."""
    file = folder / "log.parquet"
    given = {"time": T, "position": Q, "effort": TAU, "velocity": DQ, "joint_names": AB}
    Recording(**{**given, **changes}).to_parquet(file)
    if metadata is not None:
        pq.write_table(pq.read_table(file).replace_schema_metadata({b"sdpid": metadata}), file)
    return file


def bag(kind: str, **how: Any) -> Writer:
    return lambda folder: write_bag(folder / "bag", kind, T, Q, DQ, TAU, **how)


def feather(folder: Path) -> Path:
    FRAME.assign(t=T).to_feather(folder / "log.feather")
    return folder / "log.feather"


def pt(folder: Path) -> Path:
    arrays = {name: Stored(array, "DoubleStorage") for name, array in {**ARRAYS, "dq": DQ}.items()}
    return write_torch(folder / "log.pt", {**arrays, "joint_names": list(AB)})


def packed_npz(folder: Path, **changes: Any) -> Path:
    np.savez_compressed(folder / "log.npz", **{**NAMED, "period": 0.1, **changes})
    return folder / "log.npz"


TOML = """joint_names = ["a", "b"]
period = 0.1
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


def toml(folder: Path) -> Path:
    npz()(folder)
    (folder / "log.toml").write_text(TOML)
    return folder / "log.toml"


def cells(*values: Any) -> np.ndarray:
    found = np.empty(len(values), dtype=object)
    found[:] = values
    return found


def matlab_73(out: h5py.File) -> None:
    """Write as MATLAB does: reversed axes, classes in attributes, cells by reference."""

    def put(name: str, data: Any, kind: str, **more: Any) -> h5py.Dataset:
        node = out.create_dataset(name, data=data, **more)
        node.attrs["MATLAB_class"] = np.bytes_(kind)
        return node

    for name, value in {"t": T[:, None], "q": Q, "qd": DQ, "tau": TAU}.items():
        put(name, value.T, "double")
    letters = [np.array([[ord(letter)]], dtype=np.uint16) for letter in AB]
    each = [put(f"#refs#/{k}", code, "char").ref for k, code in enumerate(letters)]
    put("joint_names", np.array([each]).T, "cell", dtype=h5py.ref_dtype)


def grouped(out: h5py.File) -> None:
    out.create_dataset("arm/q", data=Q, compression="gzip", chunks=(8, 2))
    out["arm/tau"], out["arm/velocity"] = TAU, DQ
    out["arm"].attrs["joint_names"] = list(AB)
    out.attrs["fs"] = 100.0


def table(out: h5py.File) -> None:
    kinds = [("t", float), ("q_1", float), ("q_2", float), ("tau", float, (2,))]
    rows = zip(T, Q[:, 0], Q[:, 1], TAU, strict=True)
    out["log"] = np.array([(t, a, b, tau) for t, a, b, tau in rows], dtype=kinds)


NAMED = {**ARRAYS, "dq": DQ, "joint_names": np.array(AB)}
STRUCT = {"q": None, "joint_names": cells(*AB), "log": {"q": Q, "dq": DQ}}
# How a log is written, whether it has velocities, and its joints.
LOGS: dict[str, tuple[Writer, bool, Any]] = {
    "csv": (lambda f: write_csv(f / "log.csv", ["t", *NAMES], T, Q, TAU), False, None),
    "toml": (toml, False, AB),
    "npz": (packed_npz, True, AB),
    "npz plain": (npz(**NAMED), True, AB),
    "mat 4": (mat({"format": "4"}), False, None),
    "mat 5": (mat(**STRUCT), True, AB),
    "mat 7": (mat({"do_compression": True}, **STRUCT), True, AB),
    "mat 7.3": (h5(matlab_73, "log.mat", userblock_size=512), True, AB),
    "hdf5": (h5(grouped), True, AB),
    "hdf5 table": (h5(table, "log.hdf5"), False, None),
    "feather": (feather, False, None),
    "parquet": (parquet(), False, None),
    "own parquet": (own_parquet, True, AB),
    "pt": (pt, True, AB),
    "db3": (bag("db3"), True, JOINTS),
    "mcap": (bag("mcap"), True, JOINTS),
    "ros1": (bag("ros1"), True, JOINTS),
    "folder": (bag("folder"), True, JOINTS),
    "files packed": (bag("db3", packed="FILE"), True, JOINTS),
    "messages packed": (bag("db3", packed="MESSAGE"), True, JOINTS),
    "chunks packed": (bag("mcap", packed="STORAGE"), True, JOINTS),
}


@pytest.mark.parametrize("kind", [kind for kind in LOGS if kind != "toml"])
def test_every_format_is_read(tmp_path: Path, kind: str):
    write, velocity, joints = LOGS[kind]
    file = write(tmp_path)
    close(read_recording(file), velocity=velocity, joints=joints)
    if kind == "mcap":
        turned = read_recording(file, joint_names=JOINTS[::-1], topic="/joint_states")
        np.testing.assert_array_equal(turned.position, Q[:, ::-1])
        late = read_recording(file, columns={"time": "bag_time"})
        np.testing.assert_allclose(late.time, 2.0 * T, atol=1e-9)


class Bomb:
    def __reduce__(self) -> tuple[Any, ...]:
        return (pytest.fail, ("a pickle was executed",))


BOXED = np.array(Bomb(), dtype=object)


def twice(out: h5py.File) -> None:
    for run in ("first", "second"):
        out[f"{run}/t"], out[f"{run}/q"], out[f"{run}/tau"] = T, Q, TAU


def elsewhere(out: h5py.File) -> None:
    out["t"], out["tau"] = T, TAU
    out.create_dataset("q", (N, 2), "f8", external=[("raw", 0, N * 16)])


ROWS = 200_000_000


def claims_of_h5(out: h5py.File) -> None:
    out["t"], out["tau"] = T, TAU
    out.create_dataset("q", (ROWS, 2), "f8", chunks=(1024, 2))


def claims_of_npz(folder: Path) -> Path:
    file = npz(q=None)(folder)
    claim = np.lib.format.header_data_from_array_1_0(Q) | {"shape": (ROWS, 2)}
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, claim)
    with zipfile.ZipFile(file, "a") as archive:
        archive.writestr("q.npy", header.getvalue() + bytes(64))
    return file


def claims_of_mat(folder: Path) -> Path:
    # Dimensions are an element of two int32, before the one with the name.
    there, claimed = ((k).to_bytes(4, "little") + (2).to_bytes(4, "little") for k in (N, ROWS))
    file = mat(t=None, tau=None)(folder)
    file.write_bytes(file.read_bytes().replace(there, claimed))
    return file


OTHERS = '{"format": 1, "joint_names": ["a", "c"]}'
REFUSED: list[tuple[Writer, str]] = [
    (mat(q=cells(T, Q)), "'q' is a cell array"),
    (mat(q=1j * Q), "position: 'q' holds complex"),
    (h5(twice), "position is there more than once: first/q, second/q"),
    (h5(elsewhere), "'q' is kept in another file"),
    (h5(claims_of_h5), r"'q' claims 200,000,000 × 2 values, 3\.2 GB"),
    (claims_of_npz, "'q' is damaged"),
    (claims_of_mat, "cannot reshape array of size 80 into"),
    (npz(q=BOXED), "'q' holds Python objects"),
    (parquet(q=[[1.0], *Q[1:].tolist()]), "'q' is ragged: its rows have 1 to 2"),
    (parquet(q=[None, *Q[1:].tolist()]), "column 'q' has 1 missing values"),
    (parquet(q=[1.0, None, *T[2:]]), "row 2: position: 'q' has no value"),
    (partial(own_parquet, metadata="{"), "metadata under 'sdpid' is damaged"),
    (partial(own_parquet, metadata='{"format": 7}'), "is of format 7, this version reads"),
    (partial(own_parquet, metadata='{"format": 1, "joint_names": []}'), "it names no joints"),
    (partial(own_parquet, metadata=OTHERS), "lacks the columns position_c"),
    (bag("mcap", gripper=True), "several sets of joints: up, down; finger"),
    (bag("mcap", ragged=7), "message 8 has 0 entries of effort for 2 joints"),
    (lambda folder: folder, r"without metadata\.yaml.*without text files"),
]


@pytest.mark.parametrize(("write", "words"), REFUSED)
def test_what_is_refused(tmp_path: Path, write: Writer, words: str):
    refuses(DataError, words, read_recording, write(tmp_path))


def test_names_pick_what_is_read_among_others(tmp_path: Path):
    file = h5(twice)(tmp_path)
    where = {"time": "second/t", "position": "second/q", "effort": "second/tau"}
    close(read_recording(file, columns=where))
    file = bag("mcap", gripper=True)(tmp_path)
    np.testing.assert_array_equal(read_recording(file, joint_names=JOINTS).position, Q)
    for how, words in (
        ({"joint_names": ("up", "thumb")}, "message 1 lacks thumb"),
        ({"topic": "/states"}, "no topic /states.*there is /joint_states"),
    ):
        refuses(DataError, words, read_recording, file, **how)
    # An object beside the data does no harm, as long as it is not wanted.
    close(read_recording(npz(config=BOXED)(tmp_path)))


def test_hdf5_joint_by_joint(tmp_path: Path):
    def content(out: h5py.File) -> None:
        out["t"] = T
        for j, name in enumerate(("up", "down")):
            out[f"joints/{name}/position"], out[f"joints/{name}/effort"] = Q[:, j], TAU[:, j]

    reading = read_described(h5(content)(tmp_path))
    assert reading.sources["position"] == "joints/down/position ... joints/up/position"
    # The library lists groups by the alphabet.
    assert reading.recording.joint_names == ("down", "up")
    close(read_recording(tmp_path / "log.h5", joint_names=["up", "down"]))


@pytest.mark.parametrize(("suffix", "wanted"), [(".h5", "io"), (".mcap", "ros"), (".bag", "ros")])
def test_missing_packages_are_named_with_what_installs_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, wanted: str
):
    for module in ("h5py", "rosbags", "rosbags.highlevel"):
        monkeypatch.setitem(sys.modules, module, None)
    file = tmp_path / f"log{suffix}"
    file.write_bytes(b"0")
    refuses(MissingExtraError, rf"with: pip install .*\[{wanted}\]'", BY_SUFFIX[suffix].load, file)


def test_several_logs_at_once(tmp_path: Path):
    first = write_npz(tmp_path / "1.npz", **ARRAYS)
    second = write_npz(tmp_path / "2.npz", t=T, q=Q[:, :1], tau=TAU[:, :1])
    assert [log.n_samples for log in read_recording([first, first])] == [N, N]
    refuses(DataError, r"2\.npz: has the joints 1", read_recording, [first, second])


def test_joints_of_arrays_are_ordered_by_name(tmp_path: Path):
    named = {"joint_names": ["up", "down"], "effort_scale": [1.0, 2.0]}
    file = npz(**named)(tmp_path)
    log = read_recording(file, joint_names=["down", "up"])
    np.testing.assert_array_equal(log.position, Q[:, ::-1])
    np.testing.assert_array_equal(log.effort, TAU[:, ::-1] * [2.0, 1.0])
    assert read_recording(file, joint_names=["down"]).n == 1
    assert read_recording(file, joint_names=["x", "y"]).joint_names == ("x", "y")
    words = "joint_names are up, side, the file has up, down"
    refuses(DataError, words, read_recording, file, joint_names=["up", "side"])


@pytest.mark.parametrize("kind", ["parquet", "own parquet", "npz", "mat", "h5"])
def test_logs_beyond_memory_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str):
    sandboxed = kind in ("mat", "h5")
    if sandboxed and sys.platform != "linux":
        pytest.skip("other systems do not limit memory")
    # Libraries take 80 MB in the sandbox, the arrays as much again.
    monkeypatch.setattr("sdpid._common.sandbox._BASE_MEMORY", 80_000_000)
    monkeypatch.setattr("sdpid._common.sandbox._MOST_MEMORY", 30_000_000 if sandboxed else 30_000)
    rows = 2_000_000 if sandboxed else 2000
    t, q = np.arange(rows), np.zeros((rows, 2))
    writers = {
        "parquet": parquet(t=t, q=None, tau=None, **dict.fromkeys(NAMES, t)),
        "own parquet": partial(own_parquet, time=t, position=q, effort=q, velocity=None),
        "npz": partial(packed_npz, t=t, q=q, tau=q),
        "mat": mat({"do_compression": True}, t=t, q=q, tau=q),
        "h5": h5(lambda out: out.update({"t": t, "q": q, "tau": q})),
    }
    words = r"more (memory )?than the limit of 0\.03 (GB|MB; cut the log)"
    refuses(DataError, words, read_recording, writers[kind](tmp_path))


# Damaged logs of every format: read, or refused with an error of ours, nothing else. Longer runs:
# ``SDPID_FUZZ=5000 pytest tests/experiment/test_formats.py``.


# Damaged files of each kind.
COUNT = int(os.environ.get("SDPID_FUZZ", "40"))
# Of formats that are read in a child process, which takes half a second to start.
COUNT_IN_SANDBOX = 1 + COUNT // 10


@pytest.mark.parametrize("kind", [kind for kind in LOGS if kind not in list(LOGS)[-4:]])
def test_damaged_logs_are_read_or_refused(tmp_path: Path, kind: str):
    file = LOGS[kind][0](tmp_path)
    log = tmp_path / "log.npz" if kind == "toml" else file
    content = file.read_bytes()
    count = COUNT_IN_SANDBOX if BY_SUFFIX[log.suffix].sandboxed else COUNT
    rng = np.random.default_rng([COUNT, *kind.encode()])
    refused = 0
    with warnings.catch_warnings():
        # Libraries may warn of what they find in a damaged file; that is not ours.
        warnings.simplefilter("ignore")
        assert read_recording(log).n == 2
        for _ in range(count):
            file.write_bytes(damaged(content, rng, kind in ("csv", "toml")))
            try:
                read_recording(log)
            except SdpidError:
                refused += 1
    assert 0 < refused <= count


GARBAGE = [np.random.default_rng(0).bytes(500), b"", b"\x00" * 64, b"a,b\n1\n", b"1,2\n3\n"]


@pytest.mark.parametrize("suffix", ["", *sorted(BY_SUFFIX)])
def test_garbage_is_a_data_error(tmp_path: Path, suffix: str):
    # Without a suffix a folder of matrices. A child process for each content takes a moment.
    names = [f"log{suffix}"] if suffix else ["t.dat", "q.dat", "tau.dat"]
    for content in GARBAGE[: 1 if suffix and BY_SUFFIX[suffix].sandboxed else None]:
        for name in names:
            (tmp_path / name).write_bytes(content)
        words = r"log\." if suffix else r"\.dat: is no matrix"
        refuses(DataError, words, read_recording, tmp_path / names[0] if suffix else tmp_path)
    (tmp_path / "q.txt").write_bytes(b"1")
    if not suffix:
        refuses(DataError, r"q\.dat and q\.txt have the same name", read_recording, tmp_path)


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
    import lz4.frame
    from rosbags.rosbag2.reader import zstd

    pack = {"bz2": bz2.compress, "lz4": lz4.frame.compress, "zstd": zstd.compress}[name]
    return pack(bytes(size))


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
    "bomb.csv.gz": lambda: gzip.compress(b"t,q1,tau1\n" + b"1,2,3" * 1_000_000),
    "deep names.mat": lambda: b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"\xff" * 64,
}


@pytest.mark.parametrize("name", [*BOMBS, "log.parquet"])
def test_files_that_did_harm_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
):
    monkeypatch.setattr("sdpid._common.sandbox._MOST_MEMORY", 100_000_000)
    if name in BOMBS:
        (tmp_path / name).write_bytes(BOMBS[name]())
    else:
        own_parquet(tmp_path, "[" * 100_000)
    refuses(DataError, re.escape(name), read_recording, tmp_path / name)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no FIFOs")
def test_a_fifo_is_no_log(tmp_path: Path):
    for name in ("log.csv", "log.toml"):
        os.mkfifo(tmp_path / name)
    refuses(DataError, r"log\.csv: is no regular file", read_recording, tmp_path / "log.csv")
    file, mapping = npz()(tmp_path), tmp_path / "log.toml"
    words = r"log\.toml: it is no regular file"
    refuses(DataError, words, read_recording, file, mapping=mapping)


# Logs as people have them: other names, units, decimal marks, stamps and gaps.


@pytest.mark.parametrize(("unit", "factor"), [("ns", 1e9), ("us", 1e6), ("ms", 1e3)])
@pytest.mark.parametrize("start", [0.0, 17e-9, 1_700_000_000.0])
@pytest.mark.parametrize("kind", ["integers", "floats", "csv"])
def test_whole_stamps_tell_their_unit(
    tmp_path: Path, unit: str, factor: float, start: float, kind: str
):
    stamps = round(start * factor) + np.rint(T * factor).astype(np.int64)
    frame = FRAME.assign(t=stamps if kind != "floats" else stamps * 1.0)
    if kind == "csv":
        frame.to_csv(tmp_path / "log.csv", index=False)
    reading = read_described(tmp_path / "log.csv" if kind == "csv" else frame)
    found = reading.recording.time
    # A double holds nanoseconds since 1970 to 256 of them.
    exact = kind != "floats" or stamps[0] < 10**16
    np.testing.assert_allclose(found - found[0], T, atol=1e-12 if exact else 1e-6)
    assert f"taken for {unit}" in reading.sources["time"]


@pytest.mark.parametrize("rate", [21.0, 100.0, 125.0, 1000.0, 4000.0, 8000.0])
def test_stamps_in_seconds_are_left_alone(rate: float):
    for start in (0.0, 3.5, 1.7e9):
        assert guess_time_unit(start + np.arange(100) / rate) == "s"
    for unit, factor in (("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        if factor >= 1e3 * max(1.0, rate / 1000.0):
            assert guess_time_unit(np.rint(np.arange(100) * factor / rate)) == unit
    assert guess_time_unit(1_700_000_000 + np.arange(5)) == "s"
    assert guess_time_unit(np.array([5])) == "s"


def test_arrays_that_are_something_else_are_left_alone(tmp_path: Path):
    names = ["t", *NAMES, "period", "start", "periods", "rate"]
    file = write_csv(tmp_path / "log.csv", names, T, Q, TAU, DQ, DQ)
    log = read_recording(file)
    close(log)
    assert (log.period, log.start) == (None, None)
    words = "'period' for period has 40 values, expected one"
    refuses(DataError, words, read_recording, file, columns={"period": "period"})
    file = tmp_path / "log.npz"
    assert read_recording(npz(period=0.2)(tmp_path)).period == 0.2
    # What is said of whole stamps is believed.
    seconds = npz(t=np.arange(N))(tmp_path)
    assert read_recording(seconds, units={"time": "s"}).rate_hz == pytest.approx(1.0)
    # What only begins like a quantity, also of a single joint, and of a rate.
    others = {"dq_logged": DQ, "tau_model": TAU, "tau_hat": TAU, "q_note": np.array("x")}
    close(read_recording(npz(**others)(tmp_path)))
    single = {"t": None, "q": Q[:, 0], "tau": TAU[:, 0], "dq_logged": DQ[:, 0], "fs": 100.0}
    reading = read_described(npz(**single)(tmp_path))
    assert (reading.recording.n, reading.recording.velocity) == (1, None)
    assert reading.sources["time"] == "sample rate, 100 Hz"


MIDNIGHT = np.datetime64("2024-03-01T23:59:59.900000") + (T * 1e6).astype("timedelta64[us]")
# Clocks in Rome go forward on this night.
NIGHT = pd.date_range("2024-03-31T00:59:59.9", periods=N, freq="10ms", tz="UTC")
SECONDS = ["", *(f"2024-03-01 00:00:{k:02d}" for k in range(1, N))]


def test_dates(tmp_path: Path):
    csv, parquet, feather = (tmp_path / f"log.{suffix}" for suffix in ("csv", "parquet", "feather"))
    for zone, between in product(("", "Z", "+02:00", " UTC"), ("T", " ")):
        dates = [str(stamp).replace("T", between) + zone for stamp in MIDNIGHT]
        FRAME.assign(time=dates).to_csv(csv, index=False)
        close(read_recording(csv))
    for zone in (None, "UTC", "Europe/Rome"):
        frame = FRAME.assign(time=NIGHT.tz_convert(zone))
        frame.to_parquet(parquet)
        frame.to_feather(feather)
        for source in (frame, FRAME.set_axis(NIGHT.tz_convert(zone)), parquet, feather):
            close(read_recording(source))
    # Those of whole seconds are no milliseconds.
    FRAME.assign(time=SECONDS).to_csv(csv, index=False)
    for source in (csv, FRAME.assign(time=pd.to_datetime(SECONDS))):
        found = read_recording(source, missing="drop")
        np.testing.assert_allclose(found.time, np.arange(N - 1.0), atol=1e-12)


def test_names_in_a_comment_and_comments_between(tmp_path: Path):
    file = tmp_path / "log.txt"
    for mark in (",", " "):
        header = "made by a logger\n" + ",".join(["t", *NAMES])
        np.savetxt(file, np.column_stack([T, Q, TAU]), header=header, delimiter=mark)
        close(read_recording(file))
    lines = file.read_text().splitlines()
    lines[10:10] = ["", "# paused", ""]
    lines[25] = lines[25].replace(" ", " nan ", 1).rpartition(" ")[0]
    file.write_text("\n".join(lines) + "\n\n")
    refuses(DataError, "line 26: position: 'q1' has no value", read_recording, file)


def test_compressed_text_and_other_encodings(tmp_path: Path):
    names = ["t [s]", "q1 [°]", "q2 [°]", "tau1", "tau2"]
    plain = write_csv(tmp_path / "log.csv", names, T, np.degrees(Q), TAU)
    content, packed_file = plain.read_text(encoding="utf-8"), tmp_path / "run.csv.gz"
    for encoding in ("utf-8", "latin-1", "utf-16", "utf-8-sig"):
        plain.write_text(content, encoding=encoding)
        close(read_recording(plain))
    packed_file.write_bytes(gzip.compress(content.encode()))
    close(read_recording(packed_file))
    packed_file.write_bytes(gzip.compress(content.encode())[:-50])
    refuses(DataError, r"run\.csv\.gz", read_recording, packed_file)


def test_data_frames():
    frame = FRAME.assign(t=T, tau2=TAU[:, 1].astype(object))
    close(read_recording(frame))
    stamps = pd.Timestamp("2024-03-01") + pd.to_timedelta(np.rint(T * 1e3), unit="ms")
    close(read_recording(frame.drop(columns="t").set_index(stamps)))
    renamed = frame.rename(columns={"t": "stamp"})
    close(read_recording(renamed, mapping={"columns": {"time": "stamp"}}))
    holed = frame.copy()
    holed.loc[3, "q2"] = np.nan
    for given, words in (
        (frame[["t", "q1", "q2"]], "data frame: effort is missing"),
        (holed, "data frame: row 4: position: 'q2' has no value"),
        (pd.concat([frame, FRAME[["tau1"]]], axis=1), "several columns of one name"),
        (frame.assign(t="now"), "data frame: 't' holds objects, expected numbers"),
        (None, "is given NoneType, expected the path of a log"),
    ):
        refuses(DataError, words, read_recording, given)
    refuses(DataError, "this is a data frame", read_recording, frame, stored=True)


@pytest.mark.parametrize("word", ["", "nan", "NaN", "-nan", "null", "--", "N/A"])
def test_values_that_begin_late(tmp_path: Path, word: str):
    file = write_csv(tmp_path / "log.csv", ["t", *NAMES], T, Q, TAU)
    lines = file.read_text().splitlines()
    for k in (1, 2):
        lines[k] = ",".join([*lines[k].split(",")[:3], word, lines[k].split(",")[4]])
    file.write_text("\n".join(lines))
    words = r"log\.csv: line 2: effort: 'tau1' has no value .*2 of 40"
    refuses(DataError, words, read_recording, file)
    reading = read_described(file, missing="drop")
    np.testing.assert_array_equal(reading.recording.position, Q[2:])
    assert reading.sources["missing values"] == "2 of 40 samples dropped"
    words = "has no value in 2 samples from line 2 on"
    refuses(DataError, words, read_recording, file, missing="interpolate")


def test_short_gaps_are_interpolated(tmp_path: Path):
    ramp = np.column_stack([T, 2.0 * T])
    holed, stamps = ramp.copy(), T.copy()
    holed[[5, 6, 7, 20], [0, 0, 0, 1]] = np.nan
    file = npz(q=holed)(tmp_path)
    refuses(DataError, r"row 6: position: 'q of joint 1' .* in 3 of 40 rows", read_recording, file)
    reading = read_described(file, missing="interpolate")
    np.testing.assert_allclose(reading.recording.position, ramp, atol=1e-12)
    np.testing.assert_array_equal(reading.recording.effort, TAU)
    assert reading.sources["missing values"] == "interpolated in 4 of 40 samples"
    assert read_recording(file, mapping={"missing": "drop"}).n_samples == N - 4
    holed[5:20, 0], stamps[3] = np.nan, np.nan
    for change, words in (
        ({"q": holed}, "no value in 15 samples from row 6 on; at most 10"),
        ({"t": stamps}, "row 4: time: 'time' has no value"),
    ):
        file = npz(**change)(tmp_path)
        refuses(DataError, words, read_recording, file, missing="interpolate")


def test_a_joint_that_is_not_wanted_may_lack_values(tmp_path: Path):
    finger = {"q": np.column_stack([Q, T]), "tau": np.column_stack([TAU, np.full(N, np.nan)])}
    names = ["up", "down", "finger"]
    file = npz(**finger, joint_names=names)(tmp_path)
    refuses(DataError, "'tau of joint finger' has no value in any row; leave", read_recording, file)
    close(read_recording(file, joint_names=["up", "down"]))


@pytest.mark.parametrize("quoted", ["", '"'])
def test_every_line_has_as_many_fields_as_names(tmp_path: Path, quoted: str):
    names = ["label", f"{quoted}t{quoted}", "q_up", "q_down", "tau_up", "tau_down"]
    file = write_csv(tmp_path / "log.csv", names, T, T, Q, TAU)
    head, *lines = file.read_text().splitlines()
    lines = [head, *(f"{quoted}go{quoted},{line.partition(',')[2]}" for line in lines)]
    line = lines[30]
    for broken in (line.replace(".", ",", 1), line + ",1", line[: line.rfind(",")]):
        file.write_text("\n".join([*lines[:30], broken, *lines[31:]]))
        refuses(DataError, r"line 31 has [57] values for 6 columns", read_recording, file)
    file.write_text("\n".join(lines))
    close(read_recording(file), joints=JOINTS)
    turned = read_recording(file, joint_names=JOINTS[::-1])
    np.testing.assert_array_equal(turned.effort, TAU[:, ::-1])
    one = {"position": ["q_down"], "effort": ["tau_down"]}
    np.testing.assert_array_equal(read_recording(file, columns=one).position, Q[:, 1:])


def test_half_precision_is_read_without_a_warning(tmp_path: Path):
    halves = {"t": np.arange(N), "q": Q.astype(np.float16), "tau": TAU.astype(np.float16)}
    log = read_recording(npz(**halves)(tmp_path), units={"time": "ms"})
    np.testing.assert_array_equal(log.position, halves["q"])


def test_names_cannot_reach_the_terminal(tmp_path: Path):
    evil = "el\x1b[2Jbow\u202e\u2028\nPROVEN."
    log = read_recording(npz(joint_names=[evil, "b"])(tmp_path))
    assert all(name.isprintable() for name in log.joint_names)
    frame = pd.DataFrame({"t": T, f"position_{evil}": T, f"effort_{evil}": T})
    assert all(text.isprintable() for text in read_described(frame).sources.values())
    error = refuses(DataError, "time is missing", read_recording, frame.rename(columns={"t": evil}))
    assert str(error).isprintable()


# Logs of robots with a floating base: poses, IMUs and feet, found by name or as told.


def test_our_files_keep_everything(tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    whole = log(reference=log().position)
    whole.to_parquet(tmp_path / "run.parquet")
    whole.to_csv(file)
    for path in (tmp_path / "run.parquet", file):
        found = read_recording(path)
        for name, values in whole.columns().items():
            # Quaternions are made as long as one again.
            atol = 1e-15 if "orientation" in name else 0.0
            np.testing.assert_allclose(found.columns()[name], values, rtol=0, atol=atol)
        assert found.base.velocity_frame == whole.base.velocity_frame
        np.testing.assert_array_equal(found.base.imu.translation, whole.base.imu.translation)
        assert found.contacts.kind == whole.contacts.kind
        np.testing.assert_array_equal(found.contacts.offset, whole.contacts.offset)
    turned = read_recording(file, contacts={"frames": ["right", "left"], "kind": "plane"})
    assert turned.contacts.frames == ("right", "left")
    assert turned.contacts.kind == ("plane", "plane")
    np.testing.assert_array_equal(turned.contacts.down, log().contacts.down[:, ::-1])
    np.testing.assert_array_equal(turned.contacts.forces, log().contacts.forces[:, ::-1])
    assert read_recording(file, columns={"base_orientation": None}, mapping=False).base is None
    ALONE.with_held_base("trunk").to_csv(file)
    contacts = read_recording(file).contacts
    assert (contacts.frames, contacts.kind) == (("trunk",), ("plane",))
    # A mapping that was written with a log goes with it; one of other hands stays.
    ALONE.to_csv(file)
    assert read_recording(file).contacts is None
    (tmp_path / "run.toml").write_text("[units]\nposition = 'deg'\n")
    refuses(ExportError, r"run\.toml: is a mapping of another log", log().to_csv, file)


ALONE = Recording(time=T, position=log().position, effort=log().effort)


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
    file = write_npz(tmp_path / "run.npz", **arrays())
    found = read_recording(file, **TOLD)
    np.testing.assert_allclose(found.base.orientation, log().base.orientation, atol=1e-15)
    np.testing.assert_allclose(found.base.angular_velocity, log().base.angular_velocity)
    assert found.base.velocity_frame == "base"
    np.testing.assert_array_equal(found.contacts.down, log().contacts.down)
    part = read_recording(file, **TOLD, rows=(11, 30))
    assert part.n_samples == part.base.n_samples == part.contacts.n_samples == 20
    assert part.time[0] == T[10]
    # Forces of all feet as samples × feet × axes, and flags by the usual name of an array.
    forces = np.arange(6.0 * N).reshape(N, 2, 3)
    usual = arrays(feet=None, contacts=log().contacts.down, contact_forces=forces)
    file = write_npz(tmp_path / "run.npz", **usual)
    found = read_recording(file, base=TOLD["base"], contacts={"frames": ["left", "right"]})
    np.testing.assert_array_equal(found.contacts.forces, forces)
    np.testing.assert_array_equal(found.contacts.down, log().contacts.down)
    # Columns of an earlier name go before an array of a later one.
    down = dict(zip(("contact_left", "contact_right"), log().contacts.down.T, strict=True))
    usual = arrays(feet=None, contact_state=np.zeros(N), **down)
    found = read_recording(write_npz(tmp_path / "run.npz", **usual), base=TOLD["base"])
    assert found.contacts.frames == ("left", "right")
    np.testing.assert_array_equal(found.contacts.down, log().contacts.down)


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
        ({"contacts": {"frames": "left"}}, "contacts.frames: is 'left', expected a list"),
        ({"contacts": {"frames": ["left"]}}, "has 2 columns, expected 1 for each of the 1 frames"),
        ({"columns": {"contact": None}}, "contacts is given, but there are no columns of contacts"),
        ({"columns": {"base_orientation": "pose"}}, "'pose' for base_orientation is not there"),
        ({"columns": {"gyroscope": "tau"}}, "gyroscope: has 2 columns, expected 3"),
        ({"columns": {"position": "q[2:3]"}}, "asks for columns 2 to 3 of an array"),
        ({"rows": (5, 100)}, "rows: asks for row 100, the log has 40"),
        ({"rows": (0, 10)}, "rows is .*, expected the first and the last row"),
        ({"arrays": {"base_quat": None}}, "base, contacts is given, but base_orientation is missi"),
    ],
)
def test_what_is_not_told_or_not_there_is_refused(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    how = {**TOLD, **changes}
    file = write_npz(tmp_path / "run.npz", **arrays(**how.pop("arrays", {})))
    refuses(DataError, message, read_recording, file, **how)


def test_a_mapping_says_that_the_base_was_held(tmp_path: Path) -> None:
    file, tilted = tmp_path / "hung.csv", [0.0, 0.6, 0.0, 0.8]
    held = {"held": "trunk", "orientation": tilted}
    ALONE.to_csv(file)
    assert read_recording(file).base is None
    (tmp_path / "hung.toml").write_text(f'[base]\nheld = "trunk"\norientation = {tilted}\n')
    found = read_described(file)
    assert found.sources["base"] == "held at trunk"
    wanted = ALONE.with_held_base("trunk", orientation=tilted)
    for one in (found.recording, read_recording(file, mapping=False, base=held)):
        np.testing.assert_array_equal(one.base.orientation, wanted.base.orientation)
        assert (one.contacts.frames, one.contacts.kind) == (("trunk",), ("plane",))
        assert one.contacts.down.all()
        # What a saved run reads its log with.
        assert one.source.options["base"] == held


def test_velocities_of_unknown_axes_are_left_out_with_a_word(tmp_path: Path) -> None:
    names = [f"base_{quantity}_{part}" for quantity in ("orientation",) for part in "xyzw"]
    names += [f"base_angular_velocity_{part}" for part in "xyz"]
    turn = log().base
    tables = (ALONE.position, ALONE.effort, turn.orientation, turn.angular_velocity)
    csv = write_csv(tmp_path / "run.csv", ["t", *NAMES, *names], T, *tables)
    npz = write_npz(tmp_path / "run.npz", **arrays())
    told = {**TOLD, "base": {"quaternion": "wxyz"}}
    for file, how in ((npz, told), (csv, {})):
        found = read_described(file, **how)
        assert found.recording.base.angular_velocity is None
        assert "its axes are not known" in found.sources["base_angular_velocity"]
    found = read_recording(csv, base={"velocity_frame": "world"})
    np.testing.assert_array_equal(found.base.angular_velocity, turn.angular_velocity)
    columns = {"contact": "feet", "base_angular_velocity": "base_ang_vel"}
    words = "velocity_frame: is None, expected 'world' or 'base'"
    refuses(DataError, words, read_recording, npz, **{**told, "columns": columns})


@pytest.mark.parametrize(("prefix", "told"), [("imu_quat", True), ("tcp_orientation", False)])
def test_quaternions_by_another_name_are_pointed_out(tmp_path: Path, prefix: str, told: bool):
    names = ["t", "q1", "tau1", *(f"{prefix}_{part}" for part in "wxyz")]
    half = np.full((N, 4), 0.5)
    file = write_csv(tmp_path / "run.csv", names, T, ALONE.position[:, 0], TAU[:, 0], half)
    found = read_described(file)
    assert found.recording.base is None
    assert (f"--column base_orientation={prefix}" in str(found.sources)) == told
    if told:
        assert read_recording(file, columns={"base_orientation": prefix}).base is not None


def test_missing_values_of_the_base_are_dropped_or_refused(tmp_path: Path) -> None:
    given = arrays()
    given["base_quat"][7] = np.nan
    file = write_npz(tmp_path / "run.npz", **given)
    for missing, words in (
        ("refuse", r"row 8: base_orientation: 'base_quat\[1\]' has no value"),
        ("interpolate", "fills only what belongs to joints"),
    ):
        refuses(DataError, words, read_recording, file, **TOLD, missing=missing)
    found = read_recording(file, **TOLD, missing="drop")
    assert found.base.n_samples == found.contacts.n_samples == N - 1


def test_folders_of_matrices_have_channels_in_rows_or_columns(tmp_path: Path) -> None:
    given = arrays(base_quat=arrays()["base_quat"].T, q=np.hstack([log().position] * 2))
    for name, values in given.items():
        np.savetxt(tmp_path / f"{name}.dat", values, delimiter="\t", fmt="%.17g")
    told = {**TOLD, "columns": {**TOLD["columns"], "position": "q[3:4]"}}
    found = read_recording(tmp_path, **told)
    np.testing.assert_array_equal(found.position, log().position)
    np.testing.assert_allclose(found.base.orientation, log().base.orientation, atol=1e-15)
    # Rows of a long log are longer than lines of a table may be.
    np.savetxt(tmp_path / "long.dat", np.zeros((2, 1 << 19)), fmt="%d")
    assert load_matrices(tmp_path).arrays["long"]().shape == (1 << 19, 2)
    np.savetxt(tmp_path / "tau.dat", np.eye(3))
    words = "3 × 3 numbers, so that it is not known which side"
    refuses(DataError, words, read_recording, tmp_path, **TOLD)


@pytest.mark.parametrize("kind", ["mcap", "ros1"])
def test_odometry_and_imu_of_bags_come_to_the_stamps_of_the_joints(tmp_path: Path, kind: str):
    turns = Rotation.from_rotvec(np.linspace(0.0, 1.0, N)[:, None] * [0.2, 0.5, -0.8])
    slope = np.linspace(0.0, 1.0, N)[:, None]
    rows = np.hstack([slope + np.arange(3.0), turns.as_quat(), slope * np.arange(1.0, 7.0)])
    file = write_bag(tmp_path / "bag", kind, T, ALONE.position, TAU, ALONE.effort, base=rows)
    # The last joint state is later than the last odometry.
    refuses(DataError, r"base_orientation: .*has no value", read_recording, file)
    found = read_recording(file, missing="drop", imu={"translation": [0.1, 0.0, 0.0]})
    assert (found.n_samples, found.joint_names) == (N - 1, JOINTS)
    base = found.base
    np.testing.assert_allclose(base.orientation, turns.as_quat()[:-1], atol=1e-12)
    np.testing.assert_allclose(base.position, rows[:-1, :3], atol=1e-12)
    np.testing.assert_allclose(base.imu.gyroscope, rows[:-1, 10:], atol=1e-12)
    assert base.velocity_frame == "base"
    words = r"no topic /pose with .*Odometry; there is /odom"
    refuses(DataError, words, read_recording, file, base={"topic": "/pose"})


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
