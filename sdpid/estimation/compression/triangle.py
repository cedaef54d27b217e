"""A growing triangular factor of rows, at the speed of matrix products.

Rows X are divided by a triangle T of those seen so far, and only the Gram matrix ``Y^T·Y`` of
``Y = X·T^(-1)`` is kept: Cholesky QR with a preconditioner. Each row of Y solves its triangular
system but for roundings of T itself, so that Y·T is X to rounding in the size of its columns: the
error is that of an orthogonal factorization, however ill-conditioned the rows are, while the Gram
matrix is not. Where it would be, because rows bring what those before them did not have, T is made
anew, or the rows are factorized as they are.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices

# Rows multiplied at a time, in bytes: Y stays in a core's second-level cache beside the rows.
PIECE = 1 << 19

# A piece has at least this many times as many rows as columns: what is done once for any number of
# rows costs about as much as that many.
_FEW = 4

# The Gram matrix starts as the identity, and its eigenvalues may grow to this: its condition
# number stays below, and rounding in it is enlarged by the square root of that at most.
_GROWN = 1e3

# Beyond this growth even a new T, made from the Gram matrix, would not be good: the matrix is
# known to 1e-16 of its largest eigenvalue, and its smallest one is 1.
_FAR = 1e9

# With a new T the Gram matrix of everything is the identity but for what the old one was rounded
# by. More than this is no longer near.
_NEAR = 0.5


class Triangle:
    """A growing upper triangle R with R^T·R = Σ rows^T·rows, as accurate as a QR of all rows.

    Memory does not depend on the number of rows. The same rows in the same pieces give the same
    bits.

    Parameters
    ----------
    columns : int
        Columns of the rows, also kept as an attribute.
    """

    def __init__(self, columns: int) -> None:
        self.columns = columns
        # Columns of which some row so far is not zero: all below is of these alone.
        self._at: Indices = np.zeros(0, dtype=np.intp)
        # The factor of everything is T, or root(G)·T while rows are divided.
        # No array is ever written to again: a copy shares them.
        self._T: Array = np.zeros((0, 0))
        self._G: Any = None
        # No eigenvalue of G is larger.
        self._growth = 1.0
        # Rows that wait for others, since a few cost as much to fold in as many.
        self._waiting: tuple[Array, ...] = ()
        self._R: Array | None = None

    @property
    def R(self) -> Array:  # noqa: N802
        """The triangle, (at most columns, columns), read-only. To look changes nothing."""
        if self._R is None:
            found = self._factor()
            if self._waiting:
                found = _triangle(np.vstack([found, *self._waiting]))
            if len(self._at) < self.columns:
                places = self._at[: len(found)]
                own, found = found, np.zeros((max(places, default=-1) + 1, self.columns))
                found[np.ix_(places, self._at)] = own
            self._R = found
            self._R.setflags(write=False)
        return self._R

    def scale(self, factor: float) -> None:
        """Multiply all rows so far by a number, as one does to forget them slowly."""
        self._T, self._R = factor * self._T, None
        self._waiting = tuple(factor * each for each in self._waiting)

    def add(self, rows: Array, at: Indices | None = None) -> None:
        """Fold further rows (k, columns) in, or (k, c) of those columns alone; k may be zero."""
        rows = np.asarray(rows, dtype=np.float64)
        if at is not None:
            whole = np.zeros((len(rows), self.columns))
            whole[:, at] = rows
            rows = whole
        used = np.asarray(rows.any(axis=0))
        if not used.any():
            return
        used[self._at] = True
        if np.count_nonzero(used) > len(self._at):
            self._widen(np.flatnonzero(used))
        self._R, few = None, _FEW * len(self._at)
        rows = rows if len(self._at) == self.columns else rows[:, self._at]
        if len(rows) + sum(map(len, self._waiting)) < few:
            self._waiting += (np.array(rows),)
            return
        if self._waiting:
            rows = np.concatenate([*self._waiting, rows])
            self._waiting = ()
        size = max(PIECE // (8 * len(self._at)), few)
        for start in range(0, len(rows), size):
            self._fold(rows[start : start + size])

    def merge(self, other: Triangle) -> None:
        """Fold another triangle's rows in: that of all rows is the same, whoever saw them."""
        self.add(other.R)

    def split(self) -> tuple[Array, Array, float]:
        """Return A (b, b), rhs (b,) and floor, the last column being the right-hand side."""
        R, b = np.zeros((self.columns, self.columns)), self.columns - 1
        R[: len(self.R)] = self.R
        return R[:b, :b].copy(), R[:b, b].copy(), float(R[b, b] ** 2)

    def _factor(self) -> Array:
        """Return the triangle of everything folded in."""
        if self._G is None:
            return self._T
        return np.asarray(_root(self._G) @ self._T)

    def _widen(self, at: Indices) -> None:
        """Have more columns, which are zero in the rows so far."""
        old, self._at = np.searchsorted(at, self._at), at

        def wide(rows: Array) -> Array:
            found = np.zeros((len(rows), len(at)))
            found[:, old] = rows
            return found

        self._waiting = tuple(map(wide, self._waiting))
        self._restart(wide(self._factor()))

    def _restart(self, factor: Array) -> None:
        """Be the triangle of this factor, beside what waits."""
        self._T, self._G, self._R = factor, None, None

    def _fold(self, rows: Array) -> None:
        if self._G is None:
            # What is not yet as many rows as columns, or has columns that were zero in them.
            if len(self._T) < len(self._at) or not self._T.any(axis=0).all():
                self._fold_plainly(rows)
                return
            self._divide_by(self._T)
            self._G, self._growth = np.eye(len(self._T), order="F"), 1.0
        grown = self._added(self._G, rows)
        # Rows add their square at most; sums of sizes, a closer bound, cost as much as they.
        growth = self._growth + float(np.trace(grown) - np.trace(self._G))
        if not growth <= _GROWN:
            growth = _bound(grown)
        if growth <= _GROWN:
            self._G, self._growth = grown, growth
            return
        if not growth <= _FAR:  # not a number, too
            self._fold_plainly(rows)
            return
        # A T for these rows, too; what was folded in before is taken over row by row.
        before, self._G = self._factor(), grown
        self._divide_by(self._factor())
        grown = self._added(self._added(np.zeros_like(grown), before), rows)
        if np.abs(np.triu(grown) - np.eye(len(grown))).max() <= _NEAR / len(grown):
            self._G, self._growth = grown, _bound(grown)
        else:
            self._restart(before)
            self._fold_plainly(rows)

    def _added(self, G: Array, rows: Array) -> Any:
        """Return G with the products of rows, divided by T, added in its upper triangle."""
        from scipy.linalg.blas import dsyrk, dtrsm

        return dsyrk(1.0, dtrsm(1.0, self._T, rows.T, trans_a=1), beta=1.0, c=G)

    def _fold_plainly(self, rows: Array) -> None:
        self._restart(_triangle(np.vstack([self._factor(), rows])))

    def _divide_by(self, factor: Array) -> None:
        """Make T of a triangle."""
        T = np.array(factor, order="F")
        # Below, what a column adds is rounding; any other such number stands for it as well.
        norms = np.sqrt(np.einsum("ij,ij->j", T, T))
        own, least = np.diagonal(T).copy(), np.finfo(float).eps * norms
        np.fill_diagonal(T, np.copysign(np.maximum(np.abs(own), least), own))
        self._T = T


def _triangle(rows: Array) -> Array:
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _bound(G: Array) -> float:
    """Return a bound of the eigenvalues of the matrix with this upper triangle."""
    size = np.abs(G)
    return float((size.sum(axis=0) + size.sum(axis=1) - np.diagonal(size)).max())


def _root(G: Array) -> Array:
    """Return the upper Cholesky factor of the matrix with this upper triangle."""
    from scipy.linalg.lapack import dpotrf

    root, info = dpotrf(G, lower=0, clean=1)
    if info:
        raise np.linalg.LinAlgError(f"Gram matrix: pivot {info} of {len(G)} is not positive.")
    return np.asarray(root)
