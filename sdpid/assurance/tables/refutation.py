"""Proofs that no links have given base parameters, in rational arithmetic.

A proof has one weight w_k for each parameter. With ``c = Σ w_k·row_k`` cut into links, each of
them adds ``⟨C, I_g⟩ + m·q(r)`` to ``w·base``, r its center of mass, q the quadratic polynomial of

    Q = [[tr(C)·E − C, ½·c_h], [½·c_h^T, c_m]],   C the coefficients of the tensor as a matrix.

Under ``pseudo_inertia`` that is the integral of q over its mass, never negative exactly when
Q ⪰ 0; under ``spatial_inertia`` exactly when Q ⪰ 0 and C ⪰ 0. The matrices follow from the
weights, so nothing is left to be repaired and invisible directions vanish exactly. Then
``w·base`` is not negative for links that can exist, and a table that makes it so is not theirs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import Any

from sdpid.assurance.tables.witness import Question, Vector, coefficient_matrices
from sdpid.errors import CertificateError
from sdpid.robot.inertia import TENSOR_INDEX, Consistency
from sdpid.verifier.exact import positive_semidefinite

_ZERO = Fraction(0)

# Digits shown of numbers that are not exact decimals; more where fewer would hide a contradiction.
_SHOWN = 6
_MOST_SHOWN = 17


@dataclass(frozen=True, kw_only=True, eq=False)
class Refutation:
    """An inequality that all links which can exist obey, and that a table contradicts.

    ``Σ weight·parameter ≥ least`` holds for everything that satisfies the question's
    constraints, and no numbers in the box exceed ``most`` on the left.

    Attributes
    ----------
    question : Question
        What it answers.
    weights : dict
        Weights by name, those that are not zero.
    masses : dict
        Multipliers of the bound on the mass, by link; empty where the proof needs none.
    slack : dict
        What is added to the coefficients of a link's mass and diagonal moments to make them fit;
        it costs theta_max. Empty where the proof needs none.
    """

    question: Question
    weights: Mapping[str, Fraction]
    masses: Mapping[int, Fraction] = field(default_factory=dict)
    slack: Mapping[int, Fraction] = field(default_factory=dict)

    @cached_property
    def coefficients(self) -> Vector:
        """Coefficients of the inequality in theta."""
        index = {name: k for k, name in enumerate(self.question.names)}
        return self.question.combination({index[n]: w for n, w in self.weights.items()})

    def link(self, link: int) -> list[Fraction]:
        """Return a link's coefficients with what the bounds add to them."""
        c = self.question.link_part(self.coefficients, link)
        slack = self.slack.get(link, _ZERO)
        c[0] += self.masses.get(link, _ZERO) + slack
        for k in (4, 6, 9):
            c[k] += slack
        return c

    @property
    def uses_mass_bound(self) -> bool:
        """Whether the proof needs that masses are bounded."""
        return any(self.masses.values())

    @property
    def uses_theta_max(self) -> bool:
        """Whether the proof needs the bound on all standard parameters."""
        return any(self.slack.values()) or self._stray() > 0

    def _stray(self) -> Fraction:
        """Return the sum of friction coefficients whose terms may take the wrong sign."""
        first, signs = 10 * self.question.n_links, self.question.nonnegative
        friction = ((j, x) for j, x in self.coefficients.items() if j >= first)
        wrong = [abs(x) for j, x in friction if not (j in signs and x > 0)]
        return sum(wrong, _ZERO)

    @cached_property
    def spread(self) -> Fraction:
        """What each kg·m² of margin adds to the left side at least."""
        factor = 2 if self.question.consistency == "pseudo_inertia" else 1
        links = [self.link(i) for i in range(self.question.n_links)]
        return factor * sum((c[4] + c[6] + c[9] for c in links), _ZERO)

    @cached_property
    def cost(self) -> Fraction:
        """What the bounds take off the left side at most."""
        q = self.question
        masses, slack = sum(self.masses.values(), _ZERO), sum(self.slack.values(), _ZERO)
        return q.mass_max * masses + q.theta_max * (4 * slack + self._stray())

    @property
    def least(self) -> Fraction:
        """Least value of the left side for links that can exist, as far as is proven."""
        return self.question.margin * self.spread - self.cost

    @cached_property
    def most(self) -> Fraction:
        """Largest value of the left side in the box."""
        q = self.question
        index = {name: k for k, name in enumerate(q.names)}
        return sum(
            (
                w * q.values[index[n]] + abs(w) * q.halfwidths[index[n]]
                for n, w in self.weights.items()
            ),
            _ZERO,
        )

    @cached_property
    def valid(self) -> bool:
        """Whether the inequality holds for links that can exist, decided exactly."""
        known = set(self.question.names)
        if not set(self.weights) <= known:
            return False
        if any(x < 0 for x in (*self.masses.values(), *self.slack.values())):
            return False
        for link in range(self.question.n_links):
            C, Q = coefficient_matrices(self.link(link))
            if not positive_semidefinite(Q):
                return False
            if self.question.consistency == "spatial_inertia" and not positive_semidefinite(C):
                return False
        return True

    @property
    def holds(self) -> bool:
        """Whether it proves that no links have these base parameters."""
        return self.valid and self.most < self.least

    @property
    def margin_bound(self) -> Fraction | None:
        """Largest margin that it allows, None where it says nothing of it."""
        return (self.most + self.cost) / self.spread if self.spread > 0 else None

    @property
    def change_bound(self) -> Fraction | None:
        """By what factor at least the halfwidths must grow, less one; None where none helps."""
        q = self.question
        index = {name: k for k, name in enumerate(q.names)}
        room = sum((abs(w) * q.halfwidths[index[n]] for n, w in self.weights.items()), _ZERO)
        return (self.least - self.most) / room if room > 0 else None

    def inequality(self) -> str:
        """Return the inequality in one line."""
        least, most = self.least, self.most
        for digits in range(_SHOWN, _MOST_SHOWN + 1):
            # Rounded apart, the claims stay true; digits are added until they contradict.
            below, above = rounded(least, digits, up=False), rounded(most, digits, up=True)
            if above < below:
                least, most = below, above
                break
        return (
            f"{linear_text(self.weights)} >= {decimal_text(least)} for links that can exist, but "
            f"at most {decimal_text(most)} in the table"
        )

    def reasons(self) -> tuple[str, ...]:
        """Return, link by link, the polynomial whose values are not negative."""
        out, q = [], self.question
        for link in range(q.n_links):
            c = self.link(link)
            if any(c):
                line = f"link {link + 1}: {_reason(c, q.consistency)}"
                for part, bound in ((self.masses, "mass"), (self.slack, "theta_max")):
                    if part.get(link):
                        line += f"; {float(part[link]):.6g} of it from the bound on {bound}"
                out.append(line)
        if q.margin > 0 and self.spread > 0:
            gain = q.margin * self.spread
            out.append(f"the margin of {decimal_text(q.margin)} kg.m2 adds {decimal_text(gain)}")
        if self.cost > 0:
            out.append(f"the bounds take off {decimal_text(self.cost)} at most")
        return tuple(out)

    def to_dict(self) -> dict[str, Any]:
        """Return everything the proof rests on as plain values, rationals as text."""
        q = self.question
        return {
            "schema": "sdpid-refutation",
            "version": 1,
            "consistency": q.consistency,
            "margin": str(q.margin),
            "mass_min": str(q.mass_min),
            "mass_max": str(q.mass_max),
            "theta_max": str(q.theta_max),
            "links": q.n_links,
            "theta_names": list(q.theta_names),
            "nonnegative": sorted(q.nonnegative),
            "parameters": [
                {
                    "name": name,
                    "row": {str(j): str(x) for j, x in row.items()},
                    "value": str(value),
                    "halfwidth": str(half),
                }
                for name, row, value, half in zip(
                    q.names, q.rows, q.values, q.halfwidths, strict=True
                )
            ],
            "weights": {name: str(w) for name, w in self.weights.items()},
            "masses": {str(link): str(x) for link, x in self.masses.items()},
            "slack": {str(link): str(x) for link, x in self.slack.items()},
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Refutation:
        """Read what `to_dict` wrote; whether it `holds` is decided anew.

        Raises
        ------
        CertificateError
            When it is not of that form.
        """
        try:
            if data["schema"] != "sdpid-refutation" or data["version"] != 1:
                raise ValueError("unknown schema or version")
            given = data["parameters"]
            links, names = int(data["links"]), tuple(map(str, data["theta_names"]))
            rows = tuple({int(j): Fraction(x) for j, x in one["row"].items()} for one in given)
            if data["consistency"] not in ("pseudo_inertia", "spatial_inertia"):
                raise ValueError("unknown consistency")
            if not 0 < 10 * links <= len(names):
                raise ValueError("links and parameters do not fit")
            if any(not 0 <= j < len(names) for row in rows for j in row):
                raise ValueError("a row has more entries than there are parameters")
            question = Question(
                names=tuple(str(one["name"]) for one in given),
                rows=rows,
                values=tuple(Fraction(one["value"]) for one in given),
                halfwidths=tuple(Fraction(one["halfwidth"]) for one in given),
                theta_names=names,
                n_links=links,
                nonnegative=frozenset(int(j) for j in data["nonnegative"]),
                consistency=data["consistency"],
                margin=Fraction(data["margin"]),
                mass_min=Fraction(data["mass_min"]),
                mass_max=Fraction(data["mass_max"]),
                theta_max=Fraction(data["theta_max"]),
            )
            out = cls(
                question=question,
                weights={str(n): Fraction(w) for n, w in data["weights"].items()},
                masses={int(i): Fraction(x) for i, x in data["masses"].items()},
                slack={int(i): Fraction(x) for i, x in data["slack"].items()},
            )
            if len(set(question.names)) != len(question.names):
                raise ValueError("a parameter is given twice")
            if any(not 0 <= i < links for i in (*out.masses, *out.slack)):
                raise ValueError("a multiplier of a link that is not there")
            if any(j < 10 * links for j in question.nonnegative) or question.margin < 0:
                raise ValueError("a sign that physics does not give")
            if min(question.mass_max, question.theta_max, *question.halfwidths) < 0:
                raise ValueError("a negative bound")
        except (KeyError, TypeError, ValueError, AttributeError, ZeroDivisionError) as error:
            raise CertificateError(f"not a refutation: {error}.") from None
        return out


def rounded(value: Fraction, digits: int, *, up: bool) -> Fraction:
    """Return a decimal of `digits` significant digits not below (`up`) or not above the value."""
    if value == 0:
        return value
    power = digits - len(str(int(abs(value)))) if abs(value) >= 1 else digits
    if abs(value) < 1:
        power += len(str(int(1 / abs(value)))) - 1
    unit = Fraction(10) ** power
    whole = -(-(value * unit) // 1) if up else (value * unit) // 1
    return Fraction(whole) / unit


def decimal_text(value: Fraction) -> str:
    """Return a rational as a decimal: exactly where a double can hold it, else rounded."""
    return _shortest(value) if Fraction(f"{float(value):.15g}") == value else f"{float(value):.6g}"


def linear_text(weights: Mapping[str, Fraction]) -> str:
    """Return a linear combination as text, its coefficients to the last digit."""
    out = ""
    for name, weight in weights.items():
        size = abs(weight)
        number = "" if size == 1 else f"{_shortest(size)}*"
        sign = ("-" if weight < 0 else "") if not out else (" - " if weight < 0 else " + ")
        out += f"{sign}{number}{name}"
    return out or "0"


def _shortest(value: Fraction) -> str:
    """Return a decimal that is exactly the value, else the fraction."""
    text = f"{float(value):.15g}"
    return text if Fraction(text) == value else str(value)


# Terms of the polynomial, as entries of Q.
_MONOMIALS = (
    ("x^2", 0, 0),
    ("y^2", 1, 1),
    ("z^2", 2, 2),
    ("x*y", 0, 1),
    ("x*z", 0, 2),
    ("y*z", 1, 2),
    ("x", 0, 3),
    ("y", 1, 3),
    ("z", 2, 3),
    ("", 3, 3),
)


def _reason(c: Sequence[Fraction], consistency: Consistency) -> str:
    """Return what one link adds to the left side."""
    C, Q = coefficient_matrices(c)
    terms = {}
    for name, i, j in _MONOMIALS:
        value = Q[i][j] * (1 if i == j else 2)
        if value:
            terms[name or "1"] = Fraction(f"{float(value):.6g}")
    polynomial = linear_text(terms).replace("*1", "")
    if consistency == "pseudo_inertia":
        return f"every kg at (x, y, z) adds {polynomial} >= 0"
    shown = {}
    for (i, j), axes in zip(TENSOR_INDEX, ("xx", "xy", "yy", "xz", "yz", "zz"), strict=True):
        value = C[i][j] * (1 if i == j else 2)
        if value:
            shown[f"Ig_{axes}"] = Fraction(f"{float(value):.6g}")
    tensor = f"{linear_text(shown)} >= 0 and, " if shown else ""
    return f"{tensor}of its center of mass, m*({polynomial}) >= 0"
