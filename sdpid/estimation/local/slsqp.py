"""The paper's way: a local nonlinear program in masses, centers of mass and inertias."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.threads import one_thread
from sdpid.errors import DataError
from sdpid.estimation.estimate import Estimate, Status
from sdpid.estimation.local.physical import PhysicalConstraints, PhysicalVariables
from sdpid.estimation.local.run import UNCONSTRAINED, LocalRun
from sdpid.estimation.problem import Problem
from sdpid.robot.consistent import raise_second_moments
from sdpid.robot.inertia import matrix_basis

# Iterations after which SLSQP starts again from where it is, with variables in which the cost is
# round there (measured: 200 and more are worse, 50 no better).
_ROUND = 100

# Least curvature in a round's variables, as a share of the largest: unseen directions are neither
# left as they are nor blown up (measured: 1e-4 and above is worse, 1e-8 no better).
_FLATTEST = 1e-6

# A round that lowers the cost by less than this share of it is the last.
_SETTLED = 1e-8

# SciPy's exit modes: 0 is its own convergence, 8 a line search that finds no descent, 9 the limit.
_STOPPED: dict[int, Status] = {0: "stalled", 8: "stalled", 9: "iteration limit"}

# Below this share of the believed body the logarithm of the log-det prior is continued by its
# second-order expansion: trial steps may leave the cone.
_CONTINUED = 1e-6


@one_thread
def solve_slsqp(
    problem: Problem,
    *,
    start: Array | None = None,
    seed: int | np.random.Generator = 0,
    max_iterations: int = 1000,
    tolerance: float = 1e-12,
) -> Estimate:
    """Minimize the cost locally by SciPy's SLSQP [kraft1988]_, as the paper does by fmincon.

    The variables are inertia about the center of mass, center of mass and mass of every link, and
    the friction terms. Derivatives are analytic. Every eigenvalue of the inertia about the center
    of mass (for full consistency: of the second moments about it) is at least the margin. Further
    conditions and log-det priors are taken too. SLSQP runs in rounds of 100 iterations, each in
    variables that are rotated and scaled anew.

    Where the optimum lies on the boundary of what is consistent, expect ``"iteration limit"`` and
    a cost above that of `solve_sdp`, which is also faster. See
    docs/guides/estimation.md.

    Parameters
    ----------
    problem : Problem
        The problem.
    start : ndarray, shape (p,), optional
        Standard parameters to start from, masses positive.
    seed : int or numpy.random.Generator, optional
        Seed of the random start that is used without `start`.
    max_iterations : int, optional
        Limit on iterations, of all rounds together.
    tolerance : float, optional
        SLSQP's `ftol` on the scaled cost.

    Returns
    -------
    Estimate
        With status ``"optimal"`` when the point is feasible and its cost at most 1e-4 above what is
        proven of all feasible parameters, whatever SLSQP says of it; otherwise ``"infeasible"``,
        ``"iteration limit"``, ``"stalled"`` or ``"failed"``. How far from the global optimum a
        result is, `certify` tells.

    Raises
    ------
    DataError
        When the start has another size or masses that are not positive, or the problem has no
        consistency to obey.

    Examples
    --------
    >>> local = sdpid.solve_slsqp(problem, start=estimate.theta)
    >>> local.method, local.status
    ('slsqp', 'optimal')
    >>> bool(local.cost >= sdpid.certify(estimate).lower_bound)
    True
    """
    if problem.consistency == "none":
        raise DataError(f"solve_slsqp: {UNCONSTRAINED}")
    run = _SlsqpRun(problem, start, seed)
    theta, result = run.minimized(max_iterations, tolerance)
    stopped = _STOPPED.get(int(result.status), "failed")
    return run.estimate("slsqp", theta, stopped=stopped, message=str(result.message))


class _SlsqpRun(LocalRun):
    """The cost with its derivative in scaled physical variables, and SLSQP's rounds."""

    def __init__(self, problem: Problem, *start: Any) -> None:
        super().__init__(problem, *start)
        self.variables = PhysicalVariables(problem)
        self.constraints = PhysicalConstraints(self.variables)

    def theta(self, x: Array) -> Array:
        """Return the standard parameters of the physical variables."""
        return self.variables.theta(x)

    def cost(self, x: Array) -> tuple[float, Array]:
        """Return the scaled cost without its floor, and its gradient."""
        theta = self.variables.theta(x)
        residual = self.G @ theta - self.rhs
        value, slope = float(residual @ residual), 2.0 * residual @ self.G
        more, slopes = self._continued(theta)
        value, slope = value + self.scale**2 * more, slope + self.scale**2 * slopes
        return value, self.variables.pulled(x, slope[None])[0]

    def _continued(self, theta: Array) -> tuple[float, Array]:
        """Return the value and the gradient of the log-det prior, finite everywhere."""
        # Eigenvalues of the bodies in units of the believed ones enter by ``t − 1 − log t``; below
        # `_CONTINUED` the logarithm is replaced by its second-order expansion there.
        entropy, out = self.problem.log_det, np.zeros(len(theta))
        if not len(entropy.links):
            return 0.0, out
        roots = entropy.roots
        t, vectors = np.linalg.eigh(np.swapaxes(roots, 1, 2) @ entropy.matrices(theta) @ roots)
        near = np.maximum(t, _CONTINUED)
        below = (t - near) / near
        value = float((t - 1.0 - np.log(near) - below + 0.5 * below**2).sum())
        slopes = 1.0 - (1.0 - below) / near
        turned = roots @ vectors
        matrices = (turned * slopes[:, None, :]) @ np.swapaxes(turned, 1, 2)
        each = np.einsum("lij,kij->lk", matrices, matrix_basis("pseudo_inertia"))
        self.problem.feasible.bodies(out)[entropy.links] = each
        return 2.0 * entropy.strength * value, 2.0 * entropy.strength * out

    def minimized(self, max_iterations: int, tolerance: float) -> tuple[Array, Any]:
        """Return the standard parameters of the end point, and SciPy's last result."""
        x = self.variables.within(self.variables.from_theta(self.start))
        self.record(x)
        # SciPy also counts iterations that end without a step; the history has steps only.
        left, floor = max_iterations, self.scale**2 * self.problem.floor
        while True:
            before = self.cost(x)[0] + floor
            result, x = self._round(x, min(left, _ROUND), tolerance)
            left -= int(result.nit)
            after = self.cost(x)[0] + floor
            # A round that ended early gets another chance unless it hardly moved.
            moved = int(result.status) == 9 or abs(before - after) > _SETTLED * abs(after)
            if left <= 0 or result.nit == 0 or not moved:
                return self._nearly_feasible(self.variables.theta(x)), result

    def _nearly_feasible(self, theta: Array) -> Array:
        """Return theta, moved inside where that makes it more nearly feasible."""
        feasible, least = self.problem.feasible, self.problem.constraints.margin
        bodies = feasible.bodies(theta)
        bodies = raise_second_moments(bodies, least, consistency=self.problem.consistency)
        moved = np.concatenate([bodies.ravel(), theta[bodies.size :]])
        return min(theta, moved, key=feasible.violation)

    def _round(self, x: Array, limit: int, tolerance: float) -> tuple[Any, Array]:
        """Run SLSQP from x; return its result and where it ended."""
        from scipy.optimize import minimize

        constraints, J = self.constraints, self.variables.jacobian(x)
        steps = _preconditioner(self.problem, self.theta(x), J) / self.scale

        def at(z: Array) -> Array:
            return np.asarray(x + steps @ z)

        def cost(z: Array) -> tuple[float, Array]:
            value, slope = self.cost(at(z))
            return value, slope @ steps

        kinds = [("ineq", constraints.at_least, constraints.at_least_jacobian)]
        if len(constraints.zero(x)):
            kinds.append(("eq", constraints.zero, constraints.zero_jacobian))
        result = minimize(
            cost,
            np.zeros(len(x)),
            jac=True,
            method="SLSQP",
            constraints=[
                {
                    "type": kind,
                    "fun": lambda z, value=value: value(at(z)),
                    "jac": lambda z, slope=slope: slope(at(z)) @ steps,
                }
                for kind, value, slope in kinds
            ],
            callback=lambda z: self.record(at(z)),
            options={"maxiter": limit, "ftol": tolerance},
        )
        end = at(result.x)
        return result, self.variables.within(end) if np.all(np.isfinite(end)) else x


def _preconditioner(problem: Problem, theta: Array, jacobian: Array) -> Array:
    """Return H^(-1/2) of the cost's Gauss–Newton matrix H at theta, shape (count, count)."""
    G = problem.squared.matrix @ jacobian
    H = 2.0 * G.T @ G
    # A log-det prior only has curvature inside of what can exist.
    with suppress(DataError):
        rows = problem.log_det.curvature_rows(theta) @ jacobian
        H = H + 2.0 * rows.T @ rows
    values, vectors = np.linalg.eigh(H)
    values = np.maximum(values, _FLATTEST * values[-1])
    return np.asarray((vectors / np.sqrt(values)) @ vectors.T)
