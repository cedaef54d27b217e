"""Coefficients of a table's parameters in theta: those of a robot, and those in a proof."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from itertools import combinations
from typing import Any

import numpy as np

from sdpid.errors import DataError
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.friction.posed import PosedTerm
from sdpid.robot.friction.term import FrictionTerm
from sdpid.robot.friction.terms import BY_NAME, Coupling
from sdpid.robot.model.base_parameters import BaseParameters, structural_base
from sdpid.robot.model.model import RobotModel
from sdpid.verifier.decimals import decimal_text, parameter, rounded
from sdpid.verifier.reading import shown
from sdpid.verifier.realizable import Question
from sdpid.verifier.result import Result

# Regrouping coefficients that are within this share of a decimal of this many digits are that
# decimal: they come from a scan in floating point, which leaves some 1e-15 to 1e-13.
_DIGITS = 9
_ROUNDING = 1e-13

# On another machine coefficients that are no short decimals differ by some 1e-15 of the largest of
# their row.
_OTHER = Fraction(1, 10**12)


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


def regrouping(
    robot: RobotModel,
    friction: Iterable[str | FrictionTerm],
    base: BaseParameters | None = None,
) -> tuple[FrictionModel, BaseParameters]:
    """Return a robot's friction and base parameters; the latter are found unless they are given."""
    model = FrictionModel.from_terms(friction, robot.joint_names, first=robot.n_base)
    return model, structural_base(robot, model) if base is None else base


def require_posed(model: FrictionModel, base: BaseParameters) -> None:
    """Refuse terms whose parameters fold into others by the links of a table, which it leaves out.

    On arms, tilt and friction of the load stand by themselves; the tilt of a single link does not.
    """
    friction = base.matrix[:, len(base.theta_names) - len(model.parameters) :]
    several = np.count_nonzero(base.matrix, axis=1) > 1
    for term, own in model.placed:
        if not isinstance(term, PosedTerm) or term.bodies is not None:
            continue
        for k in np.flatnonzero(np.any(friction[:, own] != 0.0, axis=1) & several):
            kind = type(term).__name__
            raise DataError(
                f"audit: {base.names[k]} = {base.expression(base.names[k])} depends on the links "
                f"that {kind} was taken at; give them with friction=(..., {kind}(bodies=...))."
            )


def coefficients(robot: RobotModel, base: BaseParameters, name: str) -> dict[int, Fraction]:
    """Return a parameter's coefficients in theta, by index.

    Lengths are decimals of few digits, so regrouping coefficients are too, but for rounding; one
    that is none is taken as the double that it is.

    Raises
    ------
    DataError
        When the robot has no such parameter.
    """
    if name not in base.names:
        if name in base.theta_names:
            return {base.theta_names.index(name): Fraction(1)}
        raise DataError(
            f"audit: '{robot.name}' has no parameter {name!r}; its base parameters are "
            f"{', '.join(base.names)}, and standard ones are called like {base.theta_names[0]}."
        )
    row, found = base.matrix[base.names.index(name)], {}
    for j in np.flatnonzero(row).tolist():
        exact, short = Fraction(float(row[j])), Fraction(f"{row[j]:.{_DIGITS}g}")
        found[j] = short if abs(short - exact) < _ROUNDING * abs(short) else exact
    return found


def check_coefficients(question: Question, robot: RobotModel) -> Result:
    """Return whether a question's coefficients are those of a robot, computed anew.

    Parameters
    ----------
    question : Question
        Of a proof's file.
    robot : RobotModel
        The robot; its inertias do not matter.

    Returns
    -------
    Result
        One statement, or problems by the name of the parameter.
    """
    first, given = 10 * question.n_links, question.theta_names
    if question.link_names != robot.link_names:
        return Result(problems=(f"the links are not those of robot {shown(robot.name)}",))
    model, base = regrouping(robot, named_terms(robot, given[first:]))
    if given[:first] != base.theta_names[:first] or {*given} != {*base.theta_names}:
        return Result(problems=(f"theta is not that of robot {shown(robot.name)}",))
    signs = {p.name for p in model.parameters if p.nonnegative}
    claimed = [given[j] for j in sorted(question.nonnegative)]
    problems = [f"{parameter(name)} may be negative" for name in claimed if name not in signs]
    worst = Fraction(0)
    for name, row in zip(question.names, question.rows, strict=True):
        try:
            own = coefficients(robot, base, name)
        except DataError:
            problems.append(f"robot {shown(robot.name)} has no parameter {shown(name)}")
            continue
        # Friction may stand in another order.
        off = {base.theta_names[j]: x for j, x in own.items()}
        for j, x in row.items():
            off[given[j]] = off.get(given[j], Fraction(0)) - x
        share = max(map(abs, off.values())) / max(map(abs, own.values()))
        worst = max(worst, share)
        if share > _OTHER:
            problems.append(f"the coefficients of {parameter(name)} are other ones")
    if problems:
        return Result(problems=tuple(problems))
    near = f", to within {decimal_text(rounded(worst, 2, up=True))} of each row's largest"
    return Result(
        (
            f"The coefficients of all {len(question.names)} parameters are those of robot "
            f"{shown(robot.name)}, computed anew from its kinematics{near if worst else ''}.",
        )
    )
