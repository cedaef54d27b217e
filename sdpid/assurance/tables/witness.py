"""The question of a table in exact numbers, and the check of a witness.

Every number here is a rational. A yes is a witness: standard parameters of links that obey every
inequality. A no is a `sdpid.assurance.tables.refutation.Refutation`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.robot.inertia import TENSOR_INDEX, Consistency
from sdpid.verifier.exact import positive_semidefinite

Number = float | Fraction
Vector = dict[int, Fraction]
ExactMatrix = list[list[Fraction]]

_ZERO = Fraction(0)


def exact(value: Number | Decimal | str) -> Fraction:
    """Return a number as a rational; a float as the shortest decimal that prints it.

    Raises
    ------
    DataError
        When it is not a finite number.
    """
    try:
        if isinstance(value, (Fraction, Decimal, str)):
            return Fraction(value)
        return Fraction(repr(float(value)))
    except (ValueError, OverflowError, TypeError):
        raise DataError(f"{value!r} is not a finite number.") from None


@dataclass(frozen=True, kw_only=True, eq=False)
class Question:
    """Which standard parameters have ``|row_k·theta − value_k| ≤ halfwidth_k``, if there are any.

    They are to obey the consistency with a margin, and the bounds.

    Attributes
    ----------
    names : tuple of str
        Of the parameters that are given.
    rows : tuple of dict
        Their coefficients in theta, by index.
    values, halfwidths : tuple of Fraction
        The numbers.
    theta_names : tuple of str
        Standard parameters, ten a link and then friction.
    n_links : int
        Number of links.
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
    leading : tuple of int or None
        A column of each row along which theta may be moved without changing other base
        parameters; of use in the search for a witness only.
    """

    names: tuple[str, ...]
    rows: tuple[Vector, ...]
    values: tuple[Fraction, ...]
    halfwidths: tuple[Fraction, ...]
    theta_names: tuple[str, ...]
    n_links: int
    nonnegative: frozenset[int]
    consistency: Consistency
    margin: Fraction
    mass_min: Fraction
    mass_max: Fraction
    theta_max: Fraction
    leading: tuple[int | None, ...] = ()

    def combination(self, weights: Mapping[int, Fraction]) -> Vector:
        """Return ``Σ weight_k·row_k`` without its zeros."""
        out: Vector = {}
        for k, weight in weights.items():
            for j, coefficient in self.rows[k].items():
                out[j] = out.get(j, _ZERO) + weight * coefficient
        return {j: value for j, value in out.items() if value != 0}

    def link_part(self, c: Mapping[int, Fraction], link: int) -> list[Fraction]:
        """Return the ten coefficients of a link."""
        return [c.get(10 * link + k, _ZERO) for k in range(10)]

    def outside(self, theta: Sequence[Fraction]) -> dict[str, Fraction]:
        """Return the excess beyond the box of each parameter that is outside it."""
        out = {}
        for name, row, value, half in zip(
            self.names, self.rows, self.values, self.halfwidths, strict=True
        ):
            excess = abs(sum((x * theta[j] for j, x in row.items()), -value)) - half
            if excess > 0:
                out[name] = excess
        return out

    def is_witness(self, theta: Sequence[Fraction]) -> bool:
        """Return whether theta is in the box and satisfies every constraint."""
        if self.outside(theta) or any(abs(x) > self.theta_max for x in theta):
            return False
        if any(theta[j] < 0 for j in self.nonnegative):
            return False
        for link in range(self.n_links):
            body = list(theta[10 * link : 10 * link + 10])
            if not self.mass_min <= body[0] <= self.mass_max:
                return False
            if not positive_semidefinite(consistency_matrix(body, self.consistency, self.margin)):
                return False
        return True


def coefficient_matrices(c: Sequence[Fraction]) -> tuple[ExactMatrix, ExactMatrix]:
    """Return C (3×3) and Q (4×4) of the ten coefficients of a link."""
    C = [[_ZERO] * 3 for _ in range(3)]
    for (i, j), value in zip(TENSOR_INDEX, c[4:], strict=True):
        C[i][j] = C[j][i] = value if i == j else value / 2
    trace = C[0][0] + C[1][1] + C[2][2]
    Q = [[(trace if i == j else _ZERO) - C[i][j] for j in range(3)] for i in range(3)]
    half = [value / 2 for value in c[1:4]]
    return C, [[*row, h] for row, h in zip(Q, half, strict=True)] + [[*half, c[0]]]


def consistency_matrix(
    body: Sequence[Fraction], consistency: Consistency, margin: Fraction
) -> ExactMatrix:
    """Return the matrix that is to be positive semidefinite, of ten rational parameters."""
    m, h = body[0], body[1:4]
    tensor = [[_ZERO] * 3 for _ in range(3)]
    for (i, j), value in zip(TENSOR_INDEX, body[4:], strict=True):
        tensor[i][j] = tensor[j][i] = value
    if consistency == "pseudo_inertia":
        half = (tensor[0][0] + tensor[1][1] + tensor[2][2]) / 2
        top = [
            [(half - margin if i == j else _ZERO) - tensor[i][j] for j in range(3)]
            for i in range(3)
        ]
        return [[*row, x] for row, x in zip(top, h, strict=True)] + [[*h, m]]
    skew = [[_ZERO, -h[2], h[1]], [h[2], _ZERO, -h[0]], [-h[1], h[0], _ZERO]]
    top = [[tensor[i][j] - (margin if i == j else _ZERO) for j in range(3)] for i in range(3)]
    upper = [[*top[i], *skew[i]] for i in range(3)]
    lower = [[-x for x in skew[i]] + [m if i == j else _ZERO for j in range(3)] for i in range(3)]
    return upper + lower


def rational(theta: Array) -> list[Fraction]:
    """Return doubles as the rationals that they are."""
    return [Fraction(float(x)) for x in np.asarray(theta)]
