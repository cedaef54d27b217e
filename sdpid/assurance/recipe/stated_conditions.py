"""Conditions on parameters as plain values, and back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sdpid._common.tables import plain
from sdpid.estimation.constraints import equalities, mass, pairs
from sdpid.estimation.constraints.condition import Condition
from sdpid.robot.model.geometry import collision_points
from sdpid.robot.model.model import RobotModel

# A box without an end has null there.
_NO_END = {"lower": -np.inf, "upper": np.inf}

_KINDS: dict[str, type[Condition]] = {
    name: kind
    for module in (equalities, mass, pairs)
    for name, kind in vars(module).items()
    if isinstance(kind, type) and issubclass(kind, Condition) and kind.__module__ == module.__name__
    if not name.startswith("_")
}


def explicit(condition: Condition, robot: RobotModel) -> Condition:
    """Return a condition that holds the points that it reads from the robot's meshes."""
    if not isinstance(condition, mass.CenterOfMassInHull) or condition.points is not None:
        return condition
    points = collision_points(robot, condition.link, package_dirs=condition.package_dirs)
    return replace(condition, points=points, package_dirs=())


def can_be_stated(conditions: Iterable[Condition]) -> bool:
    """Return whether all conditions are of a kind that plain values say whole."""
    return all(_KINDS.get(type(each).__name__) is type(each) for each in conditions)


def conditions_to_list(conditions: Iterable[Condition]) -> list[dict[str, Any]]:
    """Return plain values for JSON."""
    return [{"condition": type(each).__name__, **plain(each)} for each in conditions]


def conditions_from_list(given: Any) -> tuple[Condition, ...]:
    """Return what `conditions_to_list` wrote.

    Raises
    ------
    ValueError, TypeError, SdpidError
        Where it is none.
    """
    if not isinstance(given, Sequence) or isinstance(given, str):
        raise TypeError(f"conditions are {given!r:.80}")
    found = []
    for each in given:
        if not isinstance(each, Mapping) or each.get("condition") not in _KINDS:
            raise ValueError(f"no condition is {each!r:.200}")
        values = {k: v for k, v in each.items() if k != "condition"}
        if each["condition"] == mass.CenterOfMassInBox.__name__:
            for end, far in _NO_END.items():
                values[end] = [far if x is None else x for x in values[end]]
        found.append(_KINDS[each["condition"]](**values))
    return tuple(found)


def in_words(conditions: Sequence[Condition]) -> str:
    """Return how many there are of each kind."""
    names = [type(each).__name__ for each in conditions]
    return ", ".join(f"{names.count(name)} {name}" for name in dict.fromkeys(names))
