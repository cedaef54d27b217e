"""The Huber loss of whitened residuals: its value, its majorizer, and a lower bound that proves.

The loss of a whitened residual r with the threshold t is rho(r) = r² up to t and 2·t·|r| − t²
beyond [huber1964]_. Two facts carry everything here. With w = min(1, t/|r0|),

    rho(r) ≤ w·r² + c(r0),   c(r0) = max(0, t·|r0| − t²),

with equality at r0: least squares with weighted rows lie above the Huber cost. And for every u
with |u| ≤ t,

    rho(r) ≥ 2·u·r − u²,

so that any such u for every row gives a linear lower bound of the Huber cost.

The threshold is in standard deviations of a single whitened residual. That deviation is not one:
weights may count correlated samples as fewer, belong to one period where the efforts are means of
many, or be missing altogether. It is therefore taken from the residuals themselves, joint by
joint, as the median of their size in a robust fit without constraints. The median looks at
residuals one at a time, so it is right for correlated ones too. Then it is fixed, and the loss is
convex.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, Mask, frozen
from sdpid.errors import DataError
from sdpid.estimation.compression.covariance import whitener
from sdpid.estimation.compression.rows import CHUNK
from sdpid.estimation.compression.triangle import Triangle
from sdpid.estimation.compression.whitening import whitened_chunks
from sdpid.estimation.duality.refine_multipliers import lower_bound
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.estimation.wls import solve_wls

# The median size of a standard normal variable.
_NORMAL_MEDIAN = 0.6744897501960817

# A deviation is at least this share of the joint's whitened efforts: exact data leave residuals
# of rounding, which are no measure of anything.
_LEAST_DEVIATION = 1e-9

# The deviation need not be found precisely, only once and for all.
_DEVIATION_ROUNDS = 30
_DEVIATION_SETTLED = 1e-3

# Whitened rows up to this size in bytes are kept between rounds, larger ones made again.
_KEPT = 4e8

# How often u is corrected at most.
_CORRECTIONS = 12

# A step that no row's threshold stopped leaves rounding, which another such step takes.
_WHOLE = 2

# A row whose u is within this share of its threshold has no room left for corrections.
_ROOM = 1e-9


class WhitenedRows:
    """The whitened rows of a problem, kept between rounds where they are not too large."""

    def __init__(self, problem: Problem) -> None:
        if problem.weighting in ("eq9", "eq18"):
            raise DataError(
                f"a robust cost is a sum over rows; the weighting '{problem.weighting}' is one "
                "over normal equations. Use 'gls', 'gls_per_sample' or 'residual'."
            )
        self.problem = problem
        self._kept: list[tuple[slice, Array, Mask]] = []
        self.rows = problem.require_rows_here("solve_robust")
        samples, n = problem.samples.effort.shape
        self._keeps = 8.0 * samples * n * (problem.base.count + 1) <= _KEPT

    def chunks(self) -> Iterator[tuple[slice, Array, Mask]]:
        """Yield (slice, rows (k, n, b + 1) with the efforts last, mask)."""
        if self._kept:
            yield from self._kept
            return
        made = []
        chunks = whitened_chunks(self.rows, self.problem.sigma, keep=self._keeps)
        for part, rows, mask in chunks:
            if self._keeps:
                made.append((part, rows, mask))
            yield part, rows, mask
        self._kept = made

    def residuals(self, base: Array) -> Array:
        """Return the whitened residuals ``W @ base − effort``, (K, n), 0 where masked."""
        return self.times(np.append(base, -1.0))

    def times(self, vector: Array) -> Array:
        """Return the rows, efforts last, times a vector (b + 1,), as (K, n)."""
        return np.concatenate([rows @ vector for _, rows, _ in self.chunks()])

    def compressed(self, weights: Array) -> Triangle:
        """Return the triangle of the rows times the square roots of weights (K, n)."""
        triangle = Triangle(self.problem.base.count + 1)
        for part, rows, _ in self.chunks():
            weighted = np.sqrt(weights[part])[:, :, None] * rows
            triangle.add(weighted.reshape(-1, rows.shape[2]))
        return triangle

    def pull(self, u: Array) -> Array:
        """Return ``W^T u`` and ``effort·u`` of multipliers (K, n), together (b + 1,)."""
        total = np.zeros(self.problem.base.count + 1)
        for part, rows, _ in self.chunks():
            total += np.einsum("kib,ki->b", rows, u[part])
        return total


@dataclass(frozen=True, eq=False)
class HuberLoss:
    """The Huber loss of a problem's rows.

    Attributes
    ----------
    rows : WhitenedRows
        The rows, with the problem that they are of.
    thresholds : ndarray, shape (n,)
        Largest whitened residual of each joint that counts with its square.
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
            Those deviations; by default robustly estimated.

        Raises
        ------
        DataError
            When a number is not positive, or the weighting has no rows.
        """
        if not (np.isfinite(threshold) and threshold > 0.0):
            raise DataError(f"Huber loss: the threshold is {threshold}; give a positive number.")
        rows = WhitenedRows(problem)
        if deviations is None:
            return cls(rows, frozen(threshold * _deviations(rows, threshold)))
        given = np.broadcast_to(np.asarray(deviations, dtype=np.float64), (problem.robot.n,))
        if not np.all(np.isfinite(given) & (given > 0.0)):
            raise DataError(f"Huber loss: deviations are {given}; give positive numbers.")
        return cls(rows, frozen(threshold * given))

    def cost(self, base: Array) -> float:
        """Return the Huber cost of base parameters, without a prior's."""
        size = np.abs(self.rows.residuals(base))
        t = self.thresholds
        return float(np.where(size <= t, size**2, 2.0 * t * size - t**2).sum())

    def weights(self, base: Array) -> Array:
        """Return ``min(1, t/|r|)`` of every row, (K, n)."""
        size = np.abs(self.rows.residuals(base))
        return np.asarray(self.thresholds / np.maximum(size, self.thresholds))

    def majorized(self, base: Array) -> Problem:
        """Return the weighted problem whose cost is nowhere below and touches at `base`."""
        size = np.abs(self.rows.residuals(base))
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
            constant=constant,
            sigma=frozen(_weighted_sigma(problem, weights)),
        )

    def curvature(self, base: Array) -> Array:
        """Return half the second derivative of the cost, (b, b): of the rows below thresholds."""
        inside = np.abs(self.rows.residuals(base)) <= self.thresholds
        R = self.rows.compressed(inside.astype(float)).split()[0]
        return np.asarray(R.T @ R)

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
        from scipy.linalg import lstsq

        t = self.thresholds
        scale = np.linalg.norm(problem.A, axis=0)
        scale = np.where(scale > 0.0, scale, 1.0)
        base = lstsq(problem.A / scale, y + problem.rhs)[0] / scale
        u = np.clip(self.rows.residuals(base), -t, t)
        whole = 0
        for _ in range(_CORRECTIONS):
            missing = target - self.rows.pull(u)[:-1]
            room = (np.abs(u) < t * (1.0 - _ROOM)).astype(float)
            R = self.rows.compressed(room).split()[0]
            size = np.linalg.norm(R, axis=0)
            size = np.where(size > 0.0, size, 1.0)
            step = lstsq(R / size, lstsq((R / size).T, missing / size)[0])[0] / size
            wanted = u + room * self.rows.times(np.append(step, 0.0))
            u = np.clip(wanted, -t, t)
            whole += np.array_equal(u, wanted)
            if whole == _WHOLE:
                break
        return u


def _deviations(rows: WhitenedRows, threshold: float) -> Array:
    """Return the standard deviation of every joint's whitened residuals, from a robust fit."""
    problem = rows.problem
    mask = rows.rows.mask(slice(None))
    used = int(mask.sum())
    # Residuals of a fit are smaller than the errors.
    grow = np.sqrt(used / max(used - problem.base.count, 1))
    joints = [np.flatnonzero(mask[:, j]) for j in range(mask.shape[1])]

    def median(values: Array) -> Array:
        found = [
            np.median(np.abs(values[own, j])) if own.size else 1.0 for j, own in enumerate(joints)
        ]
        return np.asarray(np.array(found) / _NORMAL_MEDIAN)

    efforts = rows.residuals(np.zeros(problem.base.count))
    mean = np.sqrt((efforts**2).sum(axis=0) / np.maximum(mask.sum(axis=0), 1))
    least = _LEAST_DEVIATION * np.maximum(mean, float(mean.max()))
    least = np.where(least > 0.0, least, 1.0)
    base = solve_wls(problem).base
    found = np.maximum(grow * median(rows.residuals(base)), least)
    for _ in range(_DEVIATION_ROUNDS):
        loss = HuberLoss(rows, threshold * found)
        base = solve_wls(loss.majorized(base)).base
        updated = np.maximum(grow * median(rows.residuals(base)), least)
        settled = np.allclose(updated, found, rtol=_DEVIATION_SETTLED)
        found = updated
        if settled:
            break
    return np.asarray(found)


def _weighted_sigma(problem: Problem, weights: Array) -> Array:
    """Return covariances (K, n, n) under which plain weighting is weighting of whitened rows."""
    rows = problem.require_rows_here("solve_robust")
    samples, n = rows.samples.effort.shape
    out = np.empty((samples, n, n))
    for start in range(0, samples, CHUNK):
        part = slice(start, start + CHUNK)
        used = rows.mask(part)
        sigma = problem.sigma if problem.sigma.ndim == 2 else problem.sigma[part]
        root = whitener(sigma, used, 0.5)
        out[part] = (root / weights[part][:, None, :]) @ root
    return out
