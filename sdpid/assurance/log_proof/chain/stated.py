"""Compare what a certificate asks of parameters with what the recipe says was asked."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.plain_conditions import plain_conditions
from sdpid.assurance.log_proof.chain.links import Link
from sdpid.assurance.log_proof.chain.sealed import Sealed
from sdpid.assurance.log_proof.stated_conditions import in_words
from sdpid.assurance.log_proof.stated_problem import StatedProblem
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.constraints.condition import Layout
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.constraints.feasible_set import FeasibleSet
from sdpid.estimation.prior.alike import described_pairs
from sdpid.estimation.prior.cost_terms import SquaredTerm
from sdpid.estimation.prior.friction import with_friction_max
from sdpid.estimation.prior.log_det import LogDetTerm
from sdpid.estimation.prior.prior import prior_terms
from sdpid.verifier.reading import shown

NAME = "problem"

# Numbers of a prior come from factorizations, and from sums over the rows, which another processor
# may round otherwise.
_ROUNDED = 1e-9


def stated_problem(sealed: Sealed, source: RowSource) -> Link:
    """Return whether bounds, margin, rows, cones and prior are those that the recipe states."""
    stated, given = sealed.recipe.problem, sealed.data["problem"]
    if stated is None:
        text = (
            "the recipe does not state what was asked of the parameters, so that bounds, margin, "
            "rows, cones and prior may be any: conditions of a class of your own stand in no file"
        )
        return Link(NAME, "not proven", text)
    if wrong := list(_differences(stated, given, source)):
        return Link(NAME, "not proven", "; ".join(wrong))
    text = f"bounds, margin and prior are those of {_in_words(sealed, stated, source)}"
    return Link(NAME, "proven", text)


def feasible_set(stated: StatedProblem, source: RowSource) -> FeasibleSet:
    """Return the parameters that the recipe allows."""
    layout = Layout(source.robot, source.friction)
    return FeasibleSet.build(stated.constraints, stated.consistency, layout)


def _differences(
    stated: StatedProblem, given: Mapping[str, Any], source: RowSource
) -> Iterator[str]:
    """Yield what of the certificate's problem is not as stated."""
    feasible = feasible_set(stated, source)
    if given["consistency"] != stated.consistency:
        yield f"the consistency is {given['consistency']}, stated is {stated.consistency}"
    if given["margin"] != stated.constraints.margin:
        yield f"the margin is {given['margin']!r}, stated is {stated.constraints.margin!r}"
    for end in ("lower", "upper"):
        bounds = zip(source.base.theta_names, given[end], getattr(feasible, end), strict=True)
        others = [each for each in bounds if each[1] != each[2]]
        for name, found, wanted in others[:1]:
            more = f" (and {len(others) - 1} more)" if len(others) > 1 else ""
            yield f"the {end} bound of {shown(name)} is {found!r}, stated is {wanted!r}{more}"
    yield from _differences_of_conditions(feasible, given)
    yield from _differences_of_prior(stated, given, source)


def _differences_of_conditions(feasible: FeasibleSet, given: Mapping[str, Any]) -> Iterator[str]:
    """Yield what of the certificate's rows and cones is not as stated."""
    for kind, wanted in plain_conditions(feasible).items():
        found = given[kind]
        if len(found) != len(wanted):
            yield f"it has {len(found)} {kind}, stated are {len(wanted)}"
            continue
        pairs = zip(found, wanted, strict=True)
        other = [str(one["name"]) for one, two in pairs if not _as(one, two)]
        if other:
            more = f" (and {len(other) - 1} more)" if len(other) > 1 else ""
            yield f"of its {kind} {shown(other[0])} is not as stated{more}"


def _as(found: Mapping[str, Any], wanted: Mapping[str, Any]) -> bool:
    """Return whether a row or a cone is as stated, its coefficients but for rounding."""
    return all(
        _alike(np.array(found[key], dtype=np.float64), np.array(value))
        if isinstance(value, list)
        else found[key] == value
        for key, value in wanted.items()
    )


def _differences_of_prior(
    stated: StatedProblem, given: Mapping[str, Any], source: RowSource
) -> Iterator[str]:
    """Yield what of the certificate's prior is not as stated."""
    made = None if stated.prior is None else prior_terms(stated.prior, source)
    terms, alike = ((), ()) if made is None else (made.terms, made.alike)
    found = given.get("alike", [])
    pairs = zip(found, (each.to_dict() for each in alike), strict=False)
    if len(found) != len(alike) or not all(_as(one, two) for one, two in pairs):
        yield "links that are believed to be alike are not those that are stated"
    squared = [term for term in terms if isinstance(term, SquaredTerm)]
    log_det = [term for term in terms if isinstance(term, LogDetTerm)]
    rows = sum(len(term.rhs) for term in squared)
    if len(given["prior_rhs"]) != rows:
        yield f"the prior has {len(given['prior_rhs'])} rows, stated are {rows}"
    elif squared:
        for key, wanted in (("prior_matrix", squared[0].matrix), ("prior_rhs", squared[0].rhs)):
            if not _alike(np.array(given[key], dtype=np.float64), wanted):
                yield f"{key} holds other numbers than stated"
    entropic = given["entropic_prior"]
    if (entropic is None) == bool(log_det):
        yield "a log-det prior is stated or given, and not both"
    elif log_det:
        found = np.array(entropic["inverses"], dtype=np.float64)
        same = entropic["links"] == log_det[0].links.tolist()
        same = same and _alike(np.array(entropic["strength"]), np.array(log_det[0].strength))
        if not (same and _alike(found, log_det[0].inverses)):
            yield "the log-det prior is another than stated"


def _alike(found: Array, wanted: Array) -> bool:
    """Return whether arrays are the same but for rounding."""
    if found.shape != wanted.shape:
        return False
    size = float(np.abs(wanted).max(initial=0.0))
    return bool(np.abs(found - wanted).max(initial=0.0) <= _ROUNDED * size)


def _in_words(sealed: Sealed, stated: StatedProblem, source: RowSource) -> str:
    """Return what is asked, and whether it is what `sdpid identify` asks of this robot."""
    robot, constraints, prior = source.robot, stated.constraints, stated.prior
    entry, own = sealed.robot, robot.source
    described = entry is not None and own is not None and own.sha256 == entry["sha256"]
    numbers = (
        f"{stated.consistency}, margin {constraints.margin!r} kg.m2, masses from "
        f"{constraints.mass_min!r} to {constraints.mass_max!r} kg, parameters to "
        f"{constraints.theta_max!r}, of friction to {constraints.friction_max!r}"
    )
    if not constraints.friction_nonnegative:
        numbers += ", friction may be negative"
    default = with_friction_max(Constraints.of_size(robot), source)
    usual = described and constraints.replace(others=()) == default
    said = f"the recipe ({numbers}{', the defaults for this robot' if usual else ''}"
    if constraints.others:
        said += f"; conditions: {in_words(constraints.others)}"
    if prior is None:
        return said + "; no prior)"
    same = described and prior.bodies is not None and np.array_equal(prior.bodies, robot.prior)
    towards = "the description's bodies" if same else "bodies that the recipe states"
    said = f"{said}; prior {prior.kind} of {prior.strength!r} nats towards {towards}"
    if prior.alike:
        said += f"; {described_pairs(prior.alike, prior.within)}"
    return said + ")"
