"""Check a certificate in exact arithmetic: ``python verify.py certificate.json``.

This one file needs Python 3.10 and nothing else, and trusts no solver. Every number in a
certificate is the IEEE double that its decimals denote; from there on nothing is rounded.

A problem is: find parameters theta of smallest cost

    f(theta) = ‖A·(B·theta) − rhs‖² + floor + ‖R·theta − r‖² + 2·s·Σ D(P_i‖P0_i)

with B the ``base_matrix``, R and r the ``prior_matrix`` and ``prior_rhs``, and the last sum over
the links of an ``entropic_prior`` of strength s (all three priors may be missing), such that

* ``lower ≤ theta ≤ upper``;
* for each link ``M(body) − margin·D ⪰ 0``: body are ten entries of theta, M is the matrix of
  `link_matrix`, 4×4 or 6×6, and D = diag(1, 1, 1, 0, …). No such demand for consistency "none";
* each of the ``rows`` has ``lower ≤ coefficients·theta ≤ upper`` (null is no limit);
* each of the ``cones`` has ``‖vectors·body‖ ≤ axis·body``, which says the same as
  ``[[a·E, v], [v^T, a]] ⪰ 0`` with a = axis·body and v = vectors·body (filled up with zeros).

A lower bound follows from any numbers y, λ and any symmetric Z_i ⪰ 0, the ``multipliers``. Write
G for A·B with R below, h for rhs with r below, and F_i(theta) = L_i(theta) + F_i0 for the matrices
above. Since ‖x‖² ≥ 2·y·x − ‖y‖² and ⟨Z, F⟩ ≥ 0 where Z ⪰ 0 and F ⪰ 0, all feasible theta have

    f(theta) ≥ floor − ‖y‖² − 2·y·h − Σ ⟨Z_i, F_i0⟩ + Σ λ_j·limit_j + c·theta,
    c = 2·G^T·y − Σ L_i*(Z_i) − Σ λ_j·coefficients_j,

limit_j being the lower limit where λ_j > 0 and the upper one where λ_j < 0. Whatever c is, within
the bounds ``c·theta ≥ Σ min(c_k·lower_k, c_k·upper_k)``.

An entropic prior costs ``D(P‖P0) = −ln det P − ln det P0^-1 + tr(P0^-1·P) − 4``, P being a link's
4×4 matrix and P0^-1 the given ``inverse``. It is convex: ``−ln det P ≥ ln det W + 4 − tr(W·P)``
for any W ≻ 0, so that it adds ``ln det W − ln det P0^-1`` to the constant and ⟨P0^-1 − W, P⟩ to
c·theta, times 2·s; without W, D ≥ 0. Logarithms are enclosed between rationals.
"""

from __future__ import annotations

import hashlib
import json
import math
import sys
from dataclasses import dataclass
from fractions import Fraction
from operator import mul
from pathlib import Path
from typing import Any

SCHEMA, VERSION = "sdpid-certificate", 3
KEYS = {"schema", "version", "sha256", "metadata", "origin"}
KEYS |= {"problem", "theta", "multipliers", "claims"}
UNSEALED = ("metadata", "sha256")  # what the digest leaves out: descriptions, and itself
# Equations, and what further conditions make of them, hold to rounding only: so much is allowed.
TOLERANCE = Fraction(1e-9)
# The gap is relative to the cost, or to this share of ‖h‖² + floor where the cost is next to zero.
TINY_COST = Fraction(1e-6)


class MalformedError(ValueError):
    """The file is no certificate of this version."""


# What a file that makes no sense may cause.
REFUSED = (LookupError, TypeError, AttributeError, ArithmeticError, ValueError, RecursionError)


# ---- Linear algebra without rounding -----------------------------------------------------------


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
    """Return a rational just above the square root of value ≥ 0."""
    return Fraction(math.isqrt(math.floor(value * 4**80)) + 1, 2**80)


# ---- Bodies ------------------------------------------------------------------------------------


def link_matrix(body: Any, consistency: str) -> list[list[Fraction]]:
    """Return M of (m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz), about the joint frame's origin.

    4×4 pseudo-inertia ``[[½·tr(I)·E − I, h], [h^T, m]]`` with h = (mx, my, mz): ⪰ 0 where some
    distribution of mass has these moments. 6×6 spatial inertia ``[[I, S(h)], [S(h)^T, m·E]]``.
    """
    m, x, y, z, xx, xy, yy, xz, yz, zz = map(Fraction, body)
    o = Fraction(0)
    if consistency == "spatial_inertia":
        return [
            [xx, xy, xz, o, -z, y],
            [xy, yy, yz, z, o, -x],
            [xz, yz, zz, -y, x, o],
            [o, z, -y, m, o, o],
            [-z, o, x, o, m, o],
            [y, -x, o, o, o, m],
        ]
    return [
        [(yy + zz - xx) / 2, -xy, -xz, x],
        [-xy, (xx + zz - yy) / 2, -yz, y],
        [-xz, -yz, (xx + yy - zz) / 2, z],
        [x, y, z, m],
    ]


def adjoint(Z: Any, consistency: str) -> list[Fraction]:
    """Return ⟨Z, M(e_k)⟩ for the ten unit bodies e_k."""
    units = ([int(i == k) for i in range(10)] for k in range(10))
    return [inner(Z, link_matrix(unit, consistency)) for unit in units]


def has_margin(body: Any, margin: float | Fraction, consistency: str) -> bool:
    """Return whether ``M(body) − margin·D ⪰ 0``, exactly."""
    matrix = link_matrix(body, consistency)
    for i in range(3):
        matrix[i][i] -= Fraction(margin)
    return positive_semidefinite(matrix)


# ---- Reading -----------------------------------------------------------------------------------


def numbers(value: Any, *shape: int) -> Any:
    """Return finite doubles, in nested lists of the given shape."""
    if shape:
        if type(value) is not list or len(value) != shape[0]:
            raise MalformedError(f"expected a list of {shape[0]} items")
        return [numbers(item, *shape[1:]) for item in value]
    if type(value) not in (int, float) or not math.isfinite(value):
        raise MalformedError(f"{value!r} is not a finite number")
    return float(value)


def index(value: Any, count: int) -> int:
    """Return an integer from 0 up to, but not, count."""
    if type(value) is not int or not 0 <= value < count:
        raise MalformedError(f"{value!r} is not an integer from 0 to {count - 1}")
    return value


def load(text: str) -> dict[str, Any]:
    """Parse JSON in which no key occurs twice and every number is finite."""

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        if len(found := dict(pairs)) < len(pairs):
            raise MalformedError("a key occurs twice")
        return found

    def finite(literal: str) -> Any:
        return numbers(float(literal))

    data = json.loads(text, object_pairs_hook=unique, parse_float=finite, parse_constant=finite)
    if type(data) is not dict or (data.get("schema"), data.get("version")) != (SCHEMA, VERSION):
        raise MalformedError(f"not schema {SCHEMA}, version {VERSION}")
    if wrong := data.keys() ^ KEYS:
        raise MalformedError(f"keys that are missing or not known: {', '.join(sorted(wrong))}")
    return data


def read(path: Any) -> dict[str, Any]:
    """Read a file; a pipe or a device, which may never end, is none."""
    file = Path(path)
    if file.exists() and not file.is_file():
        raise MalformedError("it is no regular file")
    return load(file.read_text(encoding="utf-8"))


def digest(data: dict[str, Any]) -> str:
    """Return the SHA-256 of everything but descriptions, in one way of writing it down."""
    sealed = {key: value for key, value in data.items() if key not in UNSEALED}
    written = json.dumps(sealed, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(written.encode("ascii")).hexdigest()


# ---- What the numbers prove --------------------------------------------------------------------


class Recomputed:
    """What the numbers of a certificate prove, claims aside.

    lower_bound (no feasible theta costs less); cost of theta (rounded up where there are
    logarithms); violation of the worst row or cone (rounded up where there are roots); scale, the
    least cost that gaps are relative to; broken, why multipliers or theta prove nothing.
    """

    def __init__(self, data: dict[str, Any]) -> None:
        self.problem, self.multipliers = data["problem"], data["multipliers"]
        p = len(self.problem["lower"])
        self.lower, self.upper = (numbers(self.problem[end], p) for end in ("lower", "upper"))
        self.theta = None if data["theta"] is None else numbers(data["theta"], p)
        self.links = index(self.problem["links"], p // 10 + 1)
        self.consistency = self.problem["consistency"]
        if self.consistency not in ("pseudo_inertia", "spatial_inertia", "none"):
            raise MalformedError(f"consistency {self.consistency!r} is not known")
        self.margin = numbers(self.problem["margin"])
        self.cost = self.violation = self.constant = Fraction(0)
        self.c, self.broken = [Fraction(0)] * p, list[str]()
        self._squares()
        self._matrices()
        self._rows()
        self._entropic()
        # c·theta is at least this much within the bounds.
        ends = zip(self.c, self.lower, self.upper, strict=True)
        self.lower_bound = self.constant + sum(
            slope * Fraction(low if slope > 0 else high) for slope, low, high in ends
        )

    def body(self, link: int) -> list[float] | None:
        """Return a link's ten entries of theta."""
        return None if self.theta is None else self.theta[10 * link : 10 * link + 10]

    def _add(self, first: int, slopes: list[Fraction]) -> None:
        """Add to entries of c."""
        for k, slope in enumerate(slopes, first):
            self.c[k] += slope

    def _squares(self) -> None:
        """Cost: ‖A·(B·theta) − rhs‖² + floor + ‖R·theta − r‖². Bound: the terms with y."""
        problem, p = self.problem, len(self.c)
        b, q = len(problem["rhs"]), len(problem["prior_rhs"])
        A, B = numbers(problem["A"], b, b), numbers(problem["base_matrix"], b, p)
        R = numbers(problem["prior_matrix"], q, p)
        h = numbers(problem["rhs"], b) + numbers(problem["prior_rhs"], q)
        if (floor := Fraction(numbers(problem["floor"]))) < 0:
            raise MalformedError("the floor is negative")
        self.scale = TINY_COST * (dot(h, h) + floor)
        if self.theta is not None:
            values = product(A, product(B, self.theta)) + product(R, self.theta)
            residual = [value - Fraction(wanted) for value, wanted in zip(values, h, strict=True)]
            self.cost = dot(residual, residual) + floor
        y = numbers(self.multipliers["y"], b + q)
        self.constant = floor - dot(y, y) - 2 * dot(y, h)
        # 2·G^T·y = 2·B^T·(A^T·y) + 2·R^T·y: G itself is never formed.
        for rows, weights in ((B, product(transposed(A), y[:b])), (R, y[b:])):
            self._add(0, [2 * slope for slope in product(transposed(rows), weights)])

    def _matrices(self) -> None:
        """Bound: the Z, first those of the links, then those of the cones. Cones' violations."""
        size = 6 if self.consistency == "spatial_inertia" else 4
        own, cones = self.links * (self.consistency != "none"), self.problem["cones"]
        Z = numbers(self.multipliers["Z"], own + len(cones), size, size)
        for i, z in enumerate(Z):
            if not positive_semidefinite(z):
                self.broken.append(f"multiplier Z {i} is not positive semidefinite")
        for link, z in enumerate(Z[:own]):
            self._add(10 * link, [-slope for slope in adjoint(z, self.consistency)])
            self.constant += Fraction(self.margin) * sum(Fraction(z[i][i]) for i in range(3))
        for cone, z in zip(cones, Z[own:], strict=True):
            link = index(cone["link"], self.links)
            axis, vectors = numbers(cone["axis"], 10), numbers(cone["vectors"], 3, 10)
            # ⟨Z, [[a·E, v], [v^T, a]]⟩ = tr(Z)·a + 2·z·v, z beginning the last row of Z.
            trace = sum(Fraction(z[i][i]) for i in range(size))
            twice = [2 * x for x in z[-1][:3]]
            self._add(
                10 * link, [-x for x in product(transposed([axis, *vectors]), [trace, *twice])]
            )
            if (body := self.body(link)) is not None:
                v = product(vectors, body)
                self.violation = max(self.violation, root_above(dot(v, v)) - dot(axis, body))

    def _rows(self) -> None:
        """Bound: the multipliers of the rows. The rows' violations."""
        rows = self.problem["rows"]
        given = numbers(self.multipliers["rows"], len(rows))
        for row, multiplier in zip(rows, map(Fraction, given), strict=True):
            coefficients = numbers(row["coefficients"], len(self.c))
            low, high = (
                None if row[end] is None else Fraction(numbers(row[end]))
                for end in ("lower", "upper")
            )
            limit = low if multiplier > 0 else high
            if multiplier and limit is None:
                self.broken.append(f"row '{row['name']}' has a multiplier but no limit there")
            elif multiplier and limit is not None:
                self.constant += multiplier * limit
                self._add(0, [-multiplier * Fraction(x) for x in coefficients])
            if self.theta is not None:
                value = dot(coefficients, self.theta)
                below = Fraction(0) if low is None else low - value
                above = Fraction(0) if high is None else value - high
                self.violation = max(self.violation, below, above)

    def _entropic(self) -> None:
        """Cost: 2·s·Σ D(P‖P0). Bound: its tangents, where there are W."""
        prior, given = self.problem["entropic_prior"], self.multipliers["W"]
        if prior is None:
            if given is not None:
                raise MalformedError("W without an entropic prior")
            return
        links, factor = prior["links"], 2 * Fraction(numbers(prior["strength"]))
        inverses = numbers(prior["inverses"], len(links), 4, 4)
        tangents = [None] * len(links) if given is None else numbers(given, len(links), 4, 4)
        for number, inverse, W in zip(links, inverses, tangents, strict=True):
            link, det = index(number, self.links), factorize(inverse)[1]
            if not (det > 0 and factor > 0):
                raise MalformedError("a prior needs a positive strength and definite inverses")
            if (body := self.body(link)) is not None:
                P = link_matrix(body, "pseudo_inertia")
                if (at_body := factorize(P)[1]) > 0:
                    self.cost += factor * (inner(inverse, P) - 4 - log_bounds(at_body * det)[0])
                else:
                    self.broken.append(f"link {link} is not inside its cone: it costs infinity")
            if W is None:
                continue
            if (at_W := factorize(W)[1]) > 0:
                self.constant += factor * log_bounds(at_W / det)[0]
                slopes = zip(*(adjoint(m, "pseudo_inertia") for m in (inverse, W)), strict=True)
                self._add(10 * link, [factor * (a - b) for a, b in slopes])
            else:
                self.broken.append(f"W of link {link} is not positive definite")


@dataclass(frozen=True)
class Result:
    """What is proven (`statements`), what is not (`problems`), and what was recomputed."""

    statements: tuple[str, ...]
    problems: tuple[str, ...]
    feasible: bool
    exact: Recomputed


def check(data: dict[str, Any]) -> Result:
    """Check the digest and every claim; MalformedError where the data make no sense."""
    try:
        result = prove(data, Recomputed(data))
        if digest(data) == data["sha256"]:
            return result
    except REFUSED as cause:
        raise MalformedError(str(cause) or repr(cause)) from cause
    changed = "the digest is another: something was changed"
    return Result(result.statements, (changed, *result.problems), result.feasible, result.exact)


def infeasible(exact: Recomputed, claims: dict[str, Any]) -> list[str]:
    """Return why theta, which there is, is not shown to obey the constraints."""
    found = []
    ends = zip(exact.lower, exact.theta or [], exact.upper, strict=True)
    for k, (low, value, high) in enumerate(ends):
        if not low <= value <= high:
            found.append(f"parameter {k} is {value!r}, outside [{low!r}, {high!r}]")
    if exact.consistency != "none":
        for link, margin in enumerate(claims["margins"]):
            # A body without a positive mass has no margin.
            if margin is None or not has_margin(exact.body(link), margin, exact.consistency):
                found.append(f"link {link} does not have the margin {margin!r}")
            elif margin < exact.margin:
                found.append(f"the margin of link {link} is {margin!r}, below {exact.margin!r}")
    violation = numbers(claims["violation"])
    if not exact.violation <= violation <= TOLERANCE:
        found.append(
            f"a row or cone is violated by {float(exact.violation):.3g}, not {violation!r}"
        )
    return found


def prove(data: dict[str, Any], exact: Recomputed) -> Result:
    """Check every claim against what was recomputed."""
    problems, claims, said = list(exact.broken), data["claims"], []
    bound = numbers(claims["lower_bound"])
    if bound > exact.lower_bound:
        problems.append(f"the lower bound {bound!r} is more than is proven")
    elif not exact.broken:
        said.append(f"No feasible parameters cost less than {bound!r}.")
    if exact.theta is None:
        problems.append("no parameters are given: none are shown to be feasible")
        return Result(tuple(said), tuple(problems), False, exact)

    own = exact.links * (exact.consistency != "none")
    if len(claims["margins"] or []) != own:
        raise MalformedError(f"expected the margins of {own} links")
    wrong = infeasible(exact, claims)
    if not wrong:
        worst = f"{exact.consistency} with margin {min(claims['margins'])!r} kg.m2" if own else ""
        count = len(exact.problem["rows"]) + len(exact.problem["cones"])
        others = f"{count} rows and cones to within {float(TOLERANCE):g}" if count else ""
        demands = ", ".join(filter(None, ("bounds", worst, others)))
        said.append(f"The given parameters are feasible: they obey {demands}.")

    if claims["cost"] is None:
        problems.append("no cost is claimed")
        return Result(tuple(said), (*problems, *wrong), not wrong, exact)
    cost, gap = numbers(claims["cost"]), numbers(claims["gap"])
    if cost < exact.cost:
        problems.append(f"the cost is {float(exact.cost)!r}, above {cost!r}")
    elif not exact.broken:
        said.append(f"They cost at most {cost!r}.")
    # Without a division, so that data without errors (cost 0) are no exception.
    unit = "the cost" if cost >= exact.scale else f"{float(exact.scale):.3g}, the cost being tiny"
    if Fraction(cost) - Fraction(bound) > Fraction(gap) * max(Fraction(cost), exact.scale):
        problems.append(f"the gap is above {gap!r}")
    elif not (problems or wrong):
        said.append(f"They are optimal up to a gap of at most {gap!r} times {unit}.")
    return Result(tuple(said), (*problems, *wrong), not wrong, exact)


def main(arguments: list[str]) -> int:
    """Check a file: status 0 where all is proven, 1 where not, 2 where it is no certificate."""
    if len(arguments) != 1:
        print("usage: python verify.py certificate.json", file=sys.stderr)
        return 2
    try:
        result = check(read(arguments[0]))
    except (OSError, *REFUSED) as cause:
        print(f"{arguments[0]}: not a certificate: {cause}", file=sys.stderr)
        return 2
    print("\n".join(result.statements))
    print("\n".join(f"NOT PROVEN: {problem}." for problem in result.problems) or "PROVEN.")
    return 1 if result.problems else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
