"""Sums of products over all weighted rows of a problem, with bounds of every rounding in them.

The rows of a sample are W_k, the efforts last, and its weight is a power of its covariance Sigma_k.
What computers have is V_k with ``V_k^T·V_k ≈ Sigma_k^(2e)``. How near is found for each V_k, from
``V·Sigma·V^T − E``, not taken from the way in which it was made.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.assurance.certificate.outward import (
    SLACK,
    UNDERFLOW,
    below_one,
    gamma,
    lengths,
    quotient,
    usable,
)
from sdpid.estimation.compression.rows import Rows, RowSource
from sdpid.estimation.compression.whitening import apply, weights

# Rows whose products are added up in one go: half of what bounds the error of the sums.
_BLOCK = 128

# Roundings of a sum of sums with their errors carried along [ogita2005]_, twice: over the chunks
# of a piece and over the pieces.
_CARRIED = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class RowSums:
    """Products of all whitened rows X, or of X·M, with what bounds their errors.

    Attributes
    ----------
    gram : ndarray, shape (c, c)
        (X·M)^T·(X·M), or X^T·X.
    lengths, off_lengths : ndarray, shape (c,)
        Norms of the columns of X, as computed, rounded up; and those of X with the rows of each
        sample times the root of the error of its weight (see `weight`).
    squares : float
        Sum of the squared entries of X·M, or of X, as computed, rounded up.
    operations : int
        Every product in `gram` goes through at most so many additions.
    weight : float
        Every sample's weight is within this share of the exact one: with Sigma the covariance,
        ``Sigma^(2e) = V^T·(E + J)·V`` with ‖J‖ at most this.
    whitening : float
        The columns of X, as computed, are off by at most this share of their computed norms, of
        all samples and of each.
    """

    gram: Array
    lengths: Array
    off_lengths: Array
    squares: float
    operations: int
    weight: float
    whitening: float

    @property
    def rounding(self) -> float:
        """Every entry of `gram` is off by at most this share of the two columns' norms."""
        return gamma(self.operations)

    @property
    def usable(self) -> bool:
        """Whether every number is finite, and so far from overflow that bounds hold."""
        bounds = np.array([self.weight, self.whitening, self.squares])
        return usable(self.gram, self.lengths, bounds)

    @classmethod
    def of(cls, rows: Rows, sigma: Array, exponent: float, M: Array | None = None) -> RowSums:
        """Add up the products over all rows, wherever they are."""
        return cls._merged(rows.map(_sums, exponent, M, sigma=sigma))

    @classmethod
    def _merged(cls, pieces: Sequence[RowSums]) -> RowSums:
        total = _CarriedSum(pieces[0].gram.shape)
        for piece in pieces:
            total.add(piece.gram)
        return cls(
            gram=total.value,
            lengths=lengths(np.array([piece.lengths for piece in pieces])),
            off_lengths=lengths(np.array([piece.off_lengths for piece in pieces])),
            squares=SLACK * sum(piece.squares for piece in pieces),
            operations=max(piece.operations for piece in pieces),
            weight=max(piece.weight for piece in pieces),
            whitening=max(piece.whitening for piece in pieces),
        )


class _CarriedSum:
    """A sum of arrays that loses next to nothing: what each addition rounds off is added up too."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._sum, self._lost = np.zeros(shape), np.zeros(shape)

    def add(self, term: Array) -> None:
        """Add an array."""
        new = self._sum + term
        seen = new - self._sum
        self._lost += (self._sum - (new - seen)) + (term - seen)
        self._sum = new

    @property
    def value(self) -> Array:
        """The sum, right to two roundings of the sizes that were added."""
        return np.asarray(self._sum + self._lost)


def _sums(rows: RowSource, sigma: Array, exponent: float, M: Array | None) -> RowSums:
    """Return the sums over the rows of one piece."""
    n, columns = rows.robot.n, rows.base.count + 1
    size = min(rows.chunk_size, len(rows.samples.effort))
    memory = np.empty((2, size, n, columns))
    total, squared, squares = _CarriedSum((columns, columns)), np.zeros((2, columns)), 0.0
    operations, weight, whitening = 0, 0.0, 0.0
    for part in rows.parts(size):
        mask, own = rows.mask(part), sigma if sigma.ndim == 2 else sigma[part]
        powers, index = weights(own, mask, exponent)
        used = np.zeros((len(powers), n), dtype=bool)
        used[index] = mask
        off, enlarged = whitener_error(powers, own, used, exponent)
        weight = max(weight, float(off.max()))
        moved = gamma(n + 1) * enlarged
        whitening = max(whitening, float(quotient(moved, below_one(moved)).max()))
        block = rows.rows(part, memory[0])
        X = apply(powers, index, block, memory[1][: len(block)]).reshape(-1, columns)
        each = np.einsum("kij,kij->kj", *[X.reshape(block.shape)] * 2)
        squared += each.sum(axis=0), np.minimum(off, 1.0)[index] @ each
        Y = X if M is None else X @ M
        gram, depth = _gram(Y)
        total.add(gram)
        squares += float(np.trace(gram))
        operations = max(operations, depth)
    # Of positive numbers: rounding is a small share of each.
    sizes, off_sizes = SLACK * np.sqrt(squared)
    return RowSums(
        gram=total.value,
        lengths=sizes,
        off_lengths=off_sizes,
        squares=SLACK * squares,
        operations=operations + _CARRIED,
        weight=SLACK * weight,
        whitening=SLACK * whitening,
    )


def _gram(rows: Array) -> tuple[Array, int]:
    """Return rows^T·rows, and through how many additions a product goes at most."""
    blocks = len(rows) // _BLOCK
    cut = blocks * _BLOCK
    stacked = rows[:cut].reshape(blocks, _BLOCK, rows.shape[1])
    gram = np.matmul(stacked.transpose(0, 2, 1), stacked).sum(axis=0)
    return gram + rows[cut:].T @ rows[cut:], _BLOCK + blocks + 1


def whitener_error(powers: Array, sigma: Array, used: Mask, exponent: float) -> tuple[Array, Array]:
    """Return how far powers V of covariances are from exact ones, and how much V enlarges errors.

    With ``V·Sigma·V^T = E + H`` and ‖H‖ ≤ d < 1, ``Sigma^-1 = V^T·(E + H)^-1·V``, so that the
    weight ``V^T·V`` is off by a share of at most d/(1 − d). For the exponent -1/4 the same follows
    from ``T·Sigma·T = E + H``, ``T = V^T·V``: with S the root of Sigma, the eigenvalues of T·S are
    those of the positive definite ``N = V·S·V^T`` and lie between the singular values of T·S, which
    are the roots of the eigenvalues of E + H; and ``S^-1 = V^T·N^-1·V``.

    Rounding in ``V·rows`` is at most a multiple of ``|V|·|rows| ≤ |V|·|V^-1|·|V·rows|``.

    Parameters
    ----------
    powers : ndarray, shape (m, n, n)
        V, zero in rows and columns that are not used.
    sigma : ndarray, shape (n, n) or (m, n, n)
        Covariances, of which the lower triangles count.
    used : ndarray of bool, shape (m, n)
        Rows that are used.
    exponent : float
        -1/2 or -1/4.

    Returns
    -------
    weight : ndarray, shape (m,)
        Bounds of that share; infinite where none is found.
    enlarged : ndarray, shape (m,)
        Bounds of the norm of ``|V|·|V^-1|``.
    """
    n = used.shape[1]
    nothing = np.full(len(used), math.inf), np.full(len(used), math.inf)
    both = used[:, :, None] & used[:, None, :]
    lower = np.tril(sigma)
    S = np.where(both, lower + np.swapaxes(np.tril(sigma, -1), -1, -2), 0.0)
    V, size = powers, np.abs(powers)
    if not usable(S, V):
        return nothing
    # Each of two products for T·Sigma·T rounds n times, and so does that for each T.
    T, T_size, operations = V, size, 2 * n + 2
    if exponent != -0.5:
        T, T_size = np.swapaxes(V, -1, -2) @ V, np.swapaxes(size, -1, -2) @ size
        operations = 4 * n + 4
    H = T @ (S @ np.swapaxes(T, -1, -2)) - np.eye(n) * used[:, None, :]
    rounding = gamma(operations) * (T_size @ (np.abs(S) @ np.swapaxes(T_size, -1, -2)))
    off = _norms(np.abs(H) + rounding)
    filled = V + np.eye(n) * ~used[:, None, :]
    try:
        inverse = np.linalg.inv(filled)
    except np.linalg.LinAlgError:
        return nothing
    product = np.abs(filled) @ np.abs(inverse)
    left = _norms(np.abs(np.eye(n) - filled @ inverse) + gamma(n + 1) * product)
    return quotient(off, below_one(off)), quotient(_norms(product), below_one(left))


def _norms(matrices: Array) -> Array:
    """Return the Frobenius norms of some matrices, rounded up."""
    return np.asarray(SLACK * np.sqrt(np.sum(np.square(matrices), axis=(1, 2))) + UNDERFLOW)
