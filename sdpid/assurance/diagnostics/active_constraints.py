"""What each constraint leaves to an estimate, and what it costs.

A constraint says that something is at least, or at most, a limit. Its room is how far the estimate
is inside, its multiplier the derivative of the optimal cost with respect to the limit: positive for
what must be at least something, negative for what must be at most something, since raising that
limit helps. Multipliers are those of the proof that comes with the estimate, in units of the cost
(twice nats) per unit of the limit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.diagnostics.provenance import ACTIVE
from sdpid.estimation.duality.bound import cost_scale
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.scaling import Scaling
from sdpid.robot.inertia import margin_shift


@dataclass(frozen=True, kw_only=True)
class ConstraintState:
    """One constraint at an estimate.

    Attributes
    ----------
    name : str
        What it says.
    room : float or None
        How far the estimate is inside; of an equation minus the error. None where it means
        nothing: a link without a positive mass has no margin.
    multiplier : float or None
        What the optimal cost would rise by per unit of the limit; for consistency the limit is the
        link's margin, for a cone what its room must be. None where the method has none.
    active : bool
        Whether it holds the estimate back (see `constraint_states`).
    unit : str or None
        Of room and limit; None where a condition does not say.
    """

    name: str
    room: float | None
    multiplier: float | None
    active: bool
    unit: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)


def constraint_states(estimate: Estimate) -> tuple[ConstraintState, ...]:
    """Return room, multiplier and activity of every constraint.

    These are, in turn: the consistency of every link, bounds on masses, signs of friction, what
    touches theta_max, and the linear rows and cones of the further conditions, limit by limit.

    A constraint is active where its room is at most `sdpid.assurance.diagnostics.provenance.ACTIVE`
    of its size. It is also where room, relative to the size, is below the multiplier, relative to
    the cost over the size: their product is part of the estimate's gap, so one of the two is small,
    and which one it is tells whether the constraint matters. No level has to be chosen for that.
    Equations are always active. Constraints may be active with a multiplier of zero: of equally
    good parameters the nearest to the description often touches some.

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
        self, name: str, room: float, size: float, multiplier: float | None, unit: str | None
    ) -> ConstraintState:
        """Return the state of an inequality."""
        near = room / size
        presses = 0.0 if multiplier is None else abs(multiplier) * size / self.cost
        active = near <= ACTIVE or near < presses
        return ConstraintState(
            name=name, room=float(room), multiplier=multiplier, active=bool(active), unit=unit
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
            room = float(margins[i])
            yield ConstraintState(
                name=feasible.block_names[i],
                room=room if np.isfinite(room) else None,
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
            for word, limit in (("least", feasible.lower[k]), ("most", feasible.upper[k])):
                sign = 1.0 if word == "least" else -1.0
                multiplier = self._bound(int(k), sign)
                room = sign * (value - float(limit))
                if abs(limit) >= wide:
                    name = f"{names[k]} at {word} {limit:g}"
                    state = self.state(name, room, wide, multiplier, units[k])
                    if state.active:
                        at_end.append(state)
                    continue
                if k < 10 * feasible.n_links:
                    name = f"mass of {problem.robot.link_names[k // 10]} at {word} {limit:g} kg"
                else:
                    name = f"{names[k]} at {word} {limit:g}"
                yield self.state(name, room, size, multiplier, units[k])
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
                    name=name, room=0.0 - abs(value - lower), multiplier=multiplier, active=True
                )
                continue
            both = np.isfinite(lower) and np.isfinite(upper)
            for word, limit, sign in (("least", lower, 1.0), ("most", upper, -1.0)):
                if not np.isfinite(limit):
                    continue
                said = f"{name}, at {word} {limit:g}" if both else name
                part = None if multiplier is None else _side(multiplier, sign)
                yield self.state(said, sign * (value - limit), float(sizes[j]), part, None)

    def cones(self) -> Iterator[ConstraintState]:
        """Yield the cones of the further conditions."""
        feasible, found = self.estimate.problem.feasible, self.estimate.multipliers
        own = feasible.n_own
        roots = self.scaling.block_roots(feasible)[own:]
        for i, room in enumerate(feasible.rooms(self.theta)):
            # Taking t off both sides of ‖v‖ ≤ a − t takes t·E off the matrix.
            multiplier = None if found is None else float(np.trace(found.Z[own + i]))
            size = float(roots[i, 0, 0]) ** 2
            yield self.state(feasible.block_names[own + i], float(room), size, multiplier, None)


def _side(multiplier: float, sign: float) -> float:
    """Return what of a multiplier is that of the lower (1) or the upper (−1) limit."""
    return max(multiplier, 0.0) if sign > 0.0 else min(multiplier, 0.0)
