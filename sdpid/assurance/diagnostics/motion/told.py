"""What recordings tell beyond what was believed before them."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.problem import Problem

# Added to the correlations of what was believed, which rounding may leave singular.
_ROUNDING = 1e-12


def directions_told(problem: Problem, theta: Array) -> int | None:
    """Return of how many directions of the base parameters the data tell more than the prior.

    Directions are those that data and prior share: along each the variance that the data alone
    would leave is set beside that which the prior alone does.

    Parameters
    ----------
    problem : Problem
        With the cost of its rows in nats, as ``weighting="residual"`` makes it.
    theta : ndarray, shape (p,)
        Where the prior's curvature is taken.

    Returns
    -------
    int or None
        None without a prior, or where it says nothing of some parameter.
    """
    if problem.prior is None:
        return None
    rows = np.vstack([term.curvature_rows(theta) for term in problem.prior.terms])
    B = problem.base.matrix
    root = np.asarray(np.linalg.qr(rows, mode="r"))
    if root.shape[0] < root.shape[1] or not np.all(np.diagonal(root) != 0.0):
        return None
    believed = np.linalg.solve(root.T, B.T)
    covariance = believed.T @ believed
    scale = np.sqrt(np.diagonal(covariance))
    correlation = covariance / np.outer(scale, scale) + _ROUNDING * np.eye(len(B))
    told = np.linalg.svd((problem.A * scale) @ np.linalg.cholesky(correlation), compute_uv=False)
    return int(np.count_nonzero(told > 1.0))
