"""Least squares with standard errors by blocks of time, in which neighbors may be alike."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sdpid._common.arrays import Array

# Stretches of a recording whose errors count as independent.
BLOCKS = 20
# What is this many standard errors from 0 is sure.
SURE = 5.0
# Directions count whose error is below this share of what matters.
_KNOWN = 0.5


def block_error(scores: Array) -> Array:
    """Return the standard error of the sum of scores (N, ...) over their rows."""
    sums = np.array([part.sum(axis=0) for part in np.array_split(scores, BLOCKS)])
    return np.asarray(np.sqrt(np.sum(sums**2, axis=0)))


def pooled(values: Array, errors: Array) -> tuple[float, float]:
    """Return the mean of values with errors, and its error, in which their spread counts."""
    errors = np.maximum(errors, 1e-3 * np.abs(values).max(initial=1e-9))
    spread = 0.0
    for _ in range(20):
        weights = 1.0 / (errors**2 + spread)
        mean = float(weights @ values / weights.sum())
        # The spread between values that makes the deviations as large as their errors say.
        excess = float(weights @ (values - mean) ** 2) - (len(values) - 1)
        if excess <= 0.0 and spread == 0.0:
            break
        spread = max(0.0, spread + excess / float(weights.sum()))
    return mean, float(1.0 / np.sqrt(weights.sum()))


def orthonormal(columns: Array, rank: float) -> tuple[Array, Array]:
    """Return an orthonormal basis of columns, and the way from it to their weights.

    Directions with less than a share `rank` of the largest singular value are noise.
    """
    size = np.linalg.norm(columns, axis=0)
    inverse = np.where(size > 0.0, 1.0 / np.where(size > 0.0, size, 1.0), 0.0)
    scaled = columns * inverse
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    kept = values > rank**2 * values[-1]
    back = vectors[:, kept] / np.sqrt(values[kept])
    return np.asarray(scaled @ back), np.asarray(inverse[:, None] * back)


def beyond(basis: Array, values: Array) -> Array:
    """Return what of values, in any shape, an orthonormal basis of columns does not make up."""
    flat = values.ravel()
    return np.asarray((flat - basis @ (basis.T @ flat)).reshape(values.shape))


class BlockFit(NamedTuple):
    """Coefficients (p,), their covariance, and the root mean square of what they leave.

    `filled` is the number of blocks of time that have rows.
    """

    values: Array
    covariance: Array
    left: float
    filled: int

    @property
    def errors(self) -> Array:
        """Standard errors of the coefficients, (p,)."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)))


def block_fit(columns: Array, signal: Array, scale: Array) -> BlockFit:
    """Return the coefficients of columns (K, m, p) that make up a signal (K, m).

    Coefficients of the size `scale` (p,) are as large as any can be: directions that the data do
    not show are known to be within it. Rows of zeros are none.
    """
    parts = zip(np.array_split(columns, BLOCKS), np.array_split(signal, BLOCKS), strict=True)
    flat = [(A.reshape(-1, A.shape[-1]), y.ravel()) for A, y in parts]
    each, right = np.array([A.T @ A for A, _ in flat]), np.array([A.T @ y for A, y in flat])
    whole, total, power = each.sum(axis=0), right.sum(axis=0), float(np.sum(signal**2))
    count = max(int(np.count_nonzero(columns.any(axis=-1))), 1)
    values, rest = np.zeros(len(scale)), power
    # What is known beforehand weighs as much as the noise says, which comes first.
    for _ in range(2):
        # Of a signal of zeros, which has none, any will do.
        noise = (max(rest, 1e-12 * power) or 1.0) / count
        inverse = np.linalg.inv(whole + np.diag(noise / scale**2))
        values = inverse @ total
        rest = max(power - 2.0 * values @ total + values @ whole @ values, 0.0)
    scores = right - each @ values
    scores -= scores.mean(axis=0)
    spread = scores.T @ scores * (len(scores) / (len(scores) - 1.0))
    spread += np.diag((noise / scale) ** 2)
    covariance, filled = inverse @ spread @ inverse, int(np.count_nonzero(each.any(axis=(1, 2))))
    return BlockFit(values, covariance, float(np.sqrt(rest / count)), filled)


def sure_part(value: Array, covariance: Array, size: float) -> tuple[Array, float] | None:
    """Return the part of a value that is known, and its error, where it is large and sure.

    Directions that the data hardly show are left as they were stated.
    """
    variances, axes = np.linalg.eigh(covariance)
    known = variances < (_KNOWN * size) ** 2
    if not known.any():
        return None
    parts = axes.T[known] @ value
    deviations = float(np.sqrt(np.mean(parts**2 / np.maximum(variances[known], 1e-30))))
    if deviations < SURE or float(np.linalg.norm(parts)) < size:
        return None
    return axes[:, known] @ parts, float(np.sqrt(variances[known].max()))
