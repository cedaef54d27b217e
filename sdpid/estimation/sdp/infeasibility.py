"""Which constraints cannot hold together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid.errors import InfeasibleError
from sdpid.estimation.conic.retry import solve_with_retries
from sdpid.estimation.conic.solve import ConicProgram, Matrix, solve_conic
from sdpid.estimation.constraints.named import Constraint
from sdpid.estimation.coordinates import CONTRADICTION, Coordinates, contradiction
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.robot.inertia import pseudo_inertia

# Constraints hold together when all of them do after each has given way by this share of its
# size: solvers are content with as much.
_GIVES = 1e-7

# Where theta_max is left out, theta_max times this takes its place.
_WIDER = 1e3

# Parameters are searched up to this many sizes away: solvers lose their way farther out.
_FAR = 1e6

# Clarabel's, tried in turn.
_REGULARIZATIONS = (1e-8, 1e-10, 1e-12)


@dataclass(frozen=True, eq=False)
class _Limit:
    """What may be left out: a constraint, theta_max as a whole, or a body that must exist.

    Attributes
    ----------
    name : str
        In words.
    group : str
        What it is part of.
    constraint : Constraint or None
        None of theta_max, and of a link that must exist.
    link : int or None
        The link that must exist.
    """

    name: str
    group: str
    constraint: Constraint | None = None
    link: int | None = None


def explained(problem: Problem) -> InfeasibleError:
    """Return the error that names a small set of constraints which cannot hold together.

    Constraints are left out as long as the rest still contradict each other, first in groups,
    such as all masses' lower bounds, then within the groups that are needed. A group of which
    several are needed is named as one.
    """
    limits = _limits(problem)
    groups = list(dict.fromkeys(limit.group for limit in limits))
    short = _shortfall(problem, limits)
    if not short > _GIVES:
        # By less than a solver sees, or where it has no answer: equations alone are to blame.
        return _contradictory_equations(problem)
    for group in list(groups):
        rest = [name for name in groups if name != group]
        if rest and _contradict(problem, [x for x in limits if x.group in rest]):
            groups = rest
    part = [limit for limit in limits if limit.group in groups]
    names = []
    for group in groups:
        members = [limit for limit in part if limit.group == group]
        others = [limit for limit in part if limit.group != group]
        alone = next((x for x in members if _contradict(problem, [*others, x])), None)
        if alone is not None:
            part = [*others, alone]
        names.append(group if alone is None else alone.name)
    return InfeasibleError(
        f"no parameters of '{problem.robot.name}' satisfy all constraints; these cannot hold "
        f"together: {'; '.join(names)}. Each of all would have to give way by {short:.1e} of its "
        f"size (limit {_GIVES:.0e}); loosen or leave out one of these.",
        problem=problem,
        conflict=tuple(names),
    )


def _contradictory_equations(problem: Problem) -> InfeasibleError:
    """Return the error that names equations which contradict each other, as few as possible."""
    feasible, scaling = problem.feasible, Scaling.of(problem)
    chosen = np.flatnonzero(feasible.equations)
    by = contradiction(problem, scaling, chosen)
    for row in chosen:
        rest = chosen[chosen != row]
        if contradiction(problem, scaling, rest) > CONTRADICTION:
            chosen = rest
    names = tuple(feasible.row_names[row] for row in chosen)
    return InfeasibleError(
        f"no parameters of '{problem.robot.name}' satisfy all constraints; these equations cannot "
        f"hold together: {'; '.join(names)}. They contradict each other by {by:.1e} of their size "
        f"(limit {CONTRADICTION:.0e}); make their numbers agree, or leave out one of them.",
        problem=problem,
        conflict=names,
    )


def require_consistent(problem: Problem) -> None:
    """Raise when the constraints cannot hold together.

    Raises
    ------
    InfeasibleError
        With a small set of constraints that cannot hold together as `conflict`.
    """
    if _contradict(problem, _limits(problem)):
        raise explained(problem)


def _limits(problem: Problem) -> list[_Limit]:
    """Return all constraints; first those to leave out first.

    theta_max comes as one; a log-det prior asks for bodies that can exist, whatever the
    consistency.
    """
    feasible = problem.feasible
    kinds: dict[str, list[_Limit]] = {}
    for constraint in feasible.named:
        kind = (
            f"{constraint.kind} {constraint.side}" if constraint.kind == "mass" else constraint.kind
        )
        limit = _Limit(constraint.name, constraint.group, constraint)
        kinds.setdefault(kind, []).append(limit)
    widest = f"theta_max {problem.constraints.theta_max:g}"
    kinds["theta_max"] = [_Limit(widest, widest)]
    kinds["exists"] = [
        _Limit(f"entropic prior of {feasible.link_names[i]}", "entropic prior", link=int(i))
        for i in problem.log_det.links
    ]
    order = (
        "consistency",
        "theta_max",
        "exists",
        "sign",
        "mass most",
        "mass least",
        "cone",
        "row",
    )
    return [limit for kind in order for limit in kinds.get(kind, [])]


def _contradict(problem: Problem, limits: list[_Limit]) -> bool:
    """Whether limits are found to contradict each other; not where the solver has no answer."""
    return _shortfall(problem, limits) > _GIVES


def _shortfall(problem: Problem, limits: list[_Limit]) -> float:
    """Return by which share of its size each constraint must give way for all to hold.

    Solves for the smallest t ≥ 0 such that bounds and rows hold but for t of their sizes and
    matrices are at least −t in scaled units. theta_max gives way by nothing, but where it is not
    among the limits a thousand times as much is allowed, for the program to be bounded. NaN where
    the solver has no answer.
    """
    feasible, scaling = problem.feasible, Scaling.of(problem)
    basis, n = scaling.basis(), problem.n_theta
    inverses = np.linalg.inv(scaling.block_roots(feasible))
    sizes = scaling.row_sizes(feasible)
    C, lower, upper = [np.append(np.zeros(n), 1.0)], [0.0], [np.inf]
    blocks = []
    coordinates = Coordinates(np.zeros(problem.n_theta), basis)
    units, exist = pseudo_inertia(np.eye(10)), np.linalg.inv(scaling.roots(4))
    widest = feasible.widest * _WIDER
    for limit in limits:
        constraint = limit.constraint
        if constraint is None and limit.link is None:
            widest = feasible.widest
        elif constraint is None or constraint.kind in ("consistency", "cone"):
            if constraint is None:
                link, inverse, F, constant = limit.link, exist[limit.link], units, np.zeros((4, 4))
            else:
                i = constraint.index
                link, inverse, F = feasible.block_links[i], inverses[i], feasible.block_basis[i]
                constant = inverse @ feasible.block_constants[i] @ inverse.T
            scaled = (inverse @ F @ inverse.T)[None]
            fixed = coordinates.matrices(constant[None], scaled, np.array([link]))[0]
            give = np.eye(len(constant))[None]
            linear = np.concatenate([fixed.linear, give])
            blocks.append(Matrix(np.append(fixed.index, n), linear, fixed.constant))
        else:
            i, end = constraint.index, float(constraint.limit or 0.0)
            by_row = constraint.kind == "row"
            row, size = (
                (feasible.rows[i] @ basis, sizes[i]) if by_row else (basis[i], scaling.theta[i])
            )
            for sign in (1.0, -1.0) if constraint.side is None else (constraint.sign,):
                C.append(np.append(row / size, sign))
                lower.append(end / size if sign > 0.0 else -np.inf)
                upper.append(end / size if sign < 0.0 else np.inf)
    wide = np.minimum(widest / scaling.theta, _FAR)
    C += list(np.column_stack([basis / scaling.theta[:, None], np.zeros(n)]))
    program = ConicProgram(
        M=np.zeros((0, n + 1)),
        m=np.zeros(0),
        cost=np.append(np.zeros(n), 1.0),
        C=np.array(C),
        lower=np.concatenate([lower, -wide]),
        upper=np.concatenate([upper, wide]),
        blocks=tuple(blocks),
    )
    found = solve_with_retries(
        lambda regularization: solve_conic(program, regularization=regularization),
        _REGULARIZATIONS,
        lambda x, solution: (float(x[-1]), 0.0) if solution.solved else None,
    )
    return float("nan") if found.value is None else found.value
