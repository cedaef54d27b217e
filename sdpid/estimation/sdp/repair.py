"""Parameters that a solver leaves outside of constraints, by rounding."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.constraints.feasible_set import FeasibleSet
from sdpid.estimation.problem import Problem
from sdpid.robot.consistent import raise_second_moments

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
