"""Is what a certificate claims true? Judged by other tools than those that prove it.

Written from docs/theory.md and the table of fields in docs/certificate.md, without a look at the
verifier: link matrices by their definition as sums over point masses, their eigenvalues and
all sums with 50 digits (mpmath), the optimum by another model of the problem (CVXPY) and two
solvers (Clarabel, and SCS where Clarabel is at a loss).

A claim is *false* only where numbers with 50 digits show it: a parameter outside its bounds, a
negative eigenvalue, a cost that is higher, or feasible parameters that cost less than the bound. It
is *true* where the same numbers, or the optimum to within `BOUND`, agree. What lies in
between is *undecided*, and said to be.

    python examples/studies/certificate_judge.py certificate.json --out results

Without a file, those of certificate_zoo.py are judged.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import cvxpy as cp
import mpmath as mp
import numpy as np

mp.mp.dps = 50

Verdict = Literal["true", "false", "undecided"]

# Optima agree to this share of the cost, or of a millionth of the squared efforts where the cost
# is less: what interior point methods reach on every problem of the zoo.
BOUND = 1e-6

# Where a solver calls its own optimum inaccurate, so much is left open.
INACCURATE = 1e-2

# Bounds on parameters beyond this size (SI units) are not put to a solver.
FAR = 1e6

# Eigenvalues, relative to the matrix's own size; sums, relative to the sum of their terms' sizes.
ROUNDING = mp.mpf(10) ** -40

# Rows and cones are said to hold to 1e-7 of the size of their terms. What is violated by a thousand
# times that is false, whoever defines the size.
CONDITION, NOT_A_CONDITION = 1.1e-7, 1e-4


@dataclass(frozen=True)
class Optimum:
    """The optimum by a solver: its cost, parameters, and what the solver says of them."""

    status: str
    cost: float
    theta: np.ndarray | None


def second_moments(consistency: str) -> np.ndarray:
    """Return the matrices (10, d, d) of bodies of which one parameter is 1 and nine are 0.

    The order is m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz. 4×4: ∫ [x; 1]·[x; 1]^T dm with the
    products ∫ x_i·x_j dm from the moments of inertia. 6×6: kinetic energy of a body whose origin
    moves with u and which turns with w, as ½·[w; u]^T·M·[w; u].
    """
    size = 4 if consistency != "spatial_inertia" else 6
    out = np.zeros((10, size, size))
    inertia = {4: (0, 0), 5: (0, 1), 6: (1, 1), 7: (0, 2), 8: (1, 2), 9: (2, 2)}
    for k in range(10):
        tensor, first = np.zeros((3, 3)), np.zeros(3)
        if k in inertia:
            i, j = inertia[k]
            tensor[i, j] = tensor[j, i] = 1.0
        if 1 <= k <= 3:
            first[k - 1] = 1.0
        mass = float(k == 0)
        if size == 4:
            # ∫ x·x^T dm = ½·tr(I)·E − I, because I = ∫ (‖x‖²·E − x·x^T) dm.
            out[k, :3, :3] = 0.5 * np.trace(tensor) * np.eye(3) - tensor
            out[k, :3, 3] = out[k, 3, :3] = first
            out[k, 3, 3] = mass
        else:
            # A point of the body moves with u + w × x, so that the mixed part is w·(h × u).
            cross = np.cross(np.eye(3), -first)  # cross[i] = e_i × (−h) = h × e_i
            out[k, :3, :3] = tensor
            out[k, :3, 3:] = cross.T
            out[k, 3:, :3] = cross
            out[k, 3:, 3:] = mass * np.eye(3)
    return out


UNITS = {kind: second_moments(kind) for kind in ("pseudo_inertia", "spatial_inertia")}


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
        claimed = data["claims"]["lower_bound"]
        problem, band = data["problem"], compression(data)
        theta = data["theta"]
        if theta is not None and feasible(data, strict=True)[0] == "true":
            cost = least(data, theta)
            if claimed > cost + ROUNDING * abs(cost):
                return "false", f"the parameters themselves cost {mp.nstr(cost, 17)} < {claimed!r}"
        key = hashlib.sha256(json.dumps([problem, band], sort_keys=True).encode()).hexdigest()
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


def doubles(value: Any, key: str = "") -> Any:
    """Return data with every number as a double but those that count links."""
    if isinstance(value, dict):
        return {name: doubles(item, name) for name, item in value.items()}
    if isinstance(value, list):
        return [doubles(item, key) for item in value]
    return float(value) if type(value) is int and key not in ("link", "links") else value


def compression(data: dict[str, Any]) -> tuple[float, float]:
    """Return (relative, absolute): how far the cost of the rows may be from the compressed one."""
    band = data.get("compression") or data["problem"].get("compression")
    return (band["relative"], band["absolute"]) if band else (0.0, 0.0)


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


def least(data: dict[str, Any], theta: Any) -> mp.mpf:
    """Return the least cost of theta that the compression's error leaves possible."""
    (delta, epsilon), (own, beside) = compression(data), known_costs(data, theta)
    return (1 - mp.mpf(delta)) * own - epsilon + beside


def most(data: dict[str, Any], theta: Any) -> mp.mpf:
    """Return the largest one."""
    (delta, epsilon), (own, beside) = compression(data), known_costs(data, theta)
    return (1 + mp.mpf(delta)) * own + epsilon + beside


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
    cost, claimed = most(data, data["theta"]), data["claims"]["cost"]
    if cost > claimed + ROUNDING * abs(cost):
        return "false", f"they cost {mp.nstr(cost, 17)}, not {claimed!r}"
    return "true", mp.nstr(cost, 17)


def gap_claim(data: dict[str, Any]) -> tuple[Verdict, str]:
    """Judge: (cost − bound) is at most the claimed share of the cost, or of its least scale."""
    claims, problem = data["claims"], data["problem"]
    h = [*problem["rhs"], *problem["prior_rhs"]]
    scale = mp.mpf(1e-6) * (mp.fdot(h, h) + problem["floor"])
    cost, bound = mp.mpf(claims["cost"]), mp.mpf(claims["lower_bound"])
    allowed = mp.mpf(claims["gap"]) * max(cost, scale)
    if cost - bound > allowed + ROUNDING * (abs(cost) + abs(bound)):
        return "false", f"{mp.nstr(cost - bound, 5)} > {mp.nstr(allowed, 5)}"
    return "true", ""


def model(data: dict[str, Any]) -> tuple[Any, list[Any], Any]:
    """Return the least possible cost less its constant, the constraints, and theta."""
    problem, (delta, _) = data["problem"], compression(data)
    x = cp.Variable(len(problem["lower"]))
    share = float(np.sqrt(max(1.0 - delta, 0.0)))
    G = np.array(problem["A"]).reshape(-1, len(problem["rhs"])) @ np.array(problem["base_matrix"])
    matrices, sides = [share * G], [share * np.array(problem["rhs"])]
    if problem["prior_matrix"]:
        matrices.append(np.array(problem["prior_matrix"]))
        sides.append(np.array(problem["prior_rhs"]))
    # As many rows as columns say the same, and the rest is a constant.
    R = np.linalg.qr(np.column_stack([np.vstack(matrices), np.concatenate(sides)]), mode="r")
    cost = cp.sum_squares(R[:, :-1] @ x - R[:, -1])
    lower, upper = np.array(problem["lower"]), np.array(problem["upper"])
    # Without bounds that no solver can work with, the optimum is the same or lower.
    far = (np.abs(lower) < FAR, np.abs(upper) < FAR)
    demands = [x[far[0]] >= lower[far[0]], x[far[1]] <= upper[far[1]]]
    kind = problem["consistency"]
    bodies = [x[10 * i : 10 * i + 10] for i in range(problem["links"])]
    if kind != "none":
        size = UNITS[kind].shape[1]
        flat = UNITS[kind].reshape(10, -1).T
        corner = np.diag([1.0] * 3 + [0.0] * (size - 3))
        for body in bodies:
            M = cp.reshape(flat @ body, (size, size), order="C")
            demands.append(M - problem["margin"] * corner >> 0)
    for row in problem["rows"]:
        value = np.array(row["coefficients"])
        size = float(np.linalg.norm(value)) or 1.0
        if row["lower"] is not None and row["lower"] == row["upper"]:
            demands.append(value / size @ x == row["lower"] / size)
            continue
        if row["lower"] is not None:
            demands.append(value / size @ x >= row["lower"] / size)
        if row["upper"] is not None:
            demands.append(value / size @ x <= row["upper"] / size)
    for cone in problem["cones"]:
        body = bodies[cone["link"]]
        demands.append(cp.SOC(np.array(cone["axis"]) @ body, np.array(cone["vectors"]) @ body))
    if entropic := problem["entropic_prior"]:
        for link, inverse in zip(entropic["links"], entropic["inverses"], strict=True):
            P = cp.reshape(
                UNITS["pseudo_inertia"].reshape(10, -1).T @ bodies[link], (4, 4), order="C"
            )
            known = np.linalg.slogdet(np.array(inverse))[1]
            divergence = cp.trace(np.array(inverse) @ P) - 4.0 - cp.log_det(P) - known
            cost = cost + 2.0 * entropic["strength"] * divergence
    return cost, demands, x


# One solver in three ways, and another one for what it cannot do.
ATTEMPTS: tuple[tuple[str, dict[str, Any]], ...] = (
    (cp.CLARABEL, {}),
    (cp.CLARABEL, {"equilibrate_enable": False}),
    (cp.CLARABEL, {"equilibrate_max_iter": 50, "static_regularization_constant": 1e-10}),
    (cp.SCS, {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iters": 5_000}),
)


def agreed(data: dict[str, Any]) -> Optimum:
    """Return the first optimum that a solver stands by; that there is none takes two of them."""
    found = list[Optimum]()
    for solver, options in ATTEMPTS:
        found.append(optimum(data, solver, options))
        status = [each.status for each in found]
        if status[-1] == cp.OPTIMAL or status.count(cp.INFEASIBLE) == 2:
            return found[-1]
    return next((each for each in found if each.theta is not None), found[-1])


def optimum(data: dict[str, Any], solver: str, options: dict[str, Any]) -> Optimum:
    """Return the optimum of the least possible cost."""
    delta, epsilon = compression(data)
    constant = (1.0 - delta) * data["problem"]["floor"] - epsilon
    cost, demands, x = model(data)
    found = solved(cp.Problem(cp.Minimize(cost), demands), x, solver, options)
    return replace(found, cost=found.cost + constant)


def solved(program: Any, x: Any, solver: str, options: dict[str, Any]) -> Optimum:
    """Return what a solver finds, whatever happens to it."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what is inaccurate is said by the status
            program.solve(solver=solver, **options)
    except BaseException as error:
        # Clarabel panics at numbers of 1e300, which is no Exception.
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
        return Optimum(f"{type(error).__name__}: {error}"[:80], np.nan, None)
    if x.value is None or program.value is None:
        return Optimum(program.status, np.nan, None)
    return Optimum(program.status, float(program.value), np.array(x.value))


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
        cost = least(data, point)
        if cost < claimed:
            return str(mp.nstr(cost, 17))
    return None


def interior(data: dict[str, Any]) -> np.ndarray | None:
    """Return parameters far inside all constraints that are no equations."""
    problem = data["problem"]
    _, demands, x = model({**data, "problem": {**problem, "entropic_prior": None}})
    depth = cp.Variable()
    widths = np.array(problem["upper"]) - np.array(problem["lower"])
    demands += [x - np.array(problem["lower"]) >= depth * np.minimum(widths, 1e-3)]
    demands += [np.array(problem["upper"]) - x >= depth * np.minimum(widths, 1e-3)]
    if (kind := problem["consistency"]) != "none":
        size = UNITS[kind].shape[1]
        for i in range(problem["links"]):
            body = x[10 * i : 10 * i + 10]
            M = cp.reshape(UNITS[kind].reshape(10, -1).T @ body, (size, size), order="C")
            corner = np.diag([1.0] * 3 + [0.0] * (size - 3)) * problem["margin"]
            demands.append(M - corner - 1e-3 * depth * np.eye(size) >> 0)
    for row in problem["rows"]:
        value = np.array(row["coefficients"])
        size = float(np.linalg.norm(value)) or 1.0
        if row["lower"] == row["upper"]:
            continue
        if row["lower"] is not None:
            demands.append(value / size @ x - row["lower"] / size >= 1e-3 * depth)
        if row["upper"] is not None:
            demands.append(row["upper"] / size - value / size @ x >= 1e-3 * depth)
    for cone in problem["cones"]:
        body = x[10 * cone["link"] : 10 * cone["link"] + 10]
        size = float(np.linalg.norm(np.array(cone["axis"]))) or 1.0
        axis = np.array(cone["axis"]) @ body - 1e-3 * depth * size
        demands.append(cp.SOC(axis, np.array(cone["vectors"]) @ body))
    demands.append(depth <= 0.1)
    return solved(cp.Problem(cp.Maximize(depth), demands), x, cp.CLARABEL, {}).theta


def repaired(data: dict[str, Any], theta: np.ndarray) -> Any:
    """Return the nearest parameters that solve all equations, with 50 digits."""
    rows = [
        row
        for row in data["problem"]["rows"]
        if row["lower"] is not None and row["lower"] == row["upper"] and any(row["coefficients"])
    ]
    point = [mp.mpf(float(value)) for value in theta]
    if not rows:
        return point
    R = [[mp.mpf(a) for a in row["coefficients"]] for row in rows]
    short = [row["lower"] - mp.fdot(r, point) for row, r in zip(rows, R, strict=True)]
    gram = mp.matrix([[mp.fdot(a, b) for b in R] for a in R])
    try:
        weights = mp.lu_solve(gram, mp.matrix(short))
    except ZeroDivisionError:
        return None
    return [x + mp.fsum(weights[j] * r[k] for j, r in enumerate(R)) for k, x in enumerate(point)]


def main() -> int:
    """Judge files, with status 1 where a claim is false, or those that certificate_zoo.py makes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", type=Path, nargs="*", help="by default certificates of the zoo")
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--quick", action="store_true", help="of the zoo, only small ones")
    arguments = parser.parse_args()
    made = {path.name: json.loads(path.read_text(encoding="utf-8")) for path in arguments.files}
    if not made:
        from certificate_zoo import made as zoo

        made = zoo(arguments.quick)
    judge, lines, wrong = Judge(), list[str](), 0
    for name, data in made.items():
        for claim, (verdict, why) in judge(data).items():
            wrong += verdict == "false"
            lines.append(f"{name:16} {claim:12} {verdict:10} {why}")
            print(lines[-1])
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "judged.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return 1 if wrong and arguments.files else 0


if __name__ == "__main__":
    sys.exit(main())
