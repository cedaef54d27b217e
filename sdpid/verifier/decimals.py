"""Rationals as text: read within bounds, written exactly or rounded to the safe side."""

from __future__ import annotations

import re
from collections.abc import Mapping
from decimal import (
    MAX_EMAX,
    MIN_EMIN,
    ROUND_CEILING,
    ROUND_FLOOR,
    ROUND_HALF_EVEN,
    Context,
    Decimal,
)
from fractions import Fraction
from math import lcm

from .reading import MalformedError, shown

# Digits on either side of a point or a stroke: those of a double written out, and some more.
MAX_DIGITS = 1200

# Bits of the least common denominator of all numbers of a file. Doubles and decimals share theirs;
# only numbers made to take forever do not.
_MAX_BITS = 8192

# Without exponents, which are short to write and long to compute with.
_NUMBER = re.compile(rf"-?[0-9]{{1,{MAX_DIGITS}}}([./][0-9]{{1,{MAX_DIGITS}}})?")

# Digits shown of numbers that are no short decimals, and up to which they are short.
_SHOWN = 6
_SHORT = 17

# Names of parameters that need no quotes to be told from the words around them.
_PLAIN = re.compile(r"[A-Za-z0-9_.^*]{1,40}")

# Decimals up to these powers of ten are written out, others with an exponent.
_POWERS = (-6, 16)


class Rationals:
    """Reads the numbers of one file, whose common denominator is bounded."""

    def __init__(self) -> None:
        self._common = 1

    def read(self, value: object, where: str) -> Fraction:
        """Return a number given as text, such as ``-0.05`` or ``2/3``."""
        if type(value) is not str or not _NUMBER.fullmatch(value):
            raise MalformedError(
                f"{where} is {value!r:.60}, no number as text like '-0.05' or '2/3'"
            )
        try:
            number = Fraction(value)
        except ZeroDivisionError:
            raise MalformedError(f"{where} is {value!r:.60}, a division by zero") from None
        self._common = lcm(self._common, number.denominator)
        if self._common.bit_length() > _MAX_BITS:
            raise MalformedError("its numbers have no common denominator of a reasonable size")
        return number


def _decimal(value: Fraction, digits: int, rounding: str) -> Decimal:
    context = Context(prec=digits, rounding=rounding, Emin=MIN_EMIN, Emax=MAX_EMAX)
    return context.divide(Decimal(value.numerator), Decimal(value.denominator))


def rounded(value: Fraction, digits: int, *, up: bool | None = None) -> Fraction:
    """Return a decimal of `digits` digits: the nearest, or with `up` one that is on that side."""
    rounding = ROUND_HALF_EVEN if up is None else ROUND_CEILING if up else ROUND_FLOOR
    return Fraction(_decimal(value, digits, rounding))


def decimal_text(value: Fraction) -> str:
    """Return a rational as a decimal: exactly where that is short, else rounded and marked by ~."""
    exact = rounded(value, _SHORT) == value
    number = _decimal(value, _SHORT if exact else _SHOWN, ROUND_HALF_EVEN).normalize()
    text = f"{number:f}" if _POWERS[0] <= number.adjusted() <= _POWERS[1] else f"{number:e}"
    return text if exact else f"~{text}"


def parameter(name: str) -> str:
    """Return a parameter's name to be printed, in quotes unless it is a plain one."""
    return name if _PLAIN.fullmatch(name) else shown(name)


def linear_text(weights: Mapping[str, Fraction]) -> str:
    """Return a linear combination as text."""
    out = ""
    for name, weight in weights.items():
        size = abs(weight)
        number = "" if size == 1 else f"{decimal_text(size)}*"
        sign = ("-" if weight < 0 else "") if not out else (" - " if weight < 0 else " + ")
        out += f"{sign}{number}{parameter(name)}"
    return out or "0"
