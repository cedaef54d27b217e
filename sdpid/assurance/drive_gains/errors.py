"""Errors of gains, from blocks of samples that are independent of each other.

The sandwich of the fit without constraints, linear about its own optimum, in all unknowns at once:
gains, links, loads and friction (see `sdpid.estimation.cluster_robust`). White noise would make the
errors some three times too small: what filtered currents leave unexplained is friction, which is
alike from sample to sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.assurance.drive_gains.fit import GainFit
from sdpid.errors import DataError
from sdpid.estimation.cluster_robust import FEWEST_BLOCKS, ScoreBlocks
from sdpid.estimation.information import information_root, information_rows


@dataclass(frozen=True, eq=False)
class GainErrors:
    """Errors of the logarithms of gains.

    Attributes
    ----------
    covariance : ndarray, shape (n, n)
        Zero for gains that are held.
    freedom : ndarray, shape (n,)
        Degrees of freedom of each variance.
    blocks : int
        How many independent groups of samples they rest on.
    """

    covariance: Array
    freedom: Array
    blocks: int


def gain_errors(fit: GainFit, log_kappa: Array, z: Array, free: Mask) -> GainErrors:
    """Return the errors of gains about the optimum of a fit; arguments as of `score_blocks`.

    Raises
    ------
    DataError
        When the recordings are too short.
    """
    blocks = score_blocks(fit, log_kappa, z, free)
    n, size = int(free.sum()), blocks.information.shape[1]
    covariance, freedom = np.zeros((fit.n, fit.n)), np.full(fit.n, np.inf)
    own = blocks.covariance
    functionals = np.eye(n, size)
    if fit.knowledge is not None:
        # What is known has errors of variance one, and holds the fit of the blocks.
        rows = np.zeros((len(fit.knowledge[0]), size))
        rows[:, n : n + len(z)] = fit.knowledge[0]
        H = blocks.information.sum(axis=0)
        root = information_root(information_rows(H + rows.T @ rows))
        inverse = root @ root.T
        functionals = functionals @ inverse @ H
        known = np.eye(n, size) @ inverse @ rows.T
        found = functionals @ own @ functionals.T + known @ known.T
    else:
        found = own[:n, :n]
    covariance[np.ix_(free, free)] = found
    freedom[free] = blocks.freedom(functionals @ blocks.root)
    return GainErrors(covariance, freedom, blocks.count)


def score_blocks(fit: GainFit, log_kappa: Array, z: Array, free: Mask) -> ScoreBlocks:
    """Return the blocks of the fit, linear at gains and links; the first unknowns are log kappa.

    Parameters
    ----------
    fit : GainFit
        The fit.
    log_kappa, z : ndarray
        Where it is linear: at its optimum.
    free : ndarray of bool, shape (n,)
        Which gains are not held.

    Raises
    ------
    DataError
        When there are too few.
    """
    n, q = int(free.sum()), len(z)
    place = np.cumsum(free) - 1
    frictions = [fit.friction(j, log_kappa, z) for j in range(fit.n)]
    present = np.concatenate([-log_kappa[free], z, *frictions])
    total, first = len(present), n + q
    counts = [len(products) for products in (run.products[0] for run in fit.runs)]
    H, target = np.zeros((sum(counts), total, total)), np.zeros((sum(counts), total))
    for j, phi in enumerate(frictions):
        kappa, own = np.exp(log_kappa[j]), slice(first, first + len(phi))
        first = own.stop
        # The columns of the joint by the unknowns, and the error as a combination of them.
        T = np.zeros((len(phi) + q + 2, total))
        T[: len(phi), own] = np.eye(len(phi))
        T[len(phi) : -2, n : n + q] = kappa * np.eye(q)
        if free[j]:
            T[len(phi) : -1, place[j]] = -kappa * np.append(z, 1.0)
        error = np.concatenate([-phi, -kappa * z, [-kappa, 1.0]])
        kept, row = np.flatnonzero(T.any(axis=0)), 0
        for run, expanded, count in zip(fit.runs, fit.maps(j)[0], counts, strict=True):
            part = (expanded @ T[:, kept]) / fit.sigma[j]
            seen = run.products[j] @ part
            where = slice(row, row + count)
            H[where, kept[:, None], kept] += part.T @ seen
            target[where, kept] += (expanded @ error) @ seen / fit.sigma[j]
            row += count
    target += H @ present
    blocks = ScoreBlocks("blocks", H, target, np.eye(total))
    if blocks.count < FEWEST_BLOCKS:
        raise DataError(
            f"gains: the recordings have {blocks.count} blocks of samples that are independent of "
            f"each other, at least {FEWEST_BLOCKS} are needed for errors; record longer."
        )
    return blocks
