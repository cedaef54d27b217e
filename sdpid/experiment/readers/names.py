"""The quantities of logs: their usual names, parts and units, one row each.

A column is called by a quantity, the joint or foot that it is of, a part and a unit:
``position_elbow [deg]``, ``joint_2_velocity``, ``base_position_x``, ``contact_force_left_z``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

_DEGREE = np.pi / 180.0
_GRAVITY = 9.80665
# Amperes stay amperes: `effort_scale`, or constants of motors, give torques.
_CURRENTS = {"A": 1.0, "mA": 1e-3}
_ANGLES = {"rad": 1.0, "deg": _DEGREE, "turn": 2.0 * np.pi, "m": 1.0, "mm": 1e-3}
_TURNING = {"rad/s": 1.0, "deg/s": _DEGREE}
_XYZ = ("x", "y", "z")
_POSITIONS = "q position positions pos joint_position joint_positions angle dof_pos"
# Words of positions that are commanded, and not what the robot did.
_COMMANDS = "reference ref desired des commanded command cmd target setpoint"
_IN_ANGLES = {"deg": "deg", "rad": "rad"}


@dataclass(frozen=True)
class Quantity:
    """What a quantity is called in logs.

    Attributes
    ----------
    names : tuple of str
        In the order in which they are looked for.
    units : mapping
        Factors to SI.
    parts : tuple of str
        The parts of a sample of a base, of contacts those of each.
    endings : mapping
        Units by how they are spelled at the end of names, as in ``time_ms`` or ``position_deg_1``;
        by "" the one of names without.
    bare : tuple of str
        Names of columns of joints that tell the quantity by their unit only: ``Joint 1 [deg]``.
    """

    names: tuple[str, ...]
    units: Mapping[str, float] = field(default_factory=dict)
    parts: tuple[str, ...] = ()
    endings: Mapping[str, str] = field(default_factory=dict)
    bare: tuple[str, ...] = ("joint", "axis", "j", "a")


def _q(names: str, units: Mapping[str, float], *parts: str, **endings: str) -> Quantity:
    """Return a quantity by its names, units, parts, and units at the end of names."""
    return Quantity(tuple(names.split()), units, parts, endings)


QUANTITIES: dict[str, Quantity] = {
    "time": _q(
        "time t timestamp time_s stamp times __time elapsed_time",
        {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
        **{"ms": "ms", "us": "us", "ns": "ns", "sec": "s"},
    ),
    "position": _q(
        "position q positions pos joint_position joint_positions actual_q actual_position "
        "measured_position position_measured q_measured angle dof_pos",
        _ANGLES,
        **_IN_ANGLES,
    ),
    "effort": _q(
        "effort tau torque efforts torques joint_effort joint_torque joint_torques tau_j "
        "tau_measured actual_torque measured_torque torque_measured eff trq",
        {"N.m": 1.0, "Nm": 1.0, "N·m": 1.0, "mN.m": 1e-3, "mNm": 1e-3, "N": 1.0, **_CURRENTS},
        **{"nm": "N.m", "mnm": "mN.m"},
    ),
    "velocity": _q(
        "velocity dq qd velocities vel qdot joint_velocity joint_velocities actual_qd "
        "actual_velocity measured_velocity velocity_measured dq_measured qd_measured speed dof_vel",
        {**_TURNING, "rpm": 2.0 * np.pi / 60.0, "m/s": 1.0, "mm/s": 1e-3},
        **{"deg_s": "deg/s", "rad_s": "rad/s", "degs": "deg/s", "rads": "rad/s", "rpm": "rpm"},
    ),
    # What is commanded may be a velocity or a torque as well: the name must say position.
    "reference": Quantity(
        (
            *(f"{name}_{word}" for name in _POSITIONS.split() for word in _COMMANDS.split()),
            *(f"{word}_{name}" for name in _POSITIONS.split() for word in _COMMANDS.split()),
            *("q_d", "reference", "commanded"),
        ),
        _ANGLES,
        endings=_IN_ANGLES,
        bare=("desired", "commanded", "command", "cmd", "target", "setpoint"),
    ),
    # Efforts that are added to those of a law; what was measured is called otherwise.
    "feedforward": _q(
        "feedforward effort_feedforward tau_feedforward torque_feedforward effort_ff tau_ff "
        "torque_ff feedforward_effort feedforward_torque",
        {"N.m": 1.0, "Nm": 1.0, "N·m": 1.0, "mN.m": 1e-3, "mNm": 1e-3, "N": 1.0},
        **{"nm": "N.m", "mnm": "mN.m"},
    ),
    "link_position": _q(
        "link_position link_positions link_q q_link link_angle load_position q_load "
        "secondary_position position_secondary q_secondary secondary_q link_encoder",
        _ANGLES,
        **_IN_ANGLES,
    ),
    "joint_names": _q("joint_names names", {}),
    "rate": _q("fs rate_hz rate sample_rate", {}),
    "period": _q("period", {}),
    "start": _q("start", {}),
    "periods": _q("periods", {}),
    "effort_scale": _q("effort_scale", {}),
    "base_orientation": _q("base_orientation base_quaternion base_quat", {"1": 1.0}, *_XYZ, "w"),
    "base_position": _q("base_position base_pos", {"m": 1.0, "mm": 1e-3}, *_XYZ),
    "base_linear_velocity": _q(
        "base_linear_velocity base_lin_vel base_velocity", {"m/s": 1.0, "mm/s": 1e-3}, *_XYZ
    ),
    "base_angular_velocity": _q("base_angular_velocity base_ang_vel", _TURNING, *_XYZ),
    "gyroscope": _q("gyroscope gyro imu_gyroscope imu_gyro imu_angular_velocity", _TURNING, *_XYZ),
    "accelerometer": _q(
        "accelerometer accel imu_accelerometer imu_accel imu_acceleration imu_linear_acceleration",
        {"m/s²": 1.0, "m/s^2": 1.0, "m/s2": 1.0, "g": _GRAVITY, "mg": 1e-3 * _GRAVITY},
        *_XYZ,
    ),
    "contact": _q("contact contacts contact_state foot_contact foot_contacts", {"1": 1.0}),
    "contact_force": _q(
        "contact_force contact_forces foot_force foot_forces", {"N": 1.0, "kN": 1e3}, *_XYZ
    ),
    "contact_wrench": _q(
        "contact_wrench contact_wrenches", {"N": 1.0}, "fx", "fy", "fz", "mx", "my", "mz"
    ),
}
# Efforts that are currents, where those can be scaled.
CURRENT = _q(
    "current actual_current motor_current currents curr cur i", {}, **{"": "A", "ma": "mA"}
)
UNITS = {name: row.units for name, row in QUANTITIES.items() if row.units}
# Of a floating base and its contacts, the orientation first.
FLOATING = tuple(QUANTITIES)[list(QUANTITIES).index("base_orientation") :]
# What is one array, by itself.
SINGLE = ("time", *(name for name in QUANTITIES if name not in UNITS))
# Other spellings of units, in small letters.
_SPELLINGS = {unit.lower(): unit for known in UNITS.values() for unit in known if unit != "1"}
_SPELLINGS |= {"sec": "s", "seconds": "s", "µs": "us", "μs": "us", "msec": "ms", "usec": "us"}
_SPELLINGS |= {"°": "deg", "degree": "deg", "degrees": "deg", "radians": "rad", "rev": "turn"}
_SPELLINGS |= {"°/s": "deg/s", "deg/sec": "deg/s", "rad/sec": "rad/s", "1/min": "rpm"}
_SPELLINGS |= {"n*m": "N.m", "n m": "N.m", "mn*m": "mN.m", "amp": "A", "ampere": "A"}
# Columns of messages of robots, named by where a number stands in its message: of motors that have
# numbers, and of the points of a controller of trajectories.
_OF_MESSAGE = re.compile(
    r"(?:.*[/.])?(?:(?P<motor>motor_state|motor_cmd)[\[/._]*(?P<of>\d+)[\]/._]+(?P<part>\w+)"
    r"|(?P<point>reference|desired|feedback|actual|error|output)[/.]"
    r"(?P<field>positions|velocities|accelerations|effort)[\[/._]*(?P<at>\d+)\]?)"
)
# Quantities by the part of a message and the field; of several the first that is filled.
OF_MESSAGES = {
    ("motor_state", "q"): "position",
    ("motor_state", "dq"): "velocity",
    ("motor_state", "tau_est"): "effort",
    ("motor_cmd", "q"): "reference",
    ("motor_cmd", "tau"): "feedforward",
    **{(point, "positions"): "position" for point in ("feedback", "actual")},
    **{(point, "velocities"): "velocity" for point in ("feedback", "actual")},
    **{(point, "effort"): "effort" for point in ("feedback", "actual", "output")},
    **{(point, "positions"): "reference" for point in ("reference", "desired")},
}
_BRACKETED = re.compile(r"(.*?)\s*[\[({]\s*([^\[\](){}]+?)\s*[\])}]\s*")


def of_message(name: str) -> str | None:
    """Return the plain name of a number in a message, "" of one that is no quantity.

    None where a name is of no such message.
    """
    match = _OF_MESSAGE.fullmatch(name)
    if match is None:
        return None
    where = match["motor"] or match["point"], match["part"] or match["field"]
    quantity = OF_MESSAGES.get(where)
    return "" if quantity is None else f"{quantity}_{match['of'] or match['at']}"


def unit_of(text: str) -> str | None:
    """Return the unit that a text spells, None where it is none."""
    return _SPELLINGS.get(text.strip().lower())


def split_unit(name: str) -> tuple[str, str | None]:
    """Split ``Joint 1 [deg]`` into the name and the unit; None where no unit stands there."""
    match = _BRACKETED.fullmatch(name)
    unit = None if match is None else unit_of(match[2])
    return (name, None) if match is None or unit is None else (match[1], unit)


def is_current(unit: str | Sequence[str] | None) -> bool:
    """Tell whether a unit, or one of several, is of currents."""
    return any(one in _CURRENTS for one in ([unit] if isinstance(unit, str) else unit or ()))
