"""Units of logs: how they are spelled, and their factors to SI."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

_DEGREE = np.pi / 180.0
# Factors to SI. Amperes stay amperes: `effort_scale`, or constants of motors, give torques.
_CURRENTS = {"A": 1.0, "mA": 1e-3}
UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "position": {"rad": 1.0, "deg": _DEGREE, "turn": 2.0 * np.pi, "m": 1.0, "mm": 1e-3},
    "velocity": {
        **{"rad/s": 1.0, "deg/s": _DEGREE, "rpm": 2.0 * np.pi / 60.0},
        **{"m/s": 1.0, "mm/s": 1e-3},
    },
    "effort": {
        **{"N.m": 1.0, "Nm": 1.0, "N·m": 1.0, "mN.m": 1e-3, "mNm": 1e-3, "N": 1.0},
        **_CURRENTS,
    },
}
UNITS["reference"] = UNITS["position"]
# Other spellings, in small letters.
_SPELLINGS = {unit.lower(): unit for known in UNITS.values() for unit in known}
_SPELLINGS |= {"sec": "s", "seconds": "s", "µs": "us", "μs": "us", "msec": "ms", "usec": "us"}
_SPELLINGS |= {"°": "deg", "degree": "deg", "degrees": "deg", "radians": "rad", "rev": "turn"}
_SPELLINGS |= {"°/s": "deg/s", "deg/sec": "deg/s", "rad/sec": "rad/s", "1/min": "rpm"}
_SPELLINGS |= {"n*m": "N.m", "n m": "N.m", "mn*m": "mN.m", "amp": "A", "ampere": "A"}
_GRAVITY = 9.80665
UNITS |= {
    "base_orientation": {"1": 1.0},
    "base_position": {"m": 1.0, "mm": 1e-3},
    "base_linear_velocity": {"m/s": 1.0, "mm/s": 1e-3},
    "base_angular_velocity": {"rad/s": 1.0, "deg/s": _DEGREE},
    "gyroscope": {"rad/s": 1.0, "deg/s": _DEGREE},
    "accelerometer": {"m/s²": 1.0, "m/s^2": 1.0, "m/s2": 1.0, "g": _GRAVITY, "mg": 1e-3 * _GRAVITY},
    "contact": {"1": 1.0},
    "contact_force": {"N": 1.0, "kN": 1e3},
    "contact_wrench": {"N": 1.0},
}
_SPELLINGS |= {unit: unit for unit in ("m/s²", "m/s^2", "m/s2", "g", "mg")} | {"kn": "kN"}
_BRACKETED = re.compile(r"(.*?)\s*[\[({]\s*([^\[\](){}]+?)\s*[\])}]\s*")


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
