"""Is what a certificate claims true? Judged by other tools than those that prove it.

Written from docs/theory and the list of fields in docs/guides/certificate.md, without a look at
the verifier: link matrices by their definition as sums over point masses, their eigenvalues and
all sums with 50 digits (mpmath), the optimum by another model of the problem (CVXPY) and two
solvers (Clarabel, and SCS where Clarabel is at a loss).

A claim is *false* only where numbers with 50 digits show it: a parameter outside its bounds, a
negative eigenvalue, a cost that is higher, or feasible parameters that cost less than the bound. It
is *true* where the same numbers, or the optimum to within `BOUND`, agree. What lies in
between is *undecided*, and said to be.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from typing import Any, Literal

import cvxpy as cp
import mpmath as mp
import numpy as np
from certificate_optimum import UNITS, Optimum, agreed, doubles, interior, repaired

mp.mp.dps = 50

Verdict = Literal["true", "false", "undecided"]

# Optima agree to this share of the cost, or of a millionth of the squared efforts where the cost
# is less: what interior point methods reach on every problem of the zoo.
BOUND = 1e-6

# Where a solver calls its own optimum inaccurate, so much is left open.
INACCURATE = 1e-2

# Eigenvalues, relative to the matrix's own size; sums, relative to the sum of their terms' sizes.
ROUNDING = mp.mpf(10) ** -40

# Rows and cones are said to hold to 1e-7 of the size of their terms. What is violated by a thousand
# times that is false, whoever defines the size.
CONDITION, NOT_A_CONDITION = 1.1e-7, 1e-4


def matrix(body: Any, kind: str, margin: Any = 0) -> mp.matrix:
    """Return M(body) − margin·diag(1, 1, 1, 0, …) with 50 digits."""
    units = UNITS[kind]
    size = units.shape[1]
    out = mp.matrix(size, size)
    for i in range(size):
        for j in range(size):
            terms = [(u[i, j], x) for u, x in zip(units, body, strict=True) if u[i, j]]
            out[i, j] = mp.fdot(terms) - (mp.mpf(margin) if i == j < 3 else 0)
    return out


def lowest(M: mp.matrix) -> tuple[mp.mpf, mp.mpf]:
    """Return the smallest eigenvalue and the largest size of one."""
    values = mp.eigsy(M, eigvals_only=True)
    return min(values), max(abs(value) for value in values)


class Judge:
    """Judges claims; remembers the optima of problems it has seen."""

    def __init__(self) -> None:
        self.optima: dict[str, Optimum] = {}

    def __call__(self, data: dict[str, Any]) -> dict[str, tuple[Verdict, str]]:
        """Return the verdict on each claim that the file makes, with the numbers."""
        made = ["lower bound"]
        if data["theta"] is not None:
            made += ["feasible"] if data["claims"]["cost"] is None else ["feasible", "cost", "gap"]
        return self.claims(data, made)

    def claim(self, data: dict[str, Any], claim: str) -> tuple[Verdict, str]:
        """Return the verdict on one claim."""
        return self.claims(data, [claim])[claim]

    def claims(self, data: dict[str, Any], made: Sequence[str]) -> dict[str, tuple[Verdict, str]]:
        """Return the verdict on some claims; numbers of the file stand for doubles."""
        data = doubles(data)
        # The cost of the parameters themselves is needed again and again.
        if data["theta"] is not None and {*made} & {"lower bound", "cost"}:
            data["costs"] = costs(data, data["theta"])
        judges = {"lower bound": self.bound, "feasible": feasible}
        judges |= {"cost": cost_claim, "gap": gap_claim}
        return {claim: judges[claim](data) for claim in made}

    def bound(self, data: dict[str, Any]) -> tuple[Verdict, str]:
        """Judge: no feasible parameters cost less than the claimed bound."""
        found = self.against_optimum(data)
        if found[0] == "undecided" and data["problem"]["entropic_prior"]:
            # Divergences are never below zero: without them the optimum is the same or lower.
            easier = {**data, "problem": {**data["problem"], "entropic_prior": None}, "theta": None}
            without = self.against_optimum(easier)
            return without if without[0] == "true" else found
        return found

    def against_optimum(self, data: dict[str, Any]) -> tuple[Verdict, str]:
        """Judge a claimed bound by the optimum that solvers find."""
        claimed = data["claims"]["lower_bound"]
        problem, theta = data["problem"], data["theta"]
        if claimed <= 0.0:
            return "true", "no cost is below zero"
        if any(a > b for a, b in zip(problem["lower"], problem["upper"], strict=True)):
            return "true", "no parameters are within their bounds"
        if theta is not None and feasible(data, strict=True)[0] == "true":
            cost = whole(data, theta)
            if claimed > cost + ROUNDING * abs(cost):
                return "false", f"the parameters themselves cost {mp.nstr(cost, 17)} < {claimed!r}"
        key = hashlib.sha256(json.dumps(problem, sort_keys=True).encode()).hexdigest()
        if key not in self.optima:
            self.optima[key] = agreed(data)
        best = self.optima[key]
        if best.status == cp.INFEASIBLE:
            return "true", "no parameters are feasible, say two solvers"
        if best.theta is None:
            return "undecided", f"no solver ends ({best.status})"
        slack = BOUND * max(abs(best.cost), tiny(problem))
        if claimed <= best.cost + slack:
            if best.status == cp.OPTIMAL or claimed <= best.cost - INACCURATE / BOUND * slack:
                return "true", f"the optimum is {best.cost:.12g}"
            return "undecided", f"{best.cost:.12g}, but the solver ends with {best.status}"
        if (cost := witness(data, best.theta, claimed)) is not None:
            return "false", f"feasible parameters cost {cost} < {claimed!r}"
        return "undecided", f"optimum {best.cost:.12g} < {claimed!r}, but not shown with 50 digits"


def tiny(problem: dict[str, Any]) -> float:
    """Return a millionth of the squared efforts: what costs are compared with where they vanish."""
    h = np.concatenate([problem["rhs"], problem["prior_rhs"]]).astype(float)
    return 1e-6 * float(h @ h + problem["floor"])


def costs(data: dict[str, Any], theta: Any) -> tuple[mp.mpf, mp.mpf]:
    """Return the data's and the prior's share of the cost, with 50 digits."""
    problem = data["problem"]
    base = [
        mp.fdot((a, x) for a, x in zip(row, theta, strict=True) if a)
        for row in problem["base_matrix"]
    ]
    left = [mp.fdot(row, base) - h for row, h in zip(problem["A"], problem["rhs"], strict=True)]
    prior = [
        mp.fdot(row, theta) - h
        for row, h in zip(problem["prior_matrix"], problem["prior_rhs"], strict=True)
    ]
    own, beside = mp.fdot(left, left) + problem["floor"], mp.fdot(prior, prior)
    if entropic := problem["entropic_prior"]:
        for link, inverse in zip(entropic["links"], entropic["inverses"], strict=True):
            P = matrix(theta[10 * link : 10 * link + 10], "pseudo_inertia")
            if lowest(P)[0] <= 0:
                return own, mp.inf
            W = mp.matrix(inverse)
            trace = sum(W[i, j] * P[i, j] for i in range(4) for j in range(4))
            divergence = trace - 4 - mp.log(mp.det(P)) - mp.log(mp.det(W))
            beside += 2 * mp.mpf(entropic["strength"]) * divergence
    return own, beside


def known_costs(data: dict[str, Any], theta: Any) -> tuple[mp.mpf, mp.mpf]:
    """Return the two shares, computed before where theta are the file's parameters."""
    return data["costs"] if theta is data["theta"] else costs(data, theta)


def whole(data: dict[str, Any], theta: Any) -> mp.mpf:
    """Return the cost of theta."""
    own, beside = known_costs(data, theta)
    return own + beside


def sizes(problem: dict[str, Any], theta: Any) -> list[mp.mpf]:
    """Return the size of each parameter: its own, or that of a body with lengths of 1 m.

    Parameters that happen to be zero would make every rounding infinitely large.
    """
    inertial = 10 * problem["links"]
    return [
        max(abs(mp.mpf(x)), abs(mp.mpf(theta[k - k % 10])) if k < inertial else mp.mpf(1))
        for k, x in enumerate(theta)
    ]


def conditions(problem: dict[str, Any], theta: Any) -> list[tuple[str, mp.mpf]]:
    """Return how far each row and cone is violated, relative to the size of its terms."""
    found, scale = [], sizes(problem, theta)
    for row in problem["rows"]:
        value = mp.fdot(row["coefficients"], theta)
        for limit, sign in ((row["lower"], 1), (row["upper"], -1)):
            if limit is not None:
                terms = [abs(a * x) for a, x in zip(row["coefficients"], scale, strict=True)]
                size = max(mp.fsum(terms), abs(mp.mpf(limit)))
                short = sign * (limit - value)
                found.append((row["name"], short / size if size else mp.mpf(0)))
    for cone in problem["cones"]:
        own = slice(10 * cone["link"], 10 * cone["link"] + 10)
        body = theta[own]
        axis = mp.fdot(cone["axis"], body)
        v = [mp.fdot(row, body) for row in cone["vectors"]]
        rows = [cone["axis"], *cone["vectors"]]
        size = mp.fsum(abs(a * x) for row in rows for a, x in zip(row, scale[own], strict=True))
        short = mp.sqrt(mp.fdot(v, v)) - axis
        found.append((cone["name"], short / size if size else mp.mpf(0)))
    return found


def feasible(data: dict[str, Any], theta: Any = None, strict: bool = False) -> tuple[Verdict, str]:
    """Judge: the parameters obey bounds, margins as claimed, rows and cones.

    Strict: the problem's own margin, and rows and cones without any allowance.
    """
    problem = data["problem"]
    own = data["theta"] if theta is None else theta
    for k, (low, x, high) in enumerate(zip(problem["lower"], own, problem["upper"], strict=True)):
        if not low <= x <= high:
            return "false", f"parameter {k} is {x!r}, outside [{low!r}, {high!r}]"
    doubt = ""
    if (kind := problem["consistency"]) != "none":
        margins = [problem["margin"]] * problem["links"] if strict else data["claims"]["margins"]
        for link, margin in enumerate(margins):
            body = own[10 * link : 10 * link + 10]
            if margin is not None and not strict and body[0] <= 0:
                return "false", f"link {link} has no mass, and claims a margin"
            margin = problem["margin"] if margin is None else max(margin, problem["margin"])
            value, size = lowest(matrix(body, kind, margin))
            if value < -ROUNDING * size:
                return "false", f"link {link}: eigenvalue {mp.nstr(value, 5)} at margin {margin!r}"
    for name, short in conditions(problem, own):
        if short > (ROUNDING if strict else NOT_A_CONDITION):
            return "false", f"{name!r} is violated by {mp.nstr(short, 5)} of its size"
        if short > CONDITION:
            doubt = f"{name!r} is violated by {mp.nstr(short, 5)} of its size"
    return ("undecided", doubt) if doubt else ("true", "")


def cost_claim(data: dict[str, Any]) -> tuple[Verdict, str]:
    """Judge: the parameters cost at most as much as claimed."""
    cost, claimed = whole(data, data["theta"]), data["claims"]["cost"]
    if cost > claimed + ROUNDING * abs(cost):
        return "false", f"they cost {mp.nstr(cost, 17)}, not {claimed!r}"
    return "true", mp.nstr(cost, 17)


def gap_claim(data: dict[str, Any]) -> tuple[Verdict, str]:
    """Judge: (cost − bound) is at most the claimed share of the cost, or of its least scale."""
    claims, problem = data["claims"], data["problem"]
    scale = mp.mpf(1e-6) * (mp.fdot(problem["rhs"], problem["rhs"]) + problem["floor"])
    cost, bound = mp.mpf(claims["cost"]), mp.mpf(claims["lower_bound"])
    allowed = mp.mpf(claims["gap"]) * max(cost, scale)
    if cost - bound > allowed + ROUNDING * (abs(cost) + abs(bound)):
        return "false", f"{mp.nstr(cost - bound, 5)} > {mp.nstr(allowed, 5)}"
    return "true", ""


def witness(data: dict[str, Any], theta: np.ndarray, claimed: float) -> str | None:
    """Return the cost of parameters that are feasible with 50 digits and cost less than claimed.

    A solver ends a little outside; on the way to a point well inside, some point is feasible.
    """
    inside = interior(data)
    if inside is None:
        return None
    for share in (0.0, *(10.0**-k for k in range(10, 0, -1))):
        point = repaired(data, theta + share * (inside - theta))
        if point is None or feasible(data, point, strict=True)[0] != "true":
            continue
        cost = whole(data, point)
        if cost < claimed:
            return str(mp.nstr(cost, 17))
    return None
