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

from sdpid._common.arrays import Array, frozen
from sdpid.estimation.conic.solve import ConicProgram, solve_conic
from sdpid.estimation.constraints.feasible_set import FeasibleSet
from sdpid.estimation.coordinates import Coordinates, LinearLimits
from sdpid.estimation.duality.bound import PROVEN, cost_scale, relative_gap
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.estimation.sdp.program import SdpProgram
from sdpid.robot.consistent import raise_second_moments

# The face often has no interior: matrices may be below zero by a slack, in the links' own scale,
# which `repair` mends. First in units of the reference's links, then of the point's own.
_SLACK = 1e-10

# Where that does not succeed the distance is weighed against the cost instead, in units in which
# the cost is one: the stronger the nearer, the weaker the cheaper.
_WEIGHTS = (1e-8, 1e-9, 1e-10, 1e-11, 1e-12)
_REGULARIZATION = 1e-10

# Null directions of the scaled base matrix: its singular values are of order one or rounding.
_NULL = 1e-9

# Choosing among the optimal points may cost this share of the cost.
_FACE = 1e-7

# The nearest point is sought again from the last one as long as that is nearer by this share: far
# from the description the units of an attempt are not those of the nearest point (UR10 without a
# prior: 278 at first, then 244 and no less).
_GAINS = 0.01
_PASSES = 5

# What is taken to be inside: a solution on the boundary is moved in by this share of the link's
# own second moments, so that rounding cannot take it out again. It is some fifty roundings and no
# more: moments that the data do not show may be as large as theta_max, and what is added to them
# is added to those that the data do show.
_INSIDE = 1e-14

# Rows are moved inside by this share of their size: some thousand roundings of their sums.
_WITHIN = 1e-12


def repair(problem: Problem, theta: Array) -> Array:
    """Move parameters that are outside by rounding just inside every constraint.

    Bounds are clipped; rows are brought back by the parameters that they hold, each in proportion
    to its own size; a link short of its margin gets the missing moments about its center of mass.
    """
    feasible = problem.feasible
    theta = _within_rows(feasible, np.clip(theta, feasible.lower, feasible.upper))
    if feasible.consistency == "none":
        return theta
    bodies = feasible.bodies(theta)
    moments = np.maximum(bodies[:, 4] + bodies[:, 6] + bodies[:, 9], 1e-3)
    least = feasible.constraints.margin + _INSIDE * moments
    raised = raise_second_moments(bodies, least, consistency=feasible.consistency)
    return np.concatenate([raised.ravel(), theta[raised.size :]])


def _within_rows(feasible: FeasibleSet, theta: Array) -> Array:
    """Return parameters within the linear rows, as near as can be by each one's own size.

    Solvers count in units of the description's links, certificates by the size of the row itself,
    which of a link that became light is much smaller.
    """
    values = feasible.rows @ theta
    lower, upper = feasible.row_lower, feasible.row_upper
    outside = (values < lower) | (values > upper)
    if not np.any(outside & ~feasible.equations):
        return theta
    inside = _WITHIN * (np.abs(feasible.rows) @ np.abs(theta)) * ~feasible.equations
    missing = np.clip(values, lower + inside, np.maximum(upper - inside, lower + inside)) - values
    moved = outside | feasible.equations
    # What is at a bound stays there.
    sizes = np.abs(theta) * ((theta > feasible.lower) & (theta < feasible.upper))
    step = np.linalg.lstsq(feasible.rows[moved] * sizes, missing[moved], rcond=None)[0]
    return np.asarray(np.clip(theta + sizes * step, feasible.lower, feasible.upper))


def settled(estimate: Estimate, bound: float) -> Estimate:
    """Move along the directions that cost nothing, to the point nearest to the description.

    What is found is kept only where it costs no more than the solver's own accuracy, and where
    the bound proves it too.
    """
    problem = estimate.problem
    if problem.consistency == "none" or problem.prior is not None or estimate.theta is None:
        # Without matrix inequalities nothing says what is near; with a prior nothing is free.
        return estimate
    allowed = estimate.cost + _FACE * max(estimate.cost, cost_scale(problem))
    nearest, far, seconds = estimate, np.inf, estimate.solve_time
    message = f"{estimate.message}; any point of the optimal face"
    for _ in range(_PASSES):
        distance = np.inf
        for point, spent in nearer_on_face(problem, np.array(nearest.theta)):
            seconds += spent
            if point is None:
                continue
            theta = repair(problem, point)
            moved = replace(estimate, theta=frozen(theta), base=frozen(problem.base_of(theta)))
            proven = relative_gap(problem, moved.cost, bound) <= PROVEN
            if moved.feasible and moved.cost <= allowed and proven:
                distance = distance_to_reference(problem, theta)
                break
        if not np.isfinite(distance) or distance > (1.0 - _GAINS) * far:
            break
        nearest, far = moved, distance
        message = f"{estimate.message}; nearest to the description on the optimal face"
    return replace(nearest, message=message, solve_time=seconds)


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
    from scipy.linalg import null_space

    feasible = problem.feasible
    links = 10 * feasible.n_links
    reference = Scaling.of(problem)
    basis = reference.basis()
    # The base parameters stay, and so do the equations among the constraints.
    equations = feasible.rows[feasible.equations] @ basis
    sizes = np.linalg.norm(equations, axis=1, keepdims=True)
    equations /= np.where(sizes > 0.0, sizes, 1.0)
    null = basis @ null_space(np.vstack([problem.base.matrix @ basis, equations]), rcond=_NULL)
    if null.shape[1] == 0:
        yield theta, 0.0
        return
    goal = np.concatenate([reference.bodies.ravel(), theta[links:]])
    there = np.column_stack([null[:links], (theta - goal)[:links]])
    distance = np.linalg.solve(basis[:links, :links], there)
    along = Coordinates(theta, null)
    for scaling in (reference, reference.around(theta)):
        limits = LinearLimits(problem, scaling, along, feasible.bounded)
        blocks = along.inequalities(feasible, scaling, slack=_SLACK)
        program = ConicProgram(
            M=distance[:, :-1],
            m=distance[:, -1],
            C=limits.C,
            # Where theta is outside by rounding it need not come back.
            lower=np.minimum(limits.lower, 0.0),
            upper=np.maximum(limits.upper, 0.0),
            blocks=tuple(block for block in blocks if len(block.index)),
        )
        step = solve_conic(program)
        left = np.inf if step.x is None else np.linalg.norm(distance @ np.append(step.x, 1.0))
        nearer = left <= np.linalg.norm(distance[:, -1])
        yield theta + null @ step.x if nearer else None, step.seconds
    scaling = replace(reference, cost=max(reference.cost, problem.cost_of(theta)))
    coordinates = Coordinates.of(problem, basis, goal)
    if coordinates is None:
        return
    for weight in _WEIGHTS:
        beside = SdpProgram.build(
            problem, scaling, coordinates, feasible.bounded, proximal_weight=weight
        )
        found = solve_conic(beside.conic, regularization=_REGULARIZATION)
        yield None if found.x is None else coordinates.theta(found.x), found.seconds


def distance_to_reference(problem: Problem, theta: Array) -> float:
    """Return the distance of parameters from the reference."""
    reference = Scaling.of(problem)
    links = reference.bodies.size
    basis = reference.basis()[:links, :links]
    return float(np.linalg.norm(np.linalg.solve(basis, theta[:links] - reference.bodies.ravel())))
