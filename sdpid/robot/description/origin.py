"""Read and write frames and numbers of a URDF: ``<origin xyz="…" rpy="…"/>``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array

# No length, mass or inertia of a robot is larger; squares of these are far from overflow.
LARGEST = 1e12

# Rotations by multiples of a right angle are written as exact zeros and ones: sin and cos of
# a rounded pi/2 differ from them by less than this.
_SNAP = 1e-15


def axis_rotation(axis: int, angle: float) -> Array:
    """Return the transform (4, 4) that turns about x (0), y (1) or z (2)."""
    c, s = math.cos(angle), math.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    transform = np.eye(4)
    transform[i, i], transform[i, j], transform[j, i], transform[j, j] = c, -s, s, c
    transform[np.abs(transform) < _SNAP] = 0.0
    return transform


def rpy_matrix(rpy: Sequence[float] | Array) -> Array:
    """Return the rotation (3, 3) of fixed-axis roll, pitch and yaw, as URDF means them."""
    roll, pitch, yaw = (float(angle) for angle in rpy)
    return (axis_rotation(2, yaw) @ axis_rotation(1, pitch) @ axis_rotation(0, roll))[:3, :3]


def matrix_rpy(rotation: ArrayLike) -> tuple[float, float, float]:
    """Return roll, pitch and yaw of a rotation matrix; at gimbal lock roll is zero."""
    R = np.asarray(rotation, dtype=np.float64)
    horizontal = math.hypot(R[0, 0], R[1, 0])
    pitch = math.atan2(-R[2, 0], horizontal)
    # Below this the two remaining angles are one: only their sum or difference exists.
    if horizontal < 1e-12:
        return 0.0, pitch, math.atan2(-R[0, 1], R[1, 1])
    return math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])


def read_triple(element: Any, key: str, default: str = "0 0 0") -> Array:
    """Return the three numbers of an element's attribute.

    Raises
    ------
    ValueError
        When they are not three finite numbers of at most `LARGEST`.
    """
    text = default if element is None else element.get(key, default)
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.array([])
    if values.shape != (3,) or not (np.abs(values) <= LARGEST).all():
        raise ValueError(f"{key} is '{text}', expected 3 finite numbers of at most {LARGEST:g}")
    return values


def read_origin(owner: Any) -> Array:
    """Return the placement (4, 4) of an element's ``<origin>``, the identity without one.

    Raises
    ------
    ValueError
        When xyz or rpy are not three numbers.
    """
    origin = owner.find("origin")
    placement = np.eye(4)
    placement[:3, 3] = read_triple(origin, "xyz")
    placement[:3, :3] = rpy_matrix(read_triple(origin, "rpy"))
    return placement


def relative(frame: Array, other: Array) -> Array:
    """Return the placement (4, 4) of another frame in a frame, both placed in a third."""
    return np.asarray(np.linalg.solve(frame, other), dtype=np.float64)


def numbers(values: ArrayLike) -> str:
    """Return numbers as XML text, in the shortest form that reads back to the same float64."""
    # Adding zero turns -0.0 into 0.0.
    return " ".join(repr(float(value) + 0.0) for value in np.ravel(np.asarray(values)))
