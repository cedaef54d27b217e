"""`JointLimits`: the limits that hold for the joints of one robot, and the shortest motions."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.tables import Table

# Where a limit comes from.
GIVEN, DESCRIBED, ASSUMED, NONE = "given", "description", "assumed", "none"

# Kinds of limits of each joint.
KINDS = ("lower", "upper", "velocity", "acceleration", "jerk", "torque")

# A motion is worth its while when every joint can travel this part of its range and back.
_WORTHWHILE = 0.1

# Units of turning and of sliding joints.
UNITS = {
    "position": ("rad", "m"),
    "lower": ("rad", "m"),
    "upper": ("rad", "m"),
    "velocity": ("rad/s", "m/s"),
    "acceleration": ("rad/s²", "m/s²"),
    "jerk": ("rad/s³", "m/s³"),
    "torque": ("N·m", "N"),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class JointLimits:
    """Limits of every joint of a robot, from `Limits.of`; infinite where there is none.

    Attributes
    ----------
    joint_names : tuple of str
        The n joints.
    sliding : tuple of bool
        Which of them slide.
    rest : ndarray, shape (n,)
        Position at rest, rad (m of sliding joints); within the limits.
    lower, upper : ndarray, shape (n,)
        Least and largest position, rad (m).
    velocity, acceleration, jerk : ndarray, shape (n,)
        Largest sizes, rad/s, rad/s² and rad/s³ (m).
    torque : ndarray, shape (n,)
        Largest sizes, N·m (N).
    tool_speed : float or None
        Largest speed of the tool, m/s.
    tool : str or None
        Frame whose speed that is; None for the outermost point of every last link.
    clearance : float or None
        Least distance between parts that must not touch, m.
    sources : dict of str to tuple of str
        Of each kind of limit, joint by joint, ``"given"``, ``"description"``, ``"assumed"`` or
        ``"none"``.
    assumed : tuple of str
        What was assumed or left out, one sentence each.
    """

    joint_names: tuple[str, ...]
    sliding: tuple[bool, ...]
    rest: Array
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    torque: Array
    tool_speed: float | None = None
    tool: str | None = None
    clearance: float | None = None
    sources: dict[str, tuple[str, ...]]
    assumed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, each.name, frozen(value))

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    def table(self) -> Table:
        """Return one row a joint; a dash where there is no limit."""
        columns: dict[str, Any] = {"joint": self.joint_names}
        return Table.of_columns(columns | {kind: getattr(self, kind).tolist() for kind in KINDS})

    def shortest_duration(self, part: float = _WORTHWHILE) -> Array:
        """Return the least time (n,) in s to travel a part of the range and back, rest to rest.

        By motions of bounded speed, acceleration and jerk, each as fast as its limits allow. A
        plan that is shorter cannot excite that joint.

        Parameters
        ----------
        part : float, optional
            Part of the range from the lower to the upper limit; by default a tenth.
        """
        distance = part * (self.upper - self.lower)
        limits = zip(distance, self.velocity, self.acceleration, self.jerk, strict=True)
        return np.array([2.0 * rest_to_rest(*map(float, joint)) for joint in limits])


def rest_to_rest(distance: float, velocity: float, acceleration: float, jerk: float) -> float:
    """Return the least time from rest to rest over a distance, under three limits, s.

    The fastest motion raises the acceleration at the full jerk, holds it, lowers it, holds the
    speed, and does the same backwards. Infinite limits are none.
    """
    # Each of the four ramps of the acceleration ends where the acceleration, the speed or half of
    # the way is reached.
    to_full = 0.0 if math.isinf(jerk) else acceleration / jerk
    ramp = min(to_full, math.sqrt(velocity / jerk), math.pow(0.5 * distance / jerk, 1.0 / 3.0))
    if math.isinf(jerk):
        ramp = 0.0
    if ramp < to_full:
        rise, top = ramp, jerk * ramp**2
    elif math.isinf(acceleration):
        rise, top = 0.0, velocity
    else:
        # Time from the first ramp's start to the second's, during which the speed rises.
        rise = 0.5 * (math.sqrt(ramp**2 + 4.0 * distance / acceleration) - ramp)
        rise = min(rise, velocity / acceleration)
        top = acceleration * rise
    cruise = distance / top - (rise + ramp) if top > 0.0 else 0.0
    return 2.0 * (rise + ramp) + max(cruise, 0.0)


def unit_of(kind: str, sliding: object) -> str:
    """Return the unit of a limit of a turning or a sliding joint."""
    return UNITS[kind][bool(sliding)]
