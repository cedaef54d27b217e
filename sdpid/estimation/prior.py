"""What is believed before the data: the description's inertias, and friction of a likely size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._arrays import Array, frozen
from sdpid.errors import DataError
from sdpid.estimation.rows import RowSource
from sdpid.robot.inertia import (
    from_pseudo_inertia,
    margin,
    pseudo_inertia,
    symmetric_basis,
)

# Second moments about the centre of mass of a believed body are at least those of a ball whose
# points are 2 cm from its centre (rms, per axis): descriptions have links that are no bodies, and
# some that are points.
_RADIUS = 0.02

# Friction and offset terms are believed to move the joint's effort by this share of its rms.
_FRICTION_SHARE = 1.0 / 3.0


@dataclass(frozen=True, kw_only=True)
class Prior:
    """A belief about the parameters, as a quadratic.

    Each link is believed to be near a body P0 = L·L^T (pseudo-inertia), with the penalty
    ``strength·½·‖L^(-1)·P·L^(-T) − E‖²`` in nats: the second-order expansion of the log-det
    divergence between pseudo-inertias, the same in every frame [lee2020]_. Friction terms are
    believed to be zero with a standard deviation that moves the effort by a third of its rms.
    Nats are units of a log-likelihood; they mean what they say when the weighting counts
    correlated samples as the few independent ones they are (``weighting="residual"``).

    Attributes
    ----------
    strength : float
        Factor on the links' penalty.
    friction : bool
        Whether friction terms are believed to be small too.
    bodies : ndarray, shape (links, 10), optional
        The bodies; by default those of the robot's description. A row of zeros is no belief.
    """

    strength: float = 1.0
    friction: bool = True
    bodies: Array | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.strength) and self.strength > 0.0):
            raise DataError(f"Prior: strength is {self.strength}; give a positive number of nats.")


@dataclass(frozen=True, eq=False)
class PriorRows:
    """A prior as rows to be added to the cost: ``‖matrix @ theta − rhs‖²``.

    Attributes
    ----------
    matrix : ndarray, shape (k, p)
    rhs : ndarray, shape (k,)
    notes : tuple of str
        What was repaired or left out.
    """

    matrix: Array
    rhs: Array
    notes: tuple[str, ...] = ()


def repaired(bodies: Array) -> tuple[Array, tuple[int, ...]]:
    """Return bodies with their second moments raised to the least, and which were not physical.

    Links without a positive mass are returned as they are.
    """
    out = bodies.copy()
    wrong = []
    for i, body in enumerate(bodies):
        if not body[0] > 0.0:
            continue
        if not margin(body, "pseudo_inertia") > 0.0:
            wrong.append(i)
        P = pseudo_inertia(body)
        com = P[:3, 3] / body[0]
        values, vectors = np.linalg.eigh(P[:3, :3] - body[0] * np.outer(com, com))
        values = np.maximum(values, body[0] * _RADIUS**2)
        P[:3, :3] = vectors @ np.diag(values) @ vectors.T + body[0] * np.outer(com, com)
        out[i] = from_pseudo_inertia(P)
    return out, tuple(wrong)


def prior_rows(prior: Prior, rows: RowSource) -> PriorRows:
    """Turn a prior into rows for a problem's cost.

    Parameters
    ----------
    prior : Prior
        The belief.
    rows : RowSource
        The robot, its friction terms and the samples, whose sizes scale the friction's belief.

    Raises
    ------
    DataError
        When no link has a body to believe in.
    """
    robot = rows.robot
    given = robot.prior if prior.bodies is None else np.asarray(prior.bodies, dtype=np.float64)
    if given.shape != (robot.n_links, 10):
        raise DataError(f"Prior: bodies have shape {given.shape}, expected {(robot.n_links, 10)}.")
    bodies, wrong = repaired(given)
    known = np.flatnonzero(given[:, 0] > 0.0)
    if known.size == 0:
        raise DataError(
            f"Prior: the description of '{robot.name}' gives no link a mass; give bodies, or no "
            "prior."
        )
    notes = []
    if wrong:
        names = ", ".join(robot.link_names[i] for i in wrong)
        notes.append(f"prior: {names} could not exist as described and were repaired first")
    unknown = [robot.link_names[i] for i in range(robot.n_links) if i not in known]
    if unknown:
        notes.append(f"prior: nothing is believed of {', '.join(unknown)}, which have no mass")
    links = 10 * robot.n_links
    total = links + len(rows.friction.parameters)
    blocks, targets = [], []
    symmetric = symmetric_basis(4)
    identity = np.trace(symmetric, axis1=1, axis2=2)
    for i in known:
        inverse = np.linalg.inv(np.linalg.cholesky(pseudo_inertia(bodies[i])))
        units = inverse @ pseudo_inertia(np.eye(10)) @ inverse.T
        block = np.zeros((len(symmetric), total))
        block[:, 10 * i : 10 * i + 10] = np.einsum("aij,kij->ak", symmetric, units)
        blocks.append(np.sqrt(prior.strength) * block)
        targets.append(np.sqrt(prior.strength) * identity)
    if prior.friction and len(rows.friction.parameters):
        weights = _friction_weights(rows)
        block = np.zeros((len(weights), total))
        block[:, links:] = np.diag(weights)
        blocks.append(block)
        targets.append(np.zeros(len(weights)))
    return PriorRows(frozen(np.vstack(blocks)), frozen(np.concatenate(targets)), tuple(notes))


def _friction_weights(rows: RowSource) -> Array:
    """Return 1/standard deviation of every friction term."""
    s = rows.samples
    columns = rows.friction.columns(s.velocity, s.acceleration)
    mask = np.ones(s.effort.shape, dtype=bool) if s.mask is None else s.mask
    count = np.maximum(mask.sum(axis=0), 1)
    effort = np.sqrt((np.where(mask, s.effort, 0.0) ** 2).sum(axis=0) / count)
    # A joint that is all but silent gets a thousandth of the loudest one's effort.
    effort = np.maximum(effort, 1e-3 * float(effort.max()) or 1.0)
    # Size of a term's effect relative to the effort of each joint that it acts on.
    square = (np.where(mask[:, :, None], columns, 0.0) ** 2).sum(axis=0) / count[:, None]
    share = np.sqrt((square / effort[:, None] ** 2).max(axis=0))
    return np.asarray(share / _FRICTION_SHARE)
