"""Slack, multiplier and activity of every constraint at an estimate.

A constraint says that something is at least, or at most, a limit. Its slack is how far the estimate
is inside, its multiplier the derivative of the optimal cost with respect to the limit: positive for
what must be at least something, negative for what must be at most something, since raising that
limit helps. Multipliers are those of the proof that comes with the estimate, in units of the cost
(twice nats) per unit of the limit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.diagnostics.provenance import ACTIVE
from sdpid.estimation.duality.bound import cost_scale
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.scaling import Scaling
from sdpid.robot.inertia import margin_shift

ConstraintKind = Literal["consistency", "mass", "sign", "theta_max", "row", "cone"]
Side = Literal["least", "most"]


@dataclass(frozen=True, kw_only=True)
class ConstraintState:
    """One constraint at an estimate.

    Attributes
    ----------
    name : str
        The constraint in words.
    kind : {"consistency", "mass", "sign", "theta_max", "row", "cone"}
        Consistency of a link, bound on a mass, sign of another parameter, the numerical bound
        `theta_max`, or a linear row or cone of a further condition.
    side : {"least", "most"} or None
        Which limit of the quantity it is; None for consistency, equations and cones.
    slack : float or None
        How far the estimate is inside; of an equation minus the error. None where it means
        nothing: a link without a positive mass has no margin.
    multiplier : float or None
        Shadow price: derivative of the optimal cost with respect to the limit. For consistency
        the limit is the link's margin, for a cone its least slack. None where the method has none.
    active : bool
        Whether it holds the estimate back (see `constraint_states`).
    unit : str or None
        Of slack and limit; None where a condition has none.
    """

    name: str
    kind: ConstraintKind
    side: Side | None = None
    slack: float | None
    multiplier: float | None
    active: bool
    unit: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)


def constraint_states(estimate: Estimate) -> tuple[ConstraintState, ...]:
    """Return slack, multiplier and activity of every constraint.

    These are, in turn: the consistency of every link, bounds on masses, signs of friction, what
    touches theta_max, and the linear rows and cones of the further conditions, limit by limit.

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
    return (*seen.consistency(), *seen.bounds(), *seen.rows(), *seen.cones())


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

    def state(
        self,
        name: str,
        kind: ConstraintKind,
        side: Side | None,
        slack: float,
        size: float,
        multiplier: float | None,
        unit: str | None,
    ) -> ConstraintState:
        """Return the state of an inequality."""
        near = slack / size
        presses = 0.0 if multiplier is None else abs(multiplier) * size / self.cost
        active = near <= ACTIVE or near < presses
        return ConstraintState(
            name=name,
            kind=kind,
            side=side,
            slack=float(slack),
            multiplier=multiplier,
            active=bool(active),
            unit=unit,
        )

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
        for i in range(own):
            multiplier, presses = None, 0.0
            if found is not None:
                multiplier = float(np.sum(found.Z[i] * shift))
                # All that Z holds, not only what a margin would add to.
                roots = np.linalg.inv(inverses[i])
                presses = float(np.trace(roots.T @ found.Z[i] @ roots)) / self.cost
            least, largest = float(eigenvalues[i, 0]), max(float(eigenvalues[i, -1]), 0.0)
            slack = float(margins[i])
            yield ConstraintState(
                name=feasible.block_names[i],
                kind="consistency",
                slack=slack if np.isfinite(slack) else None,
                multiplier=multiplier,
                active=least <= ACTIVE * largest or least < presses,
                unit="kg.m2",
            )

    def bounds(self) -> Iterator[ConstraintState]:
        """Yield masses and signs of friction, then what touches theta_max."""
        problem, feasible = self.estimate.problem, self.estimate.problem.feasible
        names, units = problem.base.theta_names, problem.base.theta_units
        wide = feasible.constraints.theta_max
        at_end = []
        for k in (*np.flatnonzero(feasible.bounded), *np.flatnonzero(~feasible.bounded)):
            value, size = float(self.theta[k]), float(self.scaling.theta[k])
            sides: tuple[tuple[Side, Any, float], ...] = (
                ("least", feasible.lower[k], 1.0),
                ("most", feasible.upper[k], -1.0),
            )
            for side, limit, sign in sides:
                multiplier = self._bound(int(k), sign)
                slack = sign * (value - float(limit))
                if abs(limit) >= wide:
                    name = f"{names[k]} at {side} {limit:g}"
                    state = self.state(name, "theta_max", side, slack, wide, multiplier, units[k])
                    if state.active:
                        at_end.append(state)
                    continue
                kind: ConstraintKind = "mass" if k < 10 * feasible.n_links else "sign"
                if kind == "mass":
                    name = f"mass of {problem.robot.link_names[k // 10]} at {side} {limit:g} kg"
                else:
                    name = f"{names[k]} at {side} {limit:g}"
                yield self.state(name, kind, side, slack, size, multiplier, units[k])
        yield from at_end

    def _bound(self, k: int, sign: float) -> float | None:
        """Return the multiplier of one side of a bound."""
        found = self.estimate.multipliers
        if found is None or not found.bounds_included[k]:
            return None
        return _side(float(found.bounds[k]), sign)

    def rows(self) -> Iterator[ConstraintState]:
        """Yield the linear rows, each of their limits a constraint."""
        feasible, found = self.estimate.problem.feasible, self.estimate.multipliers
        sizes = self.scaling.row_sizes(feasible)
        for j, (name, row) in enumerate(zip(feasible.row_names, feasible.rows, strict=True)):
            value = float(row @ self.theta)
            lower, upper = float(feasible.row_lower[j]), float(feasible.row_upper[j])
            multiplier = None if found is None else float(found.rows[j])
            if lower == upper:
                yield ConstraintState(
                    name=name,
                    kind="row",
                    slack=0.0 - abs(value - lower),
                    multiplier=multiplier,
                    active=True,
                )
                continue
            both = np.isfinite(lower) and np.isfinite(upper)
            sides: tuple[tuple[Side, float, float], ...] = (
                ("least", lower, 1.0),
                ("most", upper, -1.0),
            )
            for side, limit, sign in sides:
                if not np.isfinite(limit):
                    continue
                limited = f"{name}, at {side} {limit:g}" if both else name
                part = None if multiplier is None else _side(multiplier, sign)
                slack = sign * (value - limit)
                yield self.state(limited, "row", side, slack, float(sizes[j]), part, None)

    def cones(self) -> Iterator[ConstraintState]:
        """Yield the cones of the further conditions."""
        feasible, found = self.estimate.problem.feasible, self.estimate.multipliers
        own = feasible.n_own
        roots = self.scaling.block_roots(feasible)[own:]
        for i, slack in enumerate(feasible.rooms(self.theta)):
            # Taking t off both sides of ‖v‖ ≤ a − t takes t·E off the matrix.
            multiplier = None if found is None else float(np.trace(found.Z[own + i]))
            size = float(roots[i, 0, 0]) ** 2
            name = feasible.block_names[own + i]
            yield self.state(name, "cone", None, float(slack), size, multiplier, None)


def _side(multiplier: float, sign: float) -> float:
    """Return what of a multiplier is that of the lower (1) or the upper (−1) limit."""
    return max(multiplier, 0.0) if sign > 0.0 else min(multiplier, 0.0)
