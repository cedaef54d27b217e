"""The least cost of a certificate's problem, by another model of it (CVXPY) and other solvers.

Written from docs/theory and the table of fields in docs/guides/certificate.md, without a look at
the
verifier: link matrices by their definition as sums over point masses. Clarabel is tried in three
ways, then SCS.

    python examples/evidence/certificate_optimum.py certificate.json --out results

Without a file, those of certificate_zoo.py are solved, by both solvers.
"""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass, replace
from typing import Any

import cvxpy as cp
import mpmath as mp
import numpy as np

from sdpid._common.tables import Table

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
    lower, upper = np.array(problem["lower"]), np.array(problem["upper"])
    # Without bounds that no solver can work with, the optimum is the same or lower.
    far = (lower > -FAR, upper < FAR)
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
        axis, vectors = np.array(cone["axis"]), np.array(cone["vectors"])
        size = max(np.abs(axis).max(), np.abs(vectors).max()) or 1.0
        demands.append(cp.SOC(axis / size @ body, vectors / size @ body))
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


def main() -> None:
    """Print the optimum of each file by both solvers, beside its claims."""
    from certificate_zoo import asked

    certificates, options = asked(__doc__.splitlines()[0])
    rows = []
    for name, data in certificates.items():
        found = [optimum(doubles(data), *ATTEMPTS[k]) for k in (0, -1)]
        by = [cell for each in found for cell in (each.cost, each.status)]
        rows.append((name, data["claims"]["lower_bound"], *by))
    table = Table(("certificate", "claimed bound", "Clarabel", "", "SCS", ""), tuple(rows))
    print(table.text(digits=12))
    options.out.mkdir(parents=True, exist_ok=True)
    table.write(options.out / "optima.csv")


if __name__ == "__main__":
    sys.exit(main())
