"""The cost of constraints: how much effort error they add, joint by joint.

Together they cost the difference between the constrained optimum and the unconstrained fit. One of
them costs what leaving it out alone would save: the problem is solved again without it, which holds
however far the parameters then move, where its multiplier is right for small moves only.
Constraints that share a cost cannot each save all of it, and where either of two would do, leaving
out one saves nothing, so these costs do not add up to the total. What a local solver missed of the
optimum is no constraint's cost and is reported apart.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.tables import Table, facts_html, plain
from sdpid.errors import DataError
from sdpid.estimation.compression.covariance import JointRows
from sdpid.estimation.conic.retry import solve_with_retries
from sdpid.estimation.conic.solve import ConicProgram, ConicSolution, solve_conic
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.scaling import Scaling
from sdpid.estimation.sdp.program import Coordinates, SdpProgram
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.wls import solve_wls

# Clarabel's regularizations; the cheapest of what they find counts.
_REGULARIZATIONS = (1e-10, 1e-8)

# Multipliers count from this share of the cost over their constraint's size on: below, leaving the
# constraint out would save less than the solver's accuracy.
_PRESSES = 1e-7


@dataclass(frozen=True, kw_only=True, eq=False)
class CostOfConstraints:
    """Effort error that constraints add.

    Attributes
    ----------
    joint_names : tuple of str
        The joints.
    rmse : ndarray, shape (n,)
        Root mean square error of the constrained optimum on its own rows, N·m; 0 where a joint has
        no rows.
    rmse_free : ndarray, shape (n,)
        Root mean square error of the unconstrained fit, N·m.
    cost, cost_free : float
        Weighted cost of both.
    excess : float
        Weighted cost of the estimate above that of the constrained optimum.
    constraints : tuple of str
        Active constraints that cost something.
    saved : ndarray, shape (constraints,)
        What leaving out each of them alone takes off the weighted cost.
    increase : ndarray, shape (constraints, n)
        What each of them alone adds to the joints' root mean square errors, N·m. A constraint may
        make one joint better at the expense of others.
    """

    joint_names: tuple[str, ...]
    rmse: Array
    rmse_free: Array
    cost: float
    cost_free: float
    excess: float
    constraints: tuple[str, ...]
    saved: Array
    increase: Array

    @property
    def total(self) -> Array:
        """What all constraints together add to the root mean square errors, N·m, shape (n,)."""
        return np.asarray(self.rmse - self.rmse_free)

    def __repr__(self) -> str:
        return (
            f"CostOfConstraints({len(self.constraints)} constraints, cost={self.cost:.6g}, "
            f"cost_free={self.cost_free:.6g})"
        )

    def _repr_html_(self) -> str:
        facts = {"cost": self.cost, "without constraints": self.cost_free, "excess": self.excess}
        return facts_html("Cost of constraints", facts, self._table())

    def _table(self) -> Table:
        """Return one row a constraint: what leaving it out saves of cost and joints' errors."""
        rows: list[tuple[object, ...]] = [
            ("unconstrained", self.cost_free, *self.rmse_free.tolist()),
            ("all constraints", self.cost - self.cost_free, *self.total.tolist()),
        ]
        if self.excess > 0.0:
            nothing: list[float | None] = [None] * len(self.joint_names)
            rows.append(("estimate above the optimum", self.excess, *nothing))
        for name, saved, increase in zip(
            self.constraints, self.saved.tolist(), self.increase.tolist(), strict=True
        ):
            rows.append((name, saved, *increase))
        return Table(("N.m of rmse", "cost", *self.joint_names), tuple(rows))

    def table(self) -> str:
        """Return aligned text: one line a constraint, one column a joint."""
        return self._table().text(3)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        found: dict[str, Any] = plain(
            {
                "joints": self.joint_names,
                "rmse": self.rmse,
                "rmse_unconstrained": self.rmse_free,
                "cost": self.cost,
                "cost_unconstrained": self.cost_free,
                "excess": self.excess,
                "constraints": [
                    {"name": name, "cost": saved, "rmse": increase}
                    for name, saved, increase in zip(
                        self.constraints, self.saved, self.increase, strict=True
                    )
                ],
            }
        )
        return found


def cost_of_constraints(estimate: Estimate) -> CostOfConstraints:
    """Return the effort error that the constraints of an estimate's problem add.

    They are compared at the constrained optimum, which is solved for where the estimate comes from
    another solver than the SDP.

    Parameters
    ----------
    estimate : Estimate
        With standard parameters.

    Returns
    -------
    CostOfConstraints

    Raises
    ------
    DataError
        When the method has no standard parameters.
    """
    problem = estimate.problem
    if estimate.theta is None:
        raise DataError(
            f"cost of constraints: method '{estimate.method}' has none; give an estimate of a "
            "constrained solver."
        )
    rows = JointRows.merged(problem.require_rows("cost of constraints").map(JointRows.of))
    used = np.maximum(rows.used, 1.0)

    def rmse(base: Array) -> Array:
        error = np.append(base, -1.0)
        squares = [float(np.sum((triangle.R @ error) ** 2)) for triangle in rows.triangles]
        return np.asarray(np.sqrt(np.array(squares) / used))

    best = estimate if estimate.method == "sdp" else solve_sdp(problem)
    free = solve_wls(problem)
    constrained = rmse(best.base)
    names, saved, increase = [], [], []
    for name, theta in _without(best):
        names.append(name)
        saved.append(best.cost - problem.cost_of(theta))
        increase.append(constrained - rmse(problem.base_of(theta)))
    return CostOfConstraints(
        joint_names=problem.robot.joint_names,
        rmse=frozen(constrained),
        rmse_free=frozen(rmse(free.base)),
        cost=best.cost,
        cost_free=free.cost,
        excess=estimate.cost - best.cost,
        constraints=tuple(names),
        saved=frozen(saved),
        increase=frozen(np.reshape(increase, (len(names), len(constrained)))),
    )


def _without(estimate: Estimate) -> Iterator[tuple[str, Array]]:
    """Yield each constraint with a multiplier, and the optimum without it."""
    problem, theta = estimate.problem, np.array(estimate.theta)
    feasible = problem.feasible
    scaling = Scaling.of(problem)
    scaling = replace(scaling, cost=max(scaling.cost, estimate.cost))
    coordinates = Coordinates.of(problem, scaling.basis(), theta)
    if coordinates is None:
        return
    bounds_included = np.ones(problem.n_theta, dtype=bool)
    program = SdpProgram.build(problem, scaling, coordinates, bounds_included)
    found = _cheapest(program.conic, lambda _: 0.0)
    if found is None:
        return
    rows, duals = found.rows, found.blocks
    blocks = program.conic.blocks
    for at, (i, dual) in enumerate(zip(program.moving, duals, strict=True)):
        if float(np.trace(dual)) > _PRESSES:
            conic = replace(program.conic, blocks=blocks[:at] + blocks[at + 1 :])
            yield from _relaxed(feasible.block_names[i], conic, program)
    names = [_bound_name(estimate, int(k)) for k in program.bounded]
    names += [feasible.row_names[j] for j in coordinates.limited(problem, scaling)]
    for j in np.flatnonzero(np.abs(rows) > _PRESSES):
        lower, upper = program.conic.lower.copy(), program.conic.upper.copy()
        lower[j], upper[j] = -np.inf, np.inf
        conic = replace(program.conic, lower=lower, upper=upper)
        yield from _relaxed(names[j], conic, program)
    yield from _without_equations(estimate, scaling, theta)


def _without_equations(
    estimate: Estimate, scaling: Scaling, theta: Array
) -> Iterator[tuple[str, Array]]:
    """Yield each equality constraint, and the optimum without it."""
    problem = estimate.problem
    feasible = problem.feasible
    bounds_included = np.ones(problem.n_theta, dtype=bool)
    for j in np.flatnonzero(feasible.equations):
        lower, upper = feasible.row_lower.copy(), feasible.row_upper.copy()
        lower[j], upper[j] = -np.inf, np.inf
        other = replace(
            problem, feasible=replace(feasible, row_lower=frozen(lower), row_upper=frozen(upper))
        )
        coordinates = Coordinates.of(other, scaling.basis(), theta)
        if coordinates is not None:
            program = SdpProgram.build(other, scaling, coordinates, bounds_included)
            yield from _relaxed(feasible.row_names[j], program.conic, program)


def _relaxed(name: str, conic: ConicProgram, program: SdpProgram) -> Iterator[tuple[str, Array]]:
    """Yield the optimum of a program with one constraint removed, unless none is found."""
    found = _cheapest(conic, _cost(program))
    if found is not None:
        yield name, program.theta(found)


def _cost(program: SdpProgram) -> Callable[[Array], float]:
    """Return the cost of a point of a program."""
    return lambda x: program.problem.cost_of(program.coordinates.theta(x))


def _cheapest(conic: ConicProgram, cost: Callable[[Array], float]) -> ConicSolution | None:
    """Return the solution of the least cost, a function of its point; None without one."""

    def judge(x: Array, solution: ConicSolution) -> tuple[ConicSolution, float] | None:
        value = cost(x)
        if "Infeasible" in solution.status or not np.isfinite(value):
            return None
        return solution, value

    return solve_with_retries(
        lambda regularization: solve_conic(conic, regularization=regularization),
        _REGULARIZATIONS,
        judge,
        enough=-np.inf,
    ).value


def _bound_name(estimate: Estimate, k: int) -> str:
    """Return the name of the bound on parameter k."""
    problem, feasible = estimate.problem, estimate.problem.feasible
    if not feasible.bounded[k]:
        return f"theta_max of {problem.base.theta_names[k]}"
    if k < 10 * feasible.n_links:
        return f"mass of {problem.robot.link_names[k // 10]}"
    return f"sign of {problem.base.theta_names[k]}"
