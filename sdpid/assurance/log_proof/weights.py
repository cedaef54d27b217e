"""Diagonal weights that are at least a covariance's power, with proof."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.outward import SLACK as UP
from sdpid.assurance.certificate.outward import UNIT as U
from sdpid.assurance.log_proof.enclosure import root

# Half of the least eigenvalue of the correlations costs a factor √2 and is easily proven.
_SHARE = 0.5

# Variances below this are left alone: their products would underflow.
_LEAST = 1e-150


def diagonal_weights(sigma: Array, exponent: float) -> Array:
    """Return roots of weights (..., n) with ``diag(w²) ⪰ Sigma^exponent``, infinite without proof.

    From ``Sigma ⪰ s·diag(Sigma)`` follows ``Sigma^(−1) ⪯ diag(Sigma)^(−1)/s``, and the same for
    the root of both sides (Löwner and Heinz). It holds for any rows that are left out, too: of a
    principal part, s is the same. The share s is proven by Cholesky's method: where it ends for M,
    ``M + n·γ·diag(M) ⪰ 0`` with γ = (n + 1)u/(1 − 2(n + 1)u) [rump2006]_.

    Parameters
    ----------
    sigma : ndarray, shape (..., n, n)
        Covariances; their lower triangles count.
    exponent : float
        −1 or −1/2.
    """
    n = sigma.shape[-1]
    variance = np.diagonal(sigma, axis1=-2, axis2=-1)
    share: Array | float = 1.0
    lower = np.tril(np.ones((n, n), dtype=bool), -1)
    if np.any(sigma[..., lower] != 0.0):
        share = _proven_share(sigma, variance, n)[..., None]
    good = (variance > _LEAST) & (share > 0.0)
    square = np.where(good, UP / (np.where(good, share * variance, 1.0)), np.inf)
    return np.asarray(root(square) if exponent == -1.0 else root(root(square)))


def lesser_weights(sigma: Array, exponent: float) -> Array:
    """Return roots of weights (..., n) with ``diag(w²) ⪯ Sigma^exponent``.

    A covariance is at most n times its diagonal, since correlations are at most one; the rest is
    as for `diagonal_weights`.
    """
    n = sigma.shape[-1]
    variance = np.diagonal(sigma, axis1=-2, axis2=-1)
    square = 1.0 / (n * np.maximum(variance, _LEAST)) / UP
    found = np.sqrt(square) if exponent == -1.0 else np.sqrt(np.sqrt(square))
    return np.asarray(np.where(variance > _LEAST, found / UP, 0.0))


def _proven_share(sigma: Array, variance: Array, n: int) -> Array:
    """Return s with Sigma ⪰ s·diag(Sigma) for every covariance, zero where nothing is proven."""
    deviation = np.sqrt(np.maximum(variance, _LEAST))
    correlation = sigma / deviation[..., :, None] / deviation[..., None, :]
    share = _SHARE * np.maximum(np.linalg.eigvalsh(correlation)[..., 0], 0.0)
    rest = sigma.copy()
    entries = np.arange(n)
    rest[..., entries, entries] = (1.0 - share)[..., None] * variance
    try:
        factor = np.linalg.cholesky(rest)
    except np.linalg.LinAlgError:
        return np.zeros_like(share)
    done = np.isfinite(factor).all(axis=(-2, -1))
    # Twice n·γ, and the rounding of the diagonal.
    proven = share - (4.0 * n * (n + 2.0) + 4.0) * U
    return np.where(done, np.maximum(proven, 0.0), 0.0)
