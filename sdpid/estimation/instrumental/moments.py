"""Products of instruments, measured regressor and efforts, and the two estimates they hold.

Columns are taken in coordinates in which the measured regressor's are orthonormal, so that sums of
products lose nothing to rounding, and directions that the data do not show are left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.whitening import whiten
from sdpid.estimation.problem import Problem
from sdpid.experiment.processing.samples import Samples


@dataclass(frozen=True, kw_only=True, eq=False)
class Pair:
    """Measured samples, and those of a motion that is to be their instrument, row by row."""

    measured: Samples
    instruments: Samples


@dataclass(frozen=True, kw_only=True, eq=False)
class Columns:
    """The whitened columns of a problem in orthonormal coordinates.

    Attributes
    ----------
    problem : Problem
        With its rows.
    rows : RowSource
        Of the problem.
    root : ndarray, shape (b, r)
        T: the columns of ``W·T`` are orthonormal over all rows of the problem.
    inverse : ndarray, shape (r, b)
        ``T^+·β`` are the coordinates of β that the data show.
    """

    problem: Problem
    rows: RowSource
    root: Array
    inverse: Array

    @classmethod
    def of(cls, problem: Problem) -> Columns:
        """Find the coordinates."""
        rows, found = problem.require_rows_here("instruments"), problem.excitation
        return cls(problem=problem, rows=rows, root=found.root, inverse=found.inverse)

    def chunks(self, pair: Pair, *, block: int = 1) -> Iterator[Chunk]:
        """Yield the rows of a pair in order, cut between blocks of samples."""
        sigma = self.problem.sigma
        pieces = zip(
            pair.measured.parts, pair.measured.pieces, pair.instruments.pieces, strict=True
        )
        for piece, measured, instruments in pieces:
            own = sigma if sigma.ndim == 2 else sigma[piece]
            rows, others = self.rows.on(measured), self.rows.on(instruments)
            # Two regressors stand side by side.
            size = max(rows.chunk_size // (2 * block), 1) * block
            for part in rows.parts(size):
                yield Chunk(
                    self,
                    others.regressor(part),
                    rows.rows(part),
                    own if own.ndim == 2 else own[part],
                    rows.mask(part),
                )


@dataclass(frozen=True, eq=False)
class Chunk:
    """The rows of some samples.

    Attributes
    ----------
    columns : Columns
        What they are columns of.
    instruments : ndarray, shape (k, n, b)
        Regressor of the instruments' motion.
    measured : ndarray, shape (k, n, b + 1)
        Regressor of the measured motion, efforts last.
    sigma : ndarray, shape (n, n) or (k, n, n)
        Effort covariance.
    mask : ndarray of bool, shape (k, n)
        Rows that are used.
    """

    columns: Columns
    instruments: Array
    measured: Array
    sigma: Array
    mask: Mask

    def white(self, columns: Array) -> Array:
        """Return columns (k, n, c) whitened, masked rows zero; they may be written to."""
        return whiten(columns, self.sigma, self.mask)

    def orthonormal(self) -> Array:
        """Return ``[Z·T | W·T | y]`` whitened, (k, n, 2 r + 1)."""
        b, root = self.columns.rows.base.count, self.columns.root
        stacked = self.white(np.concatenate([self.instruments, self.measured], axis=2))
        parts = stacked[:, :, :b] @ root, stacked[:, :, b:-1] @ root, stacked[:, :, -1:]
        return np.concatenate(parts, axis=2)


@dataclass(frozen=True, kw_only=True, eq=False)
class Moments:
    """Sums of products over all rows, in the coordinates of `Columns`.

    Attributes
    ----------
    instruments : ndarray, shape (r, r)
        ``Z^T·Z``.
    cross : ndarray, shape (r, r)
        ``Z^T·W``.
    target : ndarray, shape (r,)
        ``Z^T·y``.
    measured : ndarray, shape (r, r)
        ``W^T·W``.
    plain : ndarray, shape (r,)
        ``W^T·y``.
    """

    instruments: Array
    cross: Array
    target: Array
    measured: Array
    plain: Array

    @classmethod
    def of(cls, columns: Columns, pairs: tuple[Pair, ...]) -> Moments:
        """Add up the products over all pairs."""
        r = columns.root.shape[1]
        gram = np.zeros((2 * r + 1, 2 * r + 1))
        for pair in pairs:
            for chunk in columns.chunks(pair):
                flat = chunk.orthonormal().reshape(-1, 2 * r + 1)
                gram += flat.T @ flat
        z, w = slice(r), slice(r, 2 * r)
        return cls(
            instruments=gram[z, z],
            cross=gram[z, w],
            target=gram[z, -1],
            measured=gram[w, w],
            plain=gram[w, -1],
        )
