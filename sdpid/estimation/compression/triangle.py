"""A growing triangular factor of rows, at the speed of matrix products.

Rows are multiplied by a matrix M that makes those seen so far orthonormal, and only the Gram
matrix ``Y^T·Y`` of ``Y = X·M`` is kept: Cholesky QR with a preconditioner. With the columns scaled
to unit norm by D and the singular value decomposition ``U·diag(s)·V^T`` of what was seen,
``M = D·V·diag(1/s)``. As V is orthogonal, the rounding of a product ``X·D·V`` is of the size of the
rows themselves, and dividing by s and multiplying again does not enlarge it: the error is that of
an orthogonal factorization, however ill-conditioned the rows are, while the Gram matrix is not.
Where it would be, because rows bring what those before them did not have, M is made anew, or the
rows are factorized as they are.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sdpid._common.arrays import Array

# Rows multiplied at a time, in bytes: Y stays in a core's second-level cache beside the rows.
PIECE = 1 << 19

# Fewer rows than this many times the columns wait for others: what is done once for any number
# of rows costs about as much as that many rows.
_FEW = 4

# The Gram matrix starts as the identity, and its eigenvalues may grow to this: its condition
# number stays below, and rounding in it is enlarged by the square root of that at most.
_GROWN = 1e3

# Beyond this growth even a new M, made from the Gram matrix, would not be good: the matrix is
# known to 1e-16 of its largest eigenvalue, and its smallest one is 1.
_FAR = 1e9

# With a new M the Gram matrix of everything is the identity but for what the old one was rounded
# by. More than this is no longer near.
_NEAR = 0.5


class Triangle:
    """A growing upper triangle R with R^T·R = Σ rows^T·rows, as accurate as a QR of all rows.

    Memory does not depend on the number of rows. The same rows in the same pieces give the same
    bits.

    Parameters
    ----------
    columns : int
        Columns of the rows.
    """

    def __init__(self, columns: int) -> None:
        self._columns = columns
        # The factor of everything is S, or root(G)·back once there is an M.
        self._S: Array = np.zeros((0, columns))
        self._M: Array | None = None
        self._back: Array = self._S
        self._G: Any = None
        # No eigenvalue of G is larger.
        self._growth = 1.0
        self._unseen: Any = None
        self._waiting: list[Array] = []
        self._count = 0
        self._R: Array | None = self._S

    def __getstate__(self) -> tuple[int, Array]:
        """Return what is sent: the rows' triangle stands for all of them."""
        return self._columns, self.R

    def __setstate__(self, state: tuple[int, Array]) -> None:
        """Go on from a triangle."""
        self.__init__(state[0])  # type: ignore[misc]
        self._restart(state[1])

    @property
    def columns(self) -> int:
        """Columns of the rows."""
        return self._columns

    @property
    def R(self) -> Array:  # noqa: N802
        """The triangle, (at most columns, columns), read-only. To look changes nothing."""
        if self._R is None:
            self._R = _triangle(np.vstack([self._factor(), *self._waiting]))
            self._R.setflags(write=False)
        return self._R

    def scale(self, factor: float) -> None:
        """Multiply all rows so far by a number, as one does to forget them slowly."""
        self._restart(factor * self.R)

    def add(self, rows: Array) -> None:
        """Fold further rows (k, columns) in; k may be zero."""
        rows = np.asarray(rows, dtype=np.float64)
        self._R = None
        few = _FEW * self._columns
        if self._count + len(rows) < few:
            if len(rows):
                self._waiting.append(rows.copy())
                self._count += len(rows)
            return
        if self._waiting:
            need = few - self._count
            first, rows = rows[:need], rows[need:]
            waiting = [*self._waiting, first]
            self._waiting, self._count = [], 0
            self._fold(np.concatenate(waiting))
        size = max(PIECE // (8 * self._columns), few)
        for start in range(0, len(rows), size):
            self._fold(rows[start : start + size])

    def merge(self, other: Triangle) -> None:
        """Fold another triangle's rows in: that of all rows is the same, whoever saw them."""
        self._restart(_triangle(np.vstack([self.R, other.R])))

    def split(self) -> tuple[Array, Array, float]:
        """Return A (b, b), rhs (b,) and floor, the last column being the right-hand side."""
        columns = self._columns
        R, found = np.zeros((columns, columns)), self.R
        R[: len(found)] = found[:columns]
        b = columns - 1
        return R[:b, :b].copy(), R[:b, b].copy(), float(R[b, b] ** 2)

    def _factor(self) -> Array:
        """Return a factor of everything folded in, not triangular."""
        return self._S if self._M is None else np.asarray(_root(self._G) @ self._back)

    def _restart(self, factor: Array) -> None:
        """Be the triangle of this factor alone."""
        self._S, self._M, self._R = factor, None, None
        self._waiting, self._count = [], 0

    def _fold(self, rows: Array) -> None:
        from scipy.linalg.blas import dsyrk

        if len(self._S) < self._columns and self._M is None:
            self._restart(_triangle(np.vstack([self._S, rows])))
            return
        M = self._M
        if M is None:
            M = self._precondition(self._S)
            self._G, self._growth = np.eye(M.shape[1], order="F"), 1.0
        G = self._G
        if self._unseen.size and rows[:, self._unseen].any():
            self._fold_plainly(rows)
            return
        if not len(G):
            return
        grown = dsyrk(1.0, (rows @ M).T, beta=1.0, c=G)
        # Rows add their square at most; sums of sizes, a closer bound, cost as much as they.
        growth = self._growth + float(np.trace(grown) - np.trace(G))
        if not growth <= _GROWN:
            growth = _bound(grown)
        if growth <= _GROWN:
            self._G, self._growth = grown, growth
            return
        if not growth <= _FAR:  # not a number, too
            self._fold_plainly(rows)
            return
        # An M for these rows, too; what was folded in before is taken over row by row.
        before = self._factor()
        M = self._precondition(np.asarray(_root(grown) @ self._back))
        grown = dsyrk(1.0, (rows @ M).T, beta=1.0, c=dsyrk(1.0, (before @ M).T))
        if np.abs(np.triu(grown) - np.eye(len(grown))).max() <= _NEAR / len(grown):
            self._G, self._growth = grown, _bound(grown)
        else:
            self._restart(before)
            self._fold_plainly(rows)

    def _fold_plainly(self, rows: Array) -> None:
        self._restart(_triangle(np.vstack([self._factor(), rows])))

    def _precondition(self, factor: Array) -> Array:
        """Set M and its inverse so that the factor times M is orthonormal, and return M."""
        norms = np.sqrt(np.einsum("ij,ij->j", factor, factor))
        seen = norms > 0.0
        D = np.where(seen, norms, 1.0)
        _, s, Vt = np.linalg.svd(factor[:, seen] / D[seen])
        # Below, a singular value is rounding; any other such number stands for it as well.
        s = np.maximum(s, np.finfo(float).eps * s.max(initial=0.0))
        self._unseen = np.flatnonzero(~seen)
        M, self._back = np.zeros((self._columns, len(s))), np.zeros((len(s), self._columns))
        M[seen] = (Vt.T / s) / D[seen, None]
        self._back[:, seen] = s[:, None] * Vt * D[seen]
        self._M = M
        return M


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
