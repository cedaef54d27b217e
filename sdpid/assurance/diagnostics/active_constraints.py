"""Slack, multiplier and activity of every constraint at an estimate.

A constraint says that something is at least, or at most, a limit. Its slack is how far the estimate
is inside, its multiplier the derivative of the optimal cost with respect to the limit: positive for
what must be at least something, negative for what must be at most something, since raising that
limit helps. Multipliers are those of the proof that comes with the estimate, in units of the cost
(twice nats) per unit of the limit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.diagnostics.provenance import ACTIVE
from sdpid.estimation.constraints.named import Constraint
from sdpid.estimation.duality.bound import cost_scale
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.scaling import Scaling
from sdpid.robot.inertia import margin_shift


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
        return {
            "name": self.name,
            "kind": self.kind,
            "side": self.side,
            "slack": self.slack,
            "multiplier": self.multiplier,
            "active": self.active,
            "unit": self.unit,
        }


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
    seen = _Seen.of(estimate, estimate.theta)
    consistency = seen.consistency()
    others = [
        state
        for constraint in estimate.problem.feasible.named
        if constraint.kind != "consistency"
        if (state := seen.state(constraint)).active or state.kind != "theta_max"
    ]
    return (*consistency, *others)


@dataclass(frozen=True, eq=False)
class _Seen:
    """An estimate with the sizes that its constraints are measured in.

    Attributes
    ----------
    estimate : Estimate
        The estimate.
    theta : ndarray, shape (p,)
        Its standard parameters.
    scaling : Scaling
        Links in units of the estimate's own.
    cost : float
        What multipliers are relative to.
    """

    estimate: Estimate
    theta: Array
    scaling: Scaling
    cost: float

    @classmethod
    def of(cls, estimate: Estimate, theta: Array) -> _Seen:
        problem = estimate.problem
        scaling = Scaling.of(problem).around(np.array(theta))
        return cls(estimate, theta, scaling, max(estimate.cost, cost_scale(problem)))

    def state(self, constraint: Constraint) -> ConstraintState:
        """Return the state of a bound, a row or a cone."""
        slack, size, multiplier = self._measured(constraint)
        if constraint.kind == "row" and constraint.side is None:
            active = True
        else:
            presses = 0.0 if multiplier is None else abs(multiplier) * size / self.cost
            active = slack / size <= ACTIVE or slack / size < presses
        return ConstraintState(
            **vars(constraint), slack=slack, multiplier=multiplier, active=bool(active)
        )

    def _measured(self, constraint: Constraint) -> tuple[float, float, float | None]:
        """Return slack, size and multiplier of a bound, a row or a cone."""
        feasible, found = self.estimate.problem.feasible, self.estimate.multipliers
        k, sign = constraint.index, constraint.sign
        if constraint.kind == "cone":
            # Taking t off both sides of ‖v‖ ≤ a − t takes t·E off the matrix.
            trace = None if found is None else float(np.trace(found.Z[k]))
            size = float(self.scaling.block_roots(feasible)[k, 0, 0]) ** 2
            return float(feasible.slacks(self.theta)[k - feasible.n_own]), size, trace
        limit = float(constraint.limit or 0.0)
        if constraint.kind == "row":
            size = float(self.scaling.row_sizes(feasible)[k])
            slack = sign * (float(feasible.rows[k] @ self.theta) - limit)
            multiplier = None if found is None else float(found.rows[k])
            if constraint.side is None:
                return 0.0 - abs(slack), size, multiplier
        else:
            wide = constraint.kind == "theta_max"
            size = abs(limit) if wide else float(self.scaling.theta[k])
            slack = sign * (float(self.theta[k]) - limit)
            included = found is not None and bool(found.bounds_included[k])
            multiplier = float(found.bounds[k]) if found is not None and included else None
        if multiplier is not None:
            # A multiplier belongs to the side that it presses to.
            multiplier = sign * max(sign * multiplier, 0.0)
        return slack, size, multiplier

    def consistency(self) -> Iterator[ConstraintState]:
        """Yield the links' consistency."""
        feasible, found = self.estimate.problem.feasible, self.estimate.multipliers
        own = feasible.n_own
        if not own or feasible.consistency == "none":
            return
        shift = margin_shift(feasible.consistency)
        inverses = np.linalg.inv(self.scaling.block_roots(feasible)[:own])
        transposed = np.swapaxes(inverses, 1, 2)
        eigenvalues = np.linalg.eigvalsh(
            inverses @ feasible.matrices(self.theta)[:own] @ transposed
        )
        margins = feasible.margins(self.theta) - feasible.constraints.margin
        for constraint in feasible.named:
            if constraint.kind != "consistency":
                continue
            i = constraint.index
            multiplier, presses = None, 0.0
            if found is not None:
                multiplier = float(np.sum(found.Z[i] * shift))
                # All that Z holds, not only what a margin would add to.
                roots = np.linalg.inv(inverses[i])
                presses = float(np.trace(roots.T @ found.Z[i] @ roots)) / self.cost
            least, largest = float(eigenvalues[i, 0]), max(float(eigenvalues[i, -1]), 0.0)
            slack = float(margins[i])
            yield ConstraintState(
                **vars(constraint),
                slack=slack if np.isfinite(slack) else None,
                multiplier=multiplier,
                active=least <= ACTIVE * largest or least < presses,
            )
