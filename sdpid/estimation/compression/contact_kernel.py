"""What contacts leave of rows, compiled where Numba is installed.

Sample by sample, it is what `contact_rows` finds for all samples at once, but for rounding.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.estimation.compression.branches import Branches
from sdpid.robot.model.regressor_kernel import compiled_loop


def independent_rows(
    directions: Array,
    active: Any,
    scale: Array,
    which: Indices,
    rows: Array,
    branches: Branches,
    *,
    doubtful: float,
) -> tuple[Array, list[Array], Any] | None:
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
    branches : Branches
        Which rows are of which branch.
    doubtful : float
        A triangle's diagonal entry below this, columns of unit length, makes a sample doubtful.

    Returns
    -------
    rows : ndarray, shape (r, c)
        Those that are mixed with others, or of no branch.
    apart : list of ndarray, shape (s, columns of the branch)
        Those of each branch that no force touches.
    good : ndarray of bool, shape (k,)
        Which samples are not doubtful: these have no rows.
    """
    reduce = _row_loop()
    if reduce is None:
        return None
    count, n, width = rows.shape
    columns = branches.columns
    branch = branches.of_row if columns else np.full(n, -1)
    out = np.empty((int(np.maximum(n - np.count_nonzero(active, axis=1), 0).sum()), width))
    good = np.ones(count, dtype=np.bool_)
    widths = np.array([len(own) for own in columns], dtype=np.intp)
    most = int(np.bincount(branch[branch >= 0], minlength=1).max())
    small = np.empty((len(columns), count * most, int(widths.max(initial=0))))
    table = np.zeros((len(columns), small.shape[2]), dtype=np.intp)
    for own, line in zip(columns, table, strict=True):
        line[: len(own)] = own
    filled = np.zeros(len(columns) + 1, dtype=np.intp)
    arrays = [np.ascontiguousarray(each) for each in (directions, active, scale)]
    reduce(
        *arrays, which, np.ascontiguousarray(rows), doubtful, branch, table, widths,
        out, small, filled, good,
    )  # fmt: skip
    found = zip(small, filled[:-1], widths, strict=True)
    return out[: filled[-1]], [own[:rows, :wide] for own, rows, wide in found], good


@functools.cache
def _row_loop() -> Callable[..., None] | None:
    """Return the compiled loop over rows."""

    def first(reduce: Callable[..., None]) -> None:
        block, flags, table = np.zeros((0, 0, 0)), np.zeros(0, dtype=np.bool_), np.zeros((0, 0))
        index = np.zeros(0, dtype=np.intp)
        reduce(
            block, np.zeros((0, 0), dtype=np.bool_), table, index, block, 0.0, index,
            np.zeros((0, 0), dtype=np.intp), index, table, block, np.zeros(1, dtype=np.intp), flags,
        )  # fmt: skip

    return compiled_loop(_reduce, first)


def _reduce(
    directions: Array,
    active: Any,
    scale: Array,
    which: Indices,
    rows: Array,
    doubtful: float,
    branch: Indices,
    table: Indices,
    widths: Indices,
    out: Array,
    small: Array,
    filled: Indices,
    good: Any,
) -> None:
    """Write the rows that Householder's reflections leave.

    A reflection takes the deepest joint that its force moves as pivot, and leaves rows alone where
    it is zero: a force on one leg mixes its rows and the base's, whatever the other legs do.
    """
    m, n, columns = directions.shape[1], rows.shape[1], rows.shape[2]
    V, x, used = np.zeros((m, n)), np.zeros(n), np.zeros(n, dtype=np.bool_)
    # Reflections are E − w·w^T, w being zero but in these rows.
    W, where = np.zeros((m, n)), np.zeros((m, n), dtype=np.intp)
    sizes, some = np.zeros(m, dtype=np.intp), np.zeros(n, dtype=np.intp)
    mixed, last = np.zeros(n, dtype=np.bool_), len(widths)
    for k in range(len(rows)):
        s = scale[which[k]]
        r, fine = 0, True
        for t in range(n):
            used[t] = mixed[t] = False
        for j in range(m):
            if not active[k, j]:
                continue
            square = 0.0
            for t in range(n):
                x[t] = s[t] * directions[k, j, t]
                square += x[t] * x[t]
            if square == 0.0 or r >= n:
                fine = False
                break
            length = 1.0 / math.sqrt(square)
            for t in range(n):
                V[r, t] = x[t] * length
            r += 1
        for j in range(r):
            if not fine:
                break
            square, size = 0.0, 0
            for t in range(n):
                if not used[t] and V[j, t] != 0.0:
                    where[j, size], W[j, size] = t, V[j, t]
                    square += V[j, t] * V[j, t]
                    size += 1
                    mixed[t] = True
            norm = math.sqrt(square)
            if norm < doubtful:
                fine = False
                break
            W[j, size - 1] += math.copysign(norm, W[j, size - 1])
            # Of the square length 2.
            half = 1.0 / math.sqrt(norm * abs(W[j, size - 1]))
            for u in range(size):
                W[j, u] *= half
            used[where[j, size - 1]] = True
            sizes[j] = size
            for i in range(j + 1, r):
                dot = 0.0
                for u in range(size):
                    dot += W[j, u] * V[i, where[j, u]]
                if dot != 0.0:
                    for u in range(size):
                        V[i, where[j, u]] -= dot * W[j, u]
        if not fine:
            good[k] = False
            continue
        for i in range(n):
            if used[i] or s[i] == 0.0:
                continue
            b = branch[i]
            if b >= 0 and not mixed[i]:
                to = filled[b]
                for c in range(widths[b]):
                    small[b, to, c] = s[i] * rows[k, i, table[b, c]]
                filled[b] += 1
                continue
            for t in range(n):
                x[t] = 0.0
            x[i] = 1.0
            for back in range(r):
                j = r - 1 - back
                dot = 0.0
                for u in range(sizes[j]):
                    dot += W[j, u] * x[where[j, u]]
                if dot != 0.0:
                    for u in range(sizes[j]):
                        x[where[j, u]] -= dot * W[j, u]
            count = 0
            for t in range(n):
                x[t] *= s[t]
                if x[t] != 0.0:
                    some[count] = t
                    count += 1
            to = filled[last]
            filled[last] += 1
            for c in range(columns):
                out[to, c] = 0.0
            # Four rows at a time: half of the work is to load and store.
            u = 0
            while u + 4 <= count:
                t0, t1, t2, t3 = some[u], some[u + 1], some[u + 2], some[u + 3]
                x0, x1, x2, x3 = x[t0], x[t1], x[t2], x[t3]
                for c in range(columns):
                    out[to, c] += (
                        x0 * rows[k, t0, c]
                        + x1 * rows[k, t1, c]
                        + x2 * rows[k, t2, c]
                        + x3 * rows[k, t3, c]
                    )
                u += 4
            while u < count:
                x0, t0 = x[some[u]], some[u]
                for c in range(columns):
                    out[to, c] += x0 * rows[k, t0, c]
                u += 1
