"""The paper's way: a local nonlinear program in masses, centres of mass and inertias."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from sdpid._arrays import Array, frozen
from sdpid.errors import DataError
from sdpid.estimation.bound import TINY_COST
from sdpid.estimation.estimate import Estimate, Step
from sdpid.estimation.local import FEASIBLE_LOCAL, STATIONARY
from sdpid.estimation.physical import PhysicalVariables
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.estimation.starts import checked_start

# Constraints this close to zero (scaled) may have a multiplier.
_ACTIVE = 1e-6


def solve_slsqp(
    problem: Problem,
    *,
    start: Array | None = None,
    seed: int | np.random.Generator = 0,
    max_iterations: int = 3000,
    tolerance: float = 1e-12,
) -> Estimate:
    """Minimise the cost locally by SciPy's SLSQP [kraft1988]_, as the paper does by fmincon.

    The variables are the paper's: inertia about the centre of mass, centre of mass and mass of
    every link, and the friction terms (66 for the Denso). All are scaled to order one, all
    derivatives are analytic. The constraints are smooth but for crossing eigenvalues: every
    eigenvalue of the inertia about the centre of mass (for full consistency: of the second
    moments about it, which is the triangle inequality) is at least the margin.

    Parameters
    ----------
    problem : Problem
        The problem.
    start : ndarray, shape (p,), optional
        Standard parameters to start from, masses positive.
    seed : int or numpy.random.Generator, optional
        Of the random start that is used without `start`.
    max_iterations : int, optional
        Limit on iterations.
    tolerance : float, optional
        SLSQP's `ftol` on the scaled cost.

    Returns
    -------
    Estimate
        With status ``"optimal"`` when SLSQP says it converged, the point is feasible, and it is
        stationary when that is recomputed; otherwise the status says what happened:
        ``"infeasible"``, ``"iteration limit"``, ``"stalled"`` or ``"failed"``. How far from the
        global optimum a result is, `certify` tells.

    Raises
    ------
    DataError
        When the start has another size or masses that are not positive, or the problem has no
        consistency to obey.
    """
    if problem.consistency == "none":
        raise DataError("solve_slsqp: consistency is 'none', nothing constrains; use solve_wls.")
    variables = PhysicalVariables.of(problem)
    start = checked_start(problem, start, seed)
    program = _Program(problem, variables)
    x0 = variables.from_theta(start)
    result = program.run(x0, max_iterations, tolerance)
    theta = variables.theta(result.x)
    violation = problem.feasible.violation(theta)
    return Estimate.of_theta(
        problem,
        theta,
        method="slsqp",
        status=_status(result, violation, program),
        message=str(result.message),
        iterations=int(result.nit),
        solve_time=program.seconds,
        history=tuple(program.history),
        start=frozen(start),
    )


def _status(result: Any, violation: float, program: _Program) -> str:
    if violation > FEASIBLE_LOCAL:
        return "infeasible"
    if result.success:
        promised = program.promised_decrease(result.x)
        return "optimal" if promised <= STATIONARY else "stalled"
    # SciPy's exit modes: 9 is the iteration limit, 8 a line search that finds no descent.
    return {9: "iteration limit", 8: "stalled"}.get(int(result.status), "failed")


class _Program:
    """Scaled cost and constraints with their derivatives, and a record of the iterations."""

    def __init__(self, problem: Problem, variables: PhysicalVariables) -> None:
        scaling = Scaling.of(problem)
        self.problem, self.variables = problem, variables
        G, h = problem.design
        self.scale = 1.0 / np.sqrt(float(h @ h) + problem.floor)
        self.G = self.scale * G
        self.rhs = self.scale * h
        self.moment = scaling.mass * scaling.length**2
        self.history: list[Step] = []
        self.seconds = 0.0
        feasible = problem.feasible
        links = feasible.n_links
        inertial = variables.free < 10 * links
        index = variables.free
        lower = np.full(variables.count, -np.inf)
        upper = np.full(variables.count, np.inf)
        mass = inertial & (index % 10 == 9)
        lower[mass], upper[mass] = problem.constraints.mass_min, problem.constraints.mass_max
        # Friction variables keep their place: the tail of theta.
        lower[~inertial] = feasible.lower[index[~inertial]]
        upper[~inertial] = feasible.upper[index[~inertial]]
        self.lower, self.upper = lower / variables.scale, upper / variables.scale

    def cost(self, x: Array) -> tuple[float, Array]:
        residual = self.G @ self.variables.theta(x) - self.rhs
        gradient = 2.0 * (residual @ self.G) @ self.variables.jacobian(x)
        return float(residual @ residual), gradient

    def constraints(self, x: Array) -> Array:
        """Return eigenvalues above the margin and diagonals below theta_max, all ≥ 0.

        In a consistent link no entry of theta exceeds the largest diagonal of its inertia by
        more than the mass allows, so bounding the diagonals bounds everything.
        """
        matrices, _ = self.variables.inertias(x)
        eigenvalues = np.linalg.eigvalsh(matrices).ravel() - self.problem.constraints.margin
        bodies = self.problem.feasible.bodies(self.variables.theta(x))
        limit = self.problem.constraints.theta_max
        room = 1.0 - bodies[:, [4, 6, 9]].ravel() / limit
        return np.concatenate([eigenvalues / self.moment, room])

    def constraint_jacobian(self, x: Array) -> Array:
        variables, problem = self.variables, self.problem
        links = problem.robot.n_links
        matrices, basis = variables.inertias(x)
        _, vectors = np.linalg.eigh(matrices)
        slopes = np.einsum("lia,kij,lja->lak", vectors, basis, vectors)
        # In the six tensor entries of each link, of all variables; then of the free ones.
        full = np.zeros((3 * links, len(variables.expand(x))))
        for link in range(links):
            full[3 * link : 3 * link + 3, 10 * link : 10 * link + 6] = slopes[link]
        if variables.axis is not None:
            own = int(variables.free[0])
            for k in (0, 2, 5):
                if k != own:
                    full[:, own] += full[:, k]
        eigen = full[:, variables.free] * variables.scale / self.moment
        J = variables.jacobian(x)[: 10 * links].reshape(links, 10, -1)
        room = -J[:, [4, 6, 9]].reshape(3 * links, -1) / problem.constraints.theta_max
        return np.vstack([eigen, room])

    def promised_decrease(self, x: Array) -> float:
        """Return the share of the cost that a Newton step along the leftover gradient promises.

        The leftover is what the best multipliers of the active constraints do not explain: zero
        at a stationary point.
        """
        from scipy.optimize import nnls

        theta, J = self.variables.theta(x), self.G @ self.variables.jacobian(x)
        residual = self.G @ theta - self.rhs
        gradient = 2.0 * residual @ J
        values = self.constraints(x)
        normals = self.constraint_jacobian(x)[values < _ACTIVE]
        identity = np.eye(len(x))
        lower, upper = x - self.lower < _ACTIVE, self.upper - x < _ACTIVE
        active = np.vstack([normals, identity[lower], -identity[upper]])
        # Variables in units in which the cost has unit curvature, so that sizes mean decrease.
        curvature = np.sqrt(2.0) * np.linalg.norm(J, axis=0)
        curvature = np.where(curvature > 0.0, curvature, 1.0)
        leftover = gradient / curvature
        if len(active):
            multipliers, _ = nnls((active / curvature).T, leftover)
            leftover = leftover - (active / curvature).T @ multipliers
        cost = float(residual @ residual + self.scale**2 * self.problem.floor)
        promised = 0.5 * float(leftover @ leftover)
        # Exact data leave a cost of rounding; the scaled squared efforts are one.
        return promised / max(cost, TINY_COST)

    def run(self, x0: Array, max_iterations: int, tolerance: float) -> Any:
        from scipy.optimize import Bounds, minimize

        begin = time.perf_counter()

        def record(x: Array) -> None:
            theta = self.variables.theta(x)
            self.history.append(
                Step(
                    time.perf_counter() - begin,
                    self.problem.cost_of(theta),
                    self.problem.feasible.violation(theta),
                )
            )

        x0 = np.clip(x0, self.lower, self.upper)
        record(x0)
        result = minimize(
            self.cost,
            x0,
            jac=True,
            method="SLSQP",
            bounds=Bounds(self.lower, self.upper),
            constraints={
                "type": "ineq",
                "fun": self.constraints,
                "jac": self.constraint_jacobian,
            },
            callback=record,
            options={"maxiter": max_iterations, "ftol": tolerance},
        )
        self.seconds = time.perf_counter() - begin
        return result
