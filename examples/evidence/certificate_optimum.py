"""The least cost of a certificate's problem, by another model of it (CVXPY) and other solvers.

Written from docs/theory and the list of fields in docs/guides/certificate.md, without a look at
the verifier: link matrices by their definition as sums over point masses. Clarabel is tried in
three ways, then SCS.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

import cvxpy as cp
import mpmath as mp
import numpy as np

# Bounds on parameters beyond this size (SI units) are not put to a solver.
FAR = 1e6


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


def doubles(value: Any, key: str = "") -> Any:
    """Return data with every number as a double but those that count links."""
    if isinstance(value, dict):
        return {name: doubles(item, name) for name, item in value.items()}
    if isinstance(value, list):
        return [doubles(item, key) for item in value]
    return float(value) if type(value) is int and key not in ("link", "links") else value


def model(data: dict[str, Any]) -> tuple[Any, list[Any], Any]:
    """Return the least possible cost less its constant, the constraints, and theta."""
    problem = data["problem"]
    x = cp.Variable(len(problem["lower"]))
    G = np.array(problem["A"]).reshape(-1, len(problem["rhs"])) @ np.array(problem["base_matrix"])
    matrices, sides = [G], [np.array(problem["rhs"])]
    if problem["prior_matrix"]:
        matrices.append(np.array(problem["prior_matrix"]))
        sides.append(np.array(problem["prior_rhs"]))
    # As many rows as columns say the same, and the rest is a constant.
    R = np.linalg.qr(np.column_stack([np.vstack(matrices), np.concatenate(sides)]), mode="r")
    cost = cp.sum_squares(R[:, :-1] @ x - R[:, -1])
    if entropic := problem["entropic_prior"]:
        for link, inverse in zip(entropic["links"], entropic["inverses"], strict=True):
            P = link_matrix(x, link, "pseudo_inertia")
            known = np.linalg.slogdet(np.array(inverse))[1]
            divergence = cp.trace(np.array(inverse) @ P) - 4.0 - cp.log_det(P) - known
            cost = cost + 2.0 * entropic["strength"] * divergence
    return cost, constraints(problem, x), x


def link_matrix(x: Any, link: int, kind: str) -> Any:
    """Return the matrix of a link of parameters that are looked for."""
    units = UNITS[kind]
    body = x[10 * link : 10 * link + 10]
    return cp.reshape(units.reshape(10, -1).T @ body, units.shape[1:], order="C")


def constraints(problem: dict[str, Any], x: Any, depth: Any = 0.0) -> list[Any]:
    """Return the constraints, inequalities with some room: `depth` times a thousandth."""
    room = 1e-3 * depth
    lower, upper = np.array(problem["lower"]), np.array(problem["upper"])
    narrow = np.minimum(upper - lower, 1e-3)
    # Without bounds that no solver can work with, the optimum is the same or lower.
    low, high = lower > -FAR, upper < FAR
    demands = [
        x[low] - lower[low] >= depth * narrow[low],
        upper[high] - x[high] >= depth * narrow[high],
    ]
    if (kind := problem["consistency"]) != "none":
        size = UNITS[kind].shape[1]
        corner = np.diag([1.0] * 3 + [0.0] * (size - 3)) * problem["margin"]
        for link in range(problem["links"]):
            demands.append(link_matrix(x, link, kind) - corner - room * np.eye(size) >> 0)
    for row in problem["rows"]:
        value = np.array(row["coefficients"])
        size = float(np.linalg.norm(value)) or 1.0
        least, most = row["lower"], row["upper"]
        if least is not None and least == most:
            demands.append(value / size @ x == least / size)
            continue
        if least is not None:
            demands.append(value / size @ x - least / size >= room)
        if most is not None:
            demands.append(most / size - value / size @ x >= room)
    for cone in problem["cones"]:
        body = x[10 * cone["link"] : 10 * cone["link"] + 10]
        axis, vectors = np.array(cone["axis"]), np.array(cone["vectors"])
        size = max(np.abs(axis).max(), np.abs(vectors).max()) or 1.0
        demands.append(cp.SOC(axis / size @ body - room, vectors / size @ body))
    return demands


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
    cost, demands, x = model(data)
    found = solved(cp.Problem(cp.Minimize(cost), demands), x, solver, options)
    return replace(found, cost=found.cost + data["problem"]["floor"])


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


def interior(data: dict[str, Any]) -> np.ndarray | None:
    """Return parameters far inside all constraints that are no equations."""
    problem, depth = data["problem"], cp.Variable()
    x = cp.Variable(len(problem["lower"]))
    demands = [*constraints(problem, x, depth), depth <= 0.1]
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
