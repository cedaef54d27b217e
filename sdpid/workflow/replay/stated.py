"""Compare what a certificate asks of parameters with the problem that was made again."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from sdpid.assurance.certificate.certificate import problem_dict
from sdpid.assurance.recipe.stated import StatedProblem, in_words
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.prior.friction import with_friction_max
from sdpid.estimation.prior.prior import described_pairs
from sdpid.estimation.problem import Problem
from sdpid.verifier.reading import shown
from sdpid.workflow.replay.compare import differences
from sdpid.workflow.replay.folder import Sealed

# What is compared as a cost, and by its effect on it.
_COST = ("A", "rhs", "floor", "base_matrix")

# Beliefs that older certificates repeat beside the rows of the prior that say them.
_REPEATED = ("alike",)


def other_demands(given: Mapping[str, Any], problem: Problem) -> Iterator[str]:
    """Yield what of the certificate's problem is not as stated: its cost aside."""
    wanted, names = problem_dict(problem), problem.base.theta_names
    found = {key: value for key, value in given.items() if key not in (*_COST, *_REPEATED)}
    wanted = {key: value for key, value in wanted.items() if key not in _COST}
    for end in ("lower", "upper"):
        named = (
            {
                f"the {end} bound of {shown(name)}": x
                for name, x in zip(names, each[end], strict=True)
            }
            for each in (found, wanted)
        )
        wrong = [
            f"{name} is {x!r}, stated is {y!r}"
            for (name, x), (_, y) in zip(*(each.items() for each in named), strict=True)
            if x != y
        ]
        yield from (f"{each}{_more(wrong)}" for each in wrong[:1])
        del found[end], wanted[end]
    for key in wanted:
        wrong = list(differences({key: found.get(key)}, {key: wanted[key]}))
        yield from (f"{each}{_more(wrong)}" for each in wrong[:1])


def _more(wrong: list[str]) -> str:
    """Return how many differences there are beside the first."""
    return f" (and {len(wrong) - 1} more)" if len(wrong) > 1 else ""


def told(sealed: Sealed, stated: StatedProblem, problem: Problem) -> str:
    """Return what is asked, and what of it is not what `sdpid identify` asks of this robot."""
    robot, constraints, prior = problem.robot, stated.constraints, stated.prior
    entry, own = sealed.robot, robot.source
    described = entry is not None and own is not None and own.sha256 == entry["sha256"]
    numbers = (
        f"{stated.consistency}, margin {constraints.margin!r} kg.m2, masses from "
        f"{constraints.mass_min!r} to {constraints.mass_max!r} kg, parameters to "
        f"{constraints.theta_max!r}, of friction to {constraints.friction_max!r}"
    )
    if not constraints.friction_nonnegative:
        numbers += ", friction may be negative"
    if described:
        default = with_friction_max(Constraints.of_size(robot), problem.require_rows("bounds"))
        others = [
            f"{each.name} {getattr(default, each.name)!r}"
            for each in fields(Constraints)
            if each.name != "others"
            and getattr(constraints, each.name) != getattr(default, each.name)
        ]
        usual = f"; by default {', '.join(others)}" if others else ", the defaults for this robot"
        numbers += usual
    said = f"the recipe ({numbers}"
    if constraints.others:
        said += f"; conditions: {in_words(constraints.others)}"
    if prior is None:
        return said + "; no prior)"
    same = described and prior.bodies is not None and np.array_equal(prior.bodies, robot.prior)
    towards = "the description's bodies" if same else "bodies that the recipe states"
    said = f"{said}; prior {prior.kind} of {prior.strength!r} nats towards {towards}"
    if not prior.friction:
        said += ", none about friction"
    if prior.alike:
        said += f"; {described_pairs(prior.alike, prior.within)}"
    return said + ")"
