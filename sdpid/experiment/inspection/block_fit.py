"""`BlockSums`: least squares of any of some columns, with standard errors by blocks of time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array

# Stretches of a recording whose errors count as independent.
_BLOCKS = 20
# What is this many standard errors from 0 is sure.
SURE = 5.0
# Directions count whose error is below this share of what matters.
_KNOWN = 0.5


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockFit:
    """Coefficients of the chosen columns.

    Attributes
    ----------
    chosen : tuple of int
        Numbers of the columns, p in all.
    values : ndarray, shape (p,)
        Their coefficients.
    covariance : ndarray, shape (p, p)
        Of the coefficients.
    left : float
        Root mean square of what they leave of the signal.
    """

    chosen: tuple[int, ...]
    values: Array
    covariance: Array
    left: float

    @property
    def errors(self) -> Array:
        """Standard errors of the coefficients, (p,)."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)))

    def of(self, columns: Sequence[int]) -> tuple[Array, Array]:
        """Return coefficients of some of the chosen columns, and their covariance."""
        at = [self.chosen.index(column) for column in columns]
        return self.values[at], self.covariance[np.ix_(at, at)]


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockSums:
    """Normal equations of blocks of time.

    Attributes
    ----------
    matrix, vector : ndarray, shapes (blocks, p, p), (blocks, p)
        Of all columns.
    power : float
        Sum of squares of the signal.
    count : int
        Rows of the signal.
    scale : ndarray, shape (p,)
        Coefficients of this size are as large as any can be: they make directions that the data do
        not show known to be within it.
    """

    matrix: Array
    vector: Array
    power: float
    count: int
    scale: Array

    @classmethod
    def of(cls, columns: Array, signal: Array, scale: Array, count: int | None = None) -> BlockSums:
        """Sum up columns (K, m, p) and a signal (K, m), of which `count` values are not masked."""
        parts = zip(np.array_split(columns, _BLOCKS), np.array_split(signal, _BLOCKS), strict=True)
        flat = [(A.reshape(-1, A.shape[-1]), y.ravel()) for A, y in parts]
        return cls(
            matrix=np.array([A.T @ A for A, _ in flat]),
            vector=np.array([A.T @ y for A, y in flat]),
            power=float(np.sum(signal**2)),
            count=signal.size if count is None else count,
            scale=scale,
        )

    @property
    def filled(self) -> int:
        """Number of blocks with rows."""
        return int(np.count_nonzero(np.einsum("bii->b", self.matrix)))

    def plus(self, other: BlockSums) -> BlockSums:
        """Return the sums of two signals with the same coefficients in the same blocks."""
        return replace(
            self,
            matrix=self.matrix + other.matrix,
            vector=self.vector + other.vector,
            power=self.power + other.power,
            count=self.count + other.count,
        )

    def fit(self, chosen: Sequence[int]) -> BlockFit:
        """Return the coefficients of some columns, those of the others being 0."""
        at = np.asarray(chosen, dtype=np.intp)
        each, right = self.matrix[:, at[:, None], at], self.vector[:, at]
        whole, total = each.sum(axis=0), right.sum(axis=0)
        values = np.zeros(len(at))
        # What is known beforehand weighs as much as the noise says, which comes first.
        for _ in range(2):
            rest = self.power - 2.0 * values @ total + values @ whole @ values
            noise = max(rest, 1e-12 * self.power) / self.count
            inverse = np.linalg.inv(whole + np.diag(noise / self.scale[at] ** 2))
            values = inverse @ total
        rest = max(self.power - 2.0 * values @ total + values @ whole @ values, 0.0)
        scores = right - each @ values
        scores -= scores.mean(axis=0)
        spread = scores.T @ scores * (len(scores) / (len(scores) - 1.0))
        spread += np.diag((noise / self.scale[at]) ** 2)
        return BlockFit(
            chosen=tuple(int(i) for i in at),
            values=values,
            covariance=inverse @ spread @ inverse,
            left=float(np.sqrt(rest / self.count)),
        )


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
