"""Choose, among equally good parameters, those nearest to the robot's description.

Directions of theta that the effort does not show are free: all feasible theta with the same base
parameters cost the same. The rule: the one nearest to the robot's own description, and where a
link has none, to a ball of the robot's size, in the distance ``‖L^(-1)·P·L^(-T) − E‖`` between
pseudo-inertias with P0 = L·L^T the reference (the constant-pullback metric [lee2020]_).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.conic.solve import ConicProgram, ConicSolution, solve_conic
from sdpid.estimation.coordinates import Coordinates, Limits
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.estimation.sdp.program import SdpProgram

# The face often has no interior: matrices may be below zero by a slack, in the links' own scale,
# which the caller repairs. First in units of the reference's links, then of the point's own.
_SLACK = 1e-10
_IN_OWN_SCALE = (False, True)

# Where that does not succeed the distance is weighed against the cost instead, in units in which
# the cost is one: the stronger the nearer, the weaker the cheaper.
_WEIGHTS = (1e-8, 1e-9, 1e-10, 1e-11, 1e-12)
_REGULARIZATION = 1e-10

# Null directions of the scaled base matrix: its singular values are of order one or rounding.
_NULL = 1e-9


def nearer_on_face(problem: Problem, theta: Array) -> Iterator[tuple[Array | None, float]]:
    """Yield parameters with theta's base parameters that are nearer to the reference.

    Parameters
    ----------
    problem : Problem
        The problem, with a consistency.
    theta : ndarray, shape (p,)
        Feasible parameters.

    Yields
    ------
    point : ndarray, shape (p,), or None
        Feasible but for rounding, where an attempt found it: the nearest first, then such as are
        nearer as far as they cost little.
    seconds : float
        In the solver, of this attempt.
    """
    feasible = problem.feasible
    links = 10 * feasible.n_links
    reference = Scaling.of(problem)
    basis = reference.basis()
    # The base parameters stay, and so do the equations among the constraints.
    kept = [problem.base.matrix @ basis, _unit_rows(feasible.rows[feasible.equations] @ basis)]
    _, singular, rows = np.linalg.svd(np.vstack(kept))
    rank = int(np.count_nonzero(singular > _NULL * singular[0]))
    null = basis @ rows[rank:].T
    if null.shape[1] == 0:
        yield theta, 0.0
        return
    goal = np.concatenate([reference.bodies.ravel(), theta[links:]])
    there = np.column_stack([null[:links], (theta - goal)[:links]])
    distance = np.linalg.solve(basis[:links, :links], there)
    for own_scale in _IN_OWN_SCALE:
        scaling = reference.around(theta) if own_scale else reference
        step = _step(problem, theta, null, distance, scaling)
        left = np.inf if step.x is None else np.linalg.norm(distance @ np.append(step.x, 1.0))
        nearer = left <= np.linalg.norm(distance[:, -1])
        yield theta + null @ step.x if nearer else None, step.seconds
    scaling = replace(reference, cost=max(reference.cost, problem.cost_of(theta)))
    coordinates = Coordinates.of(problem, basis, goal)
    if coordinates is None:
        return
    for weight in _WEIGHTS:
        program = SdpProgram.build(
            problem, scaling, coordinates, feasible.bounded, proximal_weight=weight
        )
        found = solve_conic(program.conic, regularization=_REGULARIZATION)
        yield None if found.x is None else program.theta(found), found.seconds


def distance_to_reference(problem: Problem, theta: Array) -> float:
    """Return the distance of parameters from the reference."""
    reference = Scaling.of(problem)
    links = reference.bodies.size
    basis = reference.basis()[:links, :links]
    return float(np.linalg.norm(np.linalg.solve(basis, theta[:links] - reference.bodies.ravel())))


def _unit_rows(rows: Array) -> Array:
    """Return rows of unit length; rows of zeros stay."""
    sizes = np.linalg.norm(rows, axis=1, keepdims=True)
    return np.asarray(rows / np.where(sizes > 0.0, sizes, 1.0))


def _step(
    problem: Problem,
    theta: Array,
    null: Array,
    distance: Array,
    scaling: Scaling,
) -> ConicSolution:
    """Return the step along the null directions that brings theta nearest."""
    feasible, coordinates = problem.feasible, Coordinates(theta, null)
    limits = Limits.of(problem, scaling, coordinates, feasible.bounded)
    blocks = coordinates.inequalities(feasible, scaling, slack=_SLACK)
    return solve_conic(
        ConicProgram(
            M=distance[:, :-1],
            m=distance[:, -1],
            C=limits.C,
            # Where theta is outside by rounding it need not come back.
            lower=np.minimum(limits.lower, 0.0),
            upper=np.maximum(limits.upper, 0.0),
            blocks=tuple(block for block in blocks if len(block.index)),
        )
    )
