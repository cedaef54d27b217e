"""Errors of gains, from blocks of samples that are independent of each other.

The sandwich of the fit without constraints, linear about its own optimum, in all unknowns at once:
gains, links, loads and friction (see `sdpid.estimation.cluster_robust`). White noise would make the
errors some three times too small: what filtered currents leave unexplained is friction, which is
alike from sample to sample.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.drive_gains.fit import FoundGains, GainFit
from sdpid.errors import DataError
from sdpid.estimation.cluster_robust import FEWEST_BLOCKS, ScoreBlocks
from sdpid.estimation.information import information_root, least_squares


def gain_errors(fit: GainFit, found: FoundGains) -> tuple[Array, Array, int]:
    """Return the errors of gains about the optimum of a fit.

    Returns
    -------
    covariance : ndarray, shape (n, n)
        Of the gains' logarithms; zero for gains that are held.
    freedom : ndarray, shape (n,)
        Degrees of freedom of each variance.
    blocks : int
        How many independent groups of samples they rest on.

    Raises
    ------
    DataError
        When the recordings are too short.
    """
    model, free = fit.model, fit.model.free
    n, count = len(free), int(free.sum())
    blocks, T = score_blocks(fit, found)
    if blocks.count < FEWEST_BLOCKS:
        raise DataError(
            f"gains: the recordings have {blocks.count} blocks of samples that are independent of "
            f"each other, at least {FEWEST_BLOCKS} are needed for errors; record longer."
        )
    # In these coordinates the information of the blocks and of what is believed, whose errors have
    # variance one, is E.
    blocks = replace(blocks, coordinates=T[:count] @ blocks.information.sum(axis=0))
    believed = model.believed[0][:, model.unknown] @ T[count : count + len(found.unknown)]
    moves = T[:count] @ believed.T
    covariance, freedom = np.zeros((n, n)), np.full(n, np.inf)
    covariance[np.ix_(free, free)] = blocks.covariance + moves @ moves.T
    freedom[free] = blocks.freedom(blocks.root)
    slopes = fit.at(found.logs)[2][:, free]
    for load in {id(each): each for each in model.loads if each.mass_error > 0.0}.values():
        # What the mass moves, the center of mass and the inertia about it as they are.
        theta = replace(load, inertia=None).theta
        same = [theta if each is load else np.zeros(10) for each in model.loads]
        moved = fit.weighted(found.logs)[0] @ np.concatenate([np.zeros(model.n_arm), *same])
        follows = np.zeros(n)
        follows[free] = least_squares(slopes, moved)
        covariance += (load.mass_error / load.mass) ** 2 * np.outer(follows, follows)
    return covariance, freedom, blocks.count


def score_blocks(fit: GainFit, found: FoundGains) -> tuple[ScoreBlocks, Array]:
    """Return the blocks of a fit, linear at its optimum, and T that takes them to all unknowns.

    These are the steps of the free gains' logarithms and of the bodies, and friction.
    """
    model, gains, sigma = fit.model, np.exp(found.logs), fit.sigma
    bodies, width = model.bodies(found.unknown), len(model.known) + 1
    count = int(model.free.sum())
    links = slice(count, count + len(found.unknown))
    frictions = [rows.shape[1] - width for rows in fit.rows]
    ends = links.stop + np.cumsum([0, *frictions])

    def design(j: int, columns: Array) -> Array:
        """Return the rows of joint j by all unknowns, and what is left without friction."""
        needed = columns[:, -width:-1] / gains[j]
        X = np.zeros((len(columns), ends[-1] + 1))
        if model.free[j]:
            X[:, int(model.free[:j].sum())] = -needed @ bodies
        X[:, links] = needed[:, model.unknown]
        X[:, ends[j] : ends[j + 1]] = columns[:, :-width]
        X[:, -1] = columns[:, -1] - needed @ bodies
        return np.asarray(X / sigma[j])

    believed = np.zeros((len(model.believed[0]), ends[-1]))
    believed[:, links] = model.believed[0][:, model.unknown]
    whole = [design(j, rows)[:, :-1] for j, rows in enumerate(fit.rows)]
    T = information_root(np.vstack([*whole, believed]))
    products = []
    for number, (samples, own) in enumerate(zip(model.samples, fit.links, strict=True)):
        blocks = [
            slice(start, min(start + samples.block, part.stop))
            for part in samples.parts
            for start in range(part.start, part.stop, samples.block)
        ]
        sums_of_blocks = np.zeros((len(blocks), T.shape[1], T.shape[1] + 1))
        for j, columns in enumerate(model.columns(number, own)):
            rows = design(j, columns)
            rows = np.column_stack([rows[:, :-1] @ T, rows[:, -1]])
            for sums, block in zip(sums_of_blocks, blocks, strict=True):
                sums += rows[block, :-1].T @ rows[block]
        products.append(sums_of_blocks)
    H = np.concatenate(products)
    return ScoreBlocks("blocks", H[..., :-1], H[..., -1], np.eye(T.shape[1])), T
