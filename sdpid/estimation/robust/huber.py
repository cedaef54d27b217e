"""The Huber loss of whitened residuals: its value, its majorizer, and a lower bound that proves.

The loss of a whitened residual r with the threshold t is rho(r) = r² up to t and 2·t·|r| − t²
beyond [huber1964]_. Two facts carry everything here. With w = min(1, t/|r0|),

    rho(r) ≤ w·r² + c(r0),   c(r0) = max(0, t·|r0| − t²),

with equality at r0: least squares with weighted rows lie above the Huber cost. And for every u
with |u| ≤ t,

    rho(r) ≥ 2·u·r − u²,

so that any such u for every row gives a linear lower bound of the Huber cost.

Contacts tie the rows of a sample together, and no row is a joint's own. There r is the vector of a
sample's whitened residuals, |r| its norm, u a vector of a norm of at most t, and both facts hold as
they are. A threshold of t deviations is then the one that as many of normal errors exceed.

The threshold is in standard deviations of a single whitened residual. That deviation is not one:
weights may count correlated samples as fewer, belong to one period where the efforts are means of
many, or be missing altogether. It is therefore taken from the residuals themselves, joint by
joint, as the median of their size in a robust fit without constraints. The median looks at
residuals one at a time, so it is right for correlated ones too. Then it is fixed, and the loss is
convex.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen
from sdpid.errors import DataError
from sdpid.estimation.duality.refine_multipliers import lower_bound
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.information import information_root, least_squares
from sdpid.estimation.problem import Problem
from sdpid.estimation.robust.whitened_rows import WhitenedRows
from sdpid.estimation.wls import solve_wls

# A deviation is at least this share of the joint's whitened efforts: exact data leave residuals
# of rounding, which are no measure of anything.
_LEAST_DEVIATION = 1e-9

# The deviation need not be found precisely, only once and for all.
_DEVIATION_ROUNDS = 30
_DEVIATION_SETTLED = 1e-3

# How often u is corrected at most.
_CORRECTIONS = 12

# A step that no row's threshold stopped leaves rounding, which another such step takes.
_WHOLE = 2

# A row whose u is within this share of its threshold has no room left for corrections.
_ROOM = 1e-9


@dataclass(frozen=True, eq=False)
class HuberLoss:
    """The Huber loss of a problem's rows.

    Attributes
    ----------
    rows : WhitenedRows
        The rows, with the problem that they are of.
    thresholds : ndarray, shape (n,) or (K, 1)
        Largest whitened residual of each joint, or with contacts largest norm of each sample's,
        that counts with its square.
    """

    rows: WhitenedRows
    thresholds: Array

    @classmethod
    def of(
        cls, problem: Problem, *, threshold: float, deviations: ArrayLike | None = None
    ) -> HuberLoss:
        """Build with a threshold in standard deviations.

        Parameters
        ----------
        problem : Problem
            Whose rows count.
        threshold : float
            In standard deviations of a joint's whitened residual.
        deviations : array_like, shape (n,) or (), optional
            Those deviations; by default robustly estimated. With contacts there is one.

        Raises
        ------
        DataError
            When a number is not positive, or the weighting has no rows.
        """
        if not (np.isfinite(threshold) and threshold > 0.0):
            raise DataError(f"Huber loss: the threshold is {threshold}; give a positive number.")
        rows = WhitenedRows(problem)
        scale = rows.scale(threshold)
        if deviations is None:
            return cls(rows, frozen(scale * _deviations(rows, scale)))
        shape = () if rows.together else (problem.robot.n,)
        given = np.broadcast_to(np.asarray(deviations, dtype=np.float64), shape)
        if not np.all(np.isfinite(given) & (given > 0.0)):
            raise DataError(f"Huber loss: deviations are {given}; give positive numbers.")
        return cls(rows, frozen(scale * given))

    def cost(self, base: Array) -> float:
        """Return the Huber cost of base parameters, without a prior's."""
        size = self.rows.size(self.rows.residuals(base))
        t = self.thresholds
        return float(np.where(size <= t, size**2, 2.0 * t * size - t**2).sum())

    def weights(self, base: Array) -> Array:
        """Return ``min(1, t/|r|)`` of every row, (K, n), or of every sample, (K, 1)."""
        size = self.rows.size(self.rows.residuals(base))
        return np.asarray(self.thresholds / np.maximum(size, self.thresholds))

    def majorized(self, base: Array) -> Problem:
        """Return the weighted problem whose cost is nowhere below and touches at `base`."""
        size = self.rows.size(self.rows.residuals(base))
        t = self.thresholds
        weights = t / np.maximum(size, t)
        A, rhs, floor = self.rows.compressed(weights).split()
        constant = float(np.maximum(t * size - t**2, 0.0).sum())
        problem = self.rows.problem
        return replace(
            problem,
            A=frozen(A),
            rhs=frozen(rhs),
            floor=floor + constant,
            sigma=frozen(self.rows.weighted_sigma(weights)),
        ).with_origin(constant=constant)

    def curvature(self, base: Array, T: Array) -> Array:
        """Return half the second derivative of the cost along the columns of T (b, r), (r, r)."""
        residuals = self.rows.residuals(base)
        size, t = self.rows.size(residuals), self.thresholds
        if not self.rows.together:
            # Rows beyond their threshold have none.
            R = self.rows.compressed((size <= t).astype(float)).split()[0] @ T
            return np.asarray(R.T @ R)
        weights = t / np.maximum(size, t)
        R = self.rows.compressed(weights).split()[0] @ T
        # A sample beyond it has none along its residual.
        along = np.where(size > t, residuals / np.maximum(size, t), 0.0)
        r = self.rows.along(np.sqrt(weights) * along) @ T
        return np.asarray(R.T @ R - r.T @ r)

    def bound(self, estimate: Estimate) -> float:
        """Return what the Huber cost of feasible parameters is at least, prior included.

        Parameters
        ----------
        estimate : Estimate
            Of a problem that `majorized` made. What proves its optimum, with the multiplier y of
            the compressed residual, proves this: u with W^T u = A^T y takes the place of y.
        """
        problem = estimate.problem
        theta = None if estimate.theta is None else np.array(estimate.theta)
        proven = lower_bound(problem, theta, estimate.proof, estimate.cost)
        y = proven.multipliers.y[: problem.base.count]
        target = problem.A.T @ y
        u = self._multipliers(problem, y, target)
        pulled = self.rows.pull(u)
        constant = -float((u * u).sum()) - 2.0 * float(pulled[-1])
        replaced = problem.floor - float(y @ y) - 2.0 * float(y @ problem.rhs)
        # What is left of the linear term, at its smallest within the bounds on theta.
        left = 2.0 * problem.base.matrix.T @ (pulled[:-1] - target)
        ends = np.where(left > 0.0, problem.feasible.lower, problem.feasible.upper)
        return float(proven.value + constant - replaced + left @ ends)

    def _multipliers(self, problem: Problem, y: Array, target: Array) -> Array:
        """Return u (K, n) below the thresholds, with ``W^T u = target`` where there is room."""
        t, rows = self.thresholds, self.rows
        base = least_squares(problem.A, y + problem.rhs)
        u = rows.clipped(rows.residuals(base), t)
        whole = 0
        for _ in range(_CORRECTIONS):
            missing = target - self.rows.pull(u)[:-1]
            room = (rows.size(u) < t * (1.0 - _ROOM)).astype(float)
            R = self.rows.compressed(room).split()[0]
            root = information_root(R)
            step = root @ (root.T @ missing)
            wanted = u + room * self.rows.times(np.append(step, 0.0))
            u = rows.clipped(wanted, t)
            whole += np.array_equal(u, wanted)
            if whole == _WHOLE:
                break
        return u


def _deviations(rows: WhitenedRows, scale: Array) -> Array:
    """Return the standard deviation of whitened residuals, from a robust fit: (n,) or ()."""
    problem = rows.problem
    used = rows.independent
    # Residuals of a fit are smaller than the errors.
    grow = np.sqrt(used / max(used - problem.base.count, 1))
    least = rows.rms(rows.residuals(np.zeros(problem.base.count)))
    least = _LEAST_DEVIATION * np.maximum(least, float(least.max()))
    least = np.where(least > 0.0, least, 1.0)
    base = solve_wls(problem).base
    found = np.maximum(grow * rows.median(rows.residuals(base)), least)
    for _ in range(_DEVIATION_ROUNDS):
        loss = HuberLoss(rows, scale * found)
        base = solve_wls(loss.majorized(base)).base
        updated = np.maximum(grow * rows.median(rows.residuals(base)), least)
        settled = np.allclose(updated, found, rtol=_DEVIATION_SETTLED)
        found = updated
        if settled:
            break
    return np.asarray(found)
