"""Compare the coefficients in a proof about a table with those of the robot."""

from __future__ import annotations

from fractions import Fraction

from sdpid.assurance.tables.question import coefficients, named_terms
from sdpid.errors import DataError
from sdpid.robot.friction.model import FrictionModel
from sdpid.robot.model.base_parameters import structural_base
from sdpid.robot.model.model import RobotModel
from sdpid.verifier.decimals import decimal_text, parameter, rounded
from sdpid.verifier.reading import shown
from sdpid.verifier.realizable import Question
from sdpid.verifier.result import Result

# The scan for base parameters is in floating point: on another machine coefficients that are no
# short decimals differ by some 1e-15 of the largest of their row.
_ROUNDING = Fraction(1, 10**12)


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
    first = 10 * question.n_links
    if question.link_names != robot.link_names:
        return Result(problems=(f"the links are not those of robot {shown(robot.name)}",))
    terms = named_terms(robot, question.theta_names[first:])
    model = FrictionModel.from_terms(terms, robot.joint_names, first=robot.n_base)
    base = structural_base(robot, model)
    own = base.theta_names
    if question.theta_names[:first] != own[:first] or {*question.theta_names} != {*own}:
        return Result(problems=(f"theta is not that of robot {shown(robot.name)}",))
    signs = {p.name for p in model.parameters if p.nonnegative}
    problems = [
        f"{parameter(question.theta_names[j])} may be negative"
        for j in sorted(question.nonnegative)
        if question.theta_names[j] not in signs
    ]
    worst = Fraction(0)
    for name, row in zip(question.names, question.rows, strict=True):
        try:
            found = {own[j]: x for j, x in coefficients(robot, base, name).items()}
        except DataError:
            problems.append(f"robot {shown(robot.name)} has no parameter {shown(name)}")
            continue
        given = {question.theta_names[j]: x for j, x in row.items()}
        largest = max(map(abs, found.values()))
        zero = Fraction(0)
        off = max(abs(given.get(j, zero) - found.get(j, zero)) for j in {*given, *found}) / largest
        worst = max(worst, off)
        if off > _ROUNDING:
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
