"""Sums of products over all weighted rows of a problem, with bounds of every rounding in them.

The rows of a sample, the efforts last, are multiplied by V_k with ``V_k^T·V_k ≈ Sigma_k^(2e)``, its
weight; see `whitener_errors` for how near that is, and `contact_whiteners` for samples in contact.
X are the whitened rows of all samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.contact_whiteners import contact_whiteners
from sdpid.assurance.certificate.outward import (
    LARGEST,
    SLACK,
    gamma,
    lengths,
    usable,
)
from sdpid.assurance.certificate.whitener_errors import WhitenerErrors
from sdpid.estimation.compression.rows import Rows, RowSource
from sdpid.estimation.compression.whitening import apply, weights

# Rows whose products are added up in one go: half of what bounds the error of the sums.
_BLOCK = 128

# Roundings of a sum of sums with their errors carried along [ogita2005]_, twice: over the chunks
# of a piece and over the pieces.
_CARRIED = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class RowSums:
    """Products of all whitened rows X with themselves or of X·M, with bounds of their errors.

    With J the block-diagonal error of the weights (see `WhitenerErrors`), X·M is used with X^T·X,
    and X alone with X^T·(E + J)·X, for which J is taken in as far as it is known.

    Attributes
    ----------
    gram : ndarray, shape (c, c)
        (X·M)^T·(X·M), or X^T·(E + J)·X.
    lengths, off_lengths : ndarray, shape (c,)
        Norms of the columns of X, as computed, rounded up; and those of X with the rows of each
        sample times the root of a share e_k: entry (i, j) of `gram` without M is off by at most
        the product of the two norms, beside `rounding`.
    squares : float
        Sum of the squared entries of X·M, or of X, as computed, rounded up.
    operations : int
        Every product in `gram` goes through at most so many additions.
    weight : float
        Largest ‖J‖.
    moved : ndarray, shape (c,)
        Norms of what the columns of X, as computed, are off by at most.
    """

    gram: Array
    lengths: Array
    off_lengths: Array
    squares: float
    operations: int
    weight: float
    moved: Array

    @property
    def rounding(self) -> float:
        """Every entry of `gram` is off by at most this share of its factors' columns' norms."""
        return gamma(self.operations)

    @property
    def usable(self) -> bool:
        """Whether every number is finite, and so far from overflow that bounds hold."""
        bounds = np.array([self.weight, self.squares])
        return usable(self.gram, self.lengths, self.moved, bounds)

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
            moved=lengths(np.array([piece.moved for piece in pieces])),
            squares=SLACK * sum(piece.squares for piece in pieces),
            operations=max(piece.operations for piece in pieces),
            weight=max(piece.weight for piece in pieces),
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


@dataclass(frozen=True, kw_only=True, eq=False)
class _Whitened:
    """Whitened rows of some samples, and what is known of them.

    Attributes
    ----------
    X : ndarray, shape (r, c)
        The rows as computed.
    nearly : ndarray, shape (r, c), or None
        What J nearly is, times X; None for samples in contact, of which no product needs it.
    moved, off : ndarray, shape (c,)
        Squares of `RowSums.moved` and `RowSums.off_lengths`.
    weight : float
        Largest ‖J‖.
    """

    X: Array
    nearly: Array | None
    moved: Array
    off: Array
    weight: float


def _sums(rows: RowSource, sigma: Array, exponent: float, M: Array | None) -> RowSums:
    """Return the sums over the rows of one piece."""
    n, columns = rows.robot.n, rows.base.count + 1
    size = min(rows.chunk_size, len(rows.samples.effort))
    memory = np.empty((2, size, n, columns))
    total, squared, squares = _CarriedSum((columns, columns)), np.zeros((3, columns)), 0.0
    operations, weight = 0, 0.0
    for part in rows.parts(size):
        for found in _whitened(rows, part, sigma, exponent, memory):
            weight = max(weight, found.weight)
            squared += np.einsum("ij,ij->j", found.X, found.X), found.off, found.moved
            if M is None:
                assert found.nearly is not None  # contacts have no other power than -1/2
                gram, depth = _gram(found.X, found.X + found.nearly)
            else:
                Y = found.X @ M
                gram, depth = _gram(Y, Y)
            total.add(gram)
            squares += float(np.trace(gram))
            operations = max(operations, depth)
    # Of positive numbers: rounding is a small share of each.
    sizes, off_sizes, moved = SLACK * np.sqrt(squared)
    return RowSums(
        gram=total.value,
        lengths=sizes,
        off_lengths=off_sizes,
        squares=SLACK * squares,
        operations=operations + _CARRIED,
        weight=SLACK * weight,
        moved=moved,
    )


def _whitened(
    rows: RowSource, part: slice, sigma: Array, exponent: float, memory: Array
) -> Iterator[_Whitened]:
    """Yield the whitened rows of some samples, those in contact by how many directions they lose.

    Parameters
    ----------
    memory : ndarray, shape (2, k, n, c)
        To be used.
    """
    mask, own = rows.mask(part), sigma if sigma.ndim == 2 else sigma[part]
    touching = rows.contacts(part) if exponent == -0.5 else None
    if touching is not None:
        block = rows.rows(part, memory[0])
        for each in contact_whiteners(touching, own, mask):
            W = block[each.some]
            off = np.minimum(each.moved(W), LARGEST)
            yield _Whitened(
                X=each.times(W).reshape(-1, block.shape[2]),
                nearly=None,
                moved=np.einsum("kj,kj->j", off, off),
                off=np.zeros(block.shape[2]),
                weight=float(each.weight.max(initial=0.0)),
            )
        return
    powers, index = weights(own, mask, exponent)
    used = np.zeros((len(powers), mask.shape[1]), dtype=bool)
    used[index] = mask
    errors = WhitenerErrors.of(powers, own, used, exponent)
    block = rows.rows(part, memory[0])
    X = apply(powers, index, block, memory[1][: len(block)])
    each = np.einsum("kij,kij->kj", X, X)
    off = np.minimum(_shares(errors, mask.shape[1]), LARGEST)
    share = np.minimum(errors.rounding, LARGEST) ** 2
    X = X.reshape(-1, block.shape[2])
    yield _Whitened(
        X=X,
        nearly=(errors.nearly[index] @ X.reshape(block.shape)).reshape(X.shape),
        moved=share[index] @ each,
        off=off[index] @ each,
        weight=float(errors.weight.max()),
    )


def _shares(errors: WhitenerErrors, n: int) -> Array:
    """Return bounds of the error of X^T·(E + J)·X for one sample, over the norms of two columns.

    The columns as computed are off, what J is nearly is rounded as it is multiplied and added, and
    there is what is not known of J.
    """
    moved = errors.rounding
    share = errors.rest + (2.0 + moved) * moved + gamma(n + 2)
    return SLACK * share * (1.0 + moved) ** 2 * (1.0 + errors.weight)


def _gram(left: Array, right: Array) -> tuple[Array, int]:
    """Return left^T·right, and through how many additions a product goes at most."""
    blocks, columns = len(left) // _BLOCK, left.shape[1]
    cut = blocks * _BLOCK
    shape = blocks, _BLOCK, columns
    stacked = left[:cut].reshape(shape).transpose(0, 2, 1)
    gram = np.matmul(stacked, right[:cut].reshape(shape)).sum(axis=0)
    return gram + left[cut:].T @ right[cut:], _BLOCK + blocks + 1
