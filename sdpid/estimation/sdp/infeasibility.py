"""Which constraints cannot hold together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sdpid.errors import InfeasibleError
from sdpid.estimation.conic.retry import solve_with_retries
from sdpid.estimation.conic.solve import ConicProgram, Matrix, solve_conic
from sdpid.estimation.constraints.named import Constraint
from sdpid.estimation.coordinates import CONTRADICTION, Coordinates, contradiction
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling

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
    if not short > _GIVES:
        # By less than a solver sees, or where it has no answer: equations alone are to blame.
        return _contradictory_equations(problem)
    pressing = [limit for limit, weight in zip(limits, weights, strict=True) if weight > _REST]
    limits = pressing if _contradict(problem, pressing) else limits
    for limit in limits:
        rest = [other for other in limits if other is not limit]
        if rest and _contradict(problem, rest):
            limits = rest
    groups = [limit.group for limit in limits]
    several = (limit.group if groups.count(limit.group) > 1 else limit.name for limit in limits)
    names = tuple(dict.fromkeys(several))
    return InfeasibleError(
        f"no parameters of '{problem.robot.name}' satisfy all constraints; these cannot hold "
        f"together: {'; '.join(names)}. Each of all would have to give way by {short:.1e} of its "
        f"size (limit {_GIVES:.0e}); loosen or leave out one of these.",
        problem=problem,
        conflict=names,
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
    lower, upper = np.full(len(sizes), -np.inf), np.full(len(sizes), np.inf)
    widest, blocks = feasible.widest * _WIDER, []
    # Where each limit's multipliers are: among the lower ends, then the upper ones.
    places: list[list[int]] = []
    for limit in limits:
        places.append([])
        if limit.kind == "theta_max":
            widest = feasible.widest
        elif limit.kind in ("consistency", "cone", "exists"):
            fixed = matrices[limit.index]
            linear = np.concatenate([fixed.linear, np.eye(len(fixed.constant))[None]])
            blocks.append(Matrix(np.append(fixed.index, n), linear, fixed.constant))
        else:
            k, end = limit.index + n * (limit.kind == "row"), float(limit.limit or 0.0)
            if limit.side != "most":
                lower[k] = end / sizes[k]
                places[-1].append(k)
            if limit.side != "least":
                upper[k] = end / sizes[k]
                places[-1].append(k + len(sizes))
    wide = np.minimum(widest / scaling.theta, _FAR)
    none = np.full(len(sizes), np.inf)
    gives = np.concatenate([np.ones(len(sizes)), -np.ones(len(sizes)), np.zeros(n), [1.0]])
    rows = np.vstack([functions, functions, basis / scaling.theta[:, None], np.zeros(n)])
    program = ConicProgram(
        M=np.zeros((0, n + 1)),
        m=np.zeros(0),
        cost=np.append(np.zeros(n), 1.0),
        C=np.column_stack([rows, gives]),
        lower=np.concatenate([lower, -none, -wide, [0.0]]),
        upper=np.concatenate([none, upper, wide, [np.inf]]),
        blocks=tuple(blocks),
    )
    found = solve_with_retries(
        lambda regularization: solve_conic(program, regularization=regularization),
        _REGULARIZATIONS,
        lambda x, solution: ((float(x[-1]), solution), 0.0) if solution.solved else None,
    ).value
    if found is None:
        return float("nan"), []
    value, solution = found
    pulls, duals = np.abs(solution.rows), iter(solution.blocks)
    weights = []
    for limit, own in zip(limits, places, strict=True):
        if limit.kind == "theta_max":
            weights.append(float(pulls[2 * len(sizes) : -1].sum()))
        else:
            weights.append(float(pulls[own].sum() if own else np.trace(next(duals))))
    return value, weights
