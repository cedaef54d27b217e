"""What was asked of the parameters: consistency, bounds and prior, as plain values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from sdpid._common.tables import plain
from sdpid.assurance.recipe.stated_conditions import (
    can_be_stated,
    conditions_from_list,
    conditions_to_list,
    explicit,
)
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import Problem
from sdpid.robot.inertia import CONSISTENCIES, Consistency

_NUMBERS = tuple(each.name for each in fields(Constraints) if each.name != "others")
_PRIOR = tuple(each.name for each in fields(Prior))
# Recipes of runs before there were mirrored links in a prior, and a bound on friction, lack these.
_NEW = {"alike", "within", "friction_max"}


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
        constraints, terms = problem.constraints, problem.prior
        if not can_be_stated(constraints.others):
            return None
        if terms is not None and terms.source is None:
            return None
        prior = None
        if terms is not None and (source := terms.source) is not None:
            prior = Prior(
                strength=terms.strength,
                kind=source.kind,
                friction=source.friction,
                bodies=problem.robot.prior if source.bodies is None else source.bodies,
                alike=source.alike,
                within=source.within,
            )
        others = tuple(explicit(each, problem.robot) for each in constraints.others)
        constraints = constraints.replace(others=others)
        return cls(consistency=problem.consistency, constraints=constraints, prior=prior)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        prior, numbers = self.prior, self.constraints
        stated = None
        if prior is not None:
            stated = {name: plain(getattr(prior, name)) for name in _PRIOR if name != "alike"}
            stated["alike"] = conditions_to_list(prior.alike)
        return {
            "consistency": self.consistency,
            "constraints": {
                **{name: plain(getattr(numbers, name)) for name in _NUMBERS},
                "others": conditions_to_list(numbers.others),
            },
            "prior": stated,
        }

    @classmethod
    def from_dict(cls, given: Mapping[str, Any]) -> StatedProblem:
        """Return what `to_dict` wrote; ValueError, TypeError or SdpidError where it is none."""
        consistency, numbers, prior = (
            given[name] for name in ("consistency", "constraints", "prior")
        )
        if consistency not in CONSISTENCIES:
            raise ValueError(f"consistency is {consistency!r:.80}")
        others = conditions_from_list(numbers.get("others", ()))
        numbers = {name: value for name, value in numbers.items() if name != "others"}
        if not set(_NUMBERS) - _NEW <= numbers.keys() <= set(_NUMBERS) or not all(
            type(value) in (int, float, bool) for value in numbers.values()
        ):
            raise ValueError(f"constraints are {numbers!r:.200}")
        if prior is not None:
            if not set(_PRIOR) - _NEW <= prior.keys() <= set(_PRIOR):
                raise ValueError(f"prior has the keys {', '.join(map(str, prior))[:200]}")
            prior = {**prior, "alike": conditions_from_list(prior.get("alike", ()))}
        return cls(
            consistency=consistency,
            constraints=Constraints(**numbers, others=others),
            prior=None if prior is None else Prior(**prior),
        )
