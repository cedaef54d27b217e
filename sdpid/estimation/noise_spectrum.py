"""The covariance of the base parameters, from the spectrum of the residuals.

Errors whose law does not change with time have Fourier coefficients that are independent of each
other, each with the variance S that the errors' spectrum has at its frequency [whittle1953]_. So
the scores ``X^T·e`` of whitened rows X and errors e have the covariance ``Σ S_g·H_g``: a group g
is a band of frequencies of one joint, ``H_g`` the information ``X^T·X`` within it, and S_g comes
from the power of the joint's residual there. Kept are triangles of rows, ``H_g = R_g^T·R_g``, at
the columns that the joint has. Errors may be white or correlated for long, and
filtered by the processing; a record may be too short for blocks. Errors of different joints are
taken to be independent, once whitened.

**Freedom.** A fit follows its data, so residuals are smaller than errors, the more so at the
frequencies of the motion. A group has ``n_g`` real Fourier coefficients and the fit spends
``tr(H^(-1)·H_g)`` of them: what is left divides the residual's power. Neighboring bands are
joined until enough are left. The variance of a function of the parameters is a sum of such
estimates, and the degrees of freedom of its Student's t are Satterthwaite's.

**Speeds that the data chose.** Numbers in which friction is not linear (see
`sdpid.estimation.effects`) are parameters too: to first order they are further columns of X, and
the covariance is that of the base parameters beside them. Where friction does not depend on such a
number, it is known no better than before: between the limits of the search.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from sdpid._common.arrays import Array, Indices, frozen
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.triangle import Triangle
from sdpid.estimation.compression.whitening import apply, weights_and_shares
from sdpid.estimation.effects.bending import Bending
from sdpid.estimation.information import freedom_of, information_root, least_squares
from sdpid.estimation.problem import Problem

# Half an octave a band: spectra of filtered noise and of what a model lacks bend no faster.
_BANDS_PER_OCTAVE = 2

# The lowest band ends this many octaves below half the rate, two hours at 100 Hz; it begins at 0.
_OCTAVES = 18

# Frequencies that stand for the bands, in shares of the rate: a quarter of an octave below the end
# of each.
_MIDDLES = 0.5 * 2.0 ** (
    (np.arange(_OCTAVES * _BANDS_PER_OCTAVE + 1) - 0.5) / _BANDS_PER_OCTAVE - _OCTAVES
)

# Real Fourier coefficients that must be left to the variance of a group: of ten the estimate is
# uncertain by 45 %, and a function's variance is a sum over dozens of groups.
_LEAST_ROOM = 10.0

# A speed is never known better than this beforehand, relative: where its limits meet.
_LEAST_DEVIATION = 1e-3

# A joint without information has this much, to divide by.
_NOTHING = np.finfo(float).tiny

# Columns (c',) that some rows (k, c' + 1) have, whose last one is the residual.
Band: TypeAlias = tuple[Indices, Array]

# Variances (n, m) of Fourier coefficients at frequencies (m,).
Believed: TypeAlias = Callable[[Array], Array]

# Bytes of whitened rows that are transformed together; longer pieces are cut in equal parts. Of an
# arm of seven joints that is 20 000 samples, minutes.
_TOGETHER = 1 << 26


@dataclass(frozen=True, eq=False)
class NoiseSpectrum:
    """The rows of a problem by joint and frequency.

    Attributes
    ----------
    groups : tuple of (ndarray, ndarray), length G
        R_g at the columns that it has of c: the b base parameters, and d speeds that the data
        chose; the residual last.
    power : ndarray, shape (G,)
        Power of the unconstrained fit's residual.
    room : ndarray, shape (G,)
        Real Fourier coefficients less those that the fit spends; at least one.
    joint : ndarray of int, shape (G,)
        Whose rows they are.
    known : ndarray, shape (c,)
        What is known of the parameters beforehand, as the diagonal of an information: nothing of
        base parameters.
    base_count : int
        b.
    whole_root : ndarray, shape (c, r)
        T with ``T·T^T = H^(-1)`` on what the data determine.
    """

    groups: tuple[Band, ...]
    power: Array
    room: Array
    joint: Indices
    known: Array
    base_count: int
    whole_root: Array

    @classmethod
    def of(
        cls, problem: Problem, theta: Array | None = None, *, believed: Believed | None = None
    ) -> NoiseSpectrum:
        """Transform the rows of a problem.

        Parameters
        ----------
        problem : Problem
            The problem.
        theta : ndarray, shape (p,), optional
            The estimate, whose friction depends on speeds that the data chose; by default these
            are taken to be known.
        believed : callable, optional
            Returns the variances (n, m) of each joint's Fourier coefficients, of whitened rows, at
            frequencies (m,) in shares of the samples' rate. They take the place of the power of the
            residuals, which are not looked at: for a run that is yet to be made.

        Raises
        ------
        DataError
            When the problem has no rows.
        """
        rows = problem.require_rows("standard errors")
        fit = least_squares(problem.A, problem.rhs)
        friction = rows.friction
        tail = np.zeros(0) if theta is None else theta[problem.n_theta - len(friction.parameters) :]
        bending = Bending.of(friction, () if theta is None else problem.origin.profiled, tail)
        found = rows.map(_bands, 0.5 * problem.score_exponent, fit, bending, sigma=problem.sigma)
        count = np.sum([each for _, each in found], axis=0)
        places = sorted({place for bands, _ in found for place in bands})
        bands = {p: _stacked(own[p] for own, _ in found if p in own) for p in places}
        residual, spent = np.zeros(count.shape), np.zeros(count.shape)
        for place, (_, R) in bands.items():
            residual[place] = R[:, -1] @ R[:, -1]
        # A weighted row's variance, about one unless weights are no variances.
        size = residual.sum() / max(count.sum() - problem.base.count, 1.0)
        if believed is not None:
            size = np.average(believed(_MIDDLES), weights=count + _NOTHING)
        least = np.maximum(bending.deviations, _LEAST_DEVIATION)
        known = np.concatenate([np.zeros(problem.base.count), size / least**2])
        root = information_root(_rows(list(bands.values()), known))
        for place, (columns, R) in bands.items():
            spent[place] = np.sum((R[:, :-1] @ root[columns]) ** 2)
        room = np.maximum(count - spent, 0.0)
        groups = [(j, own) for j, each in enumerate(room) for own in _joined(each)]
        left = np.array([max(room[j, own].sum(), 1.0) for j, own in groups])
        power = np.array([residual[j, own].sum() for j, own in groups])
        if believed is not None:
            variances, weights = believed(_MIDDLES), spent + _NOTHING
            means = [np.average(variances[j, own], weights=weights[j, own]) for j, own in groups]
            power = np.array(means) * left
        return cls(
            tuple(
                _stacked(bands.pop(p) for p in places if p[0] == j and own.start <= p[1] < own.stop)
                for j, own in groups
            ),
            frozen(power),
            frozen(left),
            np.array([j for j, _ in groups], dtype=np.intp),
            frozen(known),
            problem.base.count,
            frozen(root),
        )

    @property
    def density(self) -> Array:
        """Variance S_g of each group's Fourier coefficients, (G,)."""
        return np.asarray(self.power / self.room)

    @property
    def size(self) -> float:
        """Variance of a weighted row."""
        return float(self.power.sum() / self.room.sum())

    @property
    def densities(self) -> Array:
        """Variance of each joint's Fourier coefficients where its information lies, (n,)."""
        weight = [np.sum((R[:, :-1] @ self.whole_root[own]) ** 2) for own, R in self.groups]
        spread = np.bincount(self.joint, weight * self.density)
        return np.asarray(spread / np.maximum(np.bincount(self.joint, weight), _NOTHING))

    def information(self, weights: Array | None = None) -> Array:
        """Return ``Σ w_g·H_g`` (c, c), by default with weights of one."""
        total = np.zeros((len(self.known), len(self.known)))
        for g, (own, R) in enumerate(self.groups):
            H = R[:, :-1].T @ R[:, :-1]
            total[np.ix_(own, own)] += H if weights is None else weights[g] * H
        return total

    @property
    def root(self) -> Array:
        """Of the fit alone, (b, r)."""
        return self.whole_root[: self.base_count]

    @cached_property
    def scores(self) -> Array:
        """Covariance of the fit in the coordinates of `root`, (r, r)."""
        # What is known beforehand is as uncertain as stated.
        rows = _rows(self.groups, self.size * self.known, np.sqrt(self.density))
        turned = rows @ self.whole_root
        return np.asarray(turned.T @ turned)

    @property
    def covariance(self) -> Array:
        """Covariance of the unconstrained fit, (b, b)."""
        return np.asarray(self.root @ self.scores @ self.root.T)

    def freedom(self, directions: Array) -> Array:
        """Return the degrees of freedom of variances along directions (k, r) of `root`."""
        moved = self.whole_root @ directions.T
        parts = np.array([np.sum((R[:, :-1] @ moved[own]) ** 2, axis=0) for own, R in self.groups])
        found = freedom_of(parts.T * self.density, self.room)
        # A variance of zero has one degree of freedom, the least.
        return np.where(np.isfinite(found), np.maximum(found, 1.0), 1.0)


def _stacked(bands: Iterable[Band]) -> Band:
    """Return the rows of several bands at the columns of any, no more of them than columns."""
    found = list(bands)
    columns = np.unique(np.concatenate([own for own, _ in found]))
    stacked = np.zeros((sum(len(R) for _, R in found), len(columns) + 1))
    start = 0
    for own, R in found:
        stop = start + len(R)
        stacked[start:stop, np.append(np.searchsorted(columns, own), -1)] = R
        start = stop
    if len(stacked) > len(columns):
        stacked = np.asarray(np.linalg.qr(stacked, mode="r"))
    return columns, stacked


def _rows(bands: Sequence[Band], known: Array, weights: Array | None = None) -> Array:
    """Return the triangle (at most c, c) of weighted rows, and of what is known (c,) beforehand."""
    triangle = Triangle(len(known))
    triangle.add(np.diag(np.sqrt(known)))
    # Short bands first: a few rows of all joints have all columns.
    for g in np.argsort([len(R) for _, R in bands], kind="stable"):
        own, R = bands[g]
        triangle.add(R[:, :-1] if weights is None else weights[g] * R[:, :-1], own)
    return triangle.R


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


def _bands(
    rows: RowSource, sigma: Array, exponent: float, fit: Array, bending: Bending
) -> tuple[dict[tuple[int, int], Band], Array]:
    """Return rows by joint and band, and the count of coefficients of each (n, bands)."""
    K, n, base = rows.n_samples, rows.robot.n, rows.base.count
    columns = base + len(bending.deviations) + 1
    pieces = -(-K * n * columns * 8 // _TOGETHER)
    found: dict[tuple[int, int], Band] = {}
    count = np.zeros((n, _OCTAVES * _BANDS_PER_OCTAVE + 1))
    for part in rows.parts(-(-K // pieces)):
        own = rows.rows(part)
        residual = own[:, :, -1:] - own[:, :, :-1] @ fit[:, None]
        slopes = bending.columns(rows.motion(part))
        stacked = np.concatenate([own[:, :, :-1], slopes, residual], axis=2)
        powers, index, shares = weights_and_shares(rows, part, sigma, exponent)
        weighted = apply(powers, index, stacked)
        used = shares.sum(axis=0)
        for j in range(n):
            seen = np.flatnonzero(np.any(weighted[:, j, :-1] != 0.0, axis=0))
            for m, coefficients in _transformed(weighted[:, j, np.append(seen, -1)]):
                before = [found[j, m]] if (j, m) in found else []
                found[j, m] = _stacked([*before, (seen, coefficients)])
                count[j, m] += used[j] * len(coefficients) / _padded(len(own))
    return found, count


def _padded(count: int) -> int:
    """Return the length that signals of `count` samples are padded to: a fast one."""
    from scipy.fft import next_fast_len

    return int(next_fast_len(count, real=True))


def _transformed(signals: Array) -> list[tuple[int, Array]]:
    """Return the band numbers and the real Fourier coefficients (k, columns) of signals (K, …).

    There are `_padded` of them; their squares add up to those of the signals.
    """
    from scipy.fft import rfft

    size = _padded(len(signals))
    found = rfft(signals, size, axis=0, norm="ortho")
    # The constant, and half the rate where it is there, have no imaginary part.
    double = slice(1, (size + 1) // 2)
    found[double] *= np.sqrt(2.0)
    octaves = np.log2(np.maximum(2.0 * np.arange(len(found)) / size, 2.0**-_OCTAVES)) + _OCTAVES
    band = np.ceil(octaves * _BANDS_PER_OCTAVE - 1e-9).astype(int)
    coefficients = np.vstack([found.real, found.imag[double]])
    place = np.append(band, band[double])
    return [(m, coefficients[place == m]) for m in np.unique(band).tolist()]
