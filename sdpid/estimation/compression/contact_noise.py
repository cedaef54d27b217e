"""Variances of efforts, from the residuals of rows that contacts mix.

Forces that nobody measured tie the rows of a sample together, so that joints cannot be compressed
one by one. The variances are those of which the residuals r are most likely, found by iteration:
``s_j ← s_j·Σ_k (Omega·r)_j² / Σ_k Omega_jj``. The base has no motor; what its six rows are off by
are errors of motion and model: one variance for its three forces in N², one for its three torques
in (N·m)². They are never pooled with each other or with joints. The covariance of measured forces
has one factor, found likewise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.errors import DataError
from sdpid.estimation.compression.contact_rows import with_spread
from sdpid.estimation.compression.covariance import (
    EFFORT_SHARE,
    LEAST_NOISE,
    ROUNDS,
    LaggedSums,
    integrated_time,
    least_variance,
    require_effort,
    settled,
)
from sdpid.estimation.compression.rows import CHUNK, CHUNK_BYTES, RowSource
from sdpid.estimation.compression.triangle import Triangle
from sdpid.estimation.compression.whitening import weights_and_shares

# Samples that the variances come from, evenly spread: of 4096 with six independent rows each a
# joint's variance is known to some 2 %, and another pass over all samples costs as much as a fit.
_MOST_SAMPLES = 4096

# Least standard deviation of the base's rows: this share of the weight that they carry, and of it
# times the reach of the legs. What true parameters leave of them is 0.3 % of the weight with an
# IMU, and more without.
_WEIGHT_SHARE = 1e-3

# Variances that change by less than this are settled: far less than they are known to.
_SETTLED = 1e-2

# Of a row that forces take whole, rounding leaves this share at most: some 1e-16 either way.
_NO_SHARE = 1e-12

# Rounds in which the residuals stay as they are: they cost a tenth of a fit.
_INNER = 4


def contact_noise(rows: RowSource) -> tuple[Array, float, float]:
    """Return the errors of rows in contact that the residuals make most likely.

    Returns
    -------
    ndarray, shape (n,)
        Variance of every effort, of the size of the residuals (see
        `sdpid.estimation.compression.covariance.residual_noise`).
    float
        Correlation time in samples: so many are worth one independent one.
    float
        Factor of the covariance of measured forces that suits the residuals; 1 without forces.

    Raises
    ------
    DataError
        When every effort is zero, or contacts leave no row.
    """
    n, n_base = rows.robot.n, rows.robot.n_base
    thin = RowSource(rows.robot, rows.friction, rows.base, rows.samples.thinned(_MOST_SAMPLES))
    begun, least = _beginning(thin)
    left = _Left(thin)
    kept, force = left.rows(thin)

    def updated(sizes: Array) -> Array:
        base, residual = left.fitted(kept, sizes)
        least[:n_base] = _least_of_base(thin, force @ base)
        return left.settled(sizes, residual, _groups(n, n_base), least, _INNER)

    sizes = settled(updated, begun, _SETTLED)
    base, residual = left.fitted(kept, sizes)
    # One factor for all efforts, which were bounded one by one, beside that of forces.
    alike = _groups(n, 0) // n
    least = np.append(LEAST_NOISE * sizes[:-1], 1.0)
    sizes = left.settled(sizes, residual, alike, least, ROUNDS)
    shown = float(left.settled(sizes, residual, alike, 0.0 * least, ROUNDS)[-1])
    variance, scaled = sizes[:-1], rows.with_force_scale(float(sizes[-1]))
    sums = LaggedSums.merged(scaled.map(_lagged, base, sigma=np.diag(variance)))
    said = sums.products[:, 0]
    if not said.any():
        return variance, 1.0, shown
    times = np.array([integrated_time(each) for each in sums.correlation])
    return variance, float(np.average(times, weights=said)), shown


def prediction_noise(rows: RowSource, predicted: Array) -> Array:
    """Return the variance of every effort's errors (n,) under a prediction that is given.

    As `contact_noise`, but nothing is fitted, and joints share one variance: a variance each would
    be most likely where a joint or two take all errors of a poor prediction.

    Parameters
    ----------
    rows : RowSource
        Samples with contacts; their regressor is not asked for.
    predicted : ndarray, shape (K, n)
        Efforts without those of forces.
    """
    samples, n, n_base = rows.samples, rows.robot.n, rows.robot.n_base
    groups = np.minimum(_groups(n, n_base), n_base)
    groups[-1] += 1
    thin = rows.on(replace(samples, effort=samples.effort - predicted).thinned(_MOST_SAMPLES))
    left = _Left(thin)
    residual = left.of(np.concatenate([thin.effort(part) for part in thin.parts()]))
    sizes, least = _beginning(rows)
    least[:n_base] = _least_of_base(rows, predicted[:, :3])
    return left.settled(sizes, residual, groups, least, ROUNDS * _INNER)[:-1]


def _beginning(rows: RowSource) -> tuple[Array, Array]:
    """Return sizes to begin with, and the least of them, those of the base aside, (n + 1,).

    They are variances of efforts and, last, the factor of the covariance of forces.
    """
    mask, n_base = rows.samples.used, rows.robot.n_base
    own = np.where(mask, rows.samples.effort, 0.0)[:, n_base:]
    used = np.count_nonzero(mask[:, n_base:], axis=0)
    square, mean = (np.sum(each, axis=0) / np.maximum(used, 1) for each in (own**2, own))
    if used.any():
        effort = float(square @ used / used.sum())
    else:
        # The base's rows alone: forces that are known take the place of efforts.
        known = [np.where(rows.mask(p), rows.effort(p), 0.0)[:, :3] for p in rows.parts()]
        effort = _reach(rows) ** 2 * float(np.mean(np.concatenate(known) ** 2))
    require_effort(effort, int(used.sum()) or int(mask.sum()))
    variance = np.full(rows.robot.n, EFFORT_SHARE**2 * effort)
    variance[: min(3, n_base)] /= _reach(rows) ** 2
    least = least_variance(square - mean**2, effort)
    return np.append(variance, 1.0), np.concatenate([np.zeros(n_base), least, [1.0]])


def _least_of_base(rows: RowSource, weight: Array) -> Array:
    """Return the least variances of the base, of which forces (K, 3) are the weight; none else."""
    force = _WEIGHT_SHARE**2 * float(np.mean(weight**2)) * 3.0
    return force * np.repeat([1.0, _reach(rows) ** 2], 3)[: rows.robot.n_base]


def _reach(rows: RowSource) -> float:
    return float(max(rows.robot.reach, np.finfo(float).tiny))


def _groups(n: int, n_base: int) -> Indices:
    """Return which rows share a variance, and that the factor of forces is alone, (n + 1,)."""
    own = np.arange(n + 1)
    return np.asarray(np.where(own < n_base, own // 3, own), dtype=np.intp)


class _Left:
    """What forces that nobody measured leave of samples, found once for all weights.

    Samples with as many independent rows are together: patterns of contacts and masks are hundreds.
    """

    def __init__(self, rows: RowSource) -> None:
        pieces: dict[int, list[tuple[Indices, Array, Array]]] = {}
        for part in rows.parts(CHUNK):
            touching = rows.contacts(part)
            assert touching is not None
            for some, N in touching.unforced(rows.mask(part)):
                spread = np.swapaxes(N, 1, 2) @ touching.spread[some]
                pieces.setdefault(N.shape[2], []).append((part.start + some, N, spread))
        alike = (zip(*each, strict=True) for each in pieces.values())
        self.pieces = [tuple(np.concatenate(each) for each in piece) for piece in alike]

    def roots(self, sizes: Array) -> Iterator[Array]:
        """Yield G (s, r, r) of ``Omega = N·G^T·G·N^T``, the weight of what is left."""
        for _, N, spread in self.pieces:
            C = np.swapaxes(N, 1, 2) @ (sizes[:-1, None] * N)
            P = np.linalg.inv(np.linalg.cholesky(C))
            yield with_spread(P, np.sqrt(sizes[-1]) * spread)

    def of(self, residual: Array) -> list[Array]:
        """Return what is left (s, r, 1) of residuals (k, n)."""
        return [np.swapaxes(N, 1, 2) @ residual[some][:, :, None] for some, N, _ in self.pieces]

    def rows(self, rows: RowSource) -> tuple[list[Array], Array]:
        """Return what is left (s, r, b + 1) of rows, and those of the force on the base whole."""
        found = [np.empty((*N.shape[::2], rows.base.count + 1)) for _, N, _ in self.pieces]
        force = []
        for part in rows.parts():
            block = rows.rows(part)
            force.append(block[:, :3, :-1].copy())
            for (some, N, _), out in zip(self.pieces, found, strict=True):
                own = np.flatnonzero((some >= part.start) & (some < part.stop))
                out[own] = np.swapaxes(N[own], 1, 2) @ block[some[own] - part.start]
        return found, np.concatenate(force)

    def fitted(self, kept: list[Array], sizes: Array) -> tuple[Array, list[Array]]:
        """Return the best fit under sizes, and what it leaves, as large as without a fit."""
        rows = sum(X.shape[0] * X.shape[1] for X in kept)
        if rows < 1:
            raise DataError(
                "samples: the forces of the contacts explain every row, nothing is left to fit; "
                "check the mask and the contacts (flags, kinds), or give measured forces."
            )
        triangle = Triangle(kept[0].shape[2])
        for X, root in zip(kept, self.roots(sizes), strict=True):
            count = 1 + X.nbytes // CHUNK_BYTES
            for G, own in zip(*(np.array_split(each, count) for each in (root, X)), strict=True):
                triangle.add((G @ own).reshape(-1, X.shape[2]))
        # Along directions that rows without the forces do not show, the shortest in SI units.
        base, _, rank, _ = np.linalg.lstsq(triangle.R[:, :-1], triangle.R[:, -1], rcond=None)
        size = np.sqrt(rows / max(rows - int(rank), 1.0))
        return np.asarray(base), [
            size * (X[:, :, -1:] - X[:, :, :-1] @ base[:, None]) for X in kept
        ]

    def settled(
        self, sizes: Array, residual: list[Array], groups: Indices, least: Array, rounds: int
    ) -> Array:
        """Return the most likely sizes under residuals that stay as they are."""

        def updated(sizes: Array) -> Array:
            scores, information = np.zeros((2, len(sizes)))
            for (_, N, spread), own, G in zip(
                self.pieces, residual, self.roots(sizes), strict=True
            ):
                whitened = G @ own
                of_rows, of_forces = N @ np.swapaxes(G, 1, 2), np.swapaxes(G @ spread, 1, 2)
                scores[:-1] += np.sum((of_rows @ whitened)[:, :, 0] ** 2, axis=0)
                scores[-1] += np.sum((of_forces @ whitened) ** 2)
                information[:-1] += np.einsum("kir,kir->i", of_rows, of_rows)
                information[-1] += np.sum(of_forces**2)
            said, known = (np.bincount(groups, sizes * s)[groups] for s in (scores, information))
            # What contacts hide altogether keeps its size.
            ratio = np.divide(said, known, out=np.ones_like(sizes), where=known > 0.0)
            return np.maximum(sizes * ratio, least)

        return settled(updated, sizes, _SETTLED, rounds)


def _lagged(rows: RowSource, sigma: Array, base: Array) -> LaggedSums:
    """Return the lagged sums of whitened residuals about their means."""
    whitened, shares = [], []
    for part, W, effort, _ in rows.chunks():
        T, index, share = weights_and_shares(rows, part, sigma)
        whitened.append((T[index] @ (effort - W @ base)[:, :, None])[:, :, 0])
        shares.append(share)
    found, share = np.concatenate(whitened), np.concatenate(shares)
    counts = share > _NO_SHARE
    mean = found.sum(axis=0) / np.maximum(counts.sum(axis=0), 1)
    return LaggedSums.of(np.where(counts, found - mean, 0.0), counts, rows.samples.parts)
