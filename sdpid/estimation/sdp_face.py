"""Which of the equally good parameters to hand back.

Directions of theta that the effort does not show are free: all feasible theta with the same base
parameters cost the same. The rule: the one nearest to the robot's own description, and where a
link has none, to a ball of the robot's size, in the distance ``‖L^(-1)·P·L^(-T) − E‖`` between
pseudo-inertias with P0 = L·L^T the reference (the constant-pullback metric [lee2020]_).
"""

from __future__ import annotations

import warnings

import numpy as np

from sdpid._arrays import Array
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling

# The face often has no interior: matrices may be this much below zero in the links' own scale,
# which the caller repairs. The second is tried where the solver cannot resolve the first.
_SLACKS = (1e-10, 1e-8)

# Null directions of the scaled base matrix: its singular values are of order one or rounding.
_NULL = 1e-9


def nearest_on_face(problem: Problem, theta: Array) -> Array | None:
    """Return the feasible parameters with theta's base parameters nearest to the reference.

    Parameters
    ----------
    problem : Problem
        The problem, with a consistency.
    theta : ndarray, shape (p,)
        Feasible parameters.

    Returns
    -------
    ndarray, shape (p,), or None
        None when the solver does not find it. Feasible but for rounding.
    """
    import cvxpy as cp

    feasible = problem.feasible
    links = 10 * feasible.n_links
    reference = Scaling.of(problem)
    basis = reference.basis()
    _, singular, rows = np.linalg.svd(problem.base.matrix @ basis)
    rank = int(np.count_nonzero(singular > _NULL * singular[0]))
    null = basis @ rows[rank:].T
    if null.shape[1] == 0:
        return theta
    w = cp.Variable(null.shape[1])
    inertial = basis[:links, :links]
    goal = np.concatenate([reference.bodies.ravel(), theta[links:]])
    distance = np.linalg.solve(inertial, np.column_stack([null[:links], (theta - goal)[:links]]))
    size = feasible.size
    slack = cp.Parameter(nonneg=True)
    inverses = np.linalg.inv(reference.around(theta).roots(size))
    constant = inverses @ feasible.matrices(theta) @ np.swapaxes(inverses, 1, 2)
    bounded = np.flatnonzero(feasible.bounded & (np.abs(null).max(axis=1) > 0.0))
    scale = reference.theta[bounded]
    move = (null[bounded] / scale[:, None]) @ w
    constraints = [
        move >= (np.minimum(feasible.lower - theta, 0.0))[bounded] / scale,
        move <= (np.maximum(feasible.upper - theta, 0.0))[bounded] / scale,
    ]
    for link, inverse in enumerate(inverses):
        own = slice(10 * link, 10 * link + 10)
        matrices = inverse @ np.einsum("ka,kij->aij", null[own], feasible.basis()) @ inverse.T
        F = cp.reshape(matrices.reshape(len(matrices), -1).T @ w, (size, size), order="C")
        constraints.append(F + constant[link] + slack * np.eye(size) >> 0)
    objective = cp.Minimize(cp.sum_squares(distance[:, :-1] @ w + distance[:, -1]))
    model = cp.Problem(objective, constraints)
    for value in _SLACKS:
        slack.value = value
        try:
            with warnings.catch_warnings():
                # 'May be inaccurate': any feasible point that is nearer will do.
                warnings.simplefilter("ignore")
                model.solve(solver=cp.CLARABEL, accept_unknown=True)
        except cp.error.SolverError:
            continue
        if w.value is None:
            continue
        nearer = np.linalg.norm(distance[:, :-1] @ w.value + distance[:, -1])
        if nearer <= np.linalg.norm(distance[:, -1]):
            return np.asarray(theta + null @ w.value)
    return None
