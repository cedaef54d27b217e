"""ROS bags: messages with joints from db3 and MCAP files of ROS 2, and bags of ROS 1.

Read in the sandbox only: compressed pieces may unpack to more than memory holds.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import product
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid.errors import DataError
from sdpid.experiment.readers.columns import LogTable
from sdpid.experiment.readers.names import OF_MESSAGES

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
        # The message of the topic, or the first that there is.
        kinds = {c.msgtype for c in reader.connections if topic in (None, c.topic)}
        kind = next((kind for kind in STATES if kind in kinds), next(iter(STATES)))
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
        self, values_of: Callable[[Any, Sequence[str] | None], Joints], names: Sequence[str] | None
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


# Names of the joints of a message, and numbers by quantity: none, or one a joint.
Joints = tuple[Sequence[str], dict[str, Sequence[float]]]

# Quantities of joints, in the order in which they are kept.
QUANTITIES = ("position", "velocity", "effort", "reference")

# The motors of Unitree's quadrupeds, in the order of their numbers.
_LEGS = tuple(
    f"{leg}_{part}_joint"
    for leg, part in product(("FR", "FL", "RR", "RL"), ("hip", "thigh", "calf"))
)


def _joint_state(message: Any, _: Sequence[str] | None) -> Joints:
    """Return what a driver measures."""
    return message.name, {name: getattr(message, name) for name in QUANTITIES[:3]}


def _controller_state(message: Any, _: Sequence[str] | None) -> Joints:
    """Return what a controller of trajectories measures, is commanded, and asks for as effort.

    Older messages have other names for the same; parts that are not used are empty.
    """
    rows: dict[str, Sequence[float]] = {}
    for (point, field), quantity in OF_MESSAGES.items():
        if len(values := getattr(getattr(message, point, None), field, ())):
            rows.setdefault(quantity, values)
    return message.joint_names, rows


def _dynamic_state(message: Any, _: Sequence[str] | None) -> Joints:
    """Return what all components with a position measure; others are sensors."""
    rows = {
        name: dict(zip(each.interface_names, each.values, strict=True))
        for name, each in zip(message.joint_names, message.interface_values, strict=True)
    }
    names = [name for name, row in rows.items() if "position" in row]
    return names, {
        quantity: [rows[name][quantity] for name in names]
        if all(quantity in rows[name] for name in names)
        else ()
        for quantity in QUANTITIES[:3]
    }


def _motors(message: Any, chosen: Sequence[str] | None, known: Sequence[str] = ()) -> Joints:
    """Return what motors measure, which have numbers: the first ones, by the names chosen."""
    motors = message.motor_state
    names = known if set(chosen or ()) <= set(known) else chosen
    names = names or [f"motor_{k}" for k in range(len(motors))]
    used = motors[: len(names)]
    fields = {quantity: f for (part, f), quantity in OF_MESSAGES.items() if part == "motor_state"}
    return names, {name: [getattr(m, field) for m in used] for name, field in fields.items()}


def commands_of_motors(message: Any) -> list[float]:
    """Return all motors' commanded positions, then their efforts beside those of position."""
    motors = message.motor_cmd
    return [*(m.q for m in motors), *(m.tau + m.kd * m.dq for m in motors)]


# Messages with joints, the first that a bag holds goes before the others, and their usual topics.
STATES: dict[str, tuple[Callable[[Any, Sequence[str] | None], Joints], str]] = {
    "sensor_msgs/msg/JointState": (_joint_state, "/joint_states"),
    "control_msgs/msg/JointTrajectoryControllerState": (_controller_state, ""),
    "control_msgs/msg/DynamicJointState": (_dynamic_state, "/dynamic_joint_states"),
    "unitree_go/msg/LowState": (partial(_motors, known=_LEGS), "/lowstate"),
    "unitree_hg/msg/LowState": (_motors, "/lowstate"),
}
# Messages with the commands to these motors, by those of their states.
COMMANDS = {kind: kind.replace("State", "Cmd") for kind in STATES if kind.startswith("unitree")}

_POINT, _POINTS = "trajectory_msgs/JointTrajectoryPoint", "reference feedback error output"
_MULTI = "trajectory_msgs/MultiDOFJointTrajectoryPoint"
_HEAD = "uint8[2] head; uint8 level_flag; uint8 frame_reserve; uint32[2] sn; uint32[2] version; "
_MOTOR_CMD = "uint8 mode; float32 q; float32 dq; float32 tau; float32 kp; float32 kd; uint32"
_IMU = "float32[4] quaternion; float32[3] gyroscope; float32[3] accelerometer; float32[3] rpy; "
# A bag may lack the definitions of its messages; then these are taken.
_DEFINITIONS = {
    "control_msgs/msg/JointTrajectoryControllerState": "; ".join(
        [
            "std_msgs/Header header; string[] joint_names",
            *(f"{_POINT} {name}" for name in f"{_POINTS} desired actual".split()),
            "string[] multi_dof_joint_names",
            *(f"{_MULTI} multi_dof_{name}" for name in f"{_POINTS} desired actual".split()),
        ]
    ),
    "control_msgs/msg/InterfaceValue": "string[] interface_names; float64[] values",
    "control_msgs/msg/DynamicJointState": "std_msgs/Header header; string[] joint_names; "
    "InterfaceValue[] interface_values",
    "unitree_go/msg/IMUState": _IMU + "int8 temperature",
    "unitree_go/msg/MotorState": "uint8 mode; float32 q; float32 dq; float32 ddq; float32 tau_est; "
    "float32 q_raw; float32 dq_raw; float32 ddq_raw; int8 temperature; uint32 lost; "
    "uint32[2] reserve",
    "unitree_go/msg/BmsState": "uint8 version_high; uint8 version_low; uint8 status; uint8 soc; "
    "int32 current; uint16 cycle; int8[2] bq_ntc; int8[2] mcu_ntc; uint16[15] cell_vol",
    "unitree_go/msg/LowState": _HEAD + "uint16 bandwidth; IMUState imu_state; "
    "MotorState[20] motor_state; BmsState bms_state; int16[4] foot_force; "
    "int16[4] foot_force_est; uint32 tick; uint8[40] wireless_remote; uint8 bit_flag; "
    "float32 adc_reel; int8 temperature_ntc1; int8 temperature_ntc2; float32 power_v; "
    "float32 power_a; uint16[4] fan_frequency; uint32 reserve; uint32 crc",
    "unitree_go/msg/MotorCmd": _MOTOR_CMD + "[3] reserve",
    "unitree_go/msg/BmsCmd": "uint8 off; uint8[3] reserve",
    "unitree_go/msg/LowCmd": _HEAD + "uint16 bandwidth; MotorCmd[20] motor_cmd; BmsCmd bms_cmd; "
    "uint8[40] wireless_remote; uint8[12] led; uint8[2] fan; uint8 gpio; uint32 reserve; "
    "uint32 crc",
    "unitree_hg/msg/IMUState": _IMU + "int16 temperature",
    "unitree_hg/msg/MotorState": "uint8 mode; float32 q; float32 dq; float32 ddq; float32 tau_est; "
    "int16[2] temperature; float32 vol; uint32[2] sensor; uint32 motorstate; uint32[4] reserve",
    "unitree_hg/msg/LowState": "uint32[2] version; uint8 mode_pr; uint8 mode_machine; uint32 tick; "
    "IMUState imu_state; MotorState[35] motor_state; uint8[40] wireless_remote; "
    "uint32[4] reserve; uint32 crc",
    "unitree_hg/msg/MotorCmd": _MOTOR_CMD + " reserve",
    "unitree_hg/msg/LowCmd": "uint8 mode_pr; uint8 mode_machine; MotorCmd[35] motor_cmd; "
    "uint32[4] reserve; uint32 crc",
}


def register(typesys: Any, store: Any) -> None:
    """Add the definitions of these messages to a store of `rosbags`."""
    for name, fields in _DEFINITIONS.items():
        store.register(typesys.get_types_from_msg(fields.replace("; ", "\n"), name))
