"""Jacobians of contact points, compiled where Numba is installed.

Sample by sample, they are Pinocchio's but for rounding.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.robot.model.regressor_kernel import (
    FLOATING,
    PRISMATIC,
    REVOLUTE,
    Tree,
    compiled_loop,
)

# Bytes from which on Numba is loaded for them: searches ask again and again, and in all take eight
# times as long without it.
_SMALL = 1 << 20


def jacobians(
    tree: Tree, links: Indices, places: Array, offsets: Array, q: Array, worth: bool | None
) -> Array | None:
    """Return Jacobians (K, c, 6, n) of points, None without Numba or where there are few.

    Parameters
    ----------
    tree : Tree
        The robot.
    links : ndarray of int, shape (c,)
        The link of each point, -1 for the world.
    places, offsets : ndarray, shape (c, 3)
        Where it is in the link's frame, and what is added in the world's axes.
    q : ndarray, shape (K, nq)
        Pinocchio's configurations.
    worth : bool or None
        Whether to use the compiled loop; by default the size decides.
    """
    shape = (len(q), len(links), 6, tree.n)
    many = 8 * math.prod(shape) >= _SMALL if worth is None else worth
    fill = _jacobian_loop() if many else None
    if fill is None:
        return None
    out = np.zeros(shape)
    fill(*tree.arrays[:-1], links, places, offsets, np.ascontiguousarray(q, dtype=float), out)
    return out


@functools.cache
def _jacobian_loop() -> Callable[..., None] | None:
    """Return the compiled loop over Jacobians."""

    def first(fill: Callable[..., None]) -> None:
        index, flags = np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.bool_)
        fill(
            *(index,) * 4, flags, index, np.zeros(0), flags, np.zeros((0, 3, 3, 3)),
            np.zeros((0, 2, 3)), np.zeros((0, 3)), index, *(np.zeros((0, 3)),) * 2,
            np.zeros((0, 0)), np.zeros((0, 0, 6, 0)),
        )  # fmt: skip

    return compiled_loop(_fill, first)


def _fill(
    kind: Indices,
    parent: Indices,
    first_q: Indices,
    first_v: Indices,
    unbounded: Any,
    column: Indices,
    factor: Array,
    shared: Any,
    turn: Array,
    place: Array,
    axis: Array,
    links: Indices,
    places: Array,
    offsets: Array,
    q: Array,
    out: Array,
) -> None:
    """Write the Jacobians; `out` holds zeros. Written for a compiler."""
    count = len(kind)
    R, o = np.zeros((count, 3, 3)), np.zeros((count, 3))
    S, G, z = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    for k in range(len(q)):
        for i in range(count):
            p, at = parent[i], first_q[i]
            x, y, d = 0.0, 0.0, 0.0
            if kind[i] == PRISMATIC:
                d = q[k, at]
            elif unbounded[i]:
                x, y = q[k, at], q[k, at + 1]
            elif kind[i] == REVOLUTE:
                x, y = math.cos(q[k, at]), math.sin(q[k, at])
            for a in range(3):
                for b in range(3):
                    S[a, b] = turn[i, 0, a, b] * x + turn[i, 1, a, b] * y + turn[i, 2, a, b]
                z[a] = place[i, 0, a] + place[i, 1, a] * d
            if kind[i] == FLOATING:
                qx, qy, qz, qw = q[k, at + 3], q[k, at + 4], q[k, at + 5], q[k, at + 6]
                G[0, 0] = 1.0 - 2.0 * (qy * qy + qz * qz)
                G[1, 1] = 1.0 - 2.0 * (qx * qx + qz * qz)
                G[2, 2] = 1.0 - 2.0 * (qx * qx + qy * qy)
                G[0, 1], G[1, 0] = 2.0 * (qx * qy - qz * qw), 2.0 * (qx * qy + qz * qw)
                G[0, 2], G[2, 0] = 2.0 * (qx * qz + qy * qw), 2.0 * (qx * qz - qy * qw)
                G[1, 2], G[2, 1] = 2.0 * (qy * qz - qx * qw), 2.0 * (qy * qz + qx * qw)
                for a in range(3):
                    for b in range(3):
                        R[i, a, b] = S[a, 0] * G[0, b] + S[a, 1] * G[1, b] + S[a, 2] * G[2, b]
                    # Where the base is makes no difference.
                    o[i, a] = 0.0
            elif p < 0:
                for a in range(3):
                    for b in range(3):
                        R[i, a, b] = S[a, b]
                    o[i, a] = z[a]
            else:
                for a in range(3):
                    for b in range(3):
                        R[i, a, b] = (
                            R[p, a, 0] * S[0, b] + R[p, a, 1] * S[1, b] + R[p, a, 2] * S[2, b]
                        )
                    o[i, a] = o[p, a] + R[p, a, 0] * z[0] + R[p, a, 1] * z[1] + R[p, a, 2] * z[2]
        for f in range(len(links)):
            i = links[f]
            if i < 0:
                continue
            px, py, pz = places[f, 0], places[f, 1], places[f, 2]
            tx = o[i, 0] + R[i, 0, 0] * px + R[i, 0, 1] * py + R[i, 0, 2] * pz + offsets[f, 0]
            ty = o[i, 1] + R[i, 1, 0] * px + R[i, 1, 1] * py + R[i, 1, 2] * pz + offsets[f, 1]
            tz = o[i, 2] + R[i, 2, 0] * px + R[i, 2, 1] * py + R[i, 2, 2] * pz + offsets[f, 2]
            while i >= 0:
                rx, ry, rz = tx - o[i, 0], ty - o[i, 1], tz - o[i, 2]
                v = first_v[i]
                if kind[i] == FLOATING:
                    for j in range(3):
                        ax, ay, az = R[i, 0, j], R[i, 1, j], R[i, 2, j]
                        h = column[v + j]
                        out[k, f, 0, h], out[k, f, 1, h], out[k, f, 2, h] = ax, ay, az
                        h = column[v + 3 + j]
                        out[k, f, 0, h] = ay * rz - az * ry
                        out[k, f, 1, h] = az * rx - ax * rz
                        out[k, f, 2, h] = ax * ry - ay * rx
                        out[k, f, 3, h], out[k, f, 4, h], out[k, f, 5, h] = ax, ay, az
                else:
                    sx, sy, sz = axis[i, 0], axis[i, 1], axis[i, 2]
                    c, h = factor[v], column[v]
                    ax = c * (R[i, 0, 0] * sx + R[i, 0, 1] * sy + R[i, 0, 2] * sz)
                    ay = c * (R[i, 1, 0] * sx + R[i, 1, 1] * sy + R[i, 1, 2] * sz)
                    az = c * (R[i, 2, 0] * sx + R[i, 2, 1] * sy + R[i, 2, 2] * sz)
                    if kind[i] == PRISMATIC:
                        out[k, f, 0, h] += ax
                        out[k, f, 1, h] += ay
                        out[k, f, 2, h] += az
                    else:
                        out[k, f, 0, h] += ay * rz - az * ry
                        out[k, f, 1, h] += az * rx - ax * rz
                        out[k, f, 2, h] += ax * ry - ay * rx
                        out[k, f, 3, h] += ax
                        out[k, f, 4, h] += ay
                        out[k, f, 5, h] += az
                i = parent[i]
