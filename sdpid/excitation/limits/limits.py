"""`Limits`: what the user allows the joints and the arm, and how it narrows a description."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import is_number
from sdpid._common.files import load_toml
from sdpid._common.tables import Settings, plain
from sdpid.errors import DataError
from sdpid.excitation.limits.joint_limits import KINDS, OTHERS, JointLimits, Narrowing, Values
from sdpid.robot.model.model import RobotModel


@dataclass(frozen=True, kw_only=True, repr=False)
class Limits(Settings):
    """Limits that narrow those of a robot's description.

    Of what is given here and what the description says the tighter holds. Lengths and angles are
    in SI units: rad, rad/s, rad/s², rad/s³ and N·m of turning joints, m and N of sliding ones.

    Attributes
    ----------
    lower, upper, velocity, acceleration, jerk, torque : float, sequence, mapping or None
        One value for all joints, one a joint (None leaves a joint to the description), or values by
        the joint's name (``"*"`` for all that are not named). Infinity, also as the text
        ``"inf"``, is no limit.
    tool_speed : float or None
        Largest speed of the tool in m/s; None for no limit.
    tool : str or None
        Frame of the description whose speed that is; by default the outermost point of each last
        link that the description names.
    clearance : float or None
        Least distance of parts that must not touch, m.
    share : float or None
        Share of the description's position range, speeds and torques that is used. None leaves it
        to what the limits are for: a motion that is designed keeps to 95 %, since controllers stop
        the arm at their limits, and a motion that is checked may use all.
    override : bool
        Whether values that are given hold in place of the description's where they are wider, too.
        Only for descriptions that are known to be wrong.

    Raises
    ------
    DataError
        When a value is no number, NaN, or negative where a size is meant.

    Examples
    --------
    >>> limits = sdpid.Limits(velocity=1.0, torque={"joint_1": 50.0}, tool_speed=0.25)
    >>> limits.to_dict()
    {'velocity': 1.0, 'torque': {'joint_1': 50.0}, 'tool_speed': 0.25}
    >>> joints = limits.of(robot)
    >>> joints.velocity.round(2)
    array([1., 1., 1., 1., 1., 1.])
    """

    lower: Values = None
    upper: Values = None
    velocity: Values = None
    acceleration: Values = None
    jerk: Values = None
    torque: Values = None
    tool_speed: float | None = None
    tool: str | None = None
    clearance: float | None = None
    share: float | None = None
    override: bool = False

    def __post_init__(self) -> None:
        for kind in KINDS:
            object.__setattr__(self, kind, _each(getattr(self, kind), _number))
            for where, value in _entries(getattr(self, kind)):
                _check_number(kind, where, value)
        for name, least in (("tool_speed", "above 0"), ("clearance", "from 0")):
            value = getattr(self, name)
            if value is not None and not (
                is_number(value) and value >= 0.0 and (value > 0.0 or name == "clearance")
            ):
                raise DataError(f"limits: {name} is {value!r}; give a number {least} (m/s or m).")
        if not (self.tool is None or isinstance(self.tool, str)):
            raise DataError(f"limits: tool is {self.tool!r}; give the name of a frame.")
        if not isinstance(self.override, bool):
            raise DataError(f"limits: override is {self.override!r}; give true or false.")
        if self.share is not None and not (is_number(self.share) and 0.0 < self.share <= 1.0):
            raise DataError(f"limits: share is {self.share!r}; give a number above 0, at most 1.")

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str]) -> Limits:
        """Read a TOML file.

        A table a joint, ``[joint_name]``, or ``[[joint]]`` with its ``name``, holds any of lower,
        upper, velocity, acceleration, jerk and torque. The table ``[arm]`` holds any of
        tool_speed, tool, clearance, share and override, and the same six keys for all joints that
        have no value of their own. Tables named plane, box, mesh, table and wall are left to
        `sdpid.excitation.geometry.obstacles`.

        Raises
        ------
        DataError
            When the file cannot be read, or a key or a value is not understood.
        """
        try:
            return cls.from_table(load_toml(path))
        except DataError as cause:
            text = str(cause)
            raise DataError(text if str(path) in text else f"{path}: {text}") from None

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> Limits:
        """Build from the tables of a TOML file; see `from_toml`.

        Raises
        ------
        DataError
            When a key or a value is not understood.
        """
        values: dict[str, dict[str, float]] = {kind: {} for kind in KINDS}
        arm: dict[str, Any] = {}
        for joint, entries in _tables(table):
            for key, value in entries.items():
                if key in KINDS and joint in values[key]:
                    raise DataError(f"limits: joint '{joint}' has {key} twice; keep one.")
                if key in KINDS:
                    values[key][joint] = value
                elif joint == OTHERS and key in _ARM:
                    arm[key] = value
                else:
                    where = "[arm]" if joint == OTHERS else f"joint '{joint}'"
                    known = (*KINDS, *_ARM) if joint == OTHERS else KINDS
                    raise DataError(
                        f"limits: {where} has '{key}', which is not known; it may have "
                        f"{', '.join(known)}."
                    )
        found: dict[str, Any] = {kind: given or None for kind, given in values.items()}
        return cls(**found, **arm)

    def to_dict(self) -> dict[str, Any]:
        """Return the fields that are given, as JSON and `Limits` take them."""
        return {
            name: plain(_each(value, _text))
            for name, value in vars(self).items()
            if value is not None and value is not False
        }

    def of(
        self,
        robot: RobotModel,
        rest: ArrayLike | None = None,
        *,
        share: float = 1.0,
        assume: bool = True,
    ) -> JointLimits:
        """Return the limits of a robot's joints: the tighter of what is given and described.

        Parameters
        ----------
        robot : RobotModel
            On a fixed base.
        rest : array_like, shape (n,), optional
            Where the motion starts, rad (m); by default zero, or the middle of the range where
            zero is outside or near an end.
        share : float, optional
            Share of the description's limits that is used where `Limits.share` says nothing.
        assume : bool, optional
            Whether missing limits are assumed and the robot must be able to stand at rest, as the
            search for a motion needs; otherwise what is missing is infinite.

        Raises
        ------
        ModelError
            When the base floats.
        DataError
            When the limits contradict each other or the rest position, name joints that the robot
            does not have, look like degrees or mm, or gravity alone needs more torque at rest.
        """
        values = {kind: getattr(self, kind) for kind in KINDS}
        used = share if self.share is None else self.share
        found = Narrowing(robot, values, used, self.override, assume).limits(rest)
        return replace(found, tool_speed=self.tool_speed, tool=self.tool, clearance=self.clearance)


_ARM = tuple(each.name for each in fields(Limits) if each.name not in KINDS)
# Tables of a file of limits that are obstacles.
OBSTACLES = ("plane", "box", "mesh", "table", "wall")


def _each(values: Any, function: Callable[[Any], Any]) -> Any:
    """Return the same with what a function returns of each value."""
    if isinstance(values, Mapping):
        return {name: _each(value, function) for name, value in values.items()}
    if isinstance(values, list | tuple | np.ndarray):
        return tuple(_each(value, function) for value in values)
    return function(values)


def _number(value: Any) -> Any:
    """Return a number in place of the text ``"inf"``, which JSON has for infinity."""
    return {"inf": np.inf, "-inf": -np.inf}.get(value, value) if isinstance(value, str) else value


def _text(value: Any) -> Any:
    """Return a text in place of an infinite number."""
    return str(float(value)) if is_number(value) and np.isinf(value) else value


def _entries(values: Values) -> Iterable[tuple[str, object]]:
    """Yield the values of a field, each with the words for where it is."""
    if isinstance(values, Mapping):
        yield from ((f"joint '{name}'", value) for name, value in values.items())
    elif isinstance(values, tuple):
        yield from ((f"joint {j}", value) for j, value in enumerate(values, 1) if value is not None)
    elif values is not None:
        yield "all joints", values


def _check_number(kind: str, where: str, value: object) -> None:
    """Raise `DataError` unless a value can be a limit of its kind."""
    number = float(value) if is_number(value) else np.nan
    if np.isnan(number):
        raise DataError(f"limits: {kind} of {where} is {value!r}; give a number.")
    if kind not in ("lower", "upper") and number <= 0.0:
        raise DataError(
            f"limits: {kind} of {where} is {value}; give the largest size, a number above 0 "
            "(a joint that must stand still needs a small one)."
        )


def _tables(table: Mapping[str, Any]) -> Iterable[tuple[str, Mapping[str, Any]]]:
    """Yield joints and their entries; `OTHERS` stands for ``[arm]``."""
    for name, entries in table.items():
        if name in OBSTACLES:
            continue
        if name == "joint" and isinstance(entries, list):
            for each in entries:
                if not isinstance(each, Mapping) or not isinstance(each.get("name"), str):
                    raise DataError('limits: a [[joint]] without a name; give name = "...".')
                yield each["name"], {k: v for k, v in each.items() if k != "name"}
        elif isinstance(entries, Mapping):
            yield (OTHERS if name == "arm" else name), entries
        else:
            raise DataError(
                f"limits: '{name}' stands outside of a table; write it under [arm] for all joints, "
                "or under [name_of_the_joint]."
            )
