"""Fit a linear law to signals of a controller: least squares or instruments, delay, errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.simulation.tracking import Tracking

# Where noise may take more than this part of a gain, the commanded motion serves as instruments.
_BIAS = 0.02
# A delay is taken where it is this many deviations from zero, up to this many seconds.
_SURE, _LONGEST = 4.0, 0.02
# Contiguous blocks whose scores count as independent: of this many rows at least, some periods of
# the filter's cut-off.
_MOST_BLOCKS, _LEAST_BLOCKS, _ROWS_OF_BLOCK = 40, 10, 20
# Width of the smooth sign of a commanded velocity, rad/s.
_WIDTH = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class Law:
    """What is to be explained, and by what.

    Attributes
    ----------
    columns : ndarray, shape (n, K, m)
        Regressors of each joint: position error, velocity (error), integral; last a constant.
    target, target_rate : ndarray, shape (n, K)
        The effort, and its rate.
    velocity : int
        Which column has the measured velocity, with its noise; the first has the position.
    feedforward : bool
        Whether the commanded velocity is in the law.
    """

    columns: Array
    target: Array
    target_rate: Array
    velocity: int = 1
    feedforward: bool = True

    @classmethod
    def of(cls, columns: Sequence[Array], target: Array, rate: Array, **others: Any) -> Law:
        """Stack columns (K, n) of all joints, and a constant."""
        table = np.stack([*columns, np.ones_like(target)], axis=-1).transpose(1, 0, 2)
        return cls(columns=table, target=target.T, target_rate=rate.T, **others)

    def with_column(self, column: Array) -> Law:
        """Return the law with one more regressor (K, n), before the constant."""
        one = self.columns[:, :, -1:]
        table = np.concatenate([self.columns[:, :, :-1], column.T[..., None], one], axis=-1)
        return replace(self, columns=table)


@dataclass(frozen=True, kw_only=True, eq=False)
class LawFit:
    """A law with its weights.

    Attributes
    ----------
    law : Law
        What was fitted.
    weights : ndarray, shape (n, m)
        Of the columns.
    covariances : ndarray, shape (n, m, m)
        Of the weights, from blocks of residuals.
    left : ndarray, shape (n,)
        Part of the target's variance that is left.
    bias : ndarray, shape (n,)
        The largest part of a gain that noise may take from least squares.
    delay : float
        Of the target against the law, s.
    instrumental : bool
        Whether instruments were used.
    """

    law: Law
    weights: Array
    covariances: Array
    left: Array
    bias: Array
    delay: float
    instrumental: bool

    @property
    def variances(self) -> Array:
        """Variances of the weights but the constants', (n, m - 1)."""
        return np.asarray(np.einsum("jmm->jm", self.covariances)[:, :-1])


def fit_law(signals: Tracking, law: Law) -> LawFit:
    """Fit the weights of a law."""
    noise = np.zeros((len(law.columns), law.columns.shape[2]))
    noise[:, 0], noise[:, law.velocity] = signals.position_noise, signals.velocity_noise
    own = [0, law.velocity]
    weights = np.stack([_solved(X, X, y) for X, y in zip(law.columns, law.target, strict=True)])
    bias = np.empty(len(weights))
    for j, X in enumerate(law.columns):
        lost = np.linalg.lstsq(X.T @ X, len(X) * noise[j] * weights[j])[0]
        bias[j] = np.max(np.abs(lost[own]) / np.maximum(np.abs(weights[j, own]), 1e-300))
    instrumental = bool(bias.max() > _BIAS)
    delay, delay_variance, target = 0.0, 0.0, law.target
    seen = law.columns
    if instrumental:
        Z = _instruments(signals)
        seen = np.stack([Z @ np.linalg.lstsq(Z, X)[0] for X in law.columns])
    else:
        delay, delay_variance = _delay(law)
        if delay**2 <= _SURE**2 * delay_variance or abs(delay) > _LONGEST:
            delay, delay_variance = 0.0, 0.0
        target = law.target + delay * law.target_rate
    parts = [
        _with_errors(Z, X, y, rate, delay_variance)
        for Z, X, y, rate in zip(seen, law.columns, target, law.target_rate, strict=True)
    ]
    weights, covariances, left = (np.stack([part[k] for part in parts]) for k in range(3))
    return LawFit(
        law=law,
        weights=weights,
        covariances=covariances,
        left=left,
        bias=bias,
        delay=delay,
        instrumental=instrumental,
    )


def _solved(Z: Array, X: Array, y: Array) -> Array:
    """Solve Zᵀ(y − X·w) = 0 for w, columns scaled."""
    size = np.sqrt(np.mean(X * X, axis=0))
    size[size == 0.0] = 1.0
    found = np.linalg.lstsq((Z / size).T @ (X / size), (Z / size).T @ y)[0]
    return np.asarray(found / size)


def _with_errors(
    Z: Array, X: Array, y: Array, rate: Array, delay_variance: float
) -> tuple[Array, Array, Array]:
    """Return weights, their covariance and the part of the variance that is left."""
    w = _solved(Z, X, y)
    residual = y - X @ w
    size = np.sqrt(np.mean(X * X, axis=0))
    size[size == 0.0] = 1.0
    inverse = np.linalg.pinv((Z / size).T @ (X / size)) / size[:, None]
    scores = _block_sums((Z / size) * residual[:, None])
    spread = inverse @ scores.T
    # As many blocks as weights less.
    factor = len(scores) / (len(scores) - X.shape[1])
    covariance = factor * spread @ spread.T
    if delay_variance > 0.0:
        moved = _solved(Z, X, rate)
        covariance = covariance + delay_variance * np.outer(moved, moved)
    variance = max(float(np.var(y)), 1e-300)
    return w, covariance, np.asarray(np.mean(residual**2) / variance)


def _block_sums(rows: Array) -> Array:
    """Return the sums over contiguous blocks of rows, (blocks, m)."""
    count = min(max(len(rows) // _ROWS_OF_BLOCK, _LEAST_BLOCKS), _MOST_BLOCKS)
    starts = np.linspace(0, len(rows), count, endpoint=False).astype(np.intp)
    return np.asarray(np.add.reduceat(rows, starts, axis=0))


def _delay(law: Law) -> tuple[float, float]:
    """Return by how much targets are later than the law, and the variance of that.

    The target at t + d, to first order in d, follows from the regressors at t.
    """
    top, bottom = 0.0, 0.0
    moves = []
    for X, y, rate in zip(law.columns, law.target, law.target_rate, strict=True):
        rest, move = (each - X @ _solved(X, X, each) for each in (y, rate))
        weight = 1.0 / max(float(np.mean(rest**2)), 1e-12 * float(np.mean(y**2)), 1e-300)
        moves.append((weight, rest, move))
        top -= weight * float(move @ rest)
        bottom += weight * float(move @ move)
    if bottom <= 0.0:
        return 0.0, 0.0
    delay = top / bottom
    each = [weight * move * (rest + delay * move) for weight, rest, move in moves]
    scores = _block_sums(np.sum(each, axis=0)[:, None])[:, 0]
    return delay, float(scores @ scores) / bottom**2


def _instruments(signals: Tracking) -> Array:
    """Return what the commanded motion alone says, (K, 4n + 1)."""
    v = signals.reference_velocity
    parts = [signals.reference, v, signals.reference_acceleration, np.tanh(v / _WIDTH)]
    table = np.column_stack([*parts, np.ones(len(v))])
    size = np.sqrt(np.mean(table * table, axis=0))
    size[size == 0.0] = 1.0
    return np.asarray(table / size)
