"""Midpoint and radius: arithmetic that keeps a bound of its own rounding [rump1999]_.

Of every quantity there is a midpoint a sample, computed in plain doubles, and one radius for all
samples of a chunk, so that the radii cost next to nothing. Of a vector the radius bounds the
Euclidean norm of the error, of a matrix the spectral norm: a rotation then leaves it as it is.

An operation of doubles returns ``x (1 + d) + e`` for the exact x, ``|d| ≤ u``, ``|e| ≤ TINY``
(IEEE 754, to nearest). Bounds are sums and products of numbers that are not negative, so their own
rounding is covered by `sdpid.assurance.certificate.outward.SLACK`, here `UP`. They hold for any
order of summation, with or without fused operations. An overflow makes a radius infinite.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.outward import SLACK as UP
from sdpid.assurance.certificate.outward import UNIT as U

# More than underflow takes from the results of an operation on three numbers.
TINY = 2.0**-1000

# More than the root of what it takes from a sum of squares.
SMALL = 2.0**-500

# Rounding of a sum of three products: γ₃ = 3u/(1 − 3u) ≤ 3u·UP, per product of the norms. A
# component of a cross product has two, and its terms have at most √2 times the norms' product: 2·√2
# < 3.
_DOT = 3.0 * U
_CROSS = 3.0 * U

# The norm of the absolute values of a 3×3 matrix is at most √3 times its spectral norm; of a
# product of two such matrices the Frobenius norm is at most 3 times those norms.
_APPLY = 3.0 * 1.7320508075688774 * U
_COMPOSE = 9.0 * U


@dataclass(frozen=True, eq=False)
class Enclosed:
    """Numbers, vectors or matrices of K samples, each within a radius of its midpoint.

    Attributes
    ----------
    mid : ndarray, shape (..., K), (..., 3, K) or (..., 3, 3, K)
        Midpoints, samples last.
    rad : ndarray, shape (...)
        Bound of the norm of the error, for all samples.
    size : ndarray, shape (...)
        Bound of the norm of the midpoints, for all samples.
    """

    mid: Array
    rad: Array
    size: Array

    @classmethod
    def exact(cls, mid: Array) -> Enclosed:
        """Return numbers (..., K) without error."""
        mid = np.asarray(mid, dtype=np.float64)
        return cls(mid, np.zeros(mid.shape[:-1]), largest(mid))

    @classmethod
    def constant(cls, values: Any) -> Enclosed:
        """Return numbers (...) without error that are the same for all samples."""
        return cls.exact(np.asarray(values, dtype=np.float64)[..., None])

    def at(self, index: Any) -> Enclosed:
        """Return some of the quantities."""
        return Enclosed(self.mid[index], self.rad[index], self.size[index])

    def part(self, axis: int) -> Enclosed:
        """Return one component of vectors; neither bound is smaller for it."""
        return Enclosed(self.mid[..., axis, :], self.rad, self.size)

    def measured(self) -> Enclosed:
        """Return the same vectors with their size as it is, not as it was bounded."""
        square = np.einsum("...ik,...ik->...k", self.mid, self.mid)
        return replace(self, size=root(np.max(square, axis=-1)))

    def off(self, error: Any) -> Enclosed:
        """Return the same with a further error of at most this."""
        return replace(self, rad=(self.rad + error) * UP)

    def __neg__(self) -> Enclosed:
        """Return −x, which is exact."""
        return replace(self, mid=-self.mid)

    def __add__(self, other: Enclosed) -> Enclosed:
        """Return x + y: both errors, and u of the sum."""
        size = (self.size + other.size) * UP
        return Enclosed(self.mid + other.mid, (self.rad + other.rad + U * size) * UP, size)

    def __sub__(self, other: Enclosed) -> Enclosed:
        """Return x − y."""
        return self + -other

    def __mul__(self, other: Enclosed) -> Enclosed:
        """Return the products of numbers: the other's size times an error, and u of the product."""
        return _product(self.mid * other.mid, self, other, U)

    def times(self, vector: Enclosed) -> Enclosed:
        """Return vectors times these numbers, which rounds as much of each component."""
        return _product(self.mid[..., None, :] * vector.mid, self, vector, U)

    def dot(self, other: Enclosed) -> Enclosed:
        """Return x·y: Cauchy and Schwarz, for errors and for the sum of absolute products."""
        a, b = self.mid, other.mid
        mid = a[..., 0, :] * b[..., 0, :]
        mid += a[..., 1, :] * b[..., 1, :]
        mid += a[..., 2, :] * b[..., 2, :]
        return _product(mid, self, other, _DOT)

    def cross(self, other: Enclosed) -> Enclosed:
        """Return x × y, no longer than the product of the norms."""
        a, b = self.mid, other.mid
        mid = np.empty(np.broadcast_shapes(a.shape, b.shape))
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            np.multiply(a[..., j, :], b[..., k, :], out=mid[..., i, :])
            mid[..., i, :] -= a[..., k, :] * b[..., j, :]
        return _product(mid, self, other, _CROSS)

    def apply(self, vector: Enclosed) -> Enclosed:
        """Return matrices times vectors."""
        R, x = self.mid, vector.mid
        mid = R[..., :, 0, :] * x[..., None, 0, :]
        mid += R[..., :, 1, :] * x[..., None, 1, :]
        mid += R[..., :, 2, :] * x[..., None, 2, :]
        return _product(mid, self, vector, _APPLY)

    def back(self, vector: Enclosed) -> Enclosed:
        """Return the transposed matrices times vectors."""
        return replace(self, mid=np.swapaxes(self.mid, -3, -2)).apply(vector)

    def compose(self, other: Enclosed) -> Enclosed:
        """Return the products of matrices."""
        columns = [
            self.mid[..., :, 0, :] * other.mid[..., None, 0, j, :]
            + self.mid[..., :, 1, :] * other.mid[..., None, 1, j, :]
            + self.mid[..., :, 2, :] * other.mid[..., None, 2, j, :]
            for j in range(3)
        ]
        return _product(np.stack(columns, axis=-2), self, other, _COMPOSE)


def _product(mid: Array, x: Enclosed, y: Enclosed, rounding: float) -> Enclosed:
    """Return a bilinear product whose norm is at most the norms' product."""
    size = x.size * y.size
    rad = x.rad * (y.size + y.rad) + x.size * y.rad + rounding * size
    return Enclosed(mid, rad * UP + TINY, size * UP + TINY)


def largest(values: Array) -> Array:
    """Return the largest absolute value over the samples, the last axis; exact."""
    return np.asarray(np.maximum(values.max(axis=-1), -values.min(axis=-1)))


def root(values: Any) -> Any:
    """Return an upper bound of the roots of numbers that are not negative, such as squares' sums.

    The squares may have rounded to nothing.
    """
    return np.sqrt(values) * UP + SMALL
