"""Weights of the torque rows: from samples to whitened rows.

Every weighting is turned into one thing: rows to be stacked and compressed. Rows that are
masked are zero afterwards, and the covariance of the others is that of the unmasked joints
alone (masking a joint is not knowing it, not knowing it to be zero).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.errors import DataError
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.triangle import Triangle
from sdpid.estimation.information import fitted

Weighting = Literal["gls", "gls_per_sample", "eq9", "eq18", "residual"]
WEIGHTINGS: tuple[Weighting, ...] = ("gls", "gls_per_sample", "eq9", "eq18", "residual")

# Those whose cost is the norm of the normal equations' residual: no sum over rows, no likelihood.
PRINTED: tuple[Weighting, ...] = ("eq9", "eq18")

# A covariance whose reciprocal condition is below this is singular to working accuracy.
SINGULAR = 1e-12


def masked_covariance(covariance: Array, mask: Mask) -> Array:
    """Return (…, n, n) covariances with masked joints replaced by independent ones."""
    both = mask[..., :, None] & mask[..., None, :]
    # Of the size of the others, so that the condition number is that of the others.
    variance = np.where(mask, np.diagonal(covariance, axis1=-2, axis2=-1), 0.0)
    count = mask.sum(axis=-1)
    size = np.where(count > 0, variance.sum(axis=-1) / np.maximum(count, 1), 1.0)
    filler = size[..., None, None] * (np.eye(mask.shape[-1]) * ~mask[..., :, None])
    return np.asarray(np.where(both, covariance, filler))


def power(covariance: Array, exponent: float) -> Array:
    """Return symmetric powers of covariances (…, n, n).

    Raises
    ------
    DataError
        When one of them is not positive definite to working accuracy.
    """
    values, vectors = np.linalg.eigh(covariance)
    ratio = values[..., 0] / np.maximum(values[..., -1], np.finfo(float).tiny)
    if np.any(ratio < SINGULAR):
        many = f"{np.count_nonzero(ratio < SINGULAR)} of {ratio.size} " if ratio.ndim else ""
        raise DataError(
            f"effort covariance: {many}singular: the smallest eigenvalue is {np.min(ratio):.1e} of "
            f"the largest (limit {SINGULAR:.0e}); use more periods than joints, or shrink it "
            "(Processing.shrinkage)."
        )
    scaled = vectors * values[..., None, :] ** exponent
    return np.asarray(scaled @ np.swapaxes(vectors, -1, -2))


def pooled(covariance: Array) -> Array:
    """Return one covariance for all samples, (n, n) or (K, n, n) to (n, n)."""
    return covariance if covariance.ndim == 2 else np.asarray(covariance.mean(axis=0))


# Least standard deviation: this share of the overall effort, so that one quiet joint cannot
# dominate; but no more than the joint's own effort varies, or any prediction of it would do. Of
# 0.01 and 0.03 held-out errors on eight pairs of real recordings are alike (0.998 in the geometric
# mean), and the friction of wrists, which 0.03 leaves to the prior, is six times as near the truth.
EFFORT_SHARE = 0.01

# Residuals' variance is taken to be at least this share of the one with that share of the effort
# added: a standard deviation of 0.03 % of the effort, less than any sensor's.
LEAST_NOISE = 1e-3

# An effort whose variance is below this share of the mean squared effort of all joints is constant.
SILENT = 1e-12

# Residuals that are alike over more samples than this are a drift: how much longer it lasts says
# nothing of their number, and of long recordings only this much has to be kept, and sent.
_MOST_LAGS = 1 << 14

# The variances settle within a few rounds; this is where it stops at the latest.
ROUNDS = 10


@dataclass(frozen=True, eq=False)
class JointRows:
    """Rows compressed joint by joint, so that other variances need no look at the samples.

    Attributes
    ----------
    triangles : tuple of Triangle
        One a joint, of its rows, efforts last, and a column of ones, not whitened. So their
        products with themselves are sums over rows: of their number, of efforts, and of squared
        efforts.
    """

    triangles: tuple[Triangle, ...]

    @classmethod
    def of(cls, rows: RowSource) -> JointRows:
        """Compress the rows of every joint."""
        triangles = tuple(Triangle(rows.base.count + 2) for _ in range(rows.robot.n))
        for part in rows.parts():
            mask = rows.mask(part)
            found = np.ones((*mask.shape, rows.base.count + 2))
            found[:, :, :-1] = rows.rows(part)
            for j, triangle in enumerate(triangles):
                triangle.add(found[:, j] if mask[:, j].all() else found[mask[:, j], j])
        return cls(triangles)

    @classmethod
    def merged(cls, pieces: Sequence[JointRows]) -> JointRows:
        """Return the rows of several pieces as if they were one: nothing is approximated."""
        first, *others = pieces
        for other in others:
            for triangle, own in zip(first.triangles, other.triangles, strict=True):
                triangle.merge(own)
        return first

    @cached_property
    def used(self) -> Array:
        """Rows that are not masked, (n,)."""
        return np.round([np.sum(t.R[:, -1] ** 2) for t in self.triangles])

    @cached_property
    def squares(self) -> Array:
        """Sum of the squared efforts of those, (N·m)², (n,)."""
        return np.array([np.sum(t.R[:, -2] ** 2) for t in self.triangles])

    @property
    def effort(self) -> float:
        """Mean squared effort over all rows, (N·m)²."""
        return float(self.squares.sum() / self.used.sum())

    def mean_residual(self, base: Array) -> Array:
        """Return the mean of every joint's residual ``effort − W @ base``, (n,)."""
        pairs = zip(self.triangles, self._residuals(base), strict=True)
        return np.array([t.R[:, -1] @ r for t, r in pairs]) / np.maximum(self.used, 1.0)

    def joined(self, variance: Array) -> Triangle:
        """Return the triangle of all rows over the standard deviations of their joints."""
        joined = Triangle(self.triangles[0].columns - 1)
        # Their order makes no difference but to the last bits.
        pairs = zip(self.triangles[::-1], variance[::-1], strict=True)
        every = np.concatenate([t.R[:, :-1] / np.sqrt(s) for t, s in pairs])
        joined.add(every[every.any(axis=1)])
        return joined

    def fit(self, variance: Array) -> tuple[Array, int]:
        """Return the base parameters that fit best under given variances, and the rank."""
        A, rhs, _ = self.joined(variance).split()
        return fitted(A, rhs)

    def squared_residuals(self, base: Array) -> Array:
        """Return the sum of every joint's squared residuals at some base parameters, (n,)."""
        return np.array([np.sum(r**2) for r in self._residuals(base)])

    def _residuals(self, base: Array) -> list[Array]:
        """Return every joint's residuals in the rows of its triangle."""
        error = np.append(-base, 1.0)
        return [triangle.R[:, :-1] @ error for triangle in self.triangles]

    def residual_variance(self, base: Array, rank: int) -> Array:
        """Return the variance of every joint's residuals at some base parameters, (n,).

        Each joint gives up degrees of freedom in proportion to its rows.
        """
        freedom = np.maximum(self.used * (1.0 - rank / self.used.sum()), 1.0)
        return np.asarray(self.squared_residuals(base) / freedom)

    def share_of_noise(self, noise: Array, variance: Array) -> float:
        """Return how large variances of noise (n,) are beside given ones, on average over rows.

        Variances that include a share of the effort give joints their weights; multiplied by this
        number they have the size of the noise too.
        """
        return max(float((noise / variance) @ self.used / self.used.sum()), LEAST_NOISE)

    @property
    def least_variance(self) -> Array:
        """Added to the variance of each joint's residuals, (n,)."""
        used = np.maximum(self.used, 1.0)
        mean = self.mean_residual(np.zeros(self.triangles[0].columns - 2))
        return least_variance(self.squares / used - mean**2, self.effort)


def least_variance(own: Array, effort: float) -> Array:
    """Return the least variance of efforts with variances of their own and a mean square."""
    overall = EFFORT_SHARE**2 * effort
    # An effort that does not vary at all, but for rounding, was not measured.
    return np.where(own <= SILENT * effort, overall, np.minimum(overall, own))


def residual_noise(rows: RowSource, joints: JointRows) -> tuple[Array, float]:
    """Estimate every joint's variance (n,) of residuals and their correlation time, in samples.

    The variances are found by iteration: fit, take the residuals' variance with the degrees of
    freedom that the fit used up, fit again. A small share of the overall effort is added, so that a
    quiet joint does not outweigh all others. They are scaled so that the weighted residuals have a
    variance of one on average. Times the number of samples over the number of independent ones,
    found from the residuals' autocorrelation, they make a cost that counts correlated samples as
    the few independent ones they are, and a prior beside it weighs what it says.

    Parameters
    ----------
    rows : RowSource
        Regressor and efforts.
    joints : JointRows
        These rows, compressed before.

    Raises
    ------
    DataError
        When every effort is zero, or no row counts.
    """
    require_effort(float(joints.squares.sum()), int(joints.used.sum()))
    base, rank = np.zeros(rows.base.count), 0

    def updated(variance: Array) -> Array:
        nonlocal base, rank
        base, rank = joints.fit(variance)
        return joints.residual_variance(base, rank) + joints.least_variance

    variance = settled(updated, np.full(rows.robot.n, joints.effort), 1e-6)
    variance *= joints.share_of_noise(joints.residual_variance(base, rank), variance)
    return variance, correlation_time(rows, base, joints)


def settled(
    updated: Callable[[Array], Array], sizes: Array, tolerance: float, rounds: int = ROUNDS
) -> Array:
    """Return the sizes that an iteration ends with: those that it leaves within a tolerance."""
    for _ in range(rounds):
        before, sizes = sizes, updated(sizes)
        if np.allclose(sizes, before, rtol=tolerance):
            break
    return sizes


def require_effort(size: float, count: int) -> None:
    """Refuse efforts that are all zero."""
    if not size > 0.0:
        raise DataError(
            f"samples: all {count} efforts that count are zero, so residuals have no variance for "
            "weighting='residual' to estimate; check that effort was recorded and read (columns, "
            "units, mask)."
        )


def correlation_time(rows: RowSource, base: Array, joints: JointRows) -> float:
    """Return how many samples make one independent one, averaged over the joints, at least 1."""
    mean = joints.mean_residual(base)
    sums = LaggedSums.merged(rows.map(LaggedSums.of_residuals, base, mean))
    return float(np.mean([integrated_time(c) for c in sums.correlation[joints.used > 0]]))


def integrated_time(correlation: Array) -> float:
    """Return ``1 + 2·Σ rho``, the number of samples that are worth one independent one, at least 1.

    The sum ends before the first pair of neighboring lags, (0, 1), (2, 3), …, whose correlations
    do not add up to more than zero: Geyer's initial positive sequence [geyer1992]_. Noise at
    longer lags then does not add up, nor does one negative value end the sum.

    Parameters
    ----------
    correlation : ndarray, shape (lags,)
        Autocorrelations from lag 0 on.
    """
    pairs = correlation[: len(correlation) // 2 * 2].reshape(-1, 2).sum(axis=1)
    stop = np.flatnonzero(pairs <= 0.0)
    return float(max(1.0, 2.0 * pairs[: stop[0] if stop.size else None].sum() - 1.0))


class LaggedSums(NamedTuple):
    """Sums of lagged products ``Σ_k x[k]·x[k + lag]`` of each signal, and the number of pairs.

    Dividing gives the autocovariance. The two are kept apart so that recordings can be added.

    Attributes
    ----------
    products : ndarray, shape (n, lags)
        Of the centerd signals, summed over the pairs of which both count.
    pairs : ndarray, shape (n, lags)
        How many pairs there are.
    """

    products: Array
    pairs: Array

    @classmethod
    def of(cls, centerd: Array, mask: Mask, parts: Sequence[slice]) -> LaggedSums:
        """Sum over pairs within pieces, up to `_MOST_LAGS` apart.

        Parameters
        ----------
        centerd : ndarray, shape (K, n)
            Signals less their mean.
        mask : ndarray of bool, shape (K, n)
            Which samples count.
        parts : sequence of slice
            Pieces without a break.
        """
        longest = min(max(part.stop - part.start for part in parts), _MOST_LAGS)
        products, pairs = np.zeros((2, centerd.shape[1], longest))
        for part in parts:
            count = part.stop - part.start
            size = 1 << (2 * count - 1).bit_length()
            used = mask[part].T.astype(float)
            for signals, sums in ((centerd[part].T * used, products), (used, pairs)):
                power = np.abs(np.fft.rfft(signals, size, axis=1)) ** 2
                lags = min(count, longest)
                sums[:, :lags] += np.fft.irfft(power, size, axis=1)[:, :lags]
        return cls(products, np.round(pairs))

    @classmethod
    def of_residuals(cls, rows: RowSource, base: Array, mean: Array) -> LaggedSums:
        """Sum over the residuals of rows at some base parameters, about a mean (n,)."""
        residual, masks = [], []
        for _, W, effort, mask in rows.chunks():
            residual.append(effort - W @ base - mean)
            masks.append(mask)
        return cls.of(np.concatenate(residual), np.concatenate(masks), rows.samples.parts)

    @classmethod
    def merged(cls, pieces: Sequence[LaggedSums]) -> LaggedSums:
        """Return the sums over the pairs of all pieces."""
        longest = max(piece.products.shape[1] for piece in pieces)
        products, pairs = np.zeros((2, len(pieces[0].products), longest))
        for piece in pieces:
            products[:, : piece.products.shape[1]] += piece.products
            pairs[:, : piece.products.shape[1]] += piece.pairs
        return cls(products, pairs)

    @property
    def correlation(self) -> Array:
        """Autocorrelations (n, lags), 1 at the first lag; a constant has none at others."""
        found = self.products / np.maximum(self.pairs, 1.0)
        none = np.eye(1, found.shape[1]).repeat(len(found), axis=0)
        return np.divide(found, found[:, :1], out=none, where=found[:, :1] > 0.0)
