"""How many independent draws chains are worth, and whether they agree [vehtari2021]_."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array

# A share of the variance that is rounding.
_STILL = 1e-14


def effective_sizes(values: Array) -> Array:
    """Return the effective sample size (k,) of the mean of ranks of draws (count, chains, k).

    The number of independent draws whose mean of normal scores is as uncertain as that of these.
    Chains are split in halves; autocorrelations are added up by Geyer's initial monotone sequence.
    """
    scores = _normal_scores(_halves(values))
    N, M, _ = scores.shape
    within, total = _variances(scores)
    centered = scores - scores.mean(axis=0)
    spectrum = np.fft.rfft(centered, 2 * N, axis=0)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2, axis=0)[:N].mean(axis=1) / N
    constant = total <= 0.0
    rho = 1.0 - (within - covariance * N / (N - 1.0)) / np.where(constant, 1.0, total)
    rho[0] = 1.0
    pairs = rho[0 : 2 * (N // 2) : 2] + rho[1 : 2 * (N // 2) : 2]
    # From the first pair that is not positive on nothing counts, and pairs never rise.
    pairs = np.where(np.minimum.accumulate(pairs > 0.0, axis=0), pairs, 0.0)
    time = 2.0 * np.minimum.accumulate(pairs, axis=0).sum(axis=0) - 1.0
    # Chains that alternate may be worth more than independent draws, but not without limit.
    time = np.maximum(time, 1.0 / np.log10(N * M))
    return np.where(constant, float(N * M), N * M / time)


def split_r_hat(values: Array) -> Array:
    """Return the rank-normalized split R-hat (k,) of draws (count, chains, k).

    The larger of that of the draws and that of their distances from the median; 1 where all
    chains have the same distribution.
    """
    halves = _halves(values)
    folded = np.abs(halves - np.median(halves, axis=(0, 1)))
    found = []
    for each in (halves, folded):
        within, total = _variances(_normal_scores(each))
        # Chains that each stand still agree only where they are all at one point.
        still = np.where(total > 0.0, np.inf, 1.0)
        found.append(np.sqrt(np.divide(total, within, out=still, where=within > _STILL * total)))
    return np.maximum(*found)


def _halves(values: Array) -> Array:
    """Return the first and the second halves of chains as chains."""
    half = len(values) // 2
    return np.concatenate([values[:half], values[len(values) - half :]], axis=1)


def _normal_scores(values: Array) -> Array:
    """Return normal quantiles of the ranks of all draws together; equal values share a rank."""
    from scipy.special import ndtri
    from scipy.stats import rankdata

    N, M, k = values.shape
    ranks = rankdata(values.reshape(N * M, k), axis=0).reshape(N, M, k)
    return np.asarray(ndtri((ranks - 0.375) / (N * M + 0.25)))


def _variances(scores: Array) -> tuple[Array, Array]:
    """Return the variance within chains, and that of all chains together, (k,) each."""
    N = len(scores)
    within = scores.var(axis=0, ddof=1).mean(axis=0)
    between = scores.mean(axis=0).var(axis=0, ddof=1)
    return within, within * (N - 1.0) / N + between
