"""What was asked of the parameters: consistency, bounds, conditions and prior, as plain values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from sdpid._common.tables import plain
from sdpid.estimation.constraints import equalities, mass, pairs
from sdpid.estimation.constraints.condition import Condition
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import Problem
from sdpid.robot.inertia import CONSISTENCIES, Consistency
from sdpid.robot.model.geometry import collision_points

# Recipes of runs before there were mirrored links in a prior, and a bound on friction, lack these.
_NEW = {"alike", "within", "friction_max"}

# A box without an end has null there.
_NO_END = {"lower": -np.inf, "upper": np.inf}

# Conditions that plain values say whole. Where a kind is defined is asked first: to Python 3.10
# aliases such as tuple[str, ...] are types, and no classes.
_KINDS: dict[str, type[Condition]] = {
    name: kind
    for module in (equalities, mass, pairs)
    for name, kind in vars(module).items()
    if isinstance(kind, type) and kind.__module__ == module.__name__ and issubclass(kind, Condition)
    if not name.startswith("_")
}


@dataclass(frozen=True, kw_only=True)
class StatedProblem:
    """The part of a problem that comes from no log.

    Attributes
    ----------
    consistency : str
        What every link must have.
    constraints : Constraints
        Margin, bounds and conditions.
    prior : Prior or None
        Its bodies and its strength as numbers.
    """

    consistency: Consistency
    constraints: Constraints
    prior: Prior | None

    @classmethod
    def of(cls, problem: Problem) -> StatedProblem | None:
        """Return what was asked; None where conditions or a prior are not plain values."""
        constraints, terms, robot = problem.constraints, problem.prior, problem.robot
        if any(_KINDS.get(type(each).__name__) is not type(each) for each in constraints.others):
            return None
        prior = None
        if terms is not None:
            if (source := terms.source) is None:
                return None
            bodies = robot.prior if source.bodies is None else source.bodies
            prior = replace(source, strength=terms.strength, bodies=bodies)
        others = []
        for each in constraints.others:
            if isinstance(each, mass.CenterOfMassInHull) and each.points is None:
                # The points are those of the robot's meshes.
                points = collision_points(robot, each.link, package_dirs=each.package_dirs)
                each = replace(each, points=points, package_dirs=())
            others.append(each)
        constraints = constraints.replace(others=tuple(others))
        return cls(consistency=problem.consistency, constraints=constraints, prior=prior)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        prior, others = self.prior, _listed(self.constraints.others)
        return {
            "consistency": self.consistency,
            "constraints": {**plain(self.constraints), "others": others},
            "prior": None if prior is None else {**plain(prior), "alike": _listed(prior.alike)},
        }

    @classmethod
    def from_dict(cls, given: Mapping[str, Any]) -> StatedProblem:
        """Return what `to_dict` wrote; ValueError, TypeError or SdpidError where it is none."""
        consistency, constraints, prior = (
            given[name] for name in ("consistency", "constraints", "prior")
        )
        if consistency not in CONSISTENCIES:
            raise ValueError(f"consistency is {consistency!r:.80}")
        others = _conditions(constraints.get("others", ()))
        numbers = {name: value for name, value in constraints.items() if name != "others"}
        plain_numbers = all(type(value) in (int, float, bool) for value in numbers.values())
        if not plain_numbers or not _has_fields(Constraints, {*numbers, "others"}):
            raise ValueError(f"constraints are {numbers!r:.200}")
        if prior is not None:
            if not _has_fields(Prior, set(prior)):
                raise ValueError(f"prior has the keys {', '.join(map(str, prior))[:200]}")
            prior = Prior(**{**prior, "alike": _conditions(prior.get("alike", ()))})
        constraints = Constraints(**numbers, others=others)
        return cls(consistency=consistency, constraints=constraints, prior=prior)


def _has_fields(kind: type[Constraints | Prior], names: set[str]) -> bool:
    """Return whether names are those of the fields, but for such as are newer."""
    known = {each.name for each in fields(kind)}
    return known - _NEW <= names <= known


def _listed(conditions: Iterable[Condition]) -> list[dict[str, Any]]:
    """Return conditions as plain values."""
    return [{"condition": type(each).__name__, **plain(each)} for each in conditions]


def _conditions(given: Any) -> tuple[Condition, ...]:
    """Return the conditions that were listed."""
    if not isinstance(given, Sequence) or isinstance(given, str):
        raise TypeError(f"conditions are {given!r:.80}")
    found = []
    for each in given:
        if not isinstance(each, Mapping) or each.get("condition") not in _KINDS:
            raise ValueError(f"no condition is {each!r:.200}")
        values = {**each}
        kind = _KINDS[values.pop("condition")]
        if kind is mass.CenterOfMassInBox:
            for end, far in _NO_END.items():
                values[end] = [far if x is None else x for x in values[end]]
        found.append(kind(**values))
    return tuple(found)


def in_words(conditions: Sequence[Condition]) -> str:
    """Return how many there are of each kind."""
    names = [type(each).__name__ for each in conditions]
    return ", ".join(f"{names.count(name)} {name}" for name in dict.fromkeys(names))
