"""Bounds of rounding errors in double precision, on the safe side [higham2002]_, [rump2010]_.

A sum of k products of doubles, added in any order and with or without fused operations, is within
``gamma(k)·Σ|products|`` of the exact one, as long as nothing overflows or underflows. It holds for
every library that multiplies matrices by adding up products, and so for any BLAS, any block size
and any number of threads; only schemes that subtract first (Strassen's) are outside.

Bounds themselves are made of positive numbers alone, so that rounding changes them by a small
share, for which there is `SLACK`. Only a small bound is ever taken from 1 (`below_one`), which is
as harmless.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array

# Half the distance from 1 to the next double: the relative error of one operation.
UNIT = 2.0**-53

# Positive sums and products of fewer than 2^30 operations after each other are right to 2^-22, and
# so is the difference that `below_one` allows; there is room for eight such.
SLACK = 1.0 + 2.0**-19

# Numbers up to this size, and sums of at most 2^40 of their products, lose less than `UNDERFLOW`
# where results that are too small for a double are rounded to zero, even if the processor does so
# below 2^-1022 (flush to zero).
LARGEST = 2.0**200
UNDERFLOW = 2.0**-100

# What bounds of relative errors have to stay below to be of use.
_HALF = 0.5


def gamma(operations: int) -> float:
    """Return the relative error k·u/(1 − k·u) of a sum of k products."""
    return operations * UNIT / (1.0 - operations * UNIT) * SLACK


def below_one(bound: ArrayLike) -> Array:
    """Return ``1 − bound``, rounded down, or zero where the bound is no longer small."""
    values = np.asarray(bound, dtype=np.float64)
    return np.where(values < _HALF, (1.0 - SLACK * values) / SLACK, 0.0)


def quotient(numerator: ArrayLike, denominator: ArrayLike) -> Array:
    """Return a quotient of bounds; infinite where nothing is known of the denominator."""
    above, below = np.asarray(numerator, dtype=np.float64), np.asarray(denominator)
    known = below > 0.0
    return np.where(known, above / np.where(known, below, 1.0), np.inf)


def norm(matrix: Array) -> float:
    """Return the Frobenius norm, which bounds the spectral norm, rounded up."""
    return SLACK * float(np.sqrt(np.sum(np.square(matrix))))


def lengths(rows: Array) -> Array:
    """Return the Euclidean norm of each column, rounded up."""
    return np.asarray(SLACK * np.sqrt(np.einsum("ij,ij->j", rows, rows)))


def usable(*arrays: Array) -> bool:
    """Whether all numbers are finite and far from overflow."""
    return all(bool(np.all(np.abs(array) <= LARGEST)) for array in arrays)
