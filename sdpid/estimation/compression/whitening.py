"""Whitened rows of a problem, and their compression, in one pass over the samples.

A covariance that is the same for all samples has one square root for each pattern of masked
joints, not one for each sample. Samples in contact have a weight each (`contact_rows`). Whoever
whitens rows calls `weights_of`, so that all mean the same.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.errors import DataError
from sdpid.estimation.compression.ahead import one_ahead
from sdpid.estimation.compression.contact_rows import ContactRows
from sdpid.estimation.compression.covariance import masked_covariance, power
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.triangle import Triangle
from sdpid.robot.model.regressor_kernel import threads

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
    used, index = mask, np.arange(len(mask))
    if sigma.ndim == 2:
        if mask.all():
            return power(sigma, exponent)[None], np.zeros(len(mask), dtype=np.intp)
        patterns, index = np.unique(np.packbits(mask, axis=1), axis=0, return_inverse=True)
        used = np.unpackbits(patterns, axis=1, count=mask.shape[1]).astype(bool)
    powers = power(masked_covariance(sigma, used), exponent)
    return np.asarray(powers * (used[:, :, None] & used[:, None, :])), index.reshape(-1)


def whiten(rows: Array, sigma: Array, mask: Mask, exponent: float = -0.5) -> Array:
    """Return every sample's rows (k, n, c) times its power of Sigma, contacts aside.

    With a diagonal Sigma they are multiplied in place.
    """
    return apply(*weights(sigma, mask, exponent), rows)


def weights_of(
    rows: RowSource, part: slice, sigma: Array, exponent: float = -0.5
) -> tuple[Array, Indices]:
    """Return the different weights T (m, n, n) of some samples and which each one has, (k,).

    Parameters
    ----------
    rows : RowSource
        Whose samples.
    part : slice
        Which of them.
    sigma : ndarray, shape (n, n) or (K, n, n)
        Effort covariance, of all samples.
    exponent : float, optional
        -1/2 to whiten: then ``T^T·T`` is the information of the rows, contacts included.

    Raises
    ------
    DataError
        For another exponent where samples have contacts.
    """
    return weights_and_shares(rows, part, sigma, exponent)[:2]


def weights_and_shares(
    rows: RowSource, part: slice, sigma: Array, exponent: float = -0.5
) -> tuple[Array, Indices, Array]:
    """Return `weights_of` some samples, and how much of each row is independent, (k, n).

    Without contacts it is one for each row that is used; forces that nobody measured take as many
    as they have components.
    """
    touching, mask = _touching(rows, part, exponent), rows.mask(part)
    powers, index = _roots(rows, part, sigma, exponent, touching)
    if touching is None:
        return powers, index, mask.astype(np.float64)
    T, shares = touching.eliminated(powers, index, mask)
    return T, np.arange(len(index)), shares


def effort_errors(rows: RowSource, part: slice, sigma: Array, residual: Array) -> Array:
    """Return the errors of efforts in residuals (k, n, c) ``effort − W @ base`` of some samples.

    Without contacts they are the residuals; else forces that were not measured explain what they
    can (see `ContactRows.errors`).
    """
    touching = _touching(rows, part, -0.5)
    if touching is None:
        return residual
    return touching.errors(*_roots(rows, part, sigma, -0.5, touching), residual)


def with_contact_forces(rows: RowSource, part: slice, sigma: Array, predicted: Array) -> Array:
    """Return predicted efforts (k, n) of some samples, contact forces taken into account.

    They are what the robot's motion needs, `predicted`, less what forces bring: those that were
    measured, and those that leave the least error (see `effort_errors`).
    """
    if rows.samples.contacts is None:
        return predicted
    residual = (rows.effort(part) - predicted)[:, :, None]
    return rows.samples.effort[part] - effort_errors(rows, part, sigma, residual)[:, :, 0]


def _touching(rows: RowSource, part: slice, exponent: float) -> ContactRows | None:
    """Return the contacts of some samples."""
    touching = rows.contacts(part)
    if touching is not None and exponent != -0.5:
        raise DataError(
            "weighting: samples with contacts have no covariance of their own to take other powers "
            "of; use 'residual', 'gls' or 'gls_per_sample'."
        )
    return touching


def _roots(
    rows: RowSource, part: slice, sigma: Array, exponent: float, touching: ContactRows | None
) -> tuple[Array, Indices]:
    """Return the powers of the covariance of effort and measured forces, as `weights`."""
    powers, index = weights(sigma if sigma.ndim == 2 else sigma[part], rows.mask(part), exponent)
    return (powers, index) if touching is None else touching.roots(powers, index)


def apply(powers: Array, index: Indices, rows: Array, out: Array | None = None) -> Array:
    """Return every sample's rows (k, n, c) times its power, which `weights` found; as `whiten`."""
    if are_diagonal(powers):
        rows *= np.diagonal(powers, axis1=1, axis2=2)[index][:, :, None]
        return rows
    return np.matmul(powers[index] if len(powers) > 1 else powers[0], rows, out=out)


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
        block = rows.rows(part, None if memory is None else memory[0])
        out = None if memory is None else memory[1][: len(block)]
        yield part, apply(*weights_of(rows, part, sigma, exponent), block, out), rows.mask(part)


def compress(rows: RowSource, sigma: Array, within: slice = slice(None)) -> tuple[Triangle, int]:
    """Return the triangle of all whitened rows, the efforts last, and how many are independent.

    Parameters
    ----------
    rows : RowSource
        Regressor and efforts.
    sigma : ndarray, shape (n, n) or (K, n, n)
        Effort covariance.
    within : slice, optional
        Neighboring samples, by default all.
    """
    columns, n = rows.base.count + 1, rows.robot.n
    triangle, used = Triangle(columns), 0
    begin, end, _ = within.indices(len(rows.samples.effort))
    count = end - begin
    step = max(1, count * n // (_FIRST * columns))
    memory = [_memory(rows)]
    # Their order makes no difference but to the speed, and to the last bits.
    size = len(memory[0][0])
    first = range(begin, end, step) if size < count else range(0)
    again = slice(0)
    chunks = []
    for start in range(0, len(first), size):
        some = first[start : start + size]
        chunks.append((slice(some.start, some.stop, step), again, 0))
    for part in rows.parts(within=within):
        done = slice((begin - part.start) % step, None, step) if first else again
        chunks.append((part, done, 1))
    ahead = rows.many and len(chunks) > 2 and threads() > 1
    if ahead:
        memory.append(_memory(rows))

    def made(chunk: tuple[slice, slice, int], turn: int) -> tuple[Array, int]:
        part, done, counted = chunk
        found, own = _independent(rows, part, sigma, memory[turn % len(memory)], done)
        return found, counted * own

    for found, own in one_ahead(made, chunks, ahead=ahead):
        triangle.add(found)
        used += own
    return triangle, used


def _independent(
    rows: RowSource, part: slice, sigma: Array, memory: tuple[Array, Array], done: slice = slice(0)
) -> tuple[Array, int]:
    """Return independent whitened rows (r, b + 1) of some samples, and how many there are.

    The rows of samples that were done before are zero, but counted.
    """
    touching = _touching(rows, part, -0.5)
    if touching is None:
        powers, index = weights_of(rows, part, sigma)
        block = rows.rows(part, memory[0])
        whitened = apply(powers, index, block, memory[1][: len(block)])
        whitened[done] = 0.0
        return whitened.reshape(-1, whitened.shape[2]), int(np.count_nonzero(rows.mask(part)))
    block = rows.rows(part, memory[0])
    block[done] = 0.0
    powers, index = _roots(rows, part, sigma, -0.5, touching)
    found, lost = touching.independent(powers, index, block)
    return found, int(np.count_nonzero(rows.mask(part))) - lost


def are_diagonal(powers: Array) -> bool:
    """Return whether weights leave the rows of a sample unmixed."""
    diagonal = np.diagonal(powers, axis1=1, axis2=2)
    return bool(np.count_nonzero(powers) == np.count_nonzero(diagonal))


def _memory(rows: RowSource, size: int = 0) -> tuple[Array, Array]:
    """Return room for the rows of a chunk, and for the whitened ones."""
    size = min(size or rows.chunk_size, len(rows.samples.effort))
    shape = (size, rows.robot.n, rows.base.count + 1)
    return np.empty(shape), np.empty(shape)
