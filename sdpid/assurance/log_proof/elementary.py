"""Sine, cosine, exponential and hyperbolic tangent with a bound of their error.

The library's functions are not trusted: arguments are reduced here, and Taylor's polynomial is
evaluated in `sdpid.assurance.log_proof.enclosure`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.outward import SLACK as UP
from sdpid.assurance.certificate.outward import UNIT as U
from sdpid.assurance.log_proof.enclosure import TINY, Enclosed, largest

# π and ln 2 to 40 digits, so to 1e-39.
_PI = Fraction("3.1415926535897932384626433832795028841971")
_LN2 = Fraction("0.6931471805599453094172321214581765680755")

# The first part of a constant is a multiple of this, so that its products with integers below 2²⁰
# are exact: 33 and 20 binary digits. Angles below _FAR have fewer quarter turns.
_GRID = 2.0**-32
_FAR = 1.5e6


def _parts(constant: Fraction) -> tuple[float, float]:
    """Return the two parts of a constant."""
    first = float(int(constant / Fraction(_GRID))) * _GRID
    return first, float(constant - Fraction(first))


_QUARTER, _HALVING = _parts(_PI / 2), _parts(_LN2)

# Arguments are reduced to at most this; by rounding to the nearest it is π/4 = 0.7854.
_REDUCED = 0.79


def _taylor(signs: int, orders: range) -> list[Enclosed]:
    """Return the coefficients ``signs^k / order!``, each a double and what it is off by."""
    exact = [Fraction(signs**k, math.factorial(order)) for k, order in enumerate(orders)]
    return [Enclosed.constant(float(c)).off(float(abs(c - Fraction(float(c)))) * UP) for c in exact]


# Behind these terms is less than 0.79¹⁹/19!, 0.79¹⁸/18! and e·0.4¹⁵/15!.
_SINE = _taylor(-1, range(1, 18, 2))
_COSINE = _taylor(-1, range(0, 17, 2))
_EXPONENTIAL = _taylor(1, range(15))
_SINE_REST, _COSINE_REST, _EXPONENTIAL_REST = 1e-19, 3e-18, 3e-18

# Beyond, exp(−x) is below the smallest double, and below `TINY` everywhere.
_DEEP = 750.0


def sine_cosine(angle: Enclosed) -> tuple[Enclosed, Enclosed]:
    """Return sine and cosine of angles (..., K).

    With k the integer nearest to ``2x/π`` and π/2 = P + Q + q, P a multiple of 2⁻³², Q a double and
    ``|q| ≤ 2⁻⁸⁵``, the difference x − kP is exact: kP is for |k| < 2²⁰, both are multiples of 2⁻⁵³
    unless k = 0, and it is below 1. What is left, ``(x − kP) − kQ``, rounds twice. Neither function
    changes by more than its argument. Angles from `_FAR` on are anywhere on the circle.
    """
    far = ~(angle.size < _FAR)
    x = np.where(far[..., None], 0.0, angle.mid)
    turns = np.rint(x * (2.0 / np.pi))
    r = _reduced(x, turns, _QUARTER)
    bad = far | ~(r.size < _REDUCED)
    z = r * r
    s = r + r * (z * _horner(z, _SINE[1:]))
    c = Enclosed.constant(1.0) + z * _horner(z, _COSINE[1:])
    odd, k = np.mod(turns, 2.0) == 1.0, np.mod(turns, 4.0)
    sine = np.where(odd, c.mid, s.mid) * np.where(k >= 2.0, -1.0, 1.0)
    cosine = np.where(odd, s.mid, c.mid) * np.where((k == 1.0) | (k == 2.0), -1.0, 1.0)
    rad = np.maximum(s.rad + _SINE_REST, c.rad + _COSINE_REST) + angle.rad
    # Anything on the circle is within 2 of anything else.
    rad = np.where(bad, 2.0, rad * UP)
    one = np.ones_like(rad)
    return Enclosed(sine, rad, one * UP), Enclosed(cosine, rad, one * UP)


def decaying(x: Enclosed) -> Enclosed:
    """Return exp(−x) of numbers (..., K) that are not negative; it falls no faster than they grow.

    With k the integer nearest to ``x/ln 2``, ``exp(−x) = 2⁻ᵏ exp(kL − x)``, reduced as in
    `sine_cosine`; the power of two is exact, or the result is below `TINY`.
    """
    clipped = np.minimum(x.mid, _DEEP)
    k = np.rint(clipped / sum(_HALVING))
    r = -_reduced(clipped, k, _HALVING)
    p = _horner(r, _EXPONENTIAL)
    mid = np.ldexp(p.mid, -k.astype(np.int64))
    rad = (p.rad + _EXPONENTIAL_REST + x.rad + TINY) * UP
    return Enclosed(mid, np.where(r.size < 0.4, rad, 1.0), p.size)


def hyperbolic_tangent(x: Enclosed) -> Enclosed:
    """Return tanh(x) of numbers (..., K): ``(1 − t)/(1 + t)`` with ``t = exp(−2|x|)``, signed.

    The quotient falls by at most 2 as t grows by 1 (its derivative is −2/(1 + t)²), and three
    operations on numbers up to 2 round by at most 3u of the result.
    """
    size = 2.0 * np.minimum(np.abs(x.mid), _DEEP)
    t = decaying(Enclosed(size, np.zeros_like(x.rad), largest(size)))
    mid = np.copysign((1.0 - t.mid) / (1.0 + t.mid), x.mid)
    rad = (2.0 * t.rad + 4.0 * U + x.rad) * UP + TINY
    return Enclosed(mid, rad, np.full_like(rad, UP))


def _reduced(x: Array, k: Array, period: tuple[float, float]) -> Enclosed:
    """Return x − k·period."""
    first, second = period
    small = k * second
    r = (x - k * first) - small
    count = largest(k)
    # The rounding of k·second and of the difference, and of the period beyond both parts.
    rad = (U * (largest(small) + largest(r)) + count * 2.0**-85) * UP
    rad = np.where(count > 0.0, rad + TINY, 0.0)
    return Enclosed(r, rad, largest(r))


def _horner(z: Enclosed, coefficients: Sequence[Enclosed]) -> Enclosed:
    """Return the polynomial with these coefficients, lowest first."""
    found = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        found = found * z + c
    return found
