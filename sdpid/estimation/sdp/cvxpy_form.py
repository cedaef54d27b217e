"""Write a problem as a CVXPY program, to inspect, extend, or give to another solver.

`solve_sdp` hands the same program to its solvers directly (see `sdpid.estimation.conic.solve`), and
repairs and proves what they find. This form is written from the definitions, in theta itself.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.robot.inertia import pseudo_inertia


def to_cvxpy(problem: Problem) -> tuple[Any, Any]:
    """Return a problem's semidefinite program as a CVXPY problem.

    Parameters
    ----------
    problem : Problem
        The problem.

    Returns
    -------
    model : cvxpy.Problem
        Its optimal value is the optimal cost. Constraints can be added, and any solver of
        semidefinite programs can be chosen; what that returns is not proven.
    theta : cvxpy.Expression, shape (p,)
        The standard parameters; they have values once the model is solved.

    Examples
    --------
    >>> model, theta = sdpid.to_cvxpy(problem)
    >>> value = model.solve(solver="CLARABEL")
    >>> bool(np.isclose(value, estimate.cost, rtol=1e-4)), theta.shape
    (True, (72,))
    """
    import cvxpy as cp

    feasible = problem.feasible
    size = Scaling.of(problem).theta
    # In units of their sizes: in SI units alone no solver gets far.
    scaled = cp.Variable(problem.n_theta)
    theta = cp.multiply(size, scaled)
    G, h = problem.squared.matrix, problem.squared.rhs
    cost = cp.sum_squares((G * size) @ scaled - h) + problem.floor
    constraints: list[Any] = [scaled >= feasible.lower / size, scaled <= feasible.upper / size]
    for row, low, high in zip(feasible.rows, feasible.row_lower, feasible.row_upper, strict=True):
        value = (row * size) @ scaled
        if low == high:
            constraints.append(value == low)
            continue
        constraints += [value >= low] if np.isfinite(low) else []
        constraints += [value <= high] if np.isfinite(high) else []

    def matrix(basis: np.ndarray, link: int) -> Any:
        flat = basis.reshape(len(basis), -1).T @ theta[10 * link : 10 * link + 10]
        return cp.reshape(flat, basis.shape[1:], order="C")

    for constant, basis, link in zip(
        feasible.block_constants, feasible.block_basis, feasible.block_links, strict=True
    ):
        constraints.append(matrix(basis, link) + constant >> 0)
    log_det, units = problem.log_det, pseudo_inertia(np.eye(10))
    for link, C in zip(log_det.links, log_det.roots, strict=True):
        # With P0^(-1) = C·C^T the divergence is that of C^T·P·C from the identity.
        P = matrix(C.T @ units @ C, link)
        cost += 2.0 * log_det.strength * (cp.trace(P) - cp.log_det(P) - 4.0)
    return cp.Problem(cp.Minimize(cost), constraints), theta
