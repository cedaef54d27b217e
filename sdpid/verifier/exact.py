"""Linear algebra, logarithms and roots without rounding: integers and rationals only."""

from __future__ import annotations

import math
from fractions import Fraction
from operator import mul
from typing import Any


def integers(values: Any) -> tuple[list[int], int]:
    """Return integers n and one denominator d with ``values = n/d`` exactly."""
    ratios = [value.as_integer_ratio() for value in values]
    common = math.lcm(*{denominator for _, denominator in ratios})
    return [n * (common // denominator) for n, denominator in ratios], common


def product(matrix: Any, vector: Any) -> list[Fraction]:
    """Return matrix·vector."""
    entries, unit = integers(vector)
    rows = map(integers, matrix)
    return [Fraction(sum(map(mul, row, entries)), scale * unit) for row, scale in rows]


def transposed(matrix: Any) -> list[Any]:
    """Return the columns of a matrix."""
    return list(zip(*matrix, strict=True))


def dot(a: Any, b: Any) -> Fraction:
    """Return a·b."""
    return product([a], b)[0]


def inner(a: Any, b: Any) -> Fraction:
    """Return ⟨a, b⟩ = tr(a^T·b) of two matrices."""
    return dot([x for row in a for x in row], [x for row in b for x in row])


def factorize(matrix: Any) -> tuple[bool, Fraction]:
    """Return whether a matrix is symmetric and ⪰ 0, and then its determinant (else 0).

    Elimination without fractions (Bareiss): all divisions come out even, and pivots keep their
    sign. Where a pivot is zero, a matrix ⪰ 0 has nothing but zeros in that row.
    """
    size = len(matrix)
    if any(len(row) != size for row in matrix):
        return False, Fraction(0)
    flat, unit = integers([x for row in matrix for x in row])
    a = [flat[size * i : size * (i + 1)] for i in range(size)]
    if any(a[i][j] != a[j][i] for i in range(size) for j in range(i)):
        return False, Fraction(0)
    previous, singular = 1, False
    for k in range(size):
        pivot = a[k][k]
        if pivot < 0 or (pivot == 0 and any(a[k][k + 1 :])):
            return False, Fraction(0)
        if pivot == 0:
            singular = True
            continue
        for i in range(k + 1, size):
            for j in range(i, size):
                a[i][j] = (a[i][j] * pivot - a[k][i] * a[k][j]) // previous
        previous = pivot
    return True, Fraction(0) if singular else Fraction(previous, unit**size)


def positive_semidefinite(matrix: Any) -> bool:
    """Return whether a matrix of ints, Fractions or floats is symmetric and ⪰ 0, exactly."""
    return factorize(matrix)[0]


def log_bounds(value: Fraction) -> tuple[Fraction, Fraction]:
    """Return rationals with ``lower ≤ ln(value) ≤ upper``, value > 0.

    With value = m·2^e and 1/2 < m < 2, ln(value) = e·ln 2 + ln m. The logarithm rises, so m may be
    replaced by neighbors with fewer digits. ln m = 2·atanh(z), z = (m − 1)/(m + 1), |z| < 1/3, and
    atanh z = z + z³/3 + z⁵/5 + …, whose rest after the term of z^(2n−1) has the sign of z and is
    at most |z|^(2n+1) / ((2n + 1)·(1 − z²)).
    """

    def twice_atanh(z: Fraction) -> tuple[Fraction, Fraction]:
        total, power, square, terms = Fraction(0), z, z * z, 20
        for k in range(terms):
            total += power / (2 * k + 1)
            power *= square
        rest = power / ((2 * terms + 1) * (1 - square))
        return 2 * (total + min(rest, Fraction(0))), 2 * (total + max(rest, Fraction(0)))

    exponent = value.numerator.bit_length() - value.denominator.bit_length()
    m, unit = value / Fraction(2) ** exponent, 1 << 64
    below = Fraction(math.floor(m * unit), unit)
    above = below + Fraction(1, unit)
    low, high = (twice_atanh((x - 1) / (x + 1)) for x in (below, above))
    ends = sorted(exponent * end for end in twice_atanh(Fraction(1, 3)))
    return low[0] + ends[0], high[1] + ends[1]


def root_above(value: Fraction) -> Fraction:
    """Return a rational just above the square root of value ≥ 0, to 80 binary digits."""
    small = value.denominator.bit_length() - value.numerator.bit_length()
    bits = 80 + max(0, small if value else 0)
    return Fraction(math.isqrt(math.floor(value * 4**bits)) + 1, 2**bits)


def above(value: Fraction) -> float:
    """Return the smallest double that is not below a rational."""
    nearest = float(value)
    return nearest if Fraction(nearest) >= value else math.nextafter(nearest, math.inf)
