"""Many small least-squares problems with signs, from the products of their columns."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array, Mask

# What counts as negative, beside the largest product with the right-hand side. Columns have unit
# length, so this is a share of the fit that is far below any cost that is compared.
_NEGATIVE = 1e-12

# Added to the diagonal of an unknown that is held at zero; the others differ from what they would
# be without it by the inverse of this.
_HELD = 1e15

# Exchanges of all wrong signs at once, which nearly always settle in two or three; the few
# problems that have not settled then are solved one by one.
_EXCHANGES = 6


def least_squares_gain(H: Array, b: Array, free: Mask, start: Mask) -> tuple[Array, Mask]:
    """Return how much the squared length of right-hand sides falls by their best signed fits.

    Columns are known by their products alone: the fit maximises ``2·b^T·u − u^T·H·u``. Which
    unknowns are zero is found by block principal pivoting, else by active sets [lawson1974]_.

    Parameters
    ----------
    H : ndarray, shape (g, c, c)
        Products of the columns of each problem with each other, positive definite.
    b : ndarray, shape (g, c)
        Their products with the right-hand side.
    free : ndarray of bool, shape (c,)
        Unknowns of any sign; the others are not negative.
    start : ndarray of bool, shape (c,)
        Unknowns that are guessed not to be zero.

    Returns
    -------
    gain : ndarray, shape (g,)
    used : ndarray of bool, shape (g, c)
        Unknowns that are not held at zero.
    """
    used: Mask = (start | free)[None].repeat(len(b), axis=0)
    limit = -_NEGATIVE * np.abs(b).max(axis=1, initial=0.0)[:, None]
    bare = np.where(free, -np.inf, limit)
    held = np.eye(b.shape[1]) * _HELD
    for _ in range(_EXCHANGES):
        if used.all():
            u = np.linalg.solve(H, b[:, :, None])[:, :, 0]
            wrong = u < bare
        else:
            # A held unknown is all but zero, and its multiple is the slope of the fit along it.
            u = np.linalg.solve(H + ~used[:, :, None] * held, b[:, :, None])[:, :, 0]
            wrong = np.where(used, u < bare, _HELD * u > -limit)
        if not wrong.any():
            return np.einsum("gc,gc->g", b, u), used
        used = used ^ wrong
    gain = np.einsum("gc,gc->g", b, u)
    for k in np.flatnonzero(wrong.any(axis=1)):
        gain[k], used[k] = _one_by_one(H[k], b[k], free)
    return gain, used


def _one_by_one(H: Array, b: Array, free: Mask) -> tuple[float, Mask]:
    """Return the gain of one problem by an active-set method that always ends."""
    from scipy.optimize import nnls

    root = np.linalg.cholesky(H)
    rhs = np.linalg.solve(root, b)
    u, left = nnls(np.hstack([root.T, -root.T[:, free]]), rhs)
    return float(rhs @ rhs - left**2), (u[: len(b)] > 0.0) | free
