"""Tell whether recordings that are to be fitted together carry the same load."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.inspection.delays.kinematic import block_error
from sdpid.experiment.inspection.explain import described
from sdpid.experiment.inspection.kinds import KINDS, Finding, found, refuse
from sdpid.experiment.inspection.rows import Rows
from sdpid.experiment.inspection.subject import Subject
from sdpid.robot.model.model import RobotModel

KINDS.update(
    payload_differs=refuse(
        "it carries another load than recording 1: {mass:+.3g} kg (standard error {error:.2g} kg) "
        "on the last link, with a first moment of {moment:.2g} kg·m, takes {takes:.2g %} of the "
        "residual of both, limit {limit:g %}",
        "fit each load by itself, or identify the load with sdpid payload --without",
    ),
)

# Another load on the last link takes this share of the squared residuals of two recordings where
# there is one: 0.71 to 0.90 of 14 pairs of a UR10e with and without 2.8 kg, at most 0.09 of 21
# pairs of recordings without.
_TAKES, _TAKES_SURELY = 0.2, 0.4
# The arm's own parameters may differ from the description by this share of a link's mass (kg), its
# first moment at that many m, and its inertia at that many m².
_BELIEF = (0.5, *3 * (0.1,), *6 * (0.02,))
_LEAST_MASS = 0.1
# Passes in which the joints' residuals weigh their rows.
_PASSES = 3
# Mass and first moment of the load, of ten inertial parameters of the last link.
_LOAD = 4
_BLOCKS = 12


def other_loads(subjects: Sequence[Subject]) -> Iterator[tuple[int, Finding]]:
    """Yield recordings that carry another load than the first, by their place, with the finding."""
    first = subjects[0]
    for place, other in enumerate(subjects[1:], 1):
        if first.fixed is None or other.fixed is None or not described(first.fixed):
            continue
        if any(s.corrected is None or s.corrected.steps for s in (first, other)):
            continue
        assert first.low_passed is not None
        assert other.low_passed is not None
        other_load = load_difference(first.fixed, first.low_passed, other.low_passed)
        if other_load is None or other_load[0] < _TAKES:
            continue
        takes, load, error = other_load
        told = found(
            "payload_differs",
            None,
            "refuse" if takes > _TAKES_SURELY else "warning",
            mass=load[0],
            moment=float(np.linalg.norm(load[1:])),
            error=error,
            takes=takes,
            limit=_TAKES,
        )
        yield place, told


def load_difference(robot: RobotModel, one: Rows, other: Rows) -> tuple[float, Array, float] | None:
    """Return how well another load in one of two recordings explains both.

    Parameters of the arm and friction are common, offsets are each recording's own, and the load
    acts in the second.

    Returns
    -------
    tuple or None
        The share of the squared residuals that the load takes, its mass (kg) and first moment
        (kg·m) (4,), and the standard error of its mass. None where no joint can be compared.
    """
    usable = np.flatnonzero(one.usable & other.usable)
    if not usable.size:
        return None
    A, rhs = (np.concatenate(each) for each in zip(*_equations(robot, one, other), strict=True))
    A, rhs = A[:, usable], rhs[:, usable]
    bodies = np.maximum(robot.prior[:, :1], _LEAST_MASS) * np.array(_BELIEF)
    scale = np.ones(A.shape[2])
    scale[: bodies.size] = bodies.ravel()
    A = A * scale
    # A weak pull keeps what is not excited where the description has it; none on the load.
    pull = np.full(A.shape[2], 1e-3)
    pull[: bodies.size] = 1.0
    pull[-_LOAD:] = 1e-6
    weights = np.ones(usable.size)
    for _ in range(_PASSES):
        x, residual = _solved(A, rhs, weights, pull)
        # Neighboring rows are alike: a third of them counts.
        weights = 1.0 / np.maximum(3.0 * residual.std(axis=0), 1e-9)
    _, without = _solved(A[..., :-_LOAD], rhs, weights, pull[:-_LOAD])
    cost, cost_without = (float(((r * weights) ** 2).sum()) for r in (residual, without))
    if not cost_without > 0.0:
        return None
    return 1.0 - cost / cost_without, x[-_LOAD:], _error_of_mass(A, residual, weights, pull)


def _equations(robot: RobotModel, *recordings: Rows) -> Iterator[tuple[Array, Array]]:
    """Yield the matrix (K, n, unknowns) and the efforts beyond the description's, (K, n)."""
    n, count = robot.n, 10 * robot.n_links
    for place, rows in enumerate(recordings):
        Y = robot.regressor(rows.position, rows.velocity, rows.acceleration)
        speed = np.sqrt(np.abs(rows.velocity)) * rows.sign
        friction = (rows.sign, rows.velocity, speed, rows.acceleration)
        A = np.zeros((len(Y), n, count + n * (len(friction) + len(recordings)) + _LOAD))
        A[..., :count] = Y
        for k, column in enumerate(friction):
            A[:, range(n), count + k * n + np.arange(n)] = column
        A[:, range(n), count + (len(friction) + place) * n + np.arange(n)] = 1.0
        if place:
            A[..., -_LOAD:] = Y[..., count - 10 : count - 10 + _LOAD]
        yield A, rows.effort - Y @ robot.prior.ravel()


def _solved(A: Array, rhs: Array, weights: Array, pull: Array) -> tuple[Array, Array]:
    """Return the regularized least-squares solution and the residuals (K, joints)."""
    weighted = (A * weights[:, None]).reshape(-1, A.shape[2])
    target = (rhs * weights).ravel()
    stacked = np.vstack([weighted, np.diag(pull)])
    x = np.linalg.lstsq(stacked, np.concatenate([target, np.zeros(len(pull))]), rcond=None)[0]
    return x, rhs - A @ x


def _error_of_mass(A: Array, residual: Array, weights: Array, pull: Array) -> float:
    """Return the standard error of the load's mass, from blocks of rows."""
    weighted = A * weights[:, None]
    flat = weighted.reshape(-1, A.shape[2])
    direction = np.linalg.solve(flat.T @ flat + np.diag(pull**2), np.eye(A.shape[2])[-_LOAD])
    scores = np.einsum("kju,u,kj->k", weighted, direction, residual * weights)
    return block_error(scores, 1.0, 2 * _BLOCKS)
