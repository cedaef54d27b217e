"""Messages of ROS that have joints in them: what of each message is which quantity.

A bag may lack the definitions of its messages; then those here are taken.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from typing import Any

from sdpid.experiment.readers.names import OF_MESSAGES

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
