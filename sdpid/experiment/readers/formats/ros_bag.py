"""ROS bags: messages with joints from db3 and MCAP files of ROS 2, and bags of ROS 1.

Read in the sandbox only: compressed pieces may unpack to more than memory holds.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid.errors import DataError
from sdpid.experiment.readers.columns import LogTable
from sdpid.experiment.readers.formats.robot_messages import (
    COMMANDS,
    QUANTITIES,
    STATES,
    Joints,
    commands_of_motors,
    register,
)

# Messages of a base, the argument that names their topic, and where the parts of quantities are.
_OF_BASE = {
    "nav_msgs/msg/Odometry": (
        "base",
        {
            "base_position": ("pose.pose.position", "xyz"),
            "base_orientation": ("pose.pose.orientation", "xyzw"),
            "base_linear_velocity": ("twist.twist.linear", "xyz"),
            "base_angular_velocity": ("twist.twist.angular", "xyz"),
        },
    ),
    "sensor_msgs/msg/Imu": (
        "imu",
        {"gyroscope": ("angular_velocity", "xyz"), "accelerometer": ("linear_acceleration", "xyz")},
    ),
}
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
    """Read the joints' states of a bag, and the odometry and the IMU of a base.

    Parameters
    ----------
    path : Path
        A file ``.db3``, ``.mcap`` or ``.bag``, or the folder of a ROS 2 bag.
    topic : str, optional
        By default the only topic, or the usual one, of the first of `STATES` that is there.
    joint_names : sequence of str, optional
        Joints to take where several sources publish to one topic; of motors that have numbers
        the names of the first ones.
    topics : mapping, optional
        Topics of ``base`` (``nav_msgs/Odometry``) and ``imu`` (``sensor_msgs/Imu``); by default
        the only one, and none of an IMU without odometry.

    Returns
    -------
    LogTable
        ``time`` (from the messages' own stamps where they have any, else when they were
        recorded), ``bag_time`` (when they were recorded), both in s from the first message,
        ``joint_names``, ``position``, and ``velocity``, ``effort`` and ``reference`` where they
        are filled; of motors with commands also ``feedforward``, from the first command on;
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
    register(typesys, store)
    with highlevel.AnyReader([path], default_typestore=store) as reader:
        taken: dict[str, tuple[str, _Stream]] = {}
        for kind, (name, quantities) in _OF_BASE.items():
            wanted = (topics or {}).get(name)
            of_base = _topic(reader, kind, wanted, f"{name}={{'topic': ...}}")
            if of_base is None:
                break
            parts = [f"{where}.{part}" for where, parts in quantities.values() for part in parts]
            taken[of_base] = kind, _Stream(attrgetter(*parts))
        kind = _kind_of_states(reader, topic)
        values_of, usual = STATES[kind]
        joints = _Joints(values_of, joint_names)
        states, commands = _Stream(joints.row), _Stream(commands_of_motors)
        taken[_topic(reader, kind, topic, "topic=", usual) or ""] = kind, states
        if commanded := _topic(reader, COMMANDS.get(kind, ""), None, "one LowCmd topic a bag"):
            taken[commanded] = COMMANDS[kind], commands
        connections = [c for c in reader.connections if taken.get(c.topic, "")[:1] == (c.msgtype,)]
        for connection, recorded, raw in reader.messages(connections=connections):
            message = reader.deserialize(raw, connection.msgtype)
            taken[connection.topic][1].add(recorded, message)
    arrays = joints.arrays(states)
    if commands.recorded:
        arrays = _from_first(arrays, commands, states, joints.order)
    streams = [(kind, stream) for kind, stream in taken.values() if kind in _OF_BASE]
    for kind, stream in streams:
        arrays |= _at_states(_OF_BASE[kind][1], stream, states) if stream.recorded else {}
    said = {"base": {"quaternion": "xyzw", "velocity_frame": "base"}} if streams else {}
    return LogTable({name: partial(np.asarray, one) for name, one in arrays.items()}, stated=said)


def _kind_of_states(reader: Any, topic: str | None) -> str:
    """Return the message that joints are read from: that of the topic, or the first there is."""
    kinds = {c.msgtype for c in reader.connections if topic in (None, c.topic)}
    return next((kind for kind in STATES if kind in kinds), next(iter(STATES)))


def _topic(
    reader: Any, message: str, wanted: str | None, argument: str, usual: str = ""
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
            f"several topics carry {message}: {', '.join(topics)}; name one with {argument}."
        )
    if wanted is not None and wanted not in topics:
        others = topics or sorted(f"{topic} ({kind})" for topic, kind in kinds)
        raise DataError(
            f"no topic {wanted} with {message}; there is {', '.join(others) or 'nothing'}."
        )
    return wanted or next(iter(topics), None)


class _Stream:
    """Messages of one topic: their own stamps, when they were recorded (ns), and their numbers."""

    def __init__(self, row: Callable[[Any], Iterable[float] | None]) -> None:
        self._row = row
        self.stamps, self.recorded, self.values = array("q"), array("q"), array("d")

    def add(self, recorded: int, message: Any) -> None:
        """Take one message, unless there is no row of it."""
        row = self._row(message)
        if row is not None:
            header = getattr(message, "header", None)
            stamp = None if header is None else header.stamp
            own = 0 if stamp is None else int(stamp.sec) * _SECOND + int(stamp.nanosec)
            self.stamps.append(own)
            self.recorded.append(int(recorded))
            self.values.extend(row)

    def since(self, other: _Stream, own: bool) -> Array:
        """Return own stamps, or when messages were recorded, in s from the first of a stream."""
        mine, first = (self.stamps, other.stamps) if own else (self.recorded, other.recorded)
        return (np.array(mine, dtype=np.int64) - first[0]) / _SECOND

    @property
    def table(self) -> Array:
        """A row for each message."""
        return np.array(self.values).reshape(len(self.recorded), -1)


class _Joints:
    """What states of joints are of, message by message; those of other joints are passed over."""

    def __init__(
        self,
        values_of: Callable[[Any, Sequence[str] | None], Joints],
        names: Sequence[str] | None,
    ) -> None:
        self._values_of, self._given = values_of, names
        self._names = None if names is None else tuple(names)
        self._count = 0
        self._order: dict[tuple[str, ...], list[int] | None] = {}
        self._filled: dict[str, bool] = {}

    def row(self, message: Any) -> list[float] | None:
        """Return the values of all quantities that are filled, one quantity behind the other."""
        self._count += 1
        found, rows = self._values_of(message, self._given)
        names, values = tuple(found), list[float]()
        if names not in self._order:
            self._order[names] = self._matched(names)
        order = self._order[names]
        if order is None:
            return None
        for quantity in QUANTITIES:
            row = rows.get(quantity, ())
            filled = self._filled.setdefault(quantity, len(row) > 0)
            if len(row) != (len(names) if filled else 0):
                raise DataError(
                    f"message {self._count} has {len(row)} entries of {quantity} for {len(names)} "
                    f"joints; the messages before it have {'one a joint' if filled else 'none'}."
                )
            values += [float(row[j]) for j in order] if filled else []
        return values

    def _matched(self, names: tuple[str, ...]) -> list[int] | None:
        """Return where the wanted joints are in a message; None when it is of others."""
        if not names or len(set(names)) != len(names):
            raise DataError(f"message {self._count} names the joints {names}.")
        self._names = self._names or names
        missing = [name for name in self._names if name not in names]
        if missing and missing != list(self._names):
            raise DataError(
                f"message {self._count} lacks {', '.join(missing)}; it has "
                f"{', '.join(names)}. Choose joints that every message has with joint_names=."
            )
        return None if missing else [names.index(name) for name in self._names]

    @property
    def order(self) -> list[int]:
        """Where the joints are in the messages that hold them, the first of these."""
        return next(order for order in self._order.values() if order is not None)

    def arrays(self, states: _Stream) -> dict[str, NDArray[Any]]:
        """Return what was collected as named arrays."""
        others = sorted(", ".join(names) for names, order in self._order.items() if order is None)
        names = ", ".join(self._names or ())
        if not states.recorded:
            raise DataError(
                f"no message holds the joints {names}; there are "
                f"{'; '.join(others) or 'no messages'}."
            )
        if others and self._given is None:
            raise DataError(
                f"the messages are of several sets of joints: {names}; "
                f"{'; '.join(others)}. Choose with joint_names=."
            )
        filled = [quantity for quantity, there in self._filled.items() if there]
        return {
            "time": states.since(states, own=any(states.stamps)),
            "bag_time": states.since(states, own=False),
            "joint_names": np.asarray(self._names),
            **dict(zip(filled, np.split(states.table, max(1, len(filled)), axis=1), strict=False)),
        }


def _from_first(
    arrays: Mapping[str, NDArray[Any]], commands: _Stream, states: _Stream, motors: Sequence[int]
) -> dict[str, NDArray[Any]]:
    """Return arrays from the first command on, with each motor's last command."""
    when = states.since(states, own=False)
    row = np.searchsorted(commands.since(states, own=False), when, side="right") - 1
    known = row >= 0
    commanded = commands.table.reshape(len(commands.recorded), 2, -1)[row[known]][
        :, :, list(motors)
    ]
    kept = {n: each if n == "joint_names" else each[known] for n, each in arrays.items()}
    return {**kept, "reference": commanded[:, 0], "feedforward": commanded[:, 1]}


def _at_states(
    quantities: Mapping[str, tuple[str, str]], stream: _Stream, states: _Stream
) -> dict[str, Array]:
    """Return quantities of the base at the stamps of the joint states; NaN where unknown."""
    from scipy.spatial.transform import Rotation, Slerp

    own = any(states.stamps)
    stamps = states.since(states, own)
    time, first = np.unique(stream.since(states, own), return_index=True)
    after = np.searchsorted(time, stamps).clip(1, max(1, len(time) - 1))
    gap = time[after] - time[after - 1] if len(time) > 1 else np.full(len(stamps), np.inf)
    unknown = (stamps < time[0]) | (stamps > time[-1]) | (gap > _LONGEST_GAP)
    unknown &= ~np.isin(stamps, time)
    found, rows = {}, stream.table[first]
    for quantity, (_, parts) in quantities.items():
        own_rows, rows = rows[:, : len(parts)], rows[:, len(parts) :]
        values = np.column_stack([np.interp(stamps, time, column) for column in own_rows.T])
        if quantity == "base_orientation" and len(time) > 1:
            # Along the shortest turn.
            turns = Slerp(time, Rotation.from_quat(own_rows))
            values = turns(np.clip(stamps, time[0], time[-1])).as_quat()
        values[unknown] = np.nan
        found[quantity] = values
    return found
