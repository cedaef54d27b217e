"""Positions at which a motion may begin: within the limits, touching nothing, easily held."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.design.task import Task

# Random positions are drawn from this share of each joint's range, about its middle, and as many
# are looked at for a home.
_SHARE, _DRAWN = 0.6, 200
# A home keeps this more than the clearance, m, and uses this share of the torque limits at most:
# a motion needs room about it.
_ROOM, _TORQUE = 0.03, 0.8


def homes(task: Task, rng: np.random.Generator) -> Iterator[Array]:
    """Yield positions (n,), one a start: where the motion is to begin, or the rest position first.

    Where nothing else is free, the rest position is yielded again.
    """
    rest = task.limits.rest if task.collision is None else task.collision.rest
    if task.start is not None:
        while True:
            yield task.start
    yield rest
    while True:
        middle = 0.5 * (task.limits.lower + task.limits.upper)
        half = 0.5 * _SHARE * (task.limits.upper - task.limits.lower)
        drawn = middle + half * rng.uniform(-1.0, 1.0, (_DRAWN, task.robot.n))
        good = drawn[_free(task, drawn)]
        yield good[0] if len(good) else rest


def _free(task: Task, q: Array) -> Array:
    """Return which positions (K, n) are free and easily held."""
    still = np.zeros_like(q)
    allowed = _TORQUE * task.torque.allowed(task.limits.torque)
    good = np.all(np.abs(task.torque.torque(q, still, still)) <= allowed, axis=1)
    if task.collision is not None and task.collision.pairs:
        distances = task.collision.distances(q[good])
        wanted = task.collision.clearances(task.clearance, _ROOM)
        good[good] = np.all(distances >= wanted, axis=1)
    return np.asarray(good)
