"""Jacobians of contact points, and what contacts leave of rows, compiled where Numba is installed.

Both do sample by sample what `jacobians` and `sdpid.estimation.compression.contact_rows` do for all
samples at once, and differ from these by rounding.
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
    SMALL,
    Tree,
    compiled_loop,
)


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
    many = 8 * math.prod(shape) >= SMALL if worth is None else worth
    fill = _jacobian_loop() if many else None
    if fill is None:
        return None
    out = np.zeros(shape)
    fill(*tree.arrays[:-1], links, places, offsets, np.ascontiguousarray(q, dtype=float), out)
    return out


def independent_rows(
    directions: Array, active: Any, scale: Array, which: Indices, rows: Array, doubtful: float
) -> tuple[Array, Any] | None:
    """Return what rows say beside unknown forces, None without Numba.

    Parameters
    ----------
    directions : ndarray, shape (k, m, n)
        Efforts of each force.
    active : ndarray of bool, shape (k, m)
        Whether there may be one.
    scale : ndarray, shape (p, n)
        Roots of the rows' weights, of each pattern.
    which : ndarray of int, shape (k,)
        The pattern of each sample.
    rows : ndarray, shape (k, n, c)
        The rows.
    doubtful : float
        A triangle's diagonal entry below this, columns of unit length, makes a sample doubtful.

    Returns
    -------
    rows : ndarray, shape (r, c)
        Those of doubtful samples are zero.
    good : ndarray of bool, shape (k,)
        Which samples are not doubtful.
    """
    reduce = _row_loop()
    if reduce is None:
        return None
    n = rows.shape[1]
    counts = np.maximum(n - np.count_nonzero(active, axis=1), 0)
    starts = np.concatenate([[0], np.cumsum(counts)])
    out = np.zeros((int(starts[-1]), rows.shape[2]))
    good = np.ones(len(rows), dtype=np.bool_)
    arrays = [np.ascontiguousarray(each) for each in (directions, active, scale)]
    reduce(*arrays, which, np.ascontiguousarray(rows), starts, doubtful, out, good)
    return out, good


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


@functools.cache
def _row_loop() -> Callable[..., None] | None:
    """Return the compiled loop over rows."""

    def first(reduce: Callable[..., None]) -> None:
        block, flags = np.zeros((0, 0, 0)), np.zeros(0, dtype=np.bool_)
        reduce(
            block, np.zeros((0, 0), dtype=np.bool_), np.zeros((0, 0)), np.zeros(0, dtype=np.intp),
            block, np.zeros(1, dtype=np.intp), 0.0, np.zeros((0, 0)), flags,
        )  # fmt: skip

    return compiled_loop(_reduce, first)


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


def _reduce(
    directions: Array,
    active: Any,
    scale: Array,
    which: Indices,
    rows: Array,
    starts: Indices,
    doubtful: float,
    out: Array,
    good: Any,
) -> None:
    """Write the rows that Householder's reflections leave; `out` holds zeros."""
    m, n, columns = directions.shape[1], rows.shape[1], rows.shape[2]
    V, x = np.zeros((m, n)), np.zeros(n)
    for k in range(len(rows)):
        s = scale[which[k]]
        r, fine = 0, True
        for j in range(m):
            if not active[k, j]:
                continue
            square = 0.0
            for t in range(n):
                V[r, t] = s[t] * directions[k, j, t]
                square += V[r, t] * V[r, t]
            if square == 0.0 or r >= n:
                fine = False
                break
            length = 1.0 / math.sqrt(square)
            for t in range(n):
                V[r, t] *= length
            r += 1
        for j in range(r):
            if not fine:
                break
            square = 0.0
            for t in range(j, n):
                square += V[j, t] * V[j, t]
            size = math.sqrt(square)
            if size < doubtful:
                fine = False
                break
            V[j, j] += math.copysign(size, V[j, j])
            # Of the square length 2, so that the reflection is E − v·v^T.
            half = 1.0 / math.sqrt(size * abs(V[j, j]))
            for t in range(j, n):
                V[j, t] *= half
            for i in range(j + 1, r):
                dot = 0.0
                for t in range(j, n):
                    dot += V[j, t] * V[i, t]
                for t in range(j, n):
                    V[i, t] -= dot * V[j, t]
        if not fine:
            good[k] = False
            continue
        for i in range(r, n):
            for t in range(n):
                x[t] = 0.0
            x[i] = 1.0
            for back in range(r):
                j = r - 1 - back
                dot = 0.0
                for t in range(j, n):
                    dot += V[j, t] * x[t]
                for t in range(j, n):
                    x[t] -= dot * V[j, t]
            to = starts[k] + i - r
            for t in range(n):
                x[t] *= s[t]
            # Four rows at a time: half of the work is to load and store.
            t = 0
            while t + 4 <= n:
                x0, x1, x2, x3 = x[t], x[t + 1], x[t + 2], x[t + 3]
                for c in range(columns):
                    out[to, c] += (
                        x0 * rows[k, t, c]
                        + x1 * rows[k, t + 1, c]
                        + x2 * rows[k, t + 2, c]
                        + x3 * rows[k, t + 3, c]
                    )
                t += 4
            while t < n:
                x0 = x[t]
                for c in range(columns):
                    out[to, c] += x0 * rows[k, t, c]
                t += 1
