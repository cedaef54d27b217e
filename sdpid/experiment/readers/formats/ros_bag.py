"""ROS bags: `sensor_msgs/JointState` from db3 and MCAP files of ROS 2, and bags of ROS 1.

Read in the sandbox only: compressed pieces may unpack to more than memory holds.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid.errors import DataError
from sdpid.experiment.readers.columns import LogTable

_STATES = "sensor_msgs/msg/JointState"
_USUAL_TOPIC = "/joint_states"
_QUANTITIES = ("position", "velocity", "effort")
# Nanoseconds; whole numbers until they are relative, for a double holds too few digits of them.
_SECOND = 1_000_000_000
# Between messages further apart than this (s) nothing is known of a base.
_LONGEST_GAP = 0.1


def load_rosbag(
    path: Path,
    *,
    topic: str | None = None,
    joint_names: Sequence[str] | None = None,
    topics: Mapping[str, str] | None = None,
) -> LogTable:
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
    LogTable
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
        states = _JointStates(path, None if joint_names is None else tuple(joint_names))
        streams: dict[str, _Stream] = {}
        for message, (name, row) in _MESSAGES.items():
            wanted = (topics or {}).get(name)
            of_base = _topic(path, reader, message, wanted, f"{name}={{'topic': ...}}")
            if of_base is None:
                break
            streams[of_base] = _Stream(row)
        taken = dict(zip(streams, _MESSAGES, strict=False))
        taken[_topic(path, reader, _STATES, topic, "topic=", _USUAL_TOPIC) or ""] = _STATES
        connections = [c for c in reader.connections if taken.get(c.topic) == c.msgtype]
        for connection, recorded, raw in reader.messages(connections=connections):
            stream = streams.get(connection.topic, states)
            stream.add(recorded, reader.deserialize(raw, connection.msgtype))
    columns = states.columns()
    for stream in streams.values():
        columns |= _at_states(stream, states)
    said = {"base": {"quaternion": "xyzw", "velocity_frame": "base"}} if streams else {}
    return LogTable(
        {name: partial(np.asarray, values) for name, values in columns.items()}, stated=said
    )


def _topic(
    path: Path, reader: Any, message: str, wanted: str | None, argument: str, usual: str = ""
) -> str | None:
    """Return the topic with messages of a kind: the one wanted, the usual or the only one.

    Raises
    ------
    DataError
        When there are several and none is wanted, or the one wanted, or needed, is not there.
    """
    kinds = {(c.topic, c.msgtype) for c in reader.connections}
    topics = sorted(topic for topic, kind in kinds if kind == message)
    if wanted is None and usual and (usual in topics or not topics):
        wanted = usual
    if wanted is None and len(topics) > 1:
        raise DataError(
            f"{path}: several topics carry {message}: {', '.join(topics)}; name one with "
            f"{argument}."
        )
    if wanted is not None and wanted not in topics:
        others = topics or sorted(f"{topic} ({kind})" for topic, kind in kinds)
        raise DataError(
            f"{path}: no topic {wanted} with {message}; there is {', '.join(others) or 'nothing'}."
        )
    return wanted or next(iter(topics), None)


class _Stream:
    """Messages of one topic: their own stamps, when they were recorded (ns), and their numbers."""

    def __init__(self, row: Callable[[Any], Iterable[float] | None]) -> None:
        self.row = row
        self.stamps, self.recorded, self.values = array("q"), array("q"), array("d")

    def add(self, recorded: int, message: Any) -> None:
        """Take one message, unless there is no row of it."""
        row = self.row(message)
        if row is not None:
            stamp = message.header.stamp
            self.stamps.append(int(stamp.sec) * _SECOND + int(stamp.nanosec))
            self.recorded.append(int(recorded))
            self.values.extend(row)

    def clock(self, own: bool) -> NDArray[np.int64]:
        """Return the messages' own stamps, or when they were recorded, in ns."""
        return np.array(self.stamps if own else self.recorded, dtype=np.int64)


def _odometry(message: Any) -> Iterable[float]:
    """Return position, quaternion, linear and angular velocity."""
    pose, twist = message.pose.pose, message.twist.twist
    parts = (pose.position, pose.orientation, twist.linear, twist.angular)
    rows = [(part.x, part.y, part.z) for part in parts]
    return (*rows[0], *rows[1], pose.orientation.w, *rows[2], *rows[3])


def _imu(message: Any) -> Iterable[float]:
    """Return angular velocity and linear acceleration."""
    parts = (message.angular_velocity, message.linear_acceleration)
    return [value for part in parts for value in (part.x, part.y, part.z)]


class _JointStates(_Stream):
    """The joint states of a topic, message by message; those of other joints are passed over."""

    def __init__(self, path: Path, names: tuple[str, ...] | None) -> None:
        super().__init__(self._joints)
        self._path = path
        self._names = names
        self._chosen = names is not None
        self._count = 0
        self._order: dict[tuple[str, ...], list[int] | None] = {}
        self._filled: dict[str, bool] = {}

    def _joints(self, message: Any) -> list[float] | None:
        """Return the values of all quantities that are filled, one quantity behind the other."""
        self._count += 1
        names, values = tuple(message.name), []
        if names not in self._order:
            self._order[names] = self._matched(names)
        order = self._order[names]
        for quantity in _QUANTITIES if order is not None else ():
            row = getattr(message, quantity)
            filled = self._filled.setdefault(quantity, len(row) > 0)
            if len(row) != (len(names) if filled else 0):
                raise DataError(
                    f"{self._path}: message {self._count} has {len(row)} entries of {quantity} "
                    f"for {len(names)} joints; the messages before it have "
                    f"{'one a joint' if filled else 'none'}."
                )
            values += [float(row[j]) for j in order or ()] if filled else []
        return None if order is None else values

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
    def stamped(self) -> bool:
        """Whether messages have stamps of their own."""
        return any(self.stamps)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return what was collected as named arrays."""
        others = sorted(", ".join(names) for names, order in self._order.items() if order is None)
        if self._names is None or not self.recorded:
            raise DataError(
                f"{self._path}: no message holds the joints {', '.join(self._names or ())}; "
                f"there are {'; '.join(others) or 'no messages'}."
            )
        if others and not self._chosen:
            raise DataError(
                f"{self._path}: the messages are of several sets of joints: "
                f"{', '.join(self._names)}; {'; '.join(others)}. Choose with joint_names=."
            )
        clocks = {"time": self.clock(self.stamped), "bag_time": self.clock(False)}
        found: dict[str, NDArray[Any]] = {
            name: (stamps - stamps[0]) / _SECOND for name, stamps in clocks.items()
        }
        found["joint_names"] = np.asarray(self._names)
        there = [quantity for quantity, filled in self._filled.items() if filled]
        shape = (len(self.recorded), len(there), len(self._names))
        table = np.frombuffer(self.values).reshape(shape)
        return found | {quantity: table[:, k] for k, quantity in enumerate(there)}


def _at_states(stream: _Stream, states: _JointStates) -> dict[str, Array]:
    """Return quantities of the base at the stamps of the joint states; NaN where unknown."""
    if not stream.recorded:
        return {}
    clock, own = states.clock(states.stamped), stream.clock(states.stamped)
    stamps = (clock - clock[0]) / _SECOND
    time, first = np.unique((own - clock[0]) / _SECOND, return_index=True)
    rows = np.frombuffer(stream.values).reshape(len(own), -1)[first]
    values = np.column_stack([np.interp(stamps, time, column) for column in rows.T])
    if stream.row is _odometry:
        values[:, 3:7] = _between(stamps, time, rows[:, 3:7])
    after = np.searchsorted(time, stamps).clip(1, max(1, len(time) - 1))
    gap = time[after] - time[after - 1] if len(time) > 1 else np.full(len(stamps), np.inf)
    unknown = (stamps < time[0]) | (stamps > time[-1]) | (gap > _LONGEST_GAP)
    values[unknown & ~np.isin(stamps, time)] = np.nan
    if stream.row is _imu:
        return {"gyroscope": values[:, :3], "accelerometer": values[:, 3:]}
    return {
        "base_position": values[:, :3],
        "base_orientation": values[:, 3:7],
        "base_linear_velocity": values[:, 7:10],
        "base_angular_velocity": values[:, 10:],
    }


def _between(stamps: Array, time: Array, quaternions: Array) -> Array:
    """Return orientations between others, along the shortest turn."""
    from scipy.spatial.transform import Rotation, Slerp

    if len(time) == 1:
        return np.repeat(quaternions, len(stamps), axis=0)
    turns = Slerp(time, Rotation.from_quat(quaternions))
    found: Array = turns(np.clip(stamps, time[0], time[-1])).as_quat()
    return found


# What is read of which message of a base, and the argument that names its topic.
_MESSAGES: dict[str, tuple[str, Callable[[Any], Iterable[float]]]] = {
    "nav_msgs/msg/Odometry": ("base", _odometry),
    "sensor_msgs/msg/Imu": ("imu", _imu),
}
