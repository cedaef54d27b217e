"""Which base parameters bodies can have: the question of a table, and its two answers, exactly.

A table gives numbers for some linear functions of theta, the standard parameters: ten a link (m,
mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) and then friction. Are there theta with

    |row_k·theta − value_k| ≤ halfwidth_k,   M(body) − margin·D ⪰ 0 for every link,
    mass_min ≤ m ≤ mass_max,   |theta_j| ≤ theta_max,   theta_j ≥ 0 for some friction,

M the 4×4 or 6×6 matrix of `link_matrix` and D = diag(1, 1, 1, 0, …)? A `Realization` is such a
theta. A `Refutation` has a weight w_k for each number. Cut ``c = Σ w_k·row_k`` into links; each
adds ``⟨C, I_g⟩ + m·q(r)`` to ``c·theta``, r its center of mass, I_g its inertia about it, and q
the quadratic polynomial of

    Q = [[tr(C)·E − C, ½·c_h], [½·c_h^T, c_m]],   C the coefficients of the tensor as a matrix.

With 4×4 matrices that is the integral of q over the mass, at least 2·margin·tr(C) where Q ⪰ 0; with
6×6 ones it is at least margin·tr(C) where Q ⪰ 0 and C ⪰ 0. What the coefficients lack of that,
``masses`` add to c_m at a cost of mass_max, and ``slack`` adds to c_m, c_xx, c_yy, c_zz at a cost
of 4·theta_max; friction with the wrong sign costs theta_max. So ``least ≤ c·theta`` for all bodies
that exist, ``c·theta ≤ most`` for all that have the table, and no body does both if most < least.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import Literal

from .bodies import has_margin
from .decimals import decimal_text, parameter
from .exact import dot, positive_semidefinite
from .reading import shown

Consistency = Literal["pseudo_inertia", "spatial_inertia", "none"]
Vector = dict[int, Fraction]
ExactMatrix = list[list[Fraction]]

_ZERO = Fraction(0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Question:
    """Whether bodies can have the numbers of a table.

    Attributes
    ----------
    robot : str
        Name of the robot.
    link_names : tuple of str
        Its links.
    table, table_sha256 : str or None
        Name of the table's file and digest of its bytes; None where there was no file.
    names : tuple of str
        The parameters that are given.
    rows : tuple of dict
        Their coefficients in theta, by index.
    values, halfwidths : tuple of Fraction
        The numbers.
    theta_names : tuple of str
        Standard parameters, ten a link and then friction.
    nonnegative : frozenset of int
        Friction parameters that are not negative.
    consistency : {"pseudo_inertia", "spatial_inertia"}
        What each link must obey.
    margin : Fraction
        With which margin, kg·m².
    mass_min, mass_max : Fraction
        Bounds on each link's mass, kg.
    theta_max : Fraction
        Bound on each standard parameter, in its unit.
    """

    robot: str
    link_names: tuple[str, ...]
    table: str | None = None
    table_sha256: str | None = None
    names: tuple[str, ...]
    rows: tuple[Vector, ...]
    values: tuple[Fraction, ...]
    halfwidths: tuple[Fraction, ...]
    theta_names: tuple[str, ...]
    nonnegative: frozenset[int]
    consistency: Consistency
    margin: Fraction
    mass_min: Fraction
    mass_max: Fraction
    theta_max: Fraction

    @property
    def n_links(self) -> int:
        """Number of links."""
        return len(self.link_names)

    @cached_property
    def given(self) -> dict[str, tuple[Vector, Fraction, Fraction]]:
        """Coefficients, value and halfwidth by the parameter's name."""
        entries = zip(self.rows, self.values, self.halfwidths, strict=True)
        return dict(zip(self.names, entries, strict=True))

    def faults(self, theta: Sequence[Fraction]) -> list[str]:
        """Return what keeps theta from being bodies that have the table; none where they do."""
        found = []
        for name, (row, value, half) in self.given.items():
            had = dot(row.values(), [theta[j] for j in row])
            if (excess := abs(had - value) - half) > 0:
                found.append(f"{parameter(name)} is off by {decimal_text(excess)} too much")
        for j, (name, value) in enumerate(zip(self.theta_names, theta, strict=True)):
            least = 0 if j in self.nonnegative else -self.theta_max
            if not least <= value <= self.theta_max:
                found.append(f"{parameter(name)} is {decimal_text(value)}, out of bounds")
        for link, name in enumerate(self.link_names):
            body = theta[10 * link : 10 * link + 10]
            if not self.mass_min <= (m := body[0]) <= self.mass_max:
                found.append(f"the mass of {shown(name)} is {decimal_text(m)} kg, out of bounds")
            if not has_margin(body, self.margin, self.consistency):
                found.append(f"{shown(name)} does not have the margin that is asked for")
        return found

    def is_witness(self, theta: Sequence[Fraction]) -> bool:
        """Return whether theta are bodies that have the table, decided exactly."""
        return not self.faults(theta)


def coefficient_matrices(c: Sequence[Fraction]) -> tuple[ExactMatrix, ExactMatrix]:
    """Return C (3×3) and Q (4×4) of the ten coefficients of a link."""
    (xx, yy, zz), (xy, xz, yz) = (c[4], c[6], c[9]), (x / 2 for x in (c[5], c[7], c[8]))
    C, trace = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], xx + yy + zz
    Q = [[(trace if i == j else _ZERO) - C[i][j] for j in range(3)] for i in range(3)]
    half = [value / 2 for value in c[1:4]]
    return C, [[*row, h] for row, h in zip(Q, half, strict=True)] + [[*half, c[0]]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Realization:
    """Bodies that have the numbers of a table.

    Attributes
    ----------
    question : Question
        What it answers.
    theta : tuple of Fraction
        Standard parameters.
    margins : tuple of Fraction
        A margin that each link has, kg·m², no less than the one that is asked for.
    """

    question: Question
    theta: tuple[Fraction, ...]
    margins: tuple[Fraction, ...]

    @cached_property
    def faults(self) -> list[str]:
        """What keeps it from being an answer; empty where it is one."""
        q = self.question
        found = q.faults(self.theta)
        for link, (name, margin) in enumerate(zip(q.link_names, self.margins, strict=True)):
            body = self.theta[10 * link : 10 * link + 10]
            if not has_margin(body, margin, q.consistency):
                found.append(f"{shown(name)} does not have the margin that is claimed")
        return found

    @property
    def holds(self) -> bool:
        """Whether these are bodies that have the table, decided exactly."""
        return not self.faults


@dataclass(frozen=True, kw_only=True, eq=False)
class Refutation:
    """An inequality that all bodies which can exist obey, and that a table contradicts.

    ``Σ weight·parameter ≥ least`` holds for everything that satisfies the question's
    constraints, and no numbers within the halfwidths exceed ``most`` on the left.

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
        terms: dict[int, list[tuple[Fraction, Fraction]]] = {}
        for name, weight in self.weights.items():
            for j, coefficient in self.question.given[name][0].items():
                terms.setdefault(j, []).append((weight, coefficient))
        sums = {j: dot(*zip(*pairs, strict=True)) for j, pairs in terms.items()}
        return {j: value for j, value in sums.items() if value != 0}

    def link(self, link: int) -> list[Fraction]:
        """Return a link's coefficients with what the bounds add to them."""
        c = [self.coefficients.get(10 * link + k, _ZERO) for k in range(10)]
        slack = self.slack.get(link, _ZERO)
        c[0] += self.masses.get(link, _ZERO) + slack
        for k in (4, 6, 9):
            c[k] += slack
        return c

    def matrices(self, link: int) -> list[ExactMatrix]:
        """Return the matrices of a link that are to be positive semidefinite."""
        C, Q = coefficient_matrices(self.link(link))
        return [Q, C] if self.question.consistency == "spatial_inertia" else [Q]

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
        """Least value of the left side for bodies that can exist, as far as is proven."""
        return self.question.margin * self.spread - self.cost

    @cached_property
    def most(self) -> Fraction:
        """Largest value of the left side within the halfwidths."""
        used = [(w, *self.question.given[name][1:]) for name, w in self.weights.items()]
        return sum((w * value + abs(w) * half for w, value, half in used), _ZERO)

    @cached_property
    def valid(self) -> bool:
        """Whether the inequality holds for all bodies that can exist, decided exactly."""
        if not set(self.weights) <= set(self.question.names):
            return False
        if any(x < 0 for x in (*self.masses.values(), *self.slack.values())):
            return False
        links = range(self.question.n_links)
        return all(positive_semidefinite(M) for link in links for M in self.matrices(link))

    @property
    def holds(self) -> bool:
        """Whether it proves that no bodies have these numbers."""
        return self.valid and self.most < self.least
