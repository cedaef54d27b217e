"""The cost of constraints: how much effort error they add, joint by joint.

Together they cost the difference between the constrained optimum and the unconstrained fit. One of
them costs what leaving it out alone would save: the problem is solved again without it, which holds
however far the parameters then move, where its multiplier is right for small moves only.
Constraints that share a cost cannot each save all of it, and where either of two would do, leaving
out one saves nothing, so these costs do not add up to the total. What a local solver missed of the
optimum is no constraint's cost and is reported apart.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.tables import Shown, Table, plain_dict
from sdpid.assurance.diagnostics.active_constraints import constraint_states
from sdpid.errors import DataError
from sdpid.estimation.compression.covariance import JointRows
from sdpid.estimation.conic.solve import solve_conic
from sdpid.estimation.coordinates import Coordinates
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.scaling import Scaling
from sdpid.estimation.sdp.program import SdpProgram
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.wls import solve_wls

# Clarabel's regularizations; the cheapest of what they find counts.
_REGULARIZATIONS = (1e-10, 1e-8)

# A constraint costs something if leaving it out saves this share of the cost: less is within the
# accuracy of the solver.
_SAVES = 1e-7


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class CostOfConstraints(Shown):
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

    Examples
    --------
    >>> known = sdpid.Constraints(others=(sdpid.constraints.Fixed({"Fv1": 140.0}),))
    >>> cost = sdpid.cost_of_constraints(sdpid.solve_sdp(problem.constrained(constraints=known)))
    >>> cost.constraints[-1], cost.increase[-1].round(1)
    ('Fv1 fixed', array([3.3, 0.6, 0.1, 0.2, 0.1, 0.1]))
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

    _facts = ("constraints", "cost", "cost_free", "excess")

    @property
    def total(self) -> Array:
        """What all constraints together add to the root mean square errors, N·m, shape (n,)."""
        return np.asarray(self.rmse - self.rmse_free)

    def _tables(self) -> Iterator[Table]:
        yield self._table()

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
        content = {
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
        return plain_dict(content)


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

    Examples
    --------
    >>> known = sdpid.Constraints(others=(sdpid.constraints.Fixed({"Fv1": 140.0}),))
    >>> cost = sdpid.cost_of_constraints(sdpid.solve_sdp(problem.constrained(constraints=known)))
    >>> "Fv1 fixed" in cost.constraints
    True
    >>> cost.total.round(1)
    array([3.3, 0.6, 0.1, 0.2, 0.1, 0.1])
    """
    problem = estimate.problem
    if estimate.theta is None:
        raise DataError(
            f"cost of constraints: method '{estimate.method}' has none; give an estimate of a "
            "constrained solver."
        )
    source = problem.require_rows("cost of constraints")
    if source.samples.contacts is not None:
        raise DataError(
            "cost of constraints: contacts tie the rows of a sample together, so that no joint has "
            "an error of its own; compare sdpid.validate with and without a constraint."
        )
    rows = JointRows.merged(source.map(JointRows.of))
    used = np.maximum(rows.used, 1.0)

    def rmse(base: Array) -> Array:
        return np.asarray(np.sqrt(rows.squared_residuals(base) / used))

    best = estimate if estimate.method == "sdp" else solve_sdp(problem)
    free = solve_wls(problem)
    constrained = rmse(best.base)
    names, saved, increase = [], [], []
    for name, theta in _without(best):
        less = best.cost - problem.cost_of(theta)
        if less > _SAVES * best.cost:
            names.append(name)
            saved.append(less)
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
    """Yield each active constraint, and the optimum without it."""
    problem, theta = estimate.problem, np.array(estimate.theta)
    scaling = Scaling.of(problem)
    scaling = replace(scaling, cost=max(scaling.cost, estimate.cost))
    every = np.ones(problem.n_theta, dtype=bool)
    for state in constraint_states(estimate):
        if not state.active:
            continue
        # Solved as a program: solvers of estimates keep every link consistent.
        relaxed = replace(problem, feasible=problem.feasible.without(state))
        coordinates = Coordinates.of(relaxed, scaling.basis(), theta)
        if coordinates is None:
            continue
        program = SdpProgram.build(relaxed, scaling, coordinates, every)
        solutions = [solve_conic(program.conic, regularization=each) for each in _REGULARIZATIONS]
        found = [
            program.theta(each)
            for each in solutions
            if each.x is not None and "Infeasible" not in each.status
        ]
        if found:
            yield state.name, min(found, key=problem.cost_of)
