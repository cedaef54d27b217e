"""Rotations by unit quaternions (x, y, z, w): their rate in body axes, vectors turned by them."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array

# Below this sine of half an angle its logarithm is taken from the series.
_SMALL = 1e-6


def unit(quaternions: Array) -> Array:
    """Return quaternions (M, 4) scaled to length one."""
    return np.asarray(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True))


def into_body(quaternions: Array, vectors: Array) -> Array:
    """Return vectors (M, 3) or (3,) in body axes, given in world axes."""
    axis, w = -quaternions[:, :3], quaternions[:, 3:]
    twice = 2.0 * np.cross(axis, vectors)
    return np.asarray(vectors + w * twice + np.cross(axis, twice))


def body_rate(quaternions: Array, weights: Array, step: float) -> Array:
    """Return the angular velocity (M, 3) in body axes, rad/s.

    A central difference whose terms are the logarithms of the rotations between the two samples of
    each pair, so that no component of a quaternion is differentiated. The ends repeat the outermost
    value.

    Parameters
    ----------
    quaternions : (M, 4) ndarray
        Orientations, body to world.
    weights : (2 m + 1,) ndarray
        Of a first derivative at unit step, odd.
    step : float
        Distance of two samples, s.
    """
    margin = weights.size // 2
    inner = len(quaternions) - 2 * margin
    rate = np.zeros((inner, 3))
    for lag in range(1, margin + 1):
        before = quaternions[margin - lag : margin - lag + inner]
        after = quaternions[margin + lag : margin + lag + inner]
        rate += weights[margin + lag] * _logarithm(_between(before, after))
    return np.pad(rate / step, ((margin, margin), (0, 0)), mode="edge")


def _between(a: Array, b: Array) -> Array:
    """Return the rotations from `a` to `b`, in the axes of `a`: conj(a)·b."""
    vector = a[:, 3:] * b[:, :3] - b[:, 3:] * a[:, :3] - np.cross(a[:, :3], b[:, :3])
    scalar = np.einsum("ki,ki->k", a, b)
    return np.concatenate([vector, scalar[:, None]], axis=1)


def _logarithm(q: Array) -> Array:
    """Return rotation vectors (M, 3) of quaternions, of at most half a turn."""
    q = np.where(q[:, 3:] < 0.0, -q, q)
    sine = np.linalg.norm(q[:, :3], axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[:, 3:])
    scale = np.where(sine > _SMALL, angle / np.maximum(sine, _SMALL), 2.0)
    return np.asarray(scale * q[:, :3])
