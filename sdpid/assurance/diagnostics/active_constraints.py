"""Constraints at an estimate: slack, multiplier and activity of each, and the error that it costs.

A constraint says that something is at least, or at most, a limit. Its slack is how far the estimate
is inside, its multiplier the derivative of the optimal cost with respect to the limit: positive for
what must be at least something, negative for what must be at most something, since raising that
limit helps. Multipliers are those of the proof that comes with the estimate, in units of the cost
(twice nats) per unit of the limit.

Together constraints cost the difference between the constrained optimum and the unconstrained fit.
One of them costs what leaving it out alone would save: the problem is solved again without it,
which holds however far the parameters then move, where its multiplier is right for small moves
only. Constraints that share a cost cannot each save all of it, and where either of two would do,
leaving out one saves nothing, so these costs do not add up to the total. What a local solver missed
of the optimum is no constraint's cost and is reported apart.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.tables import Shown, Table, plain_dict
from sdpid.assurance.diagnostics.provenance import ACTIVE
from sdpid.errors import DataError
from sdpid.estimation.compression.covariance import JointRows
from sdpid.estimation.conic.solve import solve_conic
from sdpid.estimation.constraints.feasible_set import Constraint
from sdpid.estimation.duality.bound import cost_scale
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.scaling import Scaling, congruent
from sdpid.estimation.sdp.program import ReusableProgram
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.wls import solve_wls
from sdpid.robot.inertia import margin_shift

# Clarabel's regularizations; the cheapest of what they find counts.
_REGULARIZATIONS = (1e-10, 1e-8)

# A constraint costs something if leaving it out saves this share of the cost: less is within the
# accuracy of the solver.
_SAVES = 1e-7


@dataclass(frozen=True, kw_only=True)
class ConstraintState(Constraint):
    """One constraint at an estimate.

    Attributes
    ----------
    kind, name, index, link, side, limit, unit
        The constraint's (see `Constraint`).
    slack : float or None
        How far the estimate is inside; of an equation minus the error. None where it means
        nothing: a link without a positive mass has no margin.
    multiplier : float or None
        Shadow price: derivative of the optimal cost with respect to the limit. For consistency
        the limit is the link's margin, for a cone its least slack. None where the method has none.
    active : bool
        Whether it holds the estimate back (see `constraint_states`).
    """

    slack: float | None
    multiplier: float | None
    active: bool

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        told = ("name", "kind", "side", "slack", "multiplier", "active", "unit")
        return {name: getattr(self, name) for name in told}


def constraint_states(estimate: Estimate) -> tuple[ConstraintState, ...]:
    """Return slack, multiplier and activity of every constraint.

    These are, in turn: the consistency of every link, bounds on masses, signs of friction, what
    touches the widest bounds, and the linear rows and cones of the further conditions, limit by
    limit.

    A constraint is active where its slack is at most `ACTIVE` of its size. It is also where slack,
    relative to the size, is below the multiplier, relative to the cost over the size: their product
    is part of the estimate's gap, so one of the two is small, and which one it is tells whether the
    constraint matters. No level has to be chosen for that. Equations are always active. Constraints
    may be active with a multiplier of zero: of equally good parameters the nearest to the
    description often touches some.

    Parameters
    ----------
    estimate : Estimate
        From any solver.

    Returns
    -------
    tuple of ConstraintState
        Empty where the method has no standard parameters.
    """
    if estimate.theta is None:
        return ()
    states = _states(estimate, np.array(estimate.theta))
    return tuple(state for state in states if state.active or state.kind != "theta_max")


def _states(estimate: Estimate, theta: Array) -> Iterator[ConstraintState]:
    """Yield the state of every constraint of an estimate's problem at its parameters.

    Inside is how far the estimate is from the limit, near what counts as at it, presses what the
    multiplier is worth: all three relative to sizes, matrices in the scale of the link's body.
    """
    feasible, found = estimate.problem.feasible, estimate.multipliers
    scaling = Scaling.of(estimate.problem).around(theta)
    cost = max(estimate.cost, cost_scale(estimate.problem))
    margins = feasible.margins(theta) - feasible.constraints.margin
    slacks, values, sizes = feasible.slacks(theta), feasible.rows @ theta, scaling.theta
    row_sizes, roots = scaling.row_sizes(feasible), scaling.block_roots(feasible)
    matrices = congruent(scaling.inverses(feasible), feasible.matrices(theta))
    for each in feasible.named:
        k, limit, near = each.index, float(each.limit or 0.0), ACTIVE
        multiplier, presses = None, 0.0
        if each.kind in ("consistency", "cone"):
            if each.kind == "consistency":
                slack, shift = float(margins[k]), margin_shift(feasible.consistency)
                eigenvalues = np.linalg.eigvalsh(matrices[k])
                inside, near = eigenvalues[0], ACTIVE * max(float(eigenvalues[-1]), 0.0)
            else:
                # Taking t off both sides of ‖v‖ ≤ a − t takes t·E off the matrix.
                slack, shift = float(slacks[k - feasible.n_own]), np.eye(feasible.size)
                inside = slack / roots[k, 0, 0] ** 2
            if found is not None:
                multiplier = float(np.sum(found.Z[k] * shift))
                # All that Z holds, not only what a margin would add to.
                presses = float(np.trace(roots[k].T @ found.Z[k] @ roots[k])) / cost
        else:
            row, size = each.kind == "row", sizes[k]
            if row:
                size = row_sizes[k]
            elif each.kind == "theta_max":
                size = abs(limit)
            slack = each.sign * (float((values if row else theta)[k]) - limit)
            if row and each.side is None:
                slack = 0.0 - abs(slack)
            inside = slack / size
            if found is not None and (row or found.bounds_included[k]):
                multiplier = float((found.rows if row else found.bounds)[k])
                if each.side is not None:
                    # A multiplier belongs to the side that it presses to.
                    multiplier = each.sign * max(each.sign * multiplier, 0.0)
                presses = abs(multiplier) * size / cost
        yield ConstraintState(
            **vars(each),
            slack=slack if np.isfinite(slack) else None,
            multiplier=multiplier,
            active=bool(inside <= near or inside < presses),
        )


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
        """Yield one row a constraint: what leaving it out saves of cost and joints' errors."""
        rows: list[tuple[object, ...]] = [
            ("unconstrained", self.cost_free, *self.rmse_free),
            ("all constraints", self.cost - self.cost_free, *self.total),
        ]
        if self.excess > 0.0:
            rows.append(("estimate above the optimum", self.excess, *[None] * len(self.rmse)))
        each = zip(self.constraints, self.saved, self.increase, strict=True)
        rows += [(name, saved, *increase) for name, saved, increase in each]
        yield Table(("N.m of rmse", "cost", *self.joint_names), tuple(rows))

    def table(self) -> str:
        """Return aligned text: one line a constraint, one column a joint."""
        return next(iter(self._tables())).text(3)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        each = zip(self.constraints, self.saved, self.increase, strict=True)
        content = {
            "joints": self.joint_names,
            "rmse": self.rmse,
            "rmse_unconstrained": self.rmse_free,
            "cost": self.cost,
            "cost_unconstrained": self.cost_free,
            "excess": self.excess,
            "constraints": [
                {"name": name, "cost": saved, "rmse": increase} for name, saved, increase in each
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
        return frozen(np.sqrt(rows.squared_residuals(base) / used))

    best = estimate if estimate.method == "sdp" else solve_sdp(problem)
    free, constrained = solve_wls(problem), rmse(best.base)
    without = [
        (name, best.cost - problem.cost_of(theta), constrained - rmse(problem.base_of(theta)))
        for name, theta in _without(best)
    ]
    costly = [each for each in without if each[1] > _SAVES * best.cost]
    return CostOfConstraints(
        joint_names=problem.robot.joint_names,
        rmse=constrained,
        rmse_free=rmse(free.base),
        cost=best.cost,
        cost_free=free.cost,
        excess=estimate.cost - best.cost,
        constraints=tuple(name for name, _, _ in costly),
        saved=frozen([saved for _, saved, _ in costly]),
        increase=frozen(np.reshape([more for *_, more in costly], (-1, len(constrained)))),
    )


def _without(estimate: Estimate) -> Iterator[tuple[str, Array]]:
    """Yield each active constraint, and the optimum without it."""
    problem, theta = estimate.problem, np.array(estimate.theta)
    every = np.ones(problem.n_theta, dtype=bool)
    for state in constraint_states(estimate):
        if not state.active:
            continue
        # Solved as a program: solvers of estimates keep every link consistent.
        relaxed = replace(problem, feasible=problem.feasible.without(state))
        program = ReusableProgram.about(relaxed, theta, estimate.cost, every).program
        solutions = [solve_conic(program.conic, regularization=each) for each in _REGULARIZATIONS]
        found = [
            program.theta(each)
            for each in solutions
            if each.x is not None and "Infeasible" not in each.status
        ]
        if found:
            yield state.name, min(found, key=problem.cost_of)
