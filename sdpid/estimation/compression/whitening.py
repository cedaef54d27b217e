"""Whitened rows of a problem, and their compression, in one pass over the samples.

A covariance that is the same for all samples has one square root for each pattern of masked
joints, not one for each sample. Samples in contact have a weight each (`contact_rows`). Whoever
whitens rows calls `weights_of`, so that all mean the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.errors import DataError
from sdpid.estimation.compression.contact_rows import ContactRows
from sdpid.estimation.compression.covariance import masked_covariance, power
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.triangle import Triangle
from sdpid.robot.model.regressor_kernel import threads


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
    if sigma.ndim == 2 and mask.all():
        return power(sigma, exponent)[None], np.zeros(len(mask), dtype=np.intp)
    if sigma.ndim == 2:
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
    touching, powers, index = _roots(rows, part, sigma, exponent)
    mask = rows.mask(part)
    if touching is None:
        return powers, index, mask.astype(np.float64)
    T, shares = touching.eliminated(powers, index, mask)
    return T, np.arange(len(index)), shares


def effort_errors(rows: RowSource, part: slice, sigma: Array, residual: Array) -> Array:
    """Return the errors of efforts in residuals (k, n, c) ``effort − W @ base`` of some samples.

    Without contacts they are the residuals; else forces that were not measured explain what they
    can (see `ContactRows.errors`).
    """
    if rows.samples.contacts is None:
        return residual
    touching, powers, index = _roots(rows, part, sigma)
    assert touching is not None
    return touching.errors(powers, index, residual)


def with_contact_forces(rows: RowSource, part: slice, sigma: Array, predicted: Array) -> Array:
    """Return predicted efforts (k, n) of some samples, contact forces taken into account.

    They are what the robot's motion needs, `predicted`, less what forces bring: those that were
    measured, and those that leave the least error (see `effort_errors`).
    """
    if rows.samples.contacts is None:
        return predicted
    residual = (rows.effort(part) - predicted)[:, :, None]
    return rows.samples.effort[part] - effort_errors(rows, part, sigma, residual)[:, :, 0]


def _roots(
    rows: RowSource, part: slice, sigma: Array, exponent: float = -0.5
) -> tuple[ContactRows | None, Array, Indices]:
    """Return the contacts of some samples, and powers of the covariance that they have otherwise.

    That is the covariance of efforts and measured forces; powers as of `weights`.
    """
    powers, index = weights(sigma if sigma.ndim == 2 else sigma[part], rows.mask(part), exponent)
    touching = rows.contacts(part)
    if touching is None:
        return None, powers, index
    if exponent != -0.5:
        raise DataError(
            "weighting: samples with contacts have no covariance of their own to take other powers "
            "of; use 'residual', 'gls' or 'gls_per_sample'."
        )
    return touching, *touching.roots(powers, index)


def apply(powers: Array, index: Indices, rows: Array) -> Array:
    """Return every sample's rows (k, n, c) times its power, which `weights` found; as `whiten`."""
    if are_diagonal(powers):
        rows *= np.diagonal(powers, axis1=1, axis2=2)[index][:, :, None]
        return rows
    return np.asarray((powers[index] if len(powers) > 1 else powers[0]) @ rows)


def whitened_chunks(
    rows: RowSource, sigma: Array, exponent: float = -0.5, *, size: int = 0
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
    """
    for part in rows.parts(size):
        yield (
            part,
            apply(*weights_of(rows, part, sigma, exponent), rows.rows(part)),
            rows.mask(part),
        )


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
    triangle, used = Triangle(rows.base.count + 1), 0
    made = _independent(rows, sigma, within)
    # Compiled loops and matrix products let other threads run.
    for block, count in ahead(made) if rows.many and threads() > 1 else made:
        triangle.add(block)
        used += count
    return triangle, used


def _independent(rows: RowSource, sigma: Array, within: slice) -> Iterator[tuple[Array, int]]:
    """Yield the independent whitened rows (r, b + 1) of chunks, and how many they are."""
    for part in rows.parts(within=within):
        touching, powers, index = _roots(rows, part, sigma)
        block, count = rows.rows(part), int(np.count_nonzero(rows.mask(part)))
        if touching is None:
            yield apply(powers, index, block).reshape(-1, block.shape[2]), count
        else:
            found, lost = touching.independent(powers, index, block)
            yield found, count - lost


def ahead(made: Iterator[tuple[Array, int]]) -> Iterator[tuple[Array, int]]:
    """Yield what an iterator makes, the next one made meanwhile in a thread: to the same bits."""
    with ThreadPoolExecutor(1) as pool:
        coming = pool.submit(next, made, None)
        while (found := coming.result()) is not None:
            coming = pool.submit(next, made, None)
            yield found


def are_diagonal(powers: Array) -> bool:
    """Return whether weights leave the rows of a sample unmixed."""
    diagonal = np.diagonal(powers, axis1=1, axis2=2)
    return bool(np.count_nonzero(powers) == np.count_nonzero(diagonal))
