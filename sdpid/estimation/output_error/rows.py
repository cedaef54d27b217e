"""Rows of a linearized simulation: positions instead of efforts, sensitivities for a regressor."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen
from sdpid.estimation.compression.covariance import JointRows, correlation_time
from sdpid.estimation.compression.factor import Factor
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.triangle import Triangle
from sdpid.estimation.compression.whitening import compress
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem

T = TypeVar("T")

# What the cost of these problems is, for all that show them.
MEANING = "the last linearized problem, and no more"

# Least variance of a joint's positions, as a share of the largest: simulated logs without noise
# would otherwise weigh one joint by rounding.
_LEAST = 1e-6

# Rounds in which the joints' variances settle.
_ROUNDS = 5


@dataclass(frozen=True)
class SensitivityRows(RowSource):
    """Rows ``[S | S·β_0 + q − q_s(β_0)]`` of positions about parameters β_0.

    S is the derivative of the simulated positions q_s by the base parameters, and the last column
    takes the place of the efforts: its residual is that of the linearized simulation.

    Attributes
    ----------
    samples : Samples
        As measured; rows that efforts are masked at count all the same.
    slopes : ndarray, shape (K, n, b)
        S.
    target : ndarray, shape (K, n)
        The last column, rad (m).
    """

    slopes: Array
    target: Array

    def map(
        self, function: Callable[..., T], *arguments: object, sigma: Array | None = None
    ) -> list[T]:
        """Apply a function to the rows of each piece; as `RowSource.map`."""
        found = []
        for part, piece in zip(self.samples.parts, self.samples.pieces, strict=True):
            own = () if sigma is None else (sigma if sigma.ndim == 2 else sigma[part],)
            rows = replace(self, samples=piece, slopes=self.slopes[part], target=self.target[part])
            found.append(function(rows, *own, *arguments))
        return found

    @cached_property
    def reached(self) -> Mask:
        """At which columns rows may not be zero: at all, for a force at one joint moves all."""
        return np.ones((self.robot.n, self.base.count + 1), dtype=bool)

    def regressor(self, part: slice) -> Array:
        """Return the derivative of some positions, shape (k, n, b)."""
        return self.slopes[part]

    def rows(self, part: slice, out: Array | None = None) -> Array:
        """Return the derivative with the target as last column; as `RowSource.rows`."""
        slopes = self.slopes[part]
        if out is None:
            out = np.empty((*slopes.shape[:2], slopes.shape[2] + 1))
        rows = out[: len(slopes)]
        rows[:, :, :-1], rows[:, :, -1] = slopes, self.target[part]
        return rows

    def mask(self, part: slice) -> Mask:
        """Return which rows are used: all, for reversals spoil efforts, not positions."""
        return np.ones(self.target[part].shape, dtype=bool)

    def chunks(self, size: int = 0) -> Iterator[tuple[slice, Array, Array, Mask]]:
        """Yield (slice, derivative, target, mask); as `RowSource.chunks`."""
        for part in self.parts(size):
            yield part, self.slopes[part], self.target[part], self.mask(part)

    @property
    def hashed(self) -> tuple[Array, ...]:
        """What the rows are made of beside the samples, for their digest."""
        return self.slopes, self.target


def position_covariance(rows: SensitivityRows) -> Array:
    """Estimate a diagonal covariance (n, n) of positions from residuals of the linear fit.

    As for efforts, one variance a joint, times the number of samples that make an independent one.
    """
    joints = JointRows.merged(rows.map(JointRows.of))
    variance = np.ones(rows.robot.n)
    base = np.zeros(rows.base.count)
    for _ in range(_ROUNDS):
        base, rank = joints.fit(variance)
        freedom = np.maximum(joints.used * (1.0 - rank / joints.used.sum()), 1.0)
        found = joints.squared_residuals(base) / freedom
        variance = np.maximum(found, max(_LEAST * float(found.max()), np.finfo(float).tiny))
    return np.diag(variance * correlation_time(rows, base, joints))


def linearized(problem: Problem, rows: RowSource, factor: Factor) -> Problem:
    """Return the problem of other rows under the same constraints and prior."""
    return replace(
        problem,
        sigma=frozen(factor.sigma),
        A=frozen(factor.A),
        rhs=frozen(factor.rhs),
        floor=factor.floor,
        n_samples=rows.n_samples,
        n_rows=factor.used,
        rows=rows,
    ).with_origin(meaning=MEANING)


def compressed(rows: SensitivityRows, sigma: Array) -> Factor:
    """Weight and compress rows of positions with a covariance (n, n)."""
    triangle, used = Triangle(rows.base.count + 1), 0
    for piece, count in rows.map(compress, sigma=sigma):
        triangle.merge(piece)
        used += count
    return Factor(sigma, *triangle.split(), used)


def cost_in(problem: Problem, estimate: Estimate) -> float:
    """Return what an estimate costs in another problem, the prior's part included."""
    if problem.prior is None or estimate.theta is None:
        return problem.cost(estimate.base)
    return problem.cost_of(estimate.theta)
