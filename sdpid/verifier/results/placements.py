"""Rotations and placements in rationals: exact from quaternions, to 2^-250 from angles."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from fractions import Fraction
from operator import mul
from typing import NamedTuple

# Sines and cosines are integers over 2^_BITS, computed with _SPARE more bits. Angles are at most
# 1e12 < 2^40, so that reducing one by multiples of pi costs less than the spare bits.
_BITS, _SPARE = 256, 80
_ONE = 1 << (_BITS + _SPARE)

Matrix = list[list[Fraction]]


class Placement(NamedTuple):
    """A frame in another one: ``x = rotation·x' + translation``."""

    rotation: Matrix
    translation: list[Fraction]

    def then(self, other: Placement) -> Placement:
        """Return the frame `other`, placed in this one, in the frame that this one is placed in.

        Entries are rounded to 2^-256, so that long chains have no long numbers.
        """
        turned = matmul(self.rotation, other.rotation)
        there = [
            at + sum(map(mul, row, other.translation))
            for row, at in zip(self.rotation, self.translation, strict=True)
        ]
        return Placement([list(map(_trimmed, row)) for row in turned], list(map(_trimmed, there)))


def _trimmed(value: Fraction) -> Fraction:
    """Return a value rounded to 2^-_BITS."""
    return Fraction(math.floor(value * (1 << _BITS)), 1 << _BITS)


def matmul(a: Matrix, b: Matrix) -> Matrix:
    """Return the product of two matrices."""
    columns = list(zip(*b, strict=True))
    return [[sum(map(mul, row, column), Fraction(0)) for column in columns] for row in a]


HERE = Placement([[Fraction(int(i == j)) for j in range(3)] for i in range(3)], [Fraction(0)] * 3)


def from_rpy(rpy: Sequence[float], translation: Sequence[float]) -> Placement:
    """Return the placement of fixed-axis roll, pitch and yaw, as URDF means them."""
    (sr, cr), (sp, cp), (sy, cy) = map(sine_and_cosine, rpy)
    rotation = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return Placement(rotation, [Fraction(x) for x in translation])


def from_quaternion(
    quaternion: Sequence[float | Fraction], translation: Sequence[float]
) -> Placement:
    """Return the placement of a quaternion (w, x, y, z) of any length but zero, exactly.

    Raises
    ------
    ZeroDivisionError
        When all four are zero.
    """
    w, x, y, z = (Fraction(entry) for entry in quaternion)
    square = w * w + x * x + y * y + z * z
    rotation = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return Placement(
        [[entry / square for entry in row] for row in rotation], [Fraction(t) for t in translation]
    )


def _arctangent(inverse: int) -> int:
    """Return arctan(1/inverse) as an integer over _ONE."""
    power, total, k = _ONE // inverse, 0, 1
    while power:
        total += power // k if k % 4 == 1 else -(power // k)
        power //= inverse * inverse
        k += 2
    return total


@functools.cache
def _half_turn() -> int:
    """Return pi as an integer over _ONE, by Machin's formula."""
    return 4 * (4 * _arctangent(5) - _arctangent(239))


def sine_and_cosine(angle: float) -> tuple[Fraction, Fraction]:
    """Return the sine and the cosine of a double of at most 1e12, each to within 2^-250."""
    pi, exact = _half_turn(), Fraction(angle)
    x = exact.numerator * _ONE // exact.denominator
    turns = (2 * x + pi) // (2 * pi)
    x -= turns * pi
    sums, term, k = [0, 0], _ONE, 0
    while term:
        sums[k % 2] += term if k % 4 < 2 else -term
        k += 1
        term = term * abs(x) // (k * _ONE)
    sign = -1 if turns % 2 else 1
    cosine, sine = (Fraction(sign * (value >> _SPARE), 1 << _BITS) for value in sums)
    return sine if x >= 0 else -sine, cosine
