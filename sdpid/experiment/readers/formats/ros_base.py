"""Odometry and IMU of a bag, brought to the stamps of the joint states."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError

ODOMETRY, IMU = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"
# What is read of which message, and the argument that names its topic.
MESSAGES = {ODOMETRY: "base", IMU: "imu"}
_NS = 1_000_000_000
# Between messages further apart than this (s) nothing is known.
_LONGEST_GAP = 0.1


def topic_of(path: Path, reader: Any, message: str, wanted: str | None) -> str | None:
    """Return the topic with messages of a kind: the one wanted, or the only one.

    Raises
    ------
    DataError
        When there are several and none is wanted, or the one wanted is not there.
    """
    topics = sorted({c.topic for c in reader.connections if c.msgtype == message})
    if wanted is not None and wanted not in topics:
        listed = ", ".join(topics) or "none"
        raise DataError(f"{path}: no topic {wanted} with {message}; there is {listed}.")
    if wanted is None and len(topics) > 1:
        name = MESSAGES[message]
        raise DataError(
            f"{path}: several topics carry {message}: {', '.join(topics)}; name one with "
            f"{name}={{'topic': ...}}."
        )
    return wanted or (topics[0] if topics else None)


class BaseStream:
    """The messages of one topic, as rows of numbers."""

    def __init__(self, message: str) -> None:
        self.message = message
        self._stamps = array("q")
        self._times = array("q")
        self._rows = array("d")

    def add(self, stamp: int, message: Any) -> None:
        """Take one message."""
        header = message.header.stamp
        self._stamps.append(int(header.sec) * _NS + int(header.nanosec))
        self._times.append(int(stamp))
        if self.message == ODOMETRY:
            pose, twist = message.pose.pose, message.twist.twist
            parts = [pose.position, pose.orientation, twist.linear, twist.angular]
        else:
            parts = [message.angular_velocity, message.linear_acceleration]
        for part in parts:
            self._rows.extend((part.x, part.y, part.z))
            if hasattr(part, "w"):
                self._rows.append(part.w)

    def at(self, stamps: Array, *, stamped: bool, origin: int) -> Mapping[str, Array]:
        """Return quantities at other stamps, in s from `origin` (ns), NaN where nothing is known.

        Parameters
        ----------
        stamps : (N,) ndarray
            Those of the joint states.
        stamped : bool
            Whether they are the messages' own stamps, or when messages were recorded.
        origin : int
            Where they count from, ns.
        """
        if not self._times:
            return {}
        own = np.array(self._stamps if stamped else self._times, dtype=np.int64)
        time, first = np.unique((own - origin) / _NS, return_index=True)
        rows = np.frombuffer(self._rows).reshape(len(own), -1)[first]
        values = np.column_stack([np.interp(stamps, time, column) for column in rows.T])
        if self.message == ODOMETRY:
            values[:, 3:7] = _between(stamps, time, rows[:, 3:7])
        after = np.searchsorted(time, stamps).clip(1, max(1, len(time) - 1))
        gap = time[after] - time[after - 1] if len(time) > 1 else np.full(len(stamps), np.inf)
        unknown = (stamps < time[0]) | (stamps > time[-1]) | (gap > _LONGEST_GAP)
        values[unknown & ~np.isin(stamps, time)] = np.nan
        if self.message == IMU:
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
