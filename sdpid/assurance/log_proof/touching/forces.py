"""Forces that explain a residual best, times what Jacobians are off by.

Of a sample with the residual r = Y beta − effort the best forces are linear in (beta, −1), and what
errors of Jacobians do to the root of the cost is at most the norm of ``F (beta, −1)``, F being
forces times errors. Beside parameters that fit, forces are those that were there; far from them the
cost tells how far: ``‖F delta‖ ≤ s·‖A delta‖`` and a little, for the rows A of the compressed cost.
docs/theory ("Rows hold for the robot's equations") has the proof.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.outward import SLACK as UP
from sdpid.assurance.certificate.outward import UNIT as U
from sdpid.assurance.certificate.outward import gamma
from sdpid.assurance.log_proof.enclosure import root

# Directions that no row shows count as shares of the box; the first that makes the bound provable
# is taken. The first adds nothing that matters, the last is as wide as the box.
_SHARES = (1e-6, 1e-4, 1e-2, 1.0, 1e2, 1e4)

# What is proven is this many times what it seems to be: room for rounding.
_ROOM = 2.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Near:
    """The compressed cost ``‖A beta − rhs‖² + floor`` of rows, and parameters that fit.

    Attributes
    ----------
    A, rhs : ndarray, shape (r, b) and (r,)
        What rows were compressed to.
    relative, absolute : float
        Rows cost as much but for this, for all parameters in the box.
    base : ndarray, shape (b,)
        Base parameters with which all others are compared; any will do.
    """

    A: Array
    rhs: Array
    relative: float
    absolute: float
    base: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class ForceErrors:
    """The Gram matrix of F (b + 1 columns, the last that of efforts).

    Attributes
    ----------
    gram : ndarray, shape (b + 1, b + 1)
        As computed.
    terms : int
        No sum in it has more terms.
    """

    gram: Array
    terms: int

    @classmethod
    def none(cls, count: int) -> ForceErrors:
        """Return that of no samples with `count` columns."""
        return cls(gram=np.zeros((count, count)), terms=0)

    @classmethod
    def of(cls, F: Array) -> ForceErrors:
        """Return that of some rows (m, b + 1)."""
        return cls(gram=F.T @ F, terms=len(F))

    @staticmethod
    def sum(pieces: Sequence[ForceErrors]) -> ForceErrors:
        """Return that of all rows."""
        gram = np.sum([piece.gram for piece in pieces], axis=0)
        return ForceErrors(gram=gram, terms=sum(piece.terms for piece in pieces) + len(pieces))

    def times(self, factor: float) -> ForceErrors:
        """Return that of rows times a factor."""
        return ForceErrors(gram=self.gram * factor**2 * UP, terms=self.terms + 4)

    @property
    def norms(self) -> Array:
        """Bounds of the norms of columns, (b + 1,)."""
        return np.asarray(root(np.diagonal(self.gram) * (1.0 + gamma(self.terms + 2)) * UP))

    def at(self, base: Array, off: Array) -> float:
        """Return a bound of ``‖F (beta, −1)‖``, each beta within `off` of `base`, both (b,)."""
        x = np.append(base, -1.0)
        sizes = float(self.norms @ np.abs(x)) * UP
        square = float(x @ self.gram @ x) + gamma(self.terms + 2 * len(x) + 4) * sizes**2 * UP
        return float((root(max(square, 0.0)) + self.norms[:-1] @ off) * UP)

    def over(self, limit: Array) -> float:
        """Return a bound of the same for all base parameters up to `limit` in size, (b,)."""
        return float(self.norms @ np.append(limit, 1.0) * UP)

    def spread(self, near: Near, limit: Array) -> tuple[float, float]:
        """Return share and constant with ``‖F (beta − base)‖ ≤ share·√cost + constant``.

        For all base parameters up to `limit` in size, (b,); the cost is that of the rows. Infinite
        where that is not proven.
        """
        scale = np.where(limit > 0.0, limit, 1.0)
        b, A = len(limit), near.A * scale
        G = self.gram[:-1, :-1] * np.outer(scale, scale)
        if not (np.isfinite(A).all() and np.isfinite(G).all() and near.relative < 1.0):
            return np.inf, np.inf
        off = gamma(self.terms + 6) * float(np.sum((self.norms[:-1] * scale) ** 2)) * UP
        whole = A.T @ A
        rounding = gamma(len(A) + 6) * float(np.trace(whole)) * UP
        size = float(root(np.sum((near.A @ near.base - near.rhs) ** 2)))
        size += gamma(b + 2) * float(root(np.sum((np.abs(near.A) @ np.abs(near.base)) ** 2)))
        size += gamma(b + 2) * float(root(np.sum(near.rhs**2)))
        for share in _SHARES:
            H = whole + share**2 * np.eye(b)
            s = _ROOM * _largest_ratio(G, H)
            if not np.isfinite(s):
                continue
            if not _positive(s * H - G, off + s * rounding):
                continue
            s = float(root(s))
            left = root(1.0 - near.relative - 4.0 * U) / UP**2
            # No parameter is farther from the base than twice its limit.
            rest = size + root(near.absolute) / left + 2.0 * share * root(float(b))
            return float(s / left * UP), float(s * rest * UP)
        return np.inf, np.inf


def _largest_ratio(G: Array, H: Array) -> float:
    """Return about how large G is beside H, its largest generalized eigenvalue."""
    try:
        L = np.linalg.cholesky(H)
    except np.linalg.LinAlgError:
        return np.inf
    half = np.linalg.solve(L, np.linalg.solve(L, G).T)
    if not np.isfinite(half).all():
        return np.inf
    return max(float(np.linalg.eigvalsh(0.5 * (half + half.T))[-1]), np.finfo(float).tiny)


def _positive(M: Array, error: float) -> bool:
    """Return whether all symmetric matrices this near to M in norm are positive semidefinite.

    Cholesky's method ends for what is so but for its rounding [rump2006]_.
    """
    m, trace = len(M), float(np.trace(np.abs(M)))
    shift = (error + 4.0 * (m + 2.0) * (m + 2.0) * U * trace) * UP
    try:
        np.linalg.cholesky(0.5 * (M + M.T) - shift * np.eye(m))
    except np.linalg.LinAlgError:
        return False
    return True
