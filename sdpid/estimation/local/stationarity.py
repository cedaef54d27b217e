"""How far a point is from being stationary, by a bound on what any step from it can gain."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.estimation.duality.bound import cost_scale
from sdpid.estimation.local.physical_constraints import PhysicalConstraints
from sdpid.estimation.local.physical_variables import PhysicalVariables
from sdpid.estimation.problem import Problem
from sdpid.robot.inertia import complement, inertia_tensor

# Solvers sometimes report success where they merely stopped making progress. Their word is
# checked: what the best step promises must not exceed this share of the cost.
STATIONARY = 1e-4

# Least curvature, as a share of the largest, of directions that the effort does not show. With
# 1e-6 what is promised of the Denso is up to a thousand times less than what is to be had.
_FLATTEST = 1e-12

# Times that multipliers of the matrix inequalities are looked for in new directions.
_ROUNDS = 4


def stationarity_gap(problem: Problem, theta: Array) -> float:
    """Return the share of the cost that the best step from theta can gain, 0 at an optimum.

    It is measured in the physical variables x; there stationary points are optimal
    (docs/theory, section 5), which they need not be in coordinates that have the boundary at
    infinity. With the gradient g, the Gauss–Newton matrix H and the constraints ``c ≥ 0``, the
    step d that lowers ``g·d + ½·d^T·H·d`` most while ``c + c'·d ≥ 0`` promises, by duality,

        min over λ of  ½·(g − c'^T·λ)^T·H^(-1)·(g − c'^T·λ) + λ·c,

    with λ ≥ 0 but for equations. Any λ gives an upper bound, so no constraint need be called
    active: a multiplier counts with its slack. As the problem is convex in theta, no feasible
    point costs less by more than this (docs/theory, (6b)), with a log-det prior to second
    order. Matrix inequalities take part through
    ``u^T·(N − margin·E)·u ≥ 0``, u the eigenvectors of N and of the multiplier that the gradient
    asks for, which makes eigenvalues that meet no special case.

    Parameters
    ----------
    problem : Problem
        With a consistency.
    theta : ndarray, shape (p,)
        Feasible standard parameters, masses positive.

    Returns
    -------
    float
        Infinite where the cost is.
    """
    variables = PhysicalVariables.of(problem)
    constraints = PhysicalConstraints.of(problem, variables)
    x = variables.from_theta(theta)
    J = variables.jacobian(x)
    try:
        slope = problem.gradient(theta)
    except DataError:
        return np.inf
    steps = preconditioner(problem, theta, J, _FLATTEST)
    g = slope @ J
    values = np.maximum(constraints.at_least(x), 0.0)
    slopes = constraints.at_least_jacobian(x)
    both = constraints.zero_jacobian(x)
    slopes = np.vstack([slopes, both, -both])
    values = np.concatenate([values, np.zeros(2 * len(both))])
    spectral = np.arange(len(values)) < 3 * problem.feasible.n_links
    least, rest = np.inf, g
    for _ in range(_ROUNDS):
        vectors = _gradient_eigenvectors(variables, rest)
        more = constraints.normals(x, vectors)
        slopes = np.vstack([slopes, more])
        values = np.concatenate([values, np.maximum(constraints.along(x, vectors), 0.0)])
        spectral = np.concatenate([spectral, np.ones(len(more), dtype=bool)])
        multipliers = _multipliers(slopes @ steps, values, steps @ g)
        left = steps @ (g - multipliers @ slopes)
        least = min(least, float(0.5 * left @ left + multipliers @ values))
        # What the others do not explain is left to the matrix inequalities.
        rest = g - np.where(spectral, 0.0, multipliers) @ slopes
    return least / max(problem.cost_of(theta), cost_scale(problem))


def preconditioner(problem: Problem, theta: Array, jacobian: Array, flattest: float) -> Array:
    """Return H^(-1/2) of the cost's Gauss–Newton matrix H, shape (count, count).

    Parameters
    ----------
    problem : Problem
        The problem.
    theta : ndarray, shape (p,)
        Where; a log-det prior only has curvature inside of what can exist.
    jacobian : ndarray, shape (p, count)
        Derivative of theta in the variables.
    flattest : float
        Least eigenvalue of H, as a share of the largest.
    """
    G = problem.squared.matrix @ jacobian
    H = 2.0 * G.T @ G
    with suppress(DataError):
        rows = problem.log_det.curvature_rows(theta) @ jacobian
        H = H + 2.0 * rows.T @ rows
    values, vectors = np.linalg.eigh(H)
    values = np.maximum(values, flattest * values[-1])
    return np.asarray((vectors / np.sqrt(values)) @ vectors.T)


def _gradient_eigenvectors(variables: PhysicalVariables, slope: Array) -> Array:
    """Return eigenvectors (links, 3, 3) of the slope in what must exceed the margin."""
    links = variables.problem.robot.n_links
    full = np.zeros(10 * links)
    inertial = variables.free < len(full)
    full[variables.free[inertial]] = (slope / variables.scale)[inertial]
    # An entry off the diagonal stands for two. A link's six come first here, last in theta.
    entries = np.roll(full.reshape(links, 10), 4, axis=1)
    matrices = inertia_tensor(entries) * (0.5 + 0.5 * np.eye(3))
    if variables.problem.consistency == "pseudo_inertia":
        matrices = complement(matrices)
    return np.asarray(np.linalg.eigh(matrices)[1])


def _multipliers(slopes: Array, values: Array, gradient: Array) -> Array:
    """Return λ ≥ 0 that minimizes ``½·‖gradient − slopes^T·λ‖² + λ·values``.

    The dual of a step of least distance, solved as nonnegative least squares [lawson1974]_:
    y = step + gradient is to be shortest with ``slopes·y ≥ slopes·gradient −
    values``.
    """
    from scipy.optimize import nnls

    size = float(np.linalg.norm(gradient))
    if not size > 0.0:
        return np.zeros(len(values))
    # In units of the gradient, and rows of unit length.
    lengths = np.maximum(np.linalg.norm(slopes, axis=1), np.finfo(float).tiny)
    rows = slopes / lengths[:, None]
    limits = (rows @ gradient - values / lengths) / size
    system = np.vstack([rows.T, limits])
    target = np.zeros(len(system))
    target[-1] = 1.0
    try:
        found, _ = nnls(system, target)
    except RuntimeError:
        return np.zeros(len(values))
    remainder = 1.0 - float(limits @ found)
    return np.asarray(found / lengths * size / remainder)
