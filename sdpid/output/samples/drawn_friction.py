"""Joint friction of many draws as attributes of joints, at the cost of one.

Where every term has an attribute, these are the drawn numbers. Else each draw's attributes are
fitted as those of a single robot are (`sdpid.output.robots.joint_friction`), with one difference:
what the estimate leaves unexplained of the recorded efforts stands for what a draw does, so that
the rows are read once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.compression.rows import motion_of
from sdpid.estimation.problem import Problem
from sdpid.output.robots.joint_friction import Rows, nonnegative_fit
from sdpid.output.robots.places import Kind, Places

# Rows at a time: columns of all terms take some 2 kB each.
_CHUNK = 20_000


def drawn_attributes(
    problem: Problem, center: Array, thetas: Array, attributes: Mapping[Kind, str], what: str
) -> dict[Kind, Array]:
    """Return the attributes' values (draws, n), by term.

    Parameters
    ----------
    problem : Problem
        Terms and samples.
    center : ndarray, shape (p,)
        The estimate that the draws are of.
    thetas : ndarray, shape (draws, p)
        The draws.
    attributes : mapping
        The attribute for the parameter of a term.
    what : str
        Name of the written robots in messages.

    Raises
    ------
    ExportError
        When a drawn number that is to be written is negative.
    """
    places = Places(problem, center, attributes)
    each = [Places(problem, theta, attributes) for theta in thetas]
    if problem.rows is None or not (places.curves or places.lost):
        for drawn in each:
            drawn.require_nonnegative(what)
    nominal = [drawn.at_nominal_speeds() for drawn in each]
    values = {kind: np.stack([found[kind] for found in nominal]) for kind in places.kinds}
    if problem.rows is not None and values and (places.curves or places.lost):
        rows = Rows(problem, center, places)
        friction = thetas[:, 10 * problem.robot.n_links :]
        change = friction - center[10 * problem.robot.n_links :]
        for j, (factor, target, slope) in _reduced(rows, places).items():
            fits = [nonnegative_fit(factor, target + slope @ each) for each in change]
            for kind, column in zip(places.kinds, np.transpose(fits), strict=True):
                values[kind][:, j] = column
    return values


def _reduced(rows: Rows, places: Places) -> dict[int, tuple[Array, Array, Array]]:
    """Return each joint's equations by few rows: factor, target, and its slope in friction.

    With the factorization Q·R of a joint's columns, ``R·x = Q^T·target`` has the same solutions.
    """
    problem = rows.problem
    systems = {int(j): rows.system(int(j)) for j in np.flatnonzero(rows.shown)}
    factors = {j: np.linalg.qr(system.columns) for j, system in systems.items()}
    slopes = {
        j: np.zeros((R.shape[0], len(problem.friction.parameters))) for j, (_, R) in factors.items()
    }
    samples, first = problem.samples, problem.friction.first
    past = dict.fromkeys(systems, 0)
    for start in range(0, samples.n_samples, _CHUNK):
        part = slice(start, min(start + _CHUNK, samples.n_samples))
        columns = problem.friction.columns_in(motion_of(problem.robot, samples, part, first=first))
        for j, (Q, _) in factors.items():
            own = columns[rows.used[part, j], first + j]
            here = slice(past[j], past[j] + len(own))
            slopes[j] += (Q[here] * systems[j].weight[here, None]).T @ own
            past[j] = here.stop
    kept = {j: _kept(problem, places, system.taken_out) for j, system in systems.items()}
    return {j: (R, Q.T @ systems[j].target, slopes[j] * kept[j]) for j, (Q, R) in factors.items()}


def _kept(problem: Problem, places: Places, taken_out: Sequence[float]) -> Array:
    """Return for each friction parameter the share of its effort that attributes stand in for."""
    shares = dict(zip((part.names for part in places.lost), taken_out, strict=True))
    joints = problem.friction.joint_names
    names = [tuple(p.name for p in term.parameters(joints)) for term in problem.friction.terms]
    return np.concatenate([np.full(len(own), 1.0 - shares.get(own, 0.0)) for own in names])
