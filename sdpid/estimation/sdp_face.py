"""Which of the equally good parameters to hand back.

Directions of theta that the effort does not show are free: all feasible theta with the same base
parameters cost the same. The rule: the one nearest to the robot's own description, and where a
link has none, to a ball of the robot's size, in the distance ``‖L^(-1)·P·L^(-T) − E‖`` between
pseudo-inertias with P0 = L·L^T the reference (the constant-pullback metric [lee2020]_).
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import numpy as np

from sdpid._arrays import Array
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling

# The face often has no interior: matrices may be so much below zero in the links' own scale, which
# the caller repairs. Tried in turn: links in units of the point itself or of the reference, this
# slack, and Clarabel's regularisation.
_TRIALS = (
    (False, 1e-10, 1e-8),
    (True, 1e-10, 1e-8),
    (True, 1e-10, 1e-12),
    (True, 1e-8, 1e-12),
    (False, 1e-8, 1e-8),
)

# Null directions of the scaled base matrix: its singular values are of order one or rounding.
_NULL = 1e-9


def nearest_on_face(problem: Problem, theta: Array) -> Iterator[Array]:
    """Yield parameters with theta's base parameters, as near to the reference as was found.

    Parameters
    ----------
    problem : Problem
        The problem, with a consistency.
    theta : ndarray, shape (p,)
        Feasible parameters.

    Yields
    ------
    ndarray, shape (p,)
        Nearer than theta and feasible but for rounding, which the caller repairs; of several, the
        first that is still good enough after that will do. Nothing where the solver finds none.
    """
    feasible = problem.feasible
    links = 10 * feasible.n_links
    reference = Scaling.of(problem)
    basis = reference.basis()
    _, singular, rows = np.linalg.svd(problem.base.matrix @ basis)
    rank = int(np.count_nonzero(singular > _NULL * singular[0]))
    null = basis @ rows[rank:].T
    if null.shape[1] == 0:
        yield theta
        return
    goal = np.concatenate([reference.bodies.ravel(), theta[links:]])
    there = np.column_stack([null[:links], (theta - goal)[:links]])
    distance = np.linalg.solve(basis[:links, :links], there)
    for own_scale, slack, regularisation in _TRIALS:
        scaling = reference.around(theta) if own_scale else reference
        step = _step(problem, theta, null, distance, scaling, slack, regularisation)
        if step is None:
            continue
        nearer = np.linalg.norm(distance[:, :-1] @ step + distance[:, -1])
        if nearer <= np.linalg.norm(distance[:, -1]):
            yield np.asarray(theta + null @ step)


def _step(
    problem: Problem,
    theta: Array,
    null: Array,
    distance: Array,
    scaling: Scaling,
    slack: float,
    regularisation: float,
) -> Array | None:
    """Return the step along the null directions that brings theta nearest, None if not found."""
    import cvxpy as cp

    feasible = problem.feasible
    size = feasible.size
    w = cp.Variable(null.shape[1])
    inverses = np.linalg.inv(scaling.roots(size))
    constant = inverses @ feasible.matrices(theta) @ np.swapaxes(inverses, 1, 2)
    bounded = np.flatnonzero(feasible.bounded & (np.abs(null).max(axis=1) > 0.0))
    scale = scaling.theta[bounded]
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
    try:
        with warnings.catch_warnings():
            # 'May be inaccurate': any feasible point that is nearer will do.
            warnings.simplefilter("ignore")
            cp.Problem(objective, constraints).solve(
                solver=cp.CLARABEL,
                accept_unknown=True,
                static_regularization_constant=regularisation,
            )
    except cp.error.SolverError:
        return None
    return None if w.value is None else np.asarray(w.value)
