"""Whitened rows of a problem, and their compression, in one pass over the samples.

A covariance that is the same for all samples has one square root for each pattern of masked
joints, not one for each sample.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.estimation.compression.covariance import masked_covariance, power, whitener
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.triangle import Triangle

# The first rows folded in are those of samples spread over the whole record, this many times as
# many rows as columns: the others then have little that these have not.
_FIRST = 12


def weights(sigma: Array, mask: Mask, exponent: float = -0.5) -> tuple[Array, Indices]:
    """Return the different powers of Sigma (m, n, n) and which of them each sample has, (k,).

    Parameters
    ----------
    sigma : ndarray, shape (n, n) or (k, n, n)
        Effort covariance.
    mask : ndarray of bool, shape (k, n)
        Rows that are used; rows and columns of the others are zero.
    exponent : float
        -1/2 to whiten.
    """
    if sigma.ndim == 3:
        return whitener(sigma, mask, exponent), np.arange(len(mask))
    if mask.all():
        return power(sigma, exponent)[None], np.zeros(len(mask), dtype=np.intp)
    patterns, index = np.unique(np.packbits(mask, axis=1), axis=0, return_inverse=True)
    used = np.unpackbits(patterns, axis=1, count=mask.shape[1]).astype(bool)
    powers = power(masked_covariance(sigma, used), exponent)
    powers = powers * (used[:, :, None] & used[:, None, :])
    return np.asarray(powers), index.reshape(-1).astype(np.intp)


def whiten(
    rows: Array, sigma: Array, mask: Mask, exponent: float = -0.5, out: Array | None = None
) -> Array:
    """Return every sample's rows (k, n, c) times its power of Sigma, in `out` if it is given.

    With a diagonal Sigma and nothing masked they are multiplied in place.
    """
    return apply(*weights(sigma, mask, exponent), rows, out)


def apply(powers: Array, index: Indices, rows: Array, out: Array | None = None) -> Array:
    """Return every sample's rows (k, n, c) times its power, which `weights` found; as `whiten`."""
    if len(powers) > 1:
        return np.matmul(powers[index], rows, out=out)
    scale = np.diagonal(powers[0])
    if np.array_equal(powers[0], np.diag(scale)):
        rows *= scale[:, None]
        return rows
    return np.matmul(powers[0], rows, out=out)


def whitened_chunks(
    rows: RowSource, sigma: Array, exponent: float = -0.5, *, size: int = 0, keep: bool = False
) -> Iterator[tuple[slice, Array, Mask]]:
    """Yield (slice, Sigma^exponent times the rows (k, n, b + 1), efforts last, mask), in order.

    Parameters
    ----------
    rows : RowSource
        Regressor and efforts.
    sigma : ndarray, shape (n, n) or (K, n, n)
        Effort covariance.
    exponent : float, optional
        -1/2 makes rows of unit covariance.
    size : int, optional
        Samples at a time, by default `RowSource.chunk_size`.
    keep : bool, optional
        Give every chunk memory of its own; by default the next one uses it again.
    """
    memory = None if keep else _memory(rows, size)
    for part in rows.parts(size):
        yield part, *_whitened(rows, part, sigma, exponent, memory)


def compress(rows: RowSource, sigma: Array) -> tuple[Triangle, int]:
    """Return the triangle of all whitened rows, the efforts last, and how many rows are used.

    Parameters
    ----------
    rows : RowSource
        Regressor and efforts.
    sigma : ndarray, shape (n, n) or (K, n, n)
        Effort covariance.
    """
    columns, n = rows.base.count + 1, rows.robot.n
    triangle, used = Triangle(columns), 0
    count = len(rows.samples.effort)
    step = max(1, count * n // (_FIRST * columns))
    memory = _memory(rows)
    # Their order makes no difference but to the speed, and to the last bits.
    size = len(memory[0])
    first = range(0, count, step) if size < count else range(0)
    for start in range(0, len(first), size):
        some = first[start : start + size]
        part = slice(some.start, some.stop, step)
        triangle.add(_whitened(rows, part, sigma, -0.5, memory)[0].reshape(-1, columns))
    for part, whitened, mask in whitened_chunks(rows, sigma):
        if first:
            whitened[-part.start % step :: step] = 0.0
        triangle.add(whitened.reshape(-1, columns))
        used += int(np.count_nonzero(mask))
    return triangle, used


def _memory(rows: RowSource, size: int = 0) -> tuple[Array, Array]:
    """Return room for the rows of a chunk, and for the whitened ones."""
    size = min(size or rows.chunk_size, len(rows.samples.effort))
    shape = (size, rows.robot.n, rows.base.count + 1)
    return np.empty(shape), np.empty(shape)


def _whitened(
    rows: RowSource, part: slice, sigma: Array, exponent: float, memory: tuple[Array, Array] | None
) -> tuple[Array, Mask]:
    mask = rows.mask(part)
    block = rows.rows(part, None if memory is None else memory[0])
    out = None if memory is None else memory[1][: len(block)]
    return whiten(block, sigma if sigma.ndim == 2 else sigma[part], mask, exponent, out), mask
