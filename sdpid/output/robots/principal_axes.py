"""Principal moments of a tensor and their axes as a quaternion, each double the nearest one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from sdpid.robot.description.inertials import tensor
from sdpid.robot.description.mjcf import quaternion_of

Matrix = list[list[Fraction]]

# Off-diagonal entries end below this share of the trace, far below what a double resolves.
_SMALL = Fraction(1, 2**120)

# Fixed-point digits of quaternions: those of _SMALL, and some to spare.
_UNIT = 1 << 240

# Two sweeps do from where LAPACK ends.
_SWEEPS = 10

# Pairs of axes, and the axis about which their plane turns.
_PAIRS = ((0, 1, 2), (1, 2, 0), (2, 0, 1))


def principal_axes(moments: Sequence[Fraction]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the quaternion (w, x, y, z) of the axes, and the moments about them.

    LAPACK's axes, then Jacobi's rotations by angles in double precision, carried out exactly.

    Parameters
    ----------
    moments : sequence of Fraction
        Ixx, Ixy, Iyy, Ixz, Iyz, Izz.
    """
    given = tensor(moments)
    _, axes = np.linalg.eigh(np.array(given, dtype=np.float64))
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    quaternion = [Fraction(x) for x in quaternion_of(axes).tolist()]
    turned = along(given, rotation(quaternion))
    small = _SMALL * sum(abs(given[i][i]) for i in range(3))
    for i, j, k in _PAIRS * _SWEEPS:
        if abs(turned[i][j]) <= small:
            continue
        slope = float((turned[j][j] - turned[i][i]) / (2 * turned[i][j]))
        tangent = math.copysign(1.0, slope) / (abs(slope) + math.hypot(1.0, slope))
        half = Fraction(tangent / (1.0 + math.hypot(1.0, tangent)))
        quaternion = [Fraction(round(x * _UNIT), _UNIT) for x in _turned(quaternion, k, -half)]
        turned = along(given, rotation(quaternion))
    size = Fraction(math.isqrt(math.floor(sum(x * x for x in quaternion) * _UNIT**2)), _UNIT)
    return (
        tuple(float(x / size) for x in quaternion),
        tuple(float(turned[i][i]) for i in range(3)),
    )


def _turned(q: Sequence[Fraction], axis: int, half: Fraction) -> list[Fraction]:
    """Return the product of a quaternion and (1, half·e_axis)."""
    w, v = q[0], q[1:]
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out = [w - v[axis] * half, Fraction(0), Fraction(0), Fraction(0)]
    out[1 + axis] = v[axis] + w * half
    # v × e_axis is v_j along i and −v_i along j.
    out[1 + i] = v[i] + v[j] * half
    out[1 + j] = v[j] - v[i] * half
    return out


def rotation(quaternion: Sequence[Fraction]) -> Matrix:
    """Return the rotation of a quaternion (w, x, y, z) of any length but zero, exactly."""
    w, x, y, z = quaternion
    square = w * w + x * x + y * y + z * z
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return [[entry / square for entry in row] for row in rows]


def along(given: Matrix, R: Matrix) -> Matrix:
    """Return a tensor along the columns of a rotation, exactly."""
    return [
        [
            sum((R[k][i] * given[k][m] * R[m][j] for k in range(3) for m in range(3)), Fraction(0))
            for j in range(3)
        ]
        for i in range(3)
    ]
