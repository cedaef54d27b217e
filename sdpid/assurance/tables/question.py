"""The question that a table of base parameters poses, in exact numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from decimal import Decimal
from fractions import Fraction
from itertools import combinations
from typing import Any

import numpy as np

from sdpid.assurance.tables.answers import Number, TableFile, exact
from sdpid.errors import DataError
from sdpid.robot.friction.model import BY_NAME, FrictionModel
from sdpid.robot.friction.posed import PosedTerm
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.friction.terms import Coupling
from sdpid.robot.inertia import Consistency
from sdpid.robot.model.base_parameters import BaseParameters, structural_base
from sdpid.robot.model.model import RobotModel
from sdpid.verifier.realizable import Question

# Regrouping coefficients that are within this share of a decimal of this many digits are that
# decimal: they come from a scan in floating point, which leaves some 1e-15 to 1e-13.
_DIGITS = 9
_ROUNDING = 1e-13


def base_question(
    robot: RobotModel,
    values: Mapping[str, Number | Decimal | str],
    halfwidths: Mapping[str, Number | Decimal | str] | Number,
    *,
    bounds: Mapping[str, Number],
    consistency: Consistency,
    friction: Iterable[str | FrictionTerm] | None = None,
    friction_nonnegative: bool = True,
    base: BaseParameters | None = None,
    table: TableFile | None = None,
) -> Question:
    """Return the question of a table; for arguments and errors see `audit_base_parameters`.

    Bounds are those on margin, masses and theta, by the names of its arguments.
    """
    if consistency not in ("pseudo_inertia", "spatial_inertia"):
        raise DataError(
            f"audit: consistency is {consistency!r}; give 'pseudo_inertia' or 'spatial_inertia'."
        )
    limits = {name: _positive(x, name, zero=name == "margin") for name, x in bounds.items()}
    if not limits["mass_min"] <= limits["mass_max"] <= limits["theta_max"]:
        raise DataError(
            "audit: expected mass_min <= mass_max <= theta_max, have "
            f"{bounds['mass_min']}, {bounds['mass_max']} and {bounds['theta_max']}."
        )
    if not values:
        raise DataError("audit: no values are given; name at least one base parameter.")
    if isinstance(halfwidths, Mapping):
        stray = [name for name in halfwidths if name not in values]
        if stray:
            raise DataError(f"audit: halfwidths without a value: {', '.join(stray)}.")
    if friction is None:
        friction = named_terms(robot, values)
    model = FrictionModel.from_terms(friction, robot.joint_names, first=robot.n_base)
    base = structural_base(robot, model) if base is None else base
    _check_posed(model, base)
    first = 10 * robot.n_links
    signs = (first + i for i, p in enumerate(model.parameters) if p.nonnegative)
    return Question(
        robot=robot.name,
        link_names=tuple(robot.link_names),
        table=None if table is None else table.name,
        table_sha256=None if table is None else table.sha256,
        names=tuple(values),
        rows=tuple(coefficients(robot, base, name) for name in values),
        values=tuple(exact(value) for value in values.values()),
        halfwidths=tuple(_halfwidth(halfwidths, name) for name in values),
        theta_names=base.theta_names,
        nonnegative=frozenset(signs if friction_nonnegative else ()),
        consistency=consistency,
        **limits,
    )


def named_terms(robot: RobotModel, names: Iterable[str]) -> list[FrictionTerm]:
    """Return the friction terms that have a parameter among the names.

    A rotor inertia that folds into zz has no entry of its own in a table of base parameters: add
    the names that the table's regrouping mentions.
    """
    wanted, joints = set(names), robot.joint_names[robot.n_base :]
    # Speeds in which friction is not linear change no relation between parameters: any will do.
    kinds: tuple[Any, ...] = tuple(BY_NAME.values())
    terms: list[FrictionTerm] = [
        kind(velocity=1.0) if "velocity" in getattr(kind, "speed_fields", ()) else kind()
        for kind in kinds
    ]
    terms += [Coupling(*pair) for pair in combinations(joints, 2)]
    return [term for term in terms if any(p.name in wanted for p in term.parameters(joints))]


def _check_posed(model: FrictionModel, base: BaseParameters) -> None:
    """Refuse terms whose parameters fold into others by the links of a table, which it leaves out.

    On arms, tilt and friction of the load stand by themselves; the tilt of a single link does not.
    """
    friction = base.matrix[:, len(base.theta_names) - len(model.parameters) :]
    for term, own in model.placed:
        if not isinstance(term, PosedTerm) or term.bodies is not None:
            continue
        used = np.any(friction[:, own] != 0.0, axis=1)
        for k in np.flatnonzero(used & (np.count_nonzero(base.matrix, axis=1) > 1)):
            kind = type(term).__name__
            raise DataError(
                f"audit: {base.names[k]} = {base.expression(base.names[k])} depends on the links "
                f"that {kind} was taken at; give them with friction=(..., {kind}(bodies=...))."
            )


def coefficients(robot: RobotModel, base: BaseParameters, name: str) -> dict[int, Fraction]:
    """Return a parameter's coefficients in theta.

    Raises
    ------
    DataError
        When the robot has no such parameter.
    """
    if name in base.names:
        k = base.names.index(name)
        used = np.flatnonzero(base.matrix[k])
        return {int(j): _coefficient(float(base.matrix[k, j])) for j in used}
    if name in base.theta_names:
        return {base.theta_names.index(name): Fraction(1)}
    raise DataError(
        f"audit: '{robot.name}' has no parameter {name!r}; its base parameters are "
        f"{', '.join(base.names)}, and standard ones are called like {base.theta_names[0]}."
    )


def _halfwidth(halfwidths: Mapping[str, Number | Decimal | str] | Number, name: str) -> Fraction:
    if not isinstance(halfwidths, Mapping):
        width = exact(halfwidths)
    elif name in halfwidths:
        width = exact(halfwidths[name])
    else:
        raise DataError(f"audit: {name} has no halfwidth; give one, 0 if it is exact.")
    if width < 0:
        raise DataError(f"audit: the halfwidth of {name} is {float(width)}; the least is 0.")
    return width


def _coefficient(value: float) -> Fraction:
    """Return a regrouping coefficient as the short decimal that it is but for rounding.

    Lengths are decimals of few digits, so these are too; a coefficient that is none is taken as
    the double that it is.
    """
    short = Fraction(f"{value:.{_DIGITS}g}")
    return short if abs(short - Fraction(value)) < _ROUNDING * abs(short) else Fraction(value)


def _positive(value: Number, name: str, *, zero: bool = False) -> Fraction:
    number = exact(value)
    if number < 0 or (number == 0 and not zero):
        raise DataError(
            f"audit: {name} is {value}; it must be {'at least 0' if zero else 'positive'}."
        )
    return number
