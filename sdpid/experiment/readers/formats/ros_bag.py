"""ROS bags: `sensor_msgs/JointState` from db3 and MCAP files of ROS 2, and bags of ROS 1.

Read in the sandbox only: compressed pieces may unpack to more than memory holds.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.extras import require
from sdpid.errors import DataError
from sdpid.experiment.readers.formats.ros_base import MESSAGES, BaseStream, topic_of
from sdpid.experiment.readers.table import Table

_MESSAGE = "sensor_msgs/msg/JointState"
_USUAL_TOPIC = "/joint_states"
_QUANTITIES = ("position", "velocity", "effort")
# Nanoseconds; whole numbers until they are relative, for a double holds too few digits of them.
_SECOND = 1_000_000_000


def load_rosbag(
    path: Path,
    *,
    topic: str | None = None,
    joint_names: Sequence[str] | None = None,
    topics: Mapping[str, str] | None = None,
) -> Table:
    """Read the joint states of a bag, and the odometry and the IMU of a base.

    Parameters
    ----------
    path : Path
        A file ``.db3``, ``.mcap`` or ``.bag``, or the folder of a ROS 2 bag.
    topic : str, optional
        By default the only topic with joint states, or ``/joint_states``.
    joint_names : sequence of str, optional
        Joints to take where several sources publish to one topic.
    topics : mapping, optional
        Topics of ``base`` (``nav_msgs/Odometry``) and ``imu`` (``sensor_msgs/Imu``); by default
        the only one, and none of an IMU without odometry.

    Returns
    -------
    Table
        ``time`` (from the messages' own stamps where they have any, else when they were
        recorded), ``bag_time`` (when they were recorded), both in s from the first message,
        ``joint_names``, ``position``, and ``velocity`` and ``effort`` where they are filled;
        ``base_position`` and so on, ``gyroscope`` and ``accelerometer`` at the same stamps, NaN
        where nothing is known.

    Raises
    ------
    DataError
        When the bag has no such topic, or a message does not hold what the others do. Whatever
        the library raises passes on to the sandbox.
    MissingExtraError
        When rosbags is not installed (extra ``ros``).
    """
    highlevel = require("rosbags.highlevel", extra="ros")
    typesys = require("rosbags.typesys", extra="ros")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    with highlevel.AnyReader([path], default_typestore=store) as reader:
        states = _States(path, None if joint_names is None else tuple(joint_names))
        wanted = _connections(path, reader, topic)
        streams = _streams(path, reader, topics or {})
        wanted += [c for c in reader.connections if c.topic in streams]
        for connection, stamp, raw in reader.messages(connections=wanted):
            taker = streams.get(connection.topic, states)
            taker.add(stamp, reader.deserialize(raw, connection.msgtype))
    columns = states.columns()
    for stream in streams.values():
        stamps, stamped, origin = states.clock
        found = stream.at(stamps, stamped=stamped, origin=origin)
        columns |= {name: partial(np.asarray, values) for name, values in found.items()}
    said = {"base": {"quaternion": "xyzw", "velocity_frame": "base"}} if streams else {}
    return Table(columns, stated=said)


def _streams(path: Path, reader: Any, topics: Mapping[str, str]) -> dict[str, BaseStream]:
    """Return what takes the messages of the base, by topic; nothing without odometry."""
    found: dict[str, BaseStream] = {}
    for message, name in MESSAGES.items():
        topic = topic_of(path, reader, message, topics.get(name))
        if topic is None:
            break
        found[topic] = BaseStream(message)
    return found


def _connections(path: Path, reader: Any, topic: str | None) -> list[Any]:
    """Return the connections of the topic to read."""
    offered = [c for c in reader.connections if c.msgtype == _MESSAGE]
    topics = sorted({c.topic for c in offered})
    if topic is None:
        if len(topics) > 1 and _USUAL_TOPIC not in topics:
            raise DataError(
                f"{path}: several topics carry joint states: {', '.join(topics)}; name one "
                "with topic=."
            )
        topic = _USUAL_TOPIC if _USUAL_TOPIC in topics or not topics else topics[0]
    if topic not in topics:
        others = ", ".join(sorted({f"{c.topic} ({c.msgtype})" for c in reader.connections}))
        raise DataError(
            f"{path}: no topic {topic} with {_MESSAGE}; there is {others or 'nothing'}."
        )
    return [c for c in offered if c.topic == topic]


class _States:
    """The joint states of a topic, message by message."""

    def __init__(self, path: Path, names: tuple[str, ...] | None) -> None:
        self._path = path
        self._names = names
        self._chosen = names is not None
        self._count = 0
        self._order: dict[tuple[str, ...], list[int] | None] = {}
        self._filled: dict[str, bool] = {}
        self._stamps = array("q")
        self._times = array("q")
        self._values = {quantity: array("d") for quantity in _QUANTITIES}

    def add(self, stamp: int, message: Any) -> None:
        """Take one message; one of other joints is passed over."""
        self._count += 1
        names = tuple(message.name)
        if names not in self._order:
            self._order[names] = self._matched(names)
        order = self._order[names]
        if order is None:
            return
        header = message.header.stamp
        self._stamps.append(int(header.sec) * _SECOND + int(header.nanosec))
        self._times.append(int(stamp))
        for quantity, values in self._values.items():
            row = getattr(message, quantity)
            filled = self._filled.setdefault(quantity, len(row) > 0)
            if len(row) != (len(names) if filled else 0):
                raise DataError(
                    f"{self._path}: message {self._count} has {len(row)} entries of {quantity} "
                    f"for {len(names)} joints; the messages before it have "
                    f"{'one a joint' if filled else 'none'}."
                )
            if filled:
                values.extend(float(row[j]) for j in order)

    def _matched(self, names: tuple[str, ...]) -> list[int] | None:
        """Return where the wanted joints are in a message; None when it is of others."""
        if not names or len(set(names)) != len(names):
            raise DataError(f"{self._path}: message {self._count} names the joints {names}.")
        if self._names is None:
            self._names = names
        missing = [name for name in self._names if name not in names]
        if len(missing) == len(self._names):
            return None
        if missing:
            raise DataError(
                f"{self._path}: message {self._count} lacks {', '.join(missing)}; it has "
                f"{', '.join(names)}. Choose joints that every message has with joint_names=."
            )
        return [names.index(name) for name in self._names]

    @property
    def clock(self) -> tuple[NDArray[np.float64], bool, int]:
        """The stamps in s, whether they are the messages' own, and where they count from, ns."""
        stamped = np.array(self._stamps, dtype=np.int64)
        own = bool(stamped.any())
        best = stamped if own else np.array(self._times, dtype=np.int64)
        return (best - best[0]) / _SECOND, own, int(best[0])

    def columns(self) -> dict[str, Callable[[], NDArray[Any]]]:
        """Return what was collected as named arrays."""
        others = sorted(", ".join(names) for names, order in self._order.items() if order is None)
        if self._names is None or not self._times:
            raise DataError(
                f"{self._path}: no message holds the joints {', '.join(self._names or ())}; "
                f"there are {'; '.join(others) or 'no messages'}."
            )
        if others and not self._chosen:
            raise DataError(
                f"{self._path}: the messages are of several sets of joints: "
                f"{', '.join(self._names)}; {'; '.join(others)}. Choose with joint_names=."
            )
        found: dict[str, Callable[[], NDArray[Any]]] = {}
        recorded = np.array(self._times, dtype=np.int64)
        found["time"] = partial(np.asarray, self.clock[0])
        found["bag_time"] = partial(np.asarray, (recorded - recorded[0]) / _SECOND)
        found["joint_names"] = partial(np.asarray, np.asarray(self._names))
        for quantity, values in self._values.items():
            if values:
                table = np.frombuffer(values).reshape(len(self._times), len(self._names))
                found[quantity] = partial(np.asarray, table)
        return found
