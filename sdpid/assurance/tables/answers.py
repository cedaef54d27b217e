"""The question of a table in exact numbers, its two answers, and their files.

Every number here is a rational. What is an answer is decided by `sdpid.verifier.realizable`.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np

from sdpid import __version__
from sdpid._common.files import atomic_write_text
from sdpid.assurance.certificate.rounding import proven_margin
from sdpid.errors import CertificateError, DataError
from sdpid.robot.inertia import margin
from sdpid.verifier import realizable, tables
from sdpid.verifier.reading import MalformedError, digest
from sdpid.verifier.realizable import Question

Number = float | Fraction

# No parameter of a robot has more digits before the point, or more after it. Exponents beyond
# would be written out in exact arithmetic. All small doubles have fewer.
_BEFORE, _AFTER = 12, 400

# Digits of the numerator and the denominator of a fraction.
_DIGITS = 400

# Digits of decimals that are written as such; all others are fractions.
_SHORT = 34


@dataclass(frozen=True)
class TableFile:
    """The file that a table was read from: its name, and the SHA-256 of its bytes."""

    name: str
    sha256: str


class Stored:
    """An answer that can be written to a file."""

    question: Question
    schema: ClassVar[str]

    def to_dict(self) -> dict[str, Any]:
        """Return the file's content: the whole question and the answer, numbers as text.

        Raises
        ------
        CertificateError
            When a number has more digits than the checker reads.
        """
        q = self.question
        limits = {name: number_text(getattr(q, name)) for name in tables.LIMITS}
        columns = zip(q.names, q.rows, q.values, q.halfwidths, strict=True)
        data: dict[str, Any] = {
            "schema": self.schema,
            "version": tables.VERSION,
            "metadata": {"software": f"sdpid {__version__}"},
            "robot": {"name": q.robot, "links": list(q.link_names)},
            "table": {"file": q.table, "sha256": q.table_sha256},
            "constraints": {
                "consistency": q.consistency,
                **limits,
                "nonnegative": sorted(q.nonnegative),
            },
            "theta_names": list(q.theta_names),
            "parameters": [
                dict(zip(tables.PARAMETER, (column[0], *map(_texts, column[1:])), strict=True))
                for column in columns
            ],
            self.schema.removeprefix("sdpid-"): {
                name: _texts(getattr(self, name)) for name in tables.PARTS[self.schema]
            },
        }
        data["sha256"] = digest(data)
        try:
            tables.answer_of(data)
        except MalformedError as cause:
            raise CertificateError(
                f"the proof cannot be written: {cause}; give values with fewer digits."
            ) from None
        return data

    def to_json(self, path: str | os.PathLike[str]) -> None:
        """Write the file, whole or not at all, for ``sdpid verify`` to check."""
        atomic_write_text(path, json.dumps(self.to_dict(), indent=1) + "\n")


@dataclass(frozen=True, kw_only=True, eq=False)
class StoredRealization(Stored, realizable.Realization):
    """Bodies that have the numbers of a table (see `sdpid.verifier.realizable.Realization`)."""

    schema = tables.REALIZATION


@dataclass(frozen=True, kw_only=True, eq=False)
class StoredRefutation(Stored, realizable.Refutation):
    """An inequality that all links which can exist obey, and that a table contradicts.

    See `sdpid.verifier.realizable.Refutation` for its parts, and when it holds.
    """

    schema = tables.REFUTATION

    @property
    def margin_bound(self) -> Fraction | None:
        """Largest margin that it allows, None where it says nothing of it."""
        return (self.most + self.cost) / self.spread if self.spread > 0 else None

    @property
    def change_bound(self) -> Fraction | None:
        """By what factor at least the halfwidths must grow, less one; None where none helps."""
        given, weights = self.question.given, self.weights
        room = sum((abs(w) * given[name][2] for name, w in weights.items()), Fraction(0))
        return (self.least - self.most) / room if room > 0 else None

    def inequality(self) -> str:
        """Return the inequality in one line."""
        return tables.inequality(self)


def _texts(numbers: Any) -> Any:
    """Return a rational as text, or those of a mapping or a sequence."""
    if isinstance(numbers, Fraction):
        return number_text(numbers)
    if isinstance(numbers, Mapping):
        return {str(key): number_text(value) for key, value in numbers.items()}
    return list(map(number_text, numbers))


def number_text(value: Fraction) -> str:
    """Return the text that the verifier reads as this number: a decimal where it is a short one."""
    text = f"{Decimal(value.numerator) / Decimal(value.denominator):f}"
    return text if len(text) <= _SHORT and Fraction(text) == value else str(value)


def exact(value: Number | Decimal | str) -> Fraction:
    """Return a number as a rational; a float as the shortest decimal that prints it.

    Raises
    ------
    DataError
        When it is not a finite number, or has more digits than any parameter of a robot.
    """
    if isinstance(value, str) and "/" in value:
        ends = [exact_decimal(end, value) for end in value.split("/", 1)]
        if ends[1] == 0:
            raise DataError(f"{value!r:.60} is a division by zero.")
        return Fraction(ends[0]) / Fraction(ends[1])
    if isinstance(value, Fraction):
        if max(abs(value.numerator), value.denominator) >= 10**_DIGITS:
            raise DataError(f"a fraction has more than {_DIGITS} digits; round it.")
        return value
    return Fraction(exact_decimal(value, value))


def exact_decimal(value: object, shown: object, where: str = "") -> Decimal:
    """Return a decimal number of bounded length; DataError names it where it is none."""
    brief = repr(shown) if len(repr(shown)) <= 40 else f"{repr(shown)[:37]}..."
    brief = f"{where}: {brief}" if where else brief
    try:
        if not isinstance(value, (Decimal, str)):
            value = repr(float(value))  # type: ignore[arg-type]
        number = Decimal(value)
    except (InvalidOperation, ValueError, OverflowError, TypeError):
        number = Decimal("nan")
    if not number.is_finite():
        raise DataError(f"{brief} is not a finite number.")
    exponent = int(number.as_tuple().exponent)
    if (number and number.adjusted() > _BEFORE) or not -_AFTER <= exponent <= _AFTER:
        raise DataError(
            f"{brief} has more than {_BEFORE} digits before the point or {_AFTER} after it; no "
            "robot has such a parameter."
        )
    return number


def realization(question: Question, theta: Sequence[Fraction]) -> StoredRealization | None:
    """Return the answer that theta is, None where theta is none."""
    # Decimals of doubles are short; within the halfwidths they mostly do as well.
    for exactly in ([Fraction(repr(float(x))) for x in theta], theta):
        if question.is_witness(exactly):
            bodies = [exactly[10 * i : 10 * i + 10] for i in range(question.n_links)]
            margins = tuple(_margin(question, body) for body in bodies)
            return StoredRealization(question=question, theta=tuple(exactly), margins=margins)
    return None


def _margin(question: Question, body: Sequence[Fraction]) -> Fraction:
    """Return a margin that a body has exactly, close to the largest."""
    least, kind = float(question.margin), question.consistency
    found = float(margin(np.array(body, dtype=float), kind))
    proven = proven_margin(body, found if np.isfinite(found) else least, least, kind)
    return max(Fraction(proven), question.margin)
