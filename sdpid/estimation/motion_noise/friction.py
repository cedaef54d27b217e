"""By how much a law of friction that is not the robot's moves the unconstrained fit.

The data choose the speeds at which friction bends, not its law. What the robot's law has and the
model lacks, such as a Stribeck peak, repeats with the motion: it is no noise, and no longer log
averages it out. A model with further curves of the same kind, slower and faster ones, is fitted,
too: it knows less, and bends as the data ask. The two fits differ by what the law does, and by
noise, which is taken off as for landings (see `sdpid.estimation.motion_noise.landings`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.triangle import Triangle
from sdpid.estimation.compression.whitening import apply, weights_of
from sdpid.estimation.information import Excitation
from sdpid.estimation.motion_noise.landings import beyond
from sdpid.estimation.problem import Problem
from sdpid.robot.friction.term import JointwiseTerm
from sdpid.robot.friction.terms import RotorInertia

# Speeds of the further curves, in those that the data chose: they moved the total mass of a trot of
# a simulated A1 to where the true law has it, a third and three times alone half as far, and
# further ones, to an eighth or 16 times, no farther.
_SPEEDS = (0.25, 0.5, 2.0, 4.0)

# A parameter of which more than this share lies where no row is has an infinite variance.
_LOST = 1e-7


def friction_bias(problem: Problem, rows: RowSource) -> Array | None:
    """Return by how much the law of friction moves the fit (b,), beyond noise.

    Coefficients of friction, which mean another curve in another law, are left as they are. None
    where the data chose no speeds.

    Parameters
    ----------
    problem : Problem
        The problem.
    rows : RowSource
        Its rows.
    """
    chosen = {each.term for each in problem.origin.profiled}
    names = rows.friction.joint_names
    curves = [
        replace(term, **{f: tuple(share * term.speed(f, len(names))) for f in term.speed_fields})
        for term in rows.friction.terms
        if isinstance(term, JointwiseTerm) and type(term).__name__ in chosen
        for share in _SPEEDS
    ]
    if not curves:
        return None
    n, joints, first = rows.robot.n, len(names), rows.friction.first
    b = rows.base.count
    triangle = Triangle(b + joints * len(curves) + 1)
    for part in rows.parts():
        block, motion = rows.rows(part), rows.motion(part)
        more = np.zeros((len(block), n, joints * len(curves)))
        for i, curve in enumerate(curves):
            at = i * joints + np.arange(joints)
            more[:, np.arange(first, n), at] = curve.shape_in(motion)
        stacked = np.concatenate([block[:, :, :-1], more, block[:, :, -1:]], axis=2)
        weighted = apply(*weights_of(rows, part, problem.sigma), stacked)
        triangle.add(weighted.reshape(-1, triangle.columns))
    R = triangle.R
    plain, own = _fit(R[:, :b], R[:, -1])
    rich, others = _fit(R[:, :-1], R[:, -1])
    inertia = [np.ones(10 * rows.robot.n_links, dtype=bool)]
    for term, place in rows.friction.placed:
        inertia.append(np.full(place.stop - place.start, isinstance(term, RotorInertia)))
    compared = np.concatenate(inertia)[rows.base.kept]
    moved = np.where(compared, plain - rich[:b], 0.0)
    return beyond(moved, np.where(compared, own, 0.0), others[:b])


def _fit(A: Array, rhs: Array) -> tuple[Array, Array]:
    """Return the least-squares solution, and its variances where those of the rows are one."""
    found = Excitation.of(A, ())
    root, lost = found.root, 1.0 - np.sum(found.root * found.inverse.T, axis=1) > _LOST
    return root @ ((A @ root).T @ rhs), np.where(lost, np.inf, np.sum(root**2, axis=1))
