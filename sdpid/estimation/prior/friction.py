"""How large friction and drive terms are believed to be, and may be: by the size of the efforts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.robot.friction.terms import Offset

# Parameters that are believed to be alike, such as Coulomb friction in both directions, differ by
# less than they are believed to be large, by this factor.
_ALIKE = 3.0

# A joint that is all but silent has this share of the loudest one's effort.
_SILENT = 1e-3

# An offset also takes up what a counterweight or a spring carries, which is of the size of the
# weight, not of what is left of it to measure. Where there is neither, described efforts are up to
# 1.42 times the measured: half of them leaves those joints as they are.
_DESCRIBED = 0.5

# Described efforts are computed at this many samples of each recording.
_SAMPLES = 400

# Friction that makes this many times a joint's effort would need something else to cancel it.
_MOST = 10.0

# Columns smaller than this (of viscous friction the rms velocity, rad/s or m/s) are of joints at
# rest: noise, which says nothing about a size.
_SLOW = 1e-3


def friction_rows(rows: RowSource) -> Array:
    """Return the rows (f, f) whose squared norm is twice the nats of the friction parameters."""
    columns, efforts, unshown = _columns_and_efforts(rows)
    # Size of a term's effect relative to the effort of each joint that it acts on.
    shares = (columns / efforts).max(axis=0)
    believed = [1.0 / p.deviation if p.deviation else 0.0 for p in rows.friction.parameters]
    weights = np.where(np.array(believed) > 0.0, believed, shares)
    found = np.diag(np.where(weights > 0.0, weights, unshown))
    for i, j in rows.friction.alike:
        # A side that never moved has no weight of its own.
        weight = max(float(weights[i]), float(weights[j])) or float(unshown[i])
        found[np.ix_([i, j], [i, j])] = weight * np.array([[0.5, 0.5], [_ALIKE, -_ALIKE]])
    return found


def with_friction_max(constraints: Constraints, rows: RowSource) -> Constraints:
    """Return constraints whose bound on friction follows the efforts, unless it was given."""
    if constraints.friction_max is not None:
        return constraints
    columns, efforts, _ = _columns_and_efforts(rows)
    sizes = np.divide(efforts, columns, out=np.zeros_like(columns), where=columns > _SLOW)
    power = 10.0 ** np.ceil(np.log10(max(_MOST * float(sizes.max(initial=0.0)), 1e-300)))
    return replace(constraints, friction_max=max(float(power), constraints.theta_max))


def _columns_and_efforts(rows: RowSource) -> tuple[Array, Array, Array]:
    """Return rms columns of the terms (n, f), the efforts (n, f) they are believed to make.

    And what weighs a term (f,) whose column is zero throughout: as if that were one. Of a joint
    without rows all samples count, and the described efforts; it is not quieter than the others.
    """
    friction, unused = rows.friction, ~rows.samples.used.any(axis=0)
    sums = zip(*rows.map(_squares, unused), strict=True)
    count, measured, described, terms = (np.sum(each, axis=0) for each in sums)
    count = np.maximum(count, 1)
    effort, described = np.sqrt(measured / count), np.sqrt(described / rows.n_samples)
    effort = np.maximum(effort, _SILENT * float(effort[~unused].max(initial=0.0)) or 1.0)
    quietest = float(effort[~unused].min(initial=np.inf))
    effort[unused] = np.maximum(described[unused], min(quietest, 1e300))
    names, joints = friction.joint_names, [friction.first + p.joint for p in friction.parameters]
    offset = [isinstance(term, Offset) for term in friction.terms for _ in term.parameters(names)]
    own = np.where(offset, np.maximum(effort, _DESCRIBED * described)[:, None], effort[:, None])
    return np.sqrt(terms / count[:, None]), own, 1.0 / effort[joints]


def _squares(rows: RowSource, unused: Mask) -> tuple[Array, Array, Array, Array]:
    """Return rows used (n,), and sums of squares of efforts, described efforts and terms (n, f).

    Of joints that are unused everywhere all rows count.
    """
    s, robot, n = rows.samples, rows.robot, rows.robot.n
    count, efforts = np.zeros(n), np.zeros(n)
    terms = np.zeros((n, len(rows.friction.parameters)))
    for part in rows.parts():
        columns = rows.friction.columns_in(rows.motion(part))
        mask = rows.mask(part) | unused
        count += mask.sum(axis=0)
        efforts += (np.where(mask, s.effort[part], 0.0) ** 2).sum(axis=0)
        terms += (np.where(mask[:, :, None], columns, 0.0) ** 2).sum(axis=0)
    some = slice(None, None, max(s.n_samples // _SAMPLES, 1))
    states = (each[some] for each in (s.position, s.velocity, s.acceleration))
    described = np.mean(robot.described_efforts(*states) ** 2, axis=0) * s.n_samples
    return count, efforts, described, terms
