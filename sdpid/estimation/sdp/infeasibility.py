"""Which constraints cannot hold together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import InfeasibleError
from sdpid.estimation.conic.solve import ConicProgram, Matrix, solve_conic, solve_with_retries
from sdpid.estimation.constraints.feasible_set import Constraint
from sdpid.estimation.coordinates import CONTRADICTION, Coordinates, contradiction
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling

T = TypeVar("T")

# Constraints hold together when all of them do after each has given way by this share of its
# size: solvers are content with as much.
_GIVES = 1e-7

# Multipliers of what contradicts each other add up to one; smaller ones are a solver's rest.
_REST = 1e-6

# Where theta_max is left out, theta_max times this takes its place.
_WIDER = 1e3

# Parameters are searched up to this many sizes away: solvers lose their way farther out.
_FAR = 1e6

# Clarabel's, tried in turn.
_REGULARIZATIONS = (1e-8, 1e-10, 1e-12)

# What is left out first of what contradicts each other.
_ORDER = ("consistency", "theta_max", "exists", "sign", "most", "least", "cone", "row")


def explained(problem: Problem) -> InfeasibleError:
    """Return the error that names a small set of constraints which cannot hold together.

    Those with multipliers contradict each other; of these constraints are left out as long as the
    rest still do. A group of which several are needed, such as all masses' lower bounds, is named
    as one.
    """
    limits = _limits(problem)
    short, weights = _shortfall(problem, limits)
    if short > _GIVES:
        pressing = [limit for limit, weight in zip(limits, weights, strict=True) if weight > _REST]
        limits = pressing if _contradict(problem, pressing) else limits
        limits = _fewest(limits, lambda rest: _contradict(problem, rest))
        groups = [limit.group for limit in limits]
        several = (limit.group if groups.count(limit.group) > 1 else limit.name for limit in limits)
        names, which = tuple(dict.fromkeys(several)), "these"
        why = (
            f"Each of all would have to give way by {short:.1e} of its size (limit {_GIVES:.0e}); "
            "loosen or leave out one of these."
        )
    else:
        # By less than a solver sees, or where it has no answer: equations alone are to blame.
        def by(chosen: list[int]) -> float:
            return contradiction(problem, scaling, np.array(chosen, dtype=np.intp))

        feasible, scaling = problem.feasible, Scaling.of(problem)
        equations = np.flatnonzero(feasible.equations).tolist()
        chosen = _fewest(equations, lambda rest: by(rest) > CONTRADICTION)
        names, which = tuple(feasible.row_names[row] for row in chosen), "these equations"
        why = (
            f"They contradict each other by {by(equations):.1e} of their size (limit "
            f"{CONTRADICTION:.0e}); make their numbers agree, or leave out one of them."
        )
    return InfeasibleError(
        f"no parameters of '{problem.robot.name}' satisfy all constraints; {which} cannot hold "
        f"together: {'; '.join(names)}. {why}",
        problem=problem,
        conflict=names,
    )


def _fewest(items: list[T], contradict: Callable[[list[T]], bool]) -> list[T]:
    """Return items that contradict each other, of which none can be left out."""
    for item in items:
        rest = [other for other in items if other != item]
        if rest and contradict(rest):
            items = rest
    return items


def require_consistent(problem: Problem) -> None:
    """Raise when the constraints cannot hold together.

    Raises
    ------
    InfeasibleError
        With a small set of constraints that cannot hold together as `conflict`.
    """
    if _contradict(problem, _limits(problem)):
        raise explained(problem)


def _limits(problem: Problem) -> list[Constraint]:
    """Return all constraints, theta_max as one; first those to leave out first."""
    feasible = problem.feasible
    widest = Constraint(
        kind="theta_max", name=f"theta_max {problem.constraints.theta_max:g}", index=-1
    )
    exist = [
        Constraint(
            kind="exists",
            name=f"entropic prior of {feasible.link_names[link]}",
            index=len(feasible.block_links) + i,
        )
        for i, link in enumerate(problem.log_det.links)
    ]
    others = [each for each in feasible.named if each.kind != "theta_max"]

    def place(each: Constraint) -> int:
        return _ORDER.index(str(each.side if each.kind == "mass" else each.kind))

    return sorted([*others, widest, *exist], key=place)


def _contradict(problem: Problem, limits: Sequence[Constraint]) -> bool:
    """Whether limits are found to contradict each other; not where the solver has no answer."""
    return _shortfall(problem, limits)[0] > _GIVES


def _shortfall(problem: Problem, limits: Sequence[Constraint]) -> tuple[float, list[float]]:
    """Return by which share of its size each limit must give way for all to hold; multipliers.

    Solves for the smallest t ≥ 0 such that bounds and rows hold but for t of their sizes and
    matrices are at least −t in scaled units. theta_max gives way by nothing, but where it is not
    among the limits a thousand times as much is allowed, for the program to be bounded. NaN where
    the solver has no answer.
    """
    feasible, scaling, n = problem.feasible, Scaling.of(problem), problem.n_theta
    basis = scaling.basis()
    coordinates = Coordinates(np.zeros(n), basis)
    matrices = coordinates.inequalities(feasible, scaling)
    matrices += coordinates.pseudo_inertias(scaling, problem.log_det.links)
    sizes = np.concatenate([scaling.theta, scaling.row_sizes(feasible)])
    functions = np.vstack([basis, feasible.rows @ basis]) / sizes[:, None]
    kinds = np.array([limit.kind for limit in limits], dtype=str)
    of_matrices, of_widest = np.isin(kinds, ("consistency", "cone", "exists")), kinds == "theta_max"
    blocks = []
    # Coefficients of x, that of t, and the lower end; and the place of the limit that says so.
    rows: list[Array] = []
    of_rows: list[int] = []
    for place, limit in enumerate(limits):
        if of_matrices[place]:
            fixed = matrices[limit.index]
            linear = np.concatenate([fixed.linear, np.eye(len(fixed.constant))[None]])
            blocks.append(Matrix(np.append(fixed.index, n), linear, fixed.constant))
        elif not of_widest[place]:
            k = limit.index + n * (limit.kind == "row")
            row = np.concatenate([functions[k], [0.0, float(limit.limit or 0.0) / sizes[k]]])
            # Equations have both sides.
            for side, sign in (("least", 1.0), ("most", -1.0)):
                if limit.side in (side, None):
                    rows.append(sign * row + np.eye(n + 2)[n])
                    of_rows.append(place)
    widest = feasible.widest * (1.0 if of_widest.any() else _WIDER)
    wide = np.minimum(widest / scaling.theta, _FAR)
    inside = np.column_stack([basis / scaling.theta[:, None], np.zeros(n), -wide])
    ends = np.vstack([np.reshape(rows, (-1, n + 2)), inside, np.eye(n + 2)[n]])
    program = ConicProgram(
        M=np.zeros((0, n + 1)),
        m=np.zeros(0),
        cost=np.eye(n + 1)[n],
        C=ends[:, :-1],
        lower=ends[:, -1],
        upper=np.concatenate([np.full(len(rows), np.inf), wide, [np.inf]]),
        blocks=tuple(blocks),
    )
    found = solve_with_retries(
        partial(solve_conic, program),
        _REGULARIZATIONS,
        lambda x, solution: ((float(x[-1]), solution), 0.0) if solution.solved else None,
    ).value
    if found is None:
        return float("nan"), []
    value, solution = found
    pulls = np.abs(solution.rows)
    weights = np.bincount(np.array(of_rows, dtype=np.intp), pulls[: len(rows)], len(limits))
    weights[of_matrices] = [np.trace(dual) for dual in solution.blocks]
    weights[of_widest] = pulls[len(rows) : -1].sum()
    return value, weights.tolist()
