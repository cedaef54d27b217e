"""Standard errors that do not believe in white residuals."""

from __future__ import annotations

import numpy as np

from sdpid._arrays import Array
from sdpid.errors import DataError
from sdpid.estimation.excitation import require_excitation
from sdpid.estimation.problem import Problem
from sdpid.estimation.rows import CHUNK
from sdpid.estimation.weighting import whitened

# Fewer blocks than this say next to nothing about a variance.
FEWEST_BLOCKS = 8


def sandwich_covariance(problem: Problem, base: Array) -> Array:
    """Return H^(-1)·Cov(score)·H^(-1) of the estimating equations at `base` [white1980]_.

    The score of ``W^T Sigma^e (Y − W base)`` is summed over blocks of `samples.block` samples,
    which are longer than the filter's memory, so that the correlation of filtered residuals is
    inside a block and the blocks are independent. The usual small-sample factor
    ``G/(G−1)·N/(N−b)`` is applied.

    Parameters
    ----------
    problem : Problem
        The problem.
    base : ndarray, shape (b,)
        Where the residuals are taken.

    Returns
    -------
    ndarray, shape (b, b)

    Raises
    ------
    DataError
        When the record is too short for blocks.
    IdentifiabilityError
        When the data leave base parameters undetermined: their errors are infinite.
    """
    require_excitation(problem.excitation)
    block = problem.samples.block
    size = max(CHUNK // block, 1) * block
    count = problem.base.count
    H = np.zeros((count, count))
    scores = []
    exponent = 0.5 * problem.score_exponent
    for _, weighted, _ in whitened(problem.rows, problem.sigma, exponent=exponent, size=size):
        rows = weighted[:, :, :-1]
        residual = weighted @ np.append(-base, 1.0)
        flat = rows.reshape(-1, count)
        H += flat.T @ flat
        each = np.einsum("kib,ki->kb", rows, residual)
        scores.append(np.add.reduceat(each, np.arange(0, len(each), block), axis=0))
    S = np.concatenate(scores)
    blocks = len(S)
    if blocks < FEWEST_BLOCKS:
        raise DataError(
            f"standard errors: {blocks} blocks of {block} samples, at least {FEWEST_BLOCKS} are "
            "needed; record longer, or decimate less."
        )
    correction = blocks / (blocks - 1) * problem.n_rows / max(problem.n_rows - count, 1)
    half = np.linalg.solve(H, S.T)
    return np.asarray(correction * half @ half.T)
