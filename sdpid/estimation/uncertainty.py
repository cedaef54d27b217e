"""Standard errors that do not believe in white residuals."""

from __future__ import annotations

import numpy as np

from sdpid._arrays import Array
from sdpid.errors import DataError
from sdpid.estimation.excitation import require_excitation
from sdpid.estimation.problem import Problem
from sdpid.estimation.rows import RowSource
from sdpid.estimation.whitening import whitened_chunks

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
    count = problem.base.count
    exponent = 0.5 * problem.score_exponent
    parts = problem.rows.map(_scores, exponent, base, sigma=problem.sigma)
    H = np.sum([H for H, _ in parts], axis=0)
    S = np.concatenate([scores for _, scores in parts])
    blocks = len(S)
    if blocks < FEWEST_BLOCKS:
        raise DataError(
            f"standard errors: {blocks} blocks of {problem.samples.block} samples, at least "
            f"{FEWEST_BLOCKS} are needed; record longer, or decimate less."
        )
    correction = blocks / (blocks - 1) * problem.n_rows / max(problem.n_rows - count, 1)
    half = np.linalg.solve(H, S.T)
    return np.asarray(correction * half @ half.T)


def _scores(rows: RowSource, sigma: Array, exponent: float, base: Array) -> tuple[Array, Array]:
    """Return W^T·Sigma^e·W (b, b), and the scores of all blocks (G, b)."""
    count, block = rows.base.count, rows.samples.block
    H, scores = np.zeros((count, count)), []
    size = max(rows.chunk_size // block, 1) * block
    for _, weighted, _ in whitened_chunks(rows, sigma, exponent, size=size):
        W = weighted[:, :, :-1]
        residual = weighted @ np.append(-base, 1.0)
        flat = W.reshape(-1, count)
        H += flat.T @ flat
        each = np.einsum("kib,ki->kb", W, residual)
        scores.append(np.add.reduceat(each, np.arange(0, len(each), block), axis=0))
    return H, np.concatenate(scores)
