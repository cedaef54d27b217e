"""Proofs that no links have given base parameters: what they say, in words and numbers.

What a proof is, and whether it holds, is decided by `sdpid.verifier.realizable`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from sdpid.assurance.tables.proof_file import Stored
from sdpid.robot.inertia import TENSOR_INDEX
from sdpid.verifier import realizable, tables
from sdpid.verifier.decimals import decimal_text, linear_text, rounded
from sdpid.verifier.realizable import Consistency, coefficient_matrices

# Digits of the coefficients of a link's polynomial.
_SHOWN = 6


@dataclass(frozen=True, kw_only=True, eq=False)
class Refutation(Stored, realizable.Refutation):
    """An inequality that all links which can exist obey, and that a table contradicts.

    See `sdpid.verifier.realizable.Refutation` for its parts, and when it holds.
    """

    @property
    def margin_bound(self) -> Fraction | None:
        """Largest margin that it allows, None where it says nothing of it."""
        return (self.most + self.cost) / self.spread if self.spread > 0 else None

    @property
    def change_bound(self) -> Fraction | None:
        """By what factor at least the halfwidths must grow, less one; None where none helps."""
        halves = dict(zip(self.question.names, self.question.halfwidths, strict=True))
        room = sum((abs(w) * halves[name] for name, w in self.weights.items()), Fraction(0))
        return (self.least - self.most) / room if room > 0 else None

    def inequality(self) -> str:
        """Return the inequality in one line."""
        return tables.inequality(self)

    def reasons(self) -> tuple[str, ...]:
        """Return, link by link, the polynomial whose values are not negative."""
        out, q = [], self.question
        for link in range(q.n_links):
            c = self.link(link)
            if any(c):
                line = f"link {link + 1}: {_reason(c, q.consistency)}"
                for part, bound in ((self.masses, "mass"), (self.slack, "theta_max")):
                    if part.get(link):
                        line += f"; {decimal_text(part[link])} of it from the bound on {bound}"
                out.append(line)
        if q.margin > 0 and self.spread > 0:
            gain = q.margin * self.spread
            out.append(f"the margin of {decimal_text(q.margin)} kg.m2 adds {decimal_text(gain)}")
        if self.cost > 0:
            out.append(f"the bounds take off {decimal_text(self.cost)} at most")
        return tuple(out)


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
            terms[name or "1"] = rounded(value, _SHOWN)
    polynomial = linear_text(terms).replace("*1", "")
    if consistency == "pseudo_inertia":
        return f"every kg at (x, y, z) adds {polynomial} >= 0"
    shown = {}
    for (i, j), axes in zip(TENSOR_INDEX, ("xx", "xy", "yy", "xz", "yz", "zz"), strict=True):
        value = C[i][j] * (1 if i == j else 2)
        if value:
            shown[f"Ig_{axes}"] = rounded(value, _SHOWN)
    tensor = f"{linear_text(shown)} >= 0 and, " if shown else ""
    return f"{tensor}of its center of mass, m*({polynomial}) >= 0"
