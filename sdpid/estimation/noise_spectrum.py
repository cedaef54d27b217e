"""The covariance of the base parameters, from the spectrum of the residuals.

Errors whose law does not change with time have Fourier coefficients that are independent of each
other, each with the variance S that the errors' spectrum has at its frequency [whittle1953]_. So
the scores ``X^T·e`` of whitened rows X and errors e have the covariance ``Σ S_g·H_g``: a group g
is a band of frequencies of one joint, ``H_g`` the information ``X^T·X`` within it, and S_g comes
from the power of the joint's residual there. Errors may be white or correlated for long, and
filtered by the processing; a record may be too short for blocks. Errors of different joints are
taken to be independent, once whitened.

**Freedom.** A fit follows its data, so residuals are smaller than errors, the more so at the
frequencies of the motion. A group has ``n_g`` real Fourier coefficients and the fit spends
``tr(H^(-1)·H_g)`` of them: what is left divides the residual's power. Neighboring bands are
joined until enough are left. The variance of a function of the parameters is a sum of such
estimates, and the degrees of freedom of its Student's t are Satterthwaite's.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.whitening import whitened_chunks
from sdpid.estimation.information import information_root
from sdpid.estimation.problem import Problem

# Half an octave a band: spectra of filtered noise and of what a model lacks bend no faster.
_BANDS_PER_OCTAVE = 2

# The lowest band ends this many octaves below half the rate, two hours at 100 Hz; it begins at 0.
_OCTAVES = 18

# Real Fourier coefficients that must be left to the variance of a group: of ten the estimate is
# uncertain by 45 %, and a function's variance is a sum over dozens of groups.
_LEAST_ROOM = 10.0

# Bytes of whitened rows that are transformed together; longer pieces are cut in equal parts. Of an
# arm of seven joints that is 20 000 samples, minutes.
_TOGETHER = 1 << 26


@dataclass(frozen=True, eq=False)
class NoiseSpectrum:
    """The rows of a problem by joint and frequency.

    Attributes
    ----------
    information : ndarray, shape (G, b, b)
        H_g.
    power : ndarray, shape (G,)
        Power of the unconstrained fit's residual.
    room : ndarray, shape (G,)
        Real Fourier coefficients less those that the fit spends; at least one.
    """

    information: Array
    power: Array
    room: Array

    @classmethod
    def of(cls, problem: Problem) -> NoiseSpectrum:
        """Transform the rows of a problem.

        Raises
        ------
        DataError
            When the problem has no rows.
        """
        rows = problem.require_rows("standard errors")
        norms = problem.excitation.column_norms
        scale = np.where(norms > 0.0, norms, 1.0)
        fit = np.linalg.lstsq(problem.A / scale, problem.rhs, rcond=None)[0] / scale
        found = rows.map(_bands, 0.5 * problem.score_exponent, fit, sigma=problem.sigma)
        products, count = (np.sum(each, axis=0) for each in zip(*found, strict=True))
        H = products[:, :, :-1, :-1]
        root = information_root(H.sum(axis=(0, 1)))
        spent = np.einsum("ar,jmab,br->jm", root, H, root, optimize=True)
        room = np.maximum(count - spent, 0.0)
        groups = [(j, own) for j, each in enumerate(room) for own in _joined(each)]
        return cls(
            frozen(np.array([H[j, own].sum(axis=0) for j, own in groups])),
            frozen(np.array([products[j, own, -1, -1].sum() for j, own in groups])),
            frozen(np.array([max(room[j, own].sum(), 1.0) for j, own in groups])),
        )

    @property
    def density(self) -> Array:
        """Variance S_g of each group's Fourier coefficients, (G,)."""
        return np.asarray(self.power / self.room)

    @cached_property
    def root(self) -> Array:
        """T (b, r) with ``T·T^T = H^(-1)`` on what the data determine."""
        return information_root(self.information.sum(axis=0))

    @cached_property
    def _shares(self) -> Array:
        """H_g in the coordinates of `root`, (G, r, r): they add up to E."""
        return np.asarray(self.root.T @ self.information @ self.root)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the unconstrained fit, (b, b)."""
        scores = np.einsum("g,gij->ij", self.density, self._shares)
        return np.asarray(self.root @ scores @ self.root.T)

    def freedom(self, functionals: Array) -> Array:
        """Return the degrees of freedom of the variance of each functional (k, b) of the fit."""
        directions = functionals @ self.root
        parts = np.einsum("kg,g->kg", _quadratic(self._shares, directions), self.density)
        total = parts.sum(axis=1)
        spread = np.maximum((parts**2 / self.room).sum(axis=1), np.finfo(float).tiny)
        return np.asarray(np.maximum(total**2 / spread, 1.0))


def _quadratic(matrices: Array, vectors: Array) -> Array:
    """Return v·M·v of all vectors (k, r) and symmetric matrices (G, r, r), (k, G)."""
    return np.asarray(np.einsum("gkr,kr->kg", vectors @ matrices, vectors))


def _joined(room: Array) -> list[slice]:
    """Return runs of bands, lowest first, each of which has room enough if all together have."""
    ends: list[int] = []
    left = 0.0
    for m, own in enumerate(room):
        left += own
        if left >= _LEAST_ROOM:
            ends.append(m + 1)
            left = 0.0
    ends = [*ends[:-1], len(room)]
    return [slice(start, stop) for start, stop in pairwise([0, *ends])]


def _bands(rows: RowSource, sigma: Array, exponent: float, fit: Array) -> tuple[Array, Array]:
    """Return products of rows, the residual last, and the count of coefficients of each band.

    Returns
    -------
    ndarray, shape (n, bands, b + 1, b + 1)
    ndarray, shape (n, bands)
    """
    K, n, columns = rows.n_samples, rows.robot.n, rows.base.count + 1
    pieces = -(-K * n * columns * 8 // _TOGETHER)
    products = np.zeros((n, _OCTAVES * _BANDS_PER_OCTAVE + 1, columns, columns))
    count = np.zeros(products.shape[:2])
    for _, weighted, mask in whitened_chunks(rows, sigma, exponent, size=-(-K // pieces)):
        weighted[:, :, -1] -= weighted[:, :, :-1] @ fit
        used = mask.mean(axis=0)
        for j in range(n):
            seen = np.flatnonzero(np.any(weighted[:, j] != 0.0, axis=0))
            place = np.ix_(seen, seen)
            for m, coefficients in _transformed(weighted[:, j, seen]):
                products[j, m][place] += coefficients.T @ coefficients
                count[j, m] += used[j] * len(coefficients)
    return products, count


def _transformed(signals: Array) -> list[tuple[int, Array]]:
    """Return the band numbers and the real Fourier coefficients (k, columns) of signals (K, …).

    Their squares add up to those of the signals.
    """
    from scipy.fft import rfft

    size = len(signals)
    found = rfft(signals, axis=0, norm="ortho")
    single = [0, *([size // 2] if size % 2 == 0 else [])]
    found *= np.sqrt(2.0)
    found[single] /= np.sqrt(2.0)
    octaves = np.log2(np.maximum(2.0 * np.arange(len(found)) / size, 2.0**-_OCTAVES)) + _OCTAVES
    band = np.ceil(octaves * _BANDS_PER_OCTAVE - 1e-9).astype(int)
    edges = np.flatnonzero(np.diff(band, prepend=-1, append=band[-1] + 1))
    out = []
    for start, stop in pairwise(edges):
        own = found[start:stop]
        imaginary = own.imag[[i not in single for i in range(start, stop)]]
        out.append((int(band[start]), np.vstack([own.real, imaginary])))
    return out
