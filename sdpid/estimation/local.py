"""What local solvers share: when a result counts as feasible, and as stationary."""

from __future__ import annotations

import numpy as np

from sdpid._arrays import Array
from sdpid.estimation.bound import cost_scale
from sdpid.estimation.problem import Problem
from sdpid.robot.inertia import (
    complement,
    inertia_tensor,
    physical_parameters,
    second_moment_from_inertia,
    tensor_entries,
    theta_from_physical,
)

# A local result may lie this far outside a constraint (kg·m², kg, …) and still count as feasible;
# SLSQP works on scaled constraints and stops near 1e-10 of them.
FEASIBLE_LOCAL = 1e-7

# Solvers sometimes report success where they merely stopped making progress. Their word is
# checked: what steps along the leftover gradient promise must not exceed this share of the cost.
STATIONARY = 1e-4


def promised_decrease(problem: Problem, theta: Array) -> float:
    """Return the share of the cost that steps from theta promise, 0 at an optimum.

    It is measured in the physical variables mass m, centre of mass r and N, the matrix that must
    exceed the margin eps; there stationary points are optimal (docs/theory.md, section 5), which
    they need not be in coordinates that have the boundary at infinity. Where
    ``∇_N = Σ λ_k·u_k·u_k^T``, N may grow along u_k·u_k^T without limit and shrink by at most
    ``u_k^T·(N − eps·E)·u_k``; masses and friction have their bounds. Along each of these
    directions, and of the centre of mass, the quadratic cost is followed to its minimum or to
    the end of the room, and what is gained is added up. So a multiplier counts with its
    complementarity, and constraints need not be called active or not.

    Parameters
    ----------
    problem : Problem
        With a consistency.
    theta : ndarray, shape (p,)
        Feasible standard parameters, masses positive.

    Returns
    -------
    float
    """
    feasible = problem.feasible
    links = 10 * feasible.n_links
    G, rhs = problem.design
    gradient = 2.0 * (G @ theta - rhs) @ G
    mass, com, N = physical_parameters(feasible.bodies(theta))
    # An entry off the diagonal stands for two.
    slopes = inertia_tensor(gradient[:links].reshape(-1, 10)) * (0.5 + 0.5 * np.eye(3))
    full = problem.consistency == "pseudo_inertia"
    if full:
        N, slopes = second_moment_from_inertia(N), complement(slopes)
    values, vectors = np.linalg.eigh(slopes)
    total = 0.0
    for i, own in enumerate(range(0, links, 10)):
        part = G[:, own : own + 10]
        outer = np.einsum("ik,jk->kij", vectors[i], vectors[i])
        spread = N[i] - feasible.constraints.margin * np.eye(3)
        room = np.maximum(np.einsum("kij,ij->k", outer, spread), 0.0)
        entries = tensor_entries(complement(outer) if full else outer)
        curvature = 2.0 * ((part[:, 4:] @ entries.T) ** 2).sum(axis=0)
        total += _gain(values[i], curvature, room, np.full(3, np.inf))
        # Derivatives in m and r.
        steps = np.zeros((4, 10))
        steps[0] = theta_from_physical(1.0, com[i], np.zeros((3, 3)))
        for k in range(3):
            e = np.eye(3)[k]
            steps[1 + k, 1 + k] = mass[i]
            change = complement(np.outer(e, com[i]) + np.outer(com[i], e))
            steps[1 + k, 4:] = mass[i] * tensor_entries(change)
        below = np.array([mass[i] - feasible.lower[own], np.inf, np.inf, np.inf])
        above = np.array([feasible.upper[own] - mass[i], np.inf, np.inf, np.inf])
        curvature = 2.0 * ((part @ steps.T) ** 2).sum(axis=0)
        total += _gain(steps @ gradient[own : own + 10], curvature, below, above)
    below, above = theta - feasible.lower, feasible.upper - theta
    curvature = 2.0 * (G[:, links:] ** 2).sum(axis=0)
    total += _gain(gradient[links:], curvature, below[links:], above[links:])
    return total / max(problem.cost_of(theta), cost_scale(problem))


def _gain(slope: Array, curvature: Array, below: Array, above: Array) -> float:
    """Return the decrease of one-dimensional quadratics within the room below and above."""
    room = np.maximum(np.where(slope > 0.0, below, above), 0.0)
    # Directions that the effort does not show have neither slope nor curvature.
    newton = np.abs(slope) / np.where(curvature > 0.0, curvature, np.inf)
    step = np.minimum(newton, room)
    return float(np.sum(np.abs(slope) * step - 0.5 * curvature * step**2))
