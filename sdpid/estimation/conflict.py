"""Which constraints cannot hold together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid.errors import InfeasibleError
from sdpid.estimation.conic import ConicProgram, Matrix, solve_conic
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling

# Constraints hold together when all of them do after each has given way by this share of its
# size: solvers are content with as much.
_GIVES = 1e-7


@dataclass(frozen=True, eq=False)
class _Limit:
    """One constraint: one side of a bound, a row or a matrix inequality.

    Attributes
    ----------
    name : str
        What it says.
    group : str
        What it is part of.
    kind : {"lower", "upper", "row", "block"}
    index : int
        Of the parameter, the row or the block.
    """

    name: str
    group: str
    kind: str
    index: int


def explained(problem: Problem) -> InfeasibleError:
    """Return the error that names a small set of constraints which cannot hold together.

    Constraints are left out as long as the rest still contradict each other, first in groups,
    such as all masses' lower bounds, then within the groups that are needed. A group of which
    several are needed is named as one.
    """
    limits = _limits(problem)
    groups = list(dict.fromkeys(limit.group for limit in limits))
    short = _shortfall(problem, limits)
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
    """Return all constraints but theta_max, which always holds; first those to leave out first."""
    feasible, robot = problem.feasible, problem.robot
    numbers = problem.constraints
    wide = numbers.theta_max
    out = [
        _Limit(name, "consistency of the links" if i < feasible.n_own else name, "block", i)
        for i, name in enumerate(feasible.block_names)
    ]
    own = out[: feasible.n_own]
    bounds: dict[str, list[_Limit]] = {"friction": [], "upper": [], "lower": []}
    for k in np.flatnonzero(feasible.bounded):
        if k >= 10 * feasible.n_links:
            name = f"{problem.base.theta_names[k]} at least 0"
            bounds["friction"].append(_Limit(name, "friction_nonnegative", "lower", int(k)))
            continue
        link = robot.link_names[k // 10]
        for side, limit in (("upper", numbers.mass_max), ("lower", numbers.mass_min)):
            if abs(limit) < wide:
                word = "most" if side == "upper" else "least"
                name = f"mass of {link} at {word} {limit:g} kg"
                bounds[side].append(_Limit(name, f"masses at {word} {limit:g} kg", side, int(k)))
    rows = [_Limit(name, name, "row", i) for i, name in enumerate(feasible.row_names)]
    return [
        *own,
        *bounds["friction"],
        *bounds["upper"],
        *bounds["lower"],
        *out[feasible.n_own :],
        *rows,
    ]


def _contradict(problem: Problem, limits: list[_Limit]) -> bool:
    return _shortfall(problem, limits) > _GIVES


def _shortfall(problem: Problem, limits: list[_Limit]) -> float:
    """Return by which share of its size each constraint must give way for all to hold.

    Solves for the smallest t ≥ 0 such that bounds and rows hold but for t of their sizes and
    matrices are at least −t in scaled units. theta_max is not negotiable.
    """
    feasible, scaling = problem.feasible, Scaling.of(problem)
    basis, n = scaling.basis(), problem.n_theta
    inverses = np.linalg.inv(scaling.block_roots(feasible))
    sizes = scaling.row_sizes(feasible)
    C, lower, upper = [np.append(np.zeros(n), 1.0)], [0.0], [np.inf]
    blocks = []
    for limit in limits:
        i = limit.index
        if limit.kind == "block":
            own = slice(10 * feasible.block_links[i], 10 * feasible.block_links[i] + 10)
            index = np.flatnonzero(np.any(basis[own] != 0.0, axis=0))
            scaled = inverses[i] @ feasible.block_basis[i] @ inverses[i].T
            linear = np.einsum("ka,kij->aij", basis[own][:, index], scaled)
            constant = inverses[i] @ feasible.block_constants[i] @ inverses[i].T
            give = np.eye(len(constant))[None]
            blocks.append(Matrix(np.append(index, n), np.concatenate([linear, give]), constant))
            continue
        if limit.kind == "row":
            row, size = feasible.rows[i] @ basis, sizes[i]
            sides = [(feasible.row_lower[i], 1.0), (feasible.row_upper[i], -1.0)]
        else:
            row, size = basis[i], scaling.theta[i]
            low = limit.kind == "lower"
            sides = [(feasible.lower[i], 1.0) if low else (feasible.upper[i], -1.0)]
        for end, sign in sides:
            if np.isfinite(end):
                C.append(np.append(row / size, sign))
                lower.append(end / size if sign > 0.0 else -np.inf)
                upper.append(end / size if sign < 0.0 else np.inf)
    wide = problem.constraints.theta_max / scaling.theta
    C += list(np.column_stack([basis / scaling.theta[:, None], np.zeros(n)]))
    solution = solve_conic(
        ConicProgram(
            M=np.zeros((0, n + 1)),
            m=np.zeros(0),
            cost=np.append(np.zeros(n), 1.0),
            C=np.array(C),
            lower=np.concatenate([lower, -wide]),
            upper=np.concatenate([upper, wide]),
            blocks=tuple(blocks),
        )
    )
    return np.inf if solution.x is None else float(solution.x[-1])
