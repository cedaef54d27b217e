"""The whitened rows of a problem, row by row or, where contacts tie them, sample by sample."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.estimation.compression.rows import CHUNK
from sdpid.estimation.compression.triangle import Triangle
from sdpid.estimation.compression.whitening import weights as powers_of
from sdpid.estimation.compression.whitening import weights_and_shares, whitened_chunks
from sdpid.estimation.problem import Problem

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
    together : bool
        Whether a loss is one of samples, whose rows contacts tie together; else it is of rows.
    """

    def __init__(self, problem: Problem) -> None:
        problem.require_plain("solve_robust")
        self.problem = problem
        self._kept: list[tuple[slice, Array, Mask]] = []
        self.rows = problem.require_rows_here("solve_robust")
        samples, n = problem.samples.effort.shape
        self.together = self.rows.samples.contacts is not None
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

    def along(self, u: Array) -> Array:
        """Return ``u_k^T W_k`` of every sample, (K, b)."""
        found = [np.einsum("kib,ki->kb", rows, u[part]) for part, rows, _ in self.chunks()]
        return np.asarray(np.concatenate(found)[:, :-1])

    @cached_property
    def freedom(self) -> Array:
        """Independent rows of each sample, (K, 1)."""
        sigma = self.problem.sigma
        found = [weights_and_shares(self.rows, part, sigma)[2] for part in self.rows.parts()]
        return np.asarray(np.rint(np.concatenate(found).sum(axis=1))[:, None])

    @cached_property
    def mask(self) -> Mask:
        """Rows that are used, (K, n)."""
        return self.rows.mask(slice(None))

    @property
    def independent(self) -> int:
        """How many rows are independent."""
        return int(self.freedom.sum() if self.together else self.mask.sum())

    def size(self, values: Array) -> Array:
        """Return sizes of values (K, n): of each (K, n), or norms of each sample's (K, 1)."""
        if self.together:
            return np.asarray(np.linalg.norm(values, axis=1, keepdims=True))
        return np.abs(values)

    def clipped(self, values: Array, t: Array) -> Array:
        """Return values (K, n) of at most a size."""
        if self.together:
            return np.asarray(values * (t / np.maximum(self.size(values), t)))
        return np.clip(values, -t, t)

    def scale(self, threshold: float) -> Array:
        """Return thresholds in deviations of one row: of each joint (), or of samples (K, 1)."""
        if not self.together:
            return np.array(threshold)
        from scipy.special import gammaincinv
        from scipy.stats import norm

        # Chi-squared's quantile: as many samples are beyond as single rows.
        share = 1.0 - 2.0 * norm.sf(threshold)
        return np.asarray(np.sqrt(2.0 * gammaincinv(np.maximum(self.freedom, 1.0) / 2.0, share)))

    def rms(self, values: Array) -> Array:
        """Return root mean squares of values (K, n): of each joint (n,), or of all ()."""
        if self.together:
            return np.array(np.sqrt(np.sum(values**2) / max(self.independent, 1)))
        count = np.maximum(self.mask.sum(axis=0), 1)
        return np.asarray(np.sqrt((values**2).sum(axis=0) / count))

    def median(self, values: Array) -> Array:
        """Return deviations of normal values (K, n) of the same median size, as `rms`."""
        if self.together:
            some = self.freedom > 0.0
            usual = self.scale(_NORMAL_MEDIAN)
            return np.array(np.median((self.size(values) / usual)[some]) if some.any() else 1.0)
        joints = [np.flatnonzero(own) for own in self.mask.T]
        found = [
            np.median(np.abs(values[own, j])) if own.size else 1.0 for j, own in enumerate(joints)
        ]
        return np.asarray(np.array(found) / _NORMAL_MEDIAN)

    def weighted_sigma(self, weights: Array) -> Array:
        """Return covariances (K, n, n) under which plain weighting is that of whitened rows."""
        sigma, (count, n) = self.problem.sigma, self.rows.samples.effort.shape
        out = np.empty((count, n, n))
        for start in range(0, count, CHUNK):
            part = slice(start, start + CHUNK)
            own = sigma if sigma.ndim == 2 else sigma[part]
            if self.together:
                # Errors of measured forces, which are added to it, grow as well.
                w, touching = weights[part][:, :, None], self.rows.contacts(part)
                out[part] = own / w
                if touching is not None and touching.covariance is not None:
                    out[part] += (1.0 / w - 1.0) * touching.covariance
                continue
            root = np.take(*powers_of(own, self.rows.mask(part), 0.5), axis=0)
            out[part] = (root / weights[part][:, None, :]) @ root
        return out
