"""The cost of given parameters, and the lower bound that multipliers prove, without rounding.

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

Doubles seldom solve equations exactly. So each row and cone is relaxed by what the given theta
violates it by, and cost and bound are those of this larger set: the bound can never be above the
cost. Whether the violations are rounding is judged by `violation`, relative to the size of each
row or cone, so that no unit in which it is written makes it any smaller.

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

from fractions import Fraction
from typing import Any

from .bodies import CONSISTENCIES, adjoint, link_matrix
from .exact import (
    dot,
    factorize,
    inner,
    log_bounds,
    positive_semidefinite,
    product,
    root_above,
    transposed,
)
from .reading import MalformedError, index, items, names, numbers, require_keys, shown, text

# The gap is relative to the cost, or to this share of ‖rhs‖² + floor where that is next to zero.
TINY_COST = Fraction(1e-6)

_PROBLEM = (
    *("consistency", "margin", "links", "A", "base_matrix", "rhs", "floor"),
    *("prior_matrix", "prior_rhs", "lower", "upper", "rows", "cones", "entropic_prior"),
)
ROW = ["name", "lower", "upper", "coefficients"]
CONE = ["name", "link", "axis", "vectors"]
_PRIOR = ["links", "inverses", "strength"]
_MULTIPLIERS = ["y", "Z", "rows", "W"]


class Proof:
    """What the numbers of a certificate prove, claims aside.

    Attributes
    ----------
    lower_bound : Fraction
        No feasible theta costs less.
    data_cost, prior_cost : Fraction
        Cost of theta; that of the prior is rounded up where there are logarithms.
    violation : Fraction
        Of the worst row or cone, relative to its size (rounded up where there are roots).
    worst : str
        Its name.
    floor : Fraction
        No numbers at all, feasible or not, cost less on the data.
    scale : Fraction
        The least cost that gaps are relative to; a prior has no part in it.
    broken : list of str
        Why multipliers or theta prove nothing.
    names, link_names : list of str
        Of the parameters and links, in quotes.
    """

    def __init__(self, data: dict[str, Any]) -> None:
        # Certificates up to version 5 may repeat what the last rows of a prior believe.
        said = {"alike"} & set(data["problem"]) if data["version"] <= 5 else set()
        self.problem = require_keys(data["problem"], [*_PROBLEM, *said], "problem")
        self.multipliers = require_keys(data["multipliers"], _MULTIPLIERS, "multipliers")
        p = len(items(self.problem["lower"], "lower"))
        self.lower, self.upper = (numbers(self.problem[end], p) for end in ("lower", "upper"))
        self.theta = None if data["theta"] is None else numbers(data["theta"], p)
        self.links = index(self.problem["links"], p // 10 + 1)
        self.consistency = self.problem["consistency"]
        if self.consistency not in CONSISTENCIES:
            raise MalformedError("the consistency is not known")
        self.margin = Fraction(numbers(self.problem["margin"]))
        if self.margin < 0:
            raise MalformedError("the margin is negative")
        self.data_cost = self.prior_cost = self.violation = self.constant = Fraction(0)
        self.worst = ""
        self.c, self.broken = [Fraction(0)] * p, list[str]()
        origin = data["origin"]
        self.names = list(map(shown, names(origin["theta_names"], p, "theta_names")))
        self.link_names = list(map(shown, names(origin["links"], self.links, "links")))
        self._sizes = self._sizes_of_parameters()
        self._squares()
        self._links()
        self._cones()
        self._rows()
        self._entropic()
        # c·theta is at least this much within the bounds; squares and divergences at least zero.
        ends = zip(self.c, self.lower, self.upper, strict=True)
        linear = sum(slope * Fraction(low if slope > 0 else high) for slope, low, high in ends)
        self.lower_bound = max(self.constant + linear, self.floor)

    @property
    def cost(self) -> Fraction:
        """Cost of theta."""
        return self.data_cost + self.prior_cost

    def body(self, link: int) -> list[float] | None:
        """Return a link's ten entries of theta."""
        return None if self.theta is None else self.theta[10 * link : 10 * link + 10]

    def _sizes_of_parameters(self) -> list[float]:
        """Return the size of each parameter, at which a violation of it is judged.

        That is its own value, but of a link's moments no less than its mass a meter away, and of
        friction and drives no less than one unit: what is zero has a size, too. A size that other
        links had a part in could be made as large as one likes.
        """
        theta, first = self.theta or [0.0] * len(self.lower), 10 * self.links
        masses = (abs(theta[k // 10 * 10]) if k < first else 1.0 for k in range(len(theta)))
        return [max(abs(value), least) for value, least in zip(theta, masses, strict=True)]

    def _add(self, first: int, slopes: list[Fraction]) -> None:
        """Add to entries of c."""
        for k, slope in enumerate(slopes, first):
            self.c[k] += slope

    def _judge(self, name: str, violation: Fraction, size: Fraction) -> None:
        """Keep the worst violation, relative to the size of what is violated."""
        if violation > 0 and (relative := violation / size) > self.violation:
            self.violation, self.worst = relative, name

    def _squares(self) -> None:
        """Cost: ‖A·(B·theta) − rhs‖² + floor + ‖R·theta − r‖². Bound: the terms with y."""
        problem, p = self.problem, len(self.c)
        b, q = len(items(problem["rhs"], "rhs")), len(items(problem["prior_rhs"], "prior_rhs"))
        A, B = numbers(problem["A"], b, b), numbers(problem["base_matrix"], b, p)
        R = numbers(problem["prior_matrix"], q, p)
        rhs, prior_rhs = numbers(problem["rhs"], b), numbers(problem["prior_rhs"], q)
        h = rhs + prior_rhs
        if (floor := Fraction(numbers(problem["floor"]))) < 0:
            raise MalformedError("the floor is negative")
        self.floor, self.scale = floor, TINY_COST * (dot(rhs, rhs) + floor)
        if self.theta is not None:
            self.data_cost = floor + _squared(product(A, product(B, self.theta)), rhs)
            self.prior_cost = _squared(product(R, self.theta), prior_rhs)
        y = numbers(self.multipliers["y"], b + q)
        self.constant = floor - dot(y, y) - 2 * dot(y, h)
        # 2·G^T·y = 2·B^T·(A^T·y) + 2·R^T·y: G itself is never formed.
        for rows, weights in ((B, product(transposed(A), y[:b])), (R, y[b:])):
            self._add(0, [2 * slope for slope in product(transposed(rows), weights)])

    def _links(self) -> None:
        """Bound: the Z of the links."""
        self._size = 6 if self.consistency == "spatial_inertia" else 4
        own = self.links * (self.consistency != "none")
        count = own + len(items(self.problem["cones"], "cones"))
        Z = numbers(self.multipliers["Z"], count, self._size, self._size)
        for i, z in enumerate(Z):
            if not positive_semidefinite(z):
                self.broken.append(f"multiplier Z {i} is not positive semidefinite")
        for link, z in enumerate(Z[:own]):
            self._add(10 * link, [-slope for slope in adjoint(z, self.consistency)])
            self.constant += self.margin * sum(Fraction(z[i][i]) for i in range(3))
        self._Z_of_cones = Z[own:]

    def _cones(self) -> None:
        """Bound: the Z of the cones. The cones' violations."""
        pairs = zip(self.problem["cones"], self._Z_of_cones, strict=True)
        for number, (given, z) in enumerate(pairs, 1):
            cone = require_keys(given, CONE, f"cone {number}")
            name = f"cone {shown(text(cone['name'], f'the name of cone {number}'))}"
            link = index(cone["link"], self.links)
            axis, vectors = numbers(cone["axis"], 10), numbers(cone["vectors"], 3, 10)
            # ⟨Z, [[a·E, v], [v^T, a]]⟩ = tr(Z)·a + 2·z·v, z beginning the last row of Z.
            trace = sum(Fraction(z[i][i]) for i in range(self._size))
            twice = [2 * x for x in z[-1][:3]]
            slopes = product(transposed([axis, *vectors]), [trace, *twice])
            self._add(10 * link, [-x for x in slopes])
            if (body := self.body(link)) is None:
                continue
            v = product(vectors, body)
            violation = root_above(dot(v, v)) - dot(axis, body) if any(v) else -dot(axis, body)
            sizes = self._sizes[10 * link : 10 * link + 10]
            self._judge(name, violation, max(dot(_absolute(x), sizes) for x in (axis, *vectors)))
            # Relaxed, the matrix is F + violation·E.
            self.constant -= trace * max(violation, Fraction(0))

    def _rows(self) -> None:
        """Bound: the multipliers of the rows. The rows' violations."""
        rows = items(self.problem["rows"], "rows")
        multipliers = numbers(self.multipliers["rows"], len(rows))
        for number, (given, multiplier) in enumerate(zip(rows, multipliers, strict=True), 1):
            row = require_keys(given, ROW, f"row {number}")
            name = f"row {shown(text(row['name'], f'the name of row {number}'))}"
            coefficients = numbers(row["coefficients"], len(self.c))
            # As −coefficients·theta ≥ −upper the upper limit is a lower one.
            for end, sign in (("lower", 1), ("upper", -1)):
                weight = max(sign * Fraction(multiplier), Fraction(0))
                if row[end] is None:
                    if weight:
                        self.broken.append(f"{name} has a multiplier but no limit there")
                    continue
                limit = sign * Fraction(numbers(row[end]))
                relaxed = limit
                if self.theta is not None:
                    value = sign * dot(coefficients, self.theta)
                    size = max(abs(limit), dot(_absolute(coefficients), self._sizes))
                    self._judge(name, limit - value, size)
                    relaxed = min(limit, value)
                self.constant += weight * relaxed
                if weight:
                    self._add(0, [-weight * sign * Fraction(x) for x in coefficients])

    def _entropic(self) -> None:
        """Cost: 2·s·Σ D(P‖P0). Bound: its tangents, where there are W."""
        prior, given = self.problem["entropic_prior"], self.multipliers["W"]
        if prior is None:
            if given is not None:
                raise MalformedError("W without an entropic prior")
            return
        require_keys(prior, _PRIOR, "entropic_prior")
        links = [index(link, self.links) for link in items(prior["links"], "links of the prior")]
        if len(set(links)) != len(links):
            raise MalformedError("a link has two entropic priors")
        factor = 2 * Fraction(numbers(prior["strength"]))
        inverses = numbers(prior["inverses"], len(links), 4, 4)
        tangents = [None] * len(links) if given is None else numbers(given, len(links), 4, 4)
        for link, inverse, W in zip(links, inverses, tangents, strict=True):
            det = factorize(inverse)[1]
            if not (det > 0 and factor > 0):
                raise MalformedError("a prior needs a positive strength and definite inverses")
            if (body := self.body(link)) is not None:
                P = link_matrix(body, "pseudo_inertia")
                if (at_body := factorize(P)[1]) > 0:
                    divergence = inner(inverse, P) - 4 - log_bounds(at_body * det)[0]
                    self.prior_cost += factor * divergence
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


def _absolute(values: Any) -> list[float]:
    """Return the sizes of numbers."""
    return [abs(value) for value in values]


def _squared(values: list[Fraction], wanted: list[float]) -> Fraction:
    """Return ‖values − wanted‖²."""
    residual = [value - Fraction(each) for value, each in zip(values, wanted, strict=True)]
    return dot(residual, residual)
