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
they are. A threshold of t deviations is then the one that as many of normal errors exceed. So
residuals (K, n) fall into groups (K, g) whose norms count: g is n, or 1 with contacts.

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
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen
from sdpid.errors import DataError
from sdpid.estimation.compression.rows import CHUNK
from sdpid.estimation.compression.triangle import Triangle
from sdpid.estimation.compression.whitening import weights as powers_of
from sdpid.estimation.compression.whitening import weights_and_shares, whitened_chunks
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.information import information_root, least_squares
from sdpid.estimation.problem import Problem
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

# The median size of a standard normal variable.
_NORMAL_MEDIAN = 0.6744897501960817

# Whitened rows up to this size in bytes are kept between rounds, larger ones made again.
_KEPT = 4e8


class WhitenedRows:
    """The whitened rows of a problem, kept between rounds where they are not too large.

    Attributes
    ----------
    problem : Problem
        Whose rows.
    groups : int
        Losses a sample, g: one a row, or a single one where contacts tie the rows together.
    """

    def __init__(self, problem: Problem) -> None:
        problem.require_plain("solve_robust")
        self.problem = problem
        self.rows = problem.require_rows_here("solve_robust")
        samples, n = problem.samples.effort.shape
        self.groups = n if self.rows.samples.contacts is None else 1
        self._keeps = 8.0 * samples * n * (problem.base.count + 1) <= _KEPT
        self._kept: list[tuple[slice, Array]] = []

    def chunks(self) -> Iterator[tuple[slice, Array]]:
        """Yield (slice, rows (k, n, b + 1) with the efforts last)."""
        if self._kept:
            yield from self._kept
            return
        made = []
        for part, rows, _ in whitened_chunks(self.rows, self.problem.sigma):
            if self._keeps:
                made.append((part, rows))
            yield part, rows
        self._kept = made

    def residuals(self, base: Array) -> Array:
        """Return the whitened residuals ``W @ base − effort``, (K, n), 0 where masked."""
        return self.times(np.append(base, -1.0))

    def times(self, vector: Array) -> Array:
        """Return the rows, efforts last, times a vector (b + 1,), as (K, n)."""
        return np.concatenate([rows @ vector for _, rows in self.chunks()])

    def compressed(self, weights: Array) -> Triangle:
        """Return the triangle of the rows times the square roots of weights (K, g)."""
        triangle = Triangle(self.problem.base.count + 1)
        for part, rows in self.chunks():
            weighted = np.sqrt(weights[part])[:, :, None] * rows
            triangle.add(weighted.reshape(-1, rows.shape[2]))
        return triangle

    def pull(self, u: Array) -> Array:
        """Return ``W^T u`` and ``effort·u`` of multipliers (K, n), together (b + 1,)."""
        parts = [np.einsum("kib,ki->b", rows, u[part]) for part, rows in self.chunks()]
        return np.asarray(np.sum(parts, axis=0))

    def size(self, values: Array) -> Array:
        """Return the norms (K, g) of values (K, n)."""
        return np.asarray(np.linalg.norm(self.grouped(values), axis=2))

    def grouped(self, values: Array) -> Array:
        """Return values (K, n, …) as (K, g, n/g, …)."""
        return values.reshape(len(values), self.groups, -1, *values.shape[2:])

    def clipped(self, values: Array, t: Array) -> Array:
        """Return values (K, n) whose norms are at most t (K, g)."""
        return np.asarray(values * (t / np.maximum(self.size(values), t)))

    @cached_property
    def freedom(self) -> Array:
        """Independent rows of each group, (K, g)."""
        if self.groups > 1:
            return self.rows.mask(slice(None)).astype(np.float64)
        sigma = self.problem.sigma
        found = [weights_and_shares(self.rows, part, sigma)[2] for part in self.rows.parts()]
        return np.asarray(np.rint(np.concatenate(found).sum(axis=1))[:, None])

    def quantile(self, threshold: float) -> Array:
        """Return norms (K, g) that as many normal errors exceed as single ones a threshold."""
        from scipy.special import gammainccinv
        from scipy.stats import norm

        if self.groups > 1:
            return np.full(self.freedom.shape, threshold)
        # Chi-squared's quantile; of thresholds that no error exceeds it is finite still.
        share = max(2.0 * norm.sf(threshold), np.finfo(float).tiny)
        return np.asarray(np.sqrt(2.0 * gammainccinv(np.maximum(self.freedom, 1.0) / 2.0, share)))

    def median(self, values: Array) -> Array:
        """Return deviations (g,) of normal values (K, n) of the same median size."""
        ratio, used = self.size(values) / self.quantile(_NORMAL_MEDIAN), self.freedom > 0.0
        pairs = zip(ratio.T, used.T, strict=True)
        return np.array([np.median(own[some]) if some.any() else 1.0 for own, some in pairs])

    def weighted_sigma(self, weights: Array) -> Array:
        """Return covariances (K, n, n) under which plain weighting is that of whitened rows."""
        sigma, (count, n) = self.problem.sigma, self.rows.samples.effort.shape
        out = np.empty((count, n, n))
        for start in range(0, count, CHUNK):
            part = slice(start, start + CHUNK)
            own, w = sigma if sigma.ndim == 2 else sigma[part], weights[part]
            root = np.take(*powers_of(own, self.rows.mask(part), 0.5), axis=0)
            out[part] = (root / w[:, None, :]) @ root
            touching = self.rows.contacts(part)
            if touching is not None:
                # Errors of measured forces, which are added to it, grow as well.
                out[part] += (1.0 / w[:, :, None] - 1.0) * touching.covariance
        return out


@dataclass(frozen=True, eq=False)
class HuberLoss:
    """The Huber loss of a problem's rows.

    Attributes
    ----------
    rows : WhitenedRows
        The rows, with the problem that they are of.
    thresholds : ndarray, shape (K, g)
        Largest whitened residual, or with contacts largest norm of each sample's, that counts with
        its square.
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
        scale = rows.quantile(threshold)
        found = _deviations(rows, scale) if deviations is None else deviations
        given = np.broadcast_to(np.asarray(found, dtype=np.float64), rows.groups)
        if not np.all(np.isfinite(given) & (given > 0.0)):
            raise DataError(f"Huber loss: deviations are {given}; give positive numbers.")
        return cls(rows, frozen(scale * given))

    def cost(self, base: Array) -> float:
        """Return the Huber cost of base parameters, without a prior's."""
        size, t = self.rows.size(self.rows.residuals(base)), self.thresholds
        return float(np.where(size <= t, size**2, 2.0 * t * size - t**2).sum())

    def majorized(self, base: Array) -> Problem:
        """Return the weighted problem whose cost is nowhere below and touches at `base`."""
        size, t = self.rows.size(self.rows.residuals(base)), self.thresholds
        weights = t / np.maximum(size, t)
        A, rhs, floor = self.rows.compressed(weights).split()
        constant = float(np.maximum(t * size - t**2, 0.0).sum())
        return replace(
            self.rows.problem,
            A=frozen(A),
            rhs=frozen(rhs),
            floor=floor + constant,
            sigma=frozen(self.rows.weighted_sigma(weights)),
        ).with_origin(constant=constant)

    def curvature(self, base: Array, T: Array) -> Array:
        """Return half the second derivative of the cost along the columns of T (b, r), (r, r)."""
        rows, t = self.rows, self.thresholds
        residuals = rows.residuals(base)
        size = np.maximum(rows.size(residuals), t)
        found = np.zeros((T.shape[1], T.shape[1]))
        for part, own in rows.chunks():
            w, beyond = np.sqrt(t[part] / size[part]), size[part] > t[part]
            X = rows.grouped(w[:, :, None] * (own[:, :, :-1] @ T))
            # Beyond its threshold a group has none along its residual.
            unit = rows.grouped(residuals[part]) * (beyond / size[part])[:, :, None]
            along = np.einsum("kgi,kgir->kgr", unit, X).reshape(-1, len(found))
            flat = X.reshape(-1, len(found))
            found += flat.T @ flat - along.T @ along
        return found

    def bound(self, estimate: Estimate) -> float:
        """Return what the Huber cost of feasible parameters is at least, prior included.

        Parameters
        ----------
        estimate : Estimate
            Of a problem that `majorized` made. What proves its optimum, with the multiplier y of
            the compressed residual, proves this: u with W^T u = A^T y takes the place of y.
        """
        problem, proven = estimate.problem, estimate.bound()
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
    """Return the standard deviations (g,) of whitened residuals, from a robust fit."""
    problem, count = rows.problem, rows.freedom.sum(axis=0)
    # Residuals of a fit are smaller than the errors.
    grow = np.sqrt(count.sum() / max(count.sum() - problem.base.count, 1))
    efforts = rows.size(rows.residuals(np.zeros(problem.base.count)))
    least = np.sqrt((efforts**2).sum(axis=0) / np.maximum(count, 1.0))
    least = _LEAST_DEVIATION * np.maximum(least, least.max())
    least = np.where(least > 0.0, least, 1.0)
    weighted, found = problem, np.full(rows.groups, np.inf)
    for _ in range(1 + _DEVIATION_ROUNDS):
        base, before = solve_wls(weighted).base, found
        found = np.maximum(grow * rows.median(rows.residuals(base)), least)
        if np.allclose(found, before, rtol=_DEVIATION_SETTLED):
            break
        weighted = HuberLoss(rows, scale * found).majorized(base)
    return np.asarray(found)
