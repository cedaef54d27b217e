"""Bags that unpack to more than they say, or than memory holds, are refused unread."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

import sdpid
from sdpid.experiment.rosbag import load_rosbag
from tests.helpers.bags import write_bag

pytest.importorskip("rosbags")

MAGIC = b"\x89MCAP0\r\n"
HUGE = 1 << 36


def record(kind: int, body: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(body)) + body


def text(words: str) -> bytes:
    return struct.pack("<I", len(words)) + words.encode()


def packed(name: str, size: int) -> bytes:
    """Return zeros, compressed."""
    if name == "lz4":
        import lz4.frame

        return lz4.frame.compress(bytes(size))
    from rosbags.rosbag2.reader import zstd

    return zstd.compress(bytes(size))


def chunk(claimed: int, name: str, data: bytes) -> bytes:
    body = struct.pack("<QQQI", 0, 1, claimed, 0) + text(name) + struct.pack("<Q", len(data)) + data
    return record(6, body)


def mcap(path: Path, *records: bytes) -> Path:
    path.write_bytes(MAGIC + record(1, text("ros2") + text("")) + b"".join(records) + MAGIC)
    return path


@pytest.mark.parametrize("name", ["zstd", "lz4"])
def test_a_chunk_that_unpacks_to_more_than_it_says(tmp_path: Path, name: str) -> None:
    bag = mcap(tmp_path / "a.mcap", chunk(1000, name, packed(name, 1 << 22)))
    with pytest.raises(sdpid.DataError, match=r"claims 1,000 bytes and unpacks to more"):
        load_rosbag(bag)


@pytest.mark.parametrize("name", ["", "zstd", "lz4"])
def test_a_chunk_that_says_too_much(tmp_path: Path, name: str) -> None:
    bag = mcap(tmp_path / "a.mcap", chunk(HUGE, name, packed(name or "lz4", 1000)))
    with pytest.raises(sdpid.DataError, match=r"claims 68,719,476,736 values"):
        load_rosbag(bag)


def test_an_index_that_points_elsewhere(tmp_path: Path) -> None:
    body = struct.pack("<QQQQ", 0, 1, 17, 100) + struct.pack("<I", 0) + struct.pack("<Q", 0)
    bag = mcap(tmp_path / "a.mcap", record(8, body + text("zstd") + struct.pack("<QQ", 5, 9)))
    with pytest.raises(sdpid.DataError, match=r"points at byte 17 .* no such chunk"):
        load_rosbag(bag)


def test_a_summary_that_is_none(tmp_path: Path) -> None:
    bag = mcap(tmp_path / "a.mcap", record(2, struct.pack("<QQI", 12, 0, 0)))
    with pytest.raises(sdpid.DataError, match="summary is said to be at byte 12"):
        load_rosbag(bag)


def test_a_packed_file_and_packed_messages(tmp_path: Path) -> None:
    metadata = (
        "rosbag2_bagfile_information:\n  version: 9\n  compression_format: zstd\n"
        "  compression_mode: {mode}\n  storage_identifier: mcap\n"
    )
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "metadata.yaml").write_text(metadata.format(mode="FILE"))
    (folder / "bag.mcap.zstd").write_bytes(packed("zstd", 1 << 27))
    with pytest.raises(sdpid.DataError, match="compressed data"):
        load_rosbag(folder)
    inner = mcap(tmp_path / "inner.mcap", chunk(1000, "lz4", packed("lz4", 1 << 20)))
    from rosbags.rosbag2.reader import zstd

    (folder / "bag.mcap.zstd").write_bytes(zstd.compress(inner.read_bytes()))
    with pytest.raises(sdpid.DataError, match="unpacks to more"):
        load_rosbag(folder)
    (folder / "metadata.yaml").write_text(metadata.format(mode="MESSAGE"))
    with pytest.raises(sdpid.DataError, match="one by one"):
        load_rosbag(folder)


@pytest.mark.parametrize("kind", ["bz2", "lz4"])
def test_a_ros1_chunk(tmp_path: Path, kind: str) -> None:
    import bz2

    data = bz2.compress(bytes(1 << 22)) if kind == "bz2" else packed("lz4", 1 << 22)
    fields = (b"op=\x05", b"compression=" + kind.encode(), b"size=" + struct.pack("<I", 1000))
    header = b"".join(struct.pack("<I", len(field)) + field for field in fields)
    bag = tmp_path / "a.bag"
    parts = (struct.pack("<I", len(header)), header, struct.pack("<I", len(data)), data)
    bag.write_bytes(b"#ROSBAG V2.0\n" + b"".join(parts))
    with pytest.raises(sdpid.DataError, match="unpacks to more"):
        load_rosbag(bag)


@pytest.mark.parametrize("mode", ["NONE", "FILE", "MESSAGE", "STORAGE"])
@pytest.mark.parametrize("plugin", ["SQLITE3", "MCAP"])
def test_honest_bags_are_read(tmp_path: Path, mode: str, plugin: str) -> None:
    """Written by the library, compressed in every way that it knows."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    if (mode == "STORAGE") != (plugin == "MCAP") and mode != "NONE":
        pytest.skip("this library does not write it")
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
    columns = load_rosbag(tmp_path / "bag")
    assert columns["position"]().shape == (50, 2)


def test_an_honest_ros1_bag_is_read(tmp_path: Path) -> None:
    rows = np.zeros((20, 2))
    bag = write_bag(tmp_path / "bag", "ros1", np.arange(20.0), rows, rows, rows)
    assert load_rosbag(bag)["position"]().shape == (20, 2)
