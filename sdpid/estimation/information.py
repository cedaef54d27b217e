"""Find out which base parameters the data of a problem determine, and how well."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen
from sdpid._common.tables import Shown
from sdpid.errors import IdentifiabilityError

# Below this (columns scaled to unit length) a direction is lost in rounding: not determined.
UNDETERMINED = 1e-10

# Below this share of the largest singular value, columns scaled likewise, there is but rounding.
ROUNDING = 1e-12

# Below this a direction is reported as weak: errors there are a thousand times those of the best.
WEAK = 1e-3

# A parameter belongs to a direction when its share of the unit vector is at least this.
_SHARE = 0.3


@dataclass(frozen=True, eq=False, repr=False)
class Excitation(Shown):
    """How well the data determine the base parameters.

    Attributes
    ----------
    names : tuple of str
        The base parameters.
    singular_values : ndarray, shape (b,)
        Of the weighted regressor with columns scaled to unit length, largest first.
    directions : ndarray, shape (b, b)
        The matching right singular vectors, as rows.
    column_norms : ndarray, shape (b,)
        Lengths of the weighted regressor's columns.
    """

    names: tuple[str, ...]
    singular_values: Array
    directions: Array
    column_norms: Array

    _facts = ("names", "weak", "condition_number")

    @classmethod
    def of(cls, A: Array, names: tuple[str, ...]) -> Excitation:
        """Analyze a compressed regressor (b, b)."""
        norms = np.linalg.norm(A, axis=0)
        seen = norms > 0.0
        _, singular, found = np.linalg.svd(A[:, seen] / norms[seen], full_matrices=False)
        # A column of nothing is a direction by itself: a decomposition would mix several of them.
        shown, unseen = len(found), np.flatnonzero(~seen)
        directions = np.zeros((shown + len(unseen), len(norms)))
        directions[:shown, seen] = found
        directions[np.arange(shown, len(directions)), unseen] = 1.0
        singular = np.append(singular, np.zeros(len(unseen)))
        return cls(names, frozen(singular), frozen(directions), frozen(norms))

    @property
    def root(self) -> Array:
        """T (b, r) that makes the regressor's columns orthonormal (see `information_root`)."""
        kept, norms = self._kept, np.where(self.column_norms > 0.0, self.column_norms, 1.0)
        return self.directions[kept].T / self.singular_values[kept] / norms[:, None]

    @property
    def inverse(self) -> Array:
        """``T^+`` (r, b): the coordinates of base parameters that the data show."""
        kept = self._kept
        return self.singular_values[kept, None] * self.directions[kept] * self.column_norms

    @property
    def _kept(self) -> Mask:
        return np.asarray(self.singular_values >= UNDETERMINED)

    @property
    def condition_number(self) -> float:
        """Largest over smallest singular value of the scaled columns; infinite if one is zero."""
        smallest = float(self.singular_values[-1])
        return float(self.singular_values[0]) / smallest if smallest > 0.0 else float("inf")

    def weak(self, limit: float = WEAK) -> tuple[tuple[float, tuple[str, ...]], ...]:
        """Return (singular value, parameters) of each direction weaker than `limit`."""
        return tuple(
            (
                float(value),
                tuple(n for n, share in zip(self.names, row, strict=True) if abs(share) >= _SHARE),
            )
            for value, row in zip(self.singular_values, self.directions, strict=True)
            if value < limit
        )


def information_root(X: Array) -> Array:
    """Return T (b, r) that makes the columns of ``X·T`` orthonormal, on what X (k, b) determines.

    So ``T·T^T`` is the inverse of ``X^T·X``. Where X determines nothing, errors are infinite and T
    has no column: whoever uses it must not take them for zero.
    Give rows or their triangle: products ``X^T·X`` have lost half of the digits, and with them
    every direction below 1e-7.
    """
    return Excitation.of(X, ()).root


def least_squares(X: Array, y: Array) -> Array:
    """Return the shortest x that minimizes ``‖X·x − y‖``, its entries in units of the columns."""
    return fitted(X, y)[0]


def fitted(X: Array, y: Array) -> tuple[Array, int]:
    """Return `least_squares`, and the rank of X."""
    # Columns scaled to unit length: their units differ, and so do their sizes by orders.
    scale = np.linalg.norm(X, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    found, _, rank, _ = np.linalg.lstsq(X / scale, y, rcond=ROUNDING)
    return np.asarray(found / scale), int(rank)


def freedom_of(parts: Array, freedom: Array) -> Array:
    """Return degrees of freedom of sums of independent variances, by Satterthwaite's formula.

    Parameters
    ----------
    parts : ndarray, shape (m, k)
        Variances that make up each of m sums.
    freedom : ndarray, shape (k,) or (m, k)
        Degrees of freedom of each.

    Returns
    -------
    ndarray, shape (m,)
        Infinite where the variances are known, or zero.
    """
    spread, out = (parts**2 / freedom).sum(axis=1), np.full(len(parts), np.inf)
    return np.asarray(np.divide(parts.sum(axis=1) ** 2, spread, out=out, where=spread > 0.0))


def information_rows(H: Array) -> Array:
    """Return X (b, b) with ``X^T·X = H``, of an information of which no rows are left.

    What rounding of H hides, directions below about 1e-7, X does not determine.
    """
    size = np.sqrt(np.maximum(np.diagonal(H), 0.0))
    scale = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(H / np.outer(scale, scale))
    kept = values > len(H) * np.finfo(float).eps * values[-1]
    # A column of nothing stays one: rounding of the vectors is no information.
    return np.asarray(np.sqrt(np.where(kept, values, 0.0))[:, None] * vectors.T * size)


def require_excitation(excitation: Excitation) -> None:
    """Raise when the data leave a base parameter undetermined.

    Raises
    ------
    IdentifiabilityError
        Naming the parameters and the singular values.
    """
    lost = excitation.weak(UNDETERMINED)
    if not lost:
        return
    listed = "; ".join(
        f"{' with '.join(names) or 'a mixture of many'} ({value:.1e})" for value, names in lost[:6]
    )
    more = f"; and {len(lost) - 6} more" if len(lost) > 6 else ""
    raise IdentifiabilityError(
        f"the data do not excite {len(lost)} of {len(excitation.names)} base parameter directions "
        f"(singular values, limit {UNDETERMINED:.0e}): {listed}{more}. Record a motion that moves "
        "these joints, or leave out the terms."
    )
