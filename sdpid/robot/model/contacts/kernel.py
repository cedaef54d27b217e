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
    NOTHING,
    PRISMATIC,
    Tree,
    compiled_loop,
    joint_at,
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
    shape = (len(q), len(links), 6, int(tree.column.max()) + 1)
    many = 8 * math.prod(shape) >= _SMALL if worth is None else worth
    fill = _jacobian_loop() if many else None
    if fill is None:
        return None
    out = np.zeros(shape)
    fill(tree, links, places, offsets, np.ascontiguousarray(q, dtype=float), out)
    return out


@functools.cache
def _jacobian_loop() -> Callable[..., None] | None:
    """Return the compiled loop over Jacobians."""

    def first(fill: Callable[..., None]) -> None:
        points = np.zeros((0, 3))
        index = np.zeros(0, dtype=np.intp)
        fill(NOTHING, index, points, points, np.zeros((0, 0)), np.zeros((0, 0, 6, 0)))

    return compiled_loop(_fill, first)


def _fill(tree: Any, links: Indices, places: Array, offsets: Array, q: Array, out: Array) -> None:
    """Write the Jacobians; `out` holds zeros. Written for a compiler."""
    kind, parent, first_v, axis = tree.kind, tree.parent, tree.first_v, tree.axis
    column, factor, count = tree.column, tree.factor, len(tree.kind)
    R, o = np.zeros((count, 3, 3)), np.zeros((count, 3))
    S, z = np.zeros((3, 3)), np.zeros(3)
    for k in range(len(q)):
        for i in range(count):
            p = parent[i]
            if p < 0:
                joint_at(tree, i, q, k, R[i], o[i])
                continue
            joint_at(tree, i, q, k, S, z)
            for a in range(3):
                for b in range(3):
                    R[i, a, b] = R[p, a, 0] * S[0, b] + R[p, a, 1] * S[1, b] + R[p, a, 2] * S[2, b]
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
