"""Fits of projected rows: by gains and friction of any size, and by sensible ones."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.inspection.dynamics import GAINS

# Standard errors are from so many blocks of samples.
_BLOCKS = 20


def fitted(columns: Array, due: Array) -> tuple[Array, Array]:
    """Return least squares of rows (K, m, p), and standard errors from blocks of samples."""
    A, b = columns.reshape(-1, columns.shape[2]), due.ravel()
    size = np.linalg.norm(A, axis=0)
    size[size == 0.0] = 1.0
    A = A / size
    inverse = np.linalg.pinv(A.T @ A, rcond=1e-12, hermitian=True)
    found = inverse @ (A.T @ b)
    scores = (A * (b - A @ found)[:, None]).reshape(*due.shape, -1).sum(axis=1)
    sums = np.array([part.sum(axis=0) for part in np.array_split(scores, _BLOCKS)])
    errors = np.sqrt(np.sum((sums @ inverse) ** 2, axis=0))
    return found / size, errors / size


def sensible_fit(columns: Array, due: Array, scale: float) -> Array:
    """Return gains of 0.3 to 3, friction that takes power, rotors that have inertia."""
    from scipy.optimize import nnls

    n = columns.shape[2] // 4
    A, b = columns.reshape(-1, columns.shape[2]), due.ravel()
    # A root of the normal equations is exact enough for shares, and several times faster than QR.
    size = np.linalg.norm(A, axis=0)
    size[size == 0.0] = 1.0
    A = A / size
    values, vectors = np.linalg.eigh(A.T @ A)
    root = np.sqrt(np.maximum(values, 1e-12 * values[-1]))
    factor, rhs = (vectors * root).T, (vectors.T @ (A.T @ b)) / root
    low, high = np.zeros(4 * n), np.full(4 * n, np.inf)
    low[:n], high[:n] = (limit / scale * size[:n] for limit in GAINS)
    found = low.copy()
    open_ = np.ones(4 * n, dtype=np.bool_)
    for _ in range(n):
        fixed = factor[:, ~open_] @ found[~open_] + factor[:, open_] @ low[open_]
        found[open_] = low[open_] + nnls(factor[:, open_], rhs - fixed)[0]
        over = open_ & (found > high)
        if not over.any():
            break
        found[over] = high[over]
        open_ &= ~over
    return np.asarray(found / size)
