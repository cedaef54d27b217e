"""Which constraints cannot hold together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid.errors import InfeasibleError
from sdpid.estimation.conic.solve import ConicProgram, Matrix, solve_conic
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.estimation.sdp.program import CONTRADICTION, Coordinates, contradiction
from sdpid.robot.inertia import pseudo_inertia

# Constraints hold together when all of them do after each has given way by this share of its
# size: solvers are content with as much.
_GIVES = 1e-7

# Where theta_max is left out, so many times as much takes its place.
_WIDER = 1e3

# Nothing is looked for farther than so many sizes away: solvers lose their way there.
_FAR = 1e6

# Clarabel's, tried in turn.
_REGULARISATIONS = (1e-8, 1e-10, 1e-12)


@dataclass(frozen=True, eq=False)
class _Limit:
    """One constraint: one side of a bound, a row or a matrix inequality.

    Attributes
    ----------
    name : str
        What it says.
    group : str
        What it is part of.
    kind : {"lower", "upper", "row", "block", "exists", "all"}
    index : int
        Of the parameter, the row, the block or the link.
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
            word = "most" if side == "upper" else "least"
            name = f"mass of {link} at {word} {limit:g} kg"
            bounds[side].append(_Limit(name, f"masses at {word} {limit:g} kg", side, int(k)))
    rows = [_Limit(name, name, "row", i) for i, name in enumerate(feasible.row_names)]
    widest = f"theta_max {wide:g}"
    own.append(_Limit(widest, widest, "all", 0))
    if len(problem.log_det.links):
        own += [
            _Limit(f"entropic prior of {robot.link_names[i]}", "entropic prior", "exists", int(i))
            for i in problem.log_det.links
        ]
    return [
        *own,
        *bounds["friction"],
        *bounds["upper"],
        *bounds["lower"],
        *out[feasible.n_own :],
        *rows,
    ]


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
    feasible, scaling, numbers = problem.feasible, Scaling.of(problem), problem.constraints
    basis, n = scaling.basis(), problem.n_theta
    inverses = np.linalg.inv(scaling.block_roots(feasible))
    sizes = scaling.row_sizes(feasible)
    C, lower, upper = [np.append(np.zeros(n), 1.0)], [0.0], [np.inf]
    blocks = []
    coordinates = Coordinates(np.zeros(problem.n_theta), basis)
    units, exist = pseudo_inertia(np.eye(10)), np.linalg.inv(scaling.roots(4))
    widest = numbers.theta_max * _WIDER
    for limit in limits:
        i = limit.index
        if limit.kind == "all":
            widest = numbers.theta_max
            continue
        if limit.kind in ("block", "exists"):
            if limit.kind == "block":
                link, inverse, F = feasible.block_links[i], inverses[i], feasible.block_basis[i]
                constant = inverse @ feasible.block_constants[i] @ inverse.T
            else:
                link, inverse, F, constant = i, exist[i], units, np.zeros((4, 4))
            scaled = (inverse @ F @ inverse.T)[None]
            fixed = coordinates.matrices(constant[None], scaled, np.array([link]))[0]
            give = np.eye(len(constant))[None]
            linear = np.concatenate([fixed.linear, give])
            blocks.append(Matrix(np.append(fixed.index, n), linear, fixed.constant))
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
    for regularisation in _REGULARISATIONS:
        solution = solve_conic(program, regularisation=regularisation)
        if solution.x is not None and solution.status in ("Solved", "AlmostSolved"):
            return float(solution.x[-1])
    return float("nan")
