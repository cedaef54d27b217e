"""Columns of all parameters of links and friction, which leave nothing to a description."""

from __future__ import annotations

from functools import partial

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.model.model import RobotModel

# Widths of smooth signs (rad/s) that together imitate any dry friction.
_WIDTHS = (0.01, 0.02, 0.05, 0.2, 1.0)
# Directions of the regressor with less than this share of the largest singular value are noise.
_RANK = 1e-4


def regressor(robot: RobotModel, samples: Samples, rows: Indices) -> Array:
    """Return the columns of the links at some samples, (K, n, 10·links)."""
    return robot.regressor(
        samples.position[rows], samples.velocity[rows], samples.acceleration[rows]
    )


def free_columns(robot: RobotModel, samples: Samples, rows: Indices) -> Array:
    """Return columns of links, and of friction, rotors and offsets of every joint, (K, n, p)."""
    first, n = robot.n_base, robot.n
    wide = None if samples.wide is None else samples.wide[0]
    speed, rate = samples.velocity[rows], samples.acceleration[rows]
    signals = [speed, rate, np.ones_like(speed)]
    for width in _WIDTHS:
        if wide is None:
            signals.append(np.tanh(speed / width))
        else:
            signals.append(wide.filtered(partial(_smooth_sign, width))[rows])
    joints = np.arange(first, n)
    friction = np.zeros((len(rows), n, len(signals), n - first))
    for i, signal in enumerate(signals):
        friction[:, joints, i, joints - first] = signal[:, first:]
    return np.concatenate(
        [regressor(robot, samples, rows), friction.reshape(len(rows), n, -1)], axis=2
    )


def _smooth_sign(width: float, speed: Array, _rate: Array) -> Array:
    return np.asarray(np.tanh(speed / width))


def orthonormal(columns: Array, rank: float = _RANK) -> tuple[Array, Array]:
    """Return an orthonormal basis of columns, and the way from it to their weights.

    Directions with less than a share `rank` of the largest singular value are noise.
    """
    size = np.linalg.norm(columns, axis=0)
    inverse = np.where(size > 0.0, 1.0 / np.where(size > 0.0, size, 1.0), 0.0)
    scaled = columns * inverse
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    kept = values > rank**2 * values[-1]
    back = vectors[:, kept] / np.sqrt(values[kept])
    return np.asarray(scaled @ back), np.asarray(inverse[:, None] * back)
