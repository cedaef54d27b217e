"""The covariance of the base parameters, from groups of rows that are independent of each other.

It is the sandwich ``H^(-1)·Cov(score)·H^(-1)`` [white1980]_ of the unconstrained fit, as if no
constraint were active and there were no prior. The scores are taken at that
fit, where they add up to zero. At an estimate that physics or a prior holds back they do not, and
their squares would count the pull of the constraints as noise.

Of every group g only the information ``H_g = W_g^T·Omega·W_g`` and the target
``c_g = W_g^T·Omega·Y_g`` are kept; the estimate solves ``Σ H_g·base = Σ c_g`` and its scores are
``s_g = c_g − H_g·base``. Groups are blocks of samples, longer than the filter's memory, so that
the correlation of filtered residuals stays inside; or whole periods, where they were kept.

**Errors.** A fit follows its data, so residuals are smaller than errors, the more so in blocks with
leverage. Before their squares are summed, the residuals of a block are multiplied by
``(E − P_gg)^(-1/2)``, with P the projection of the fit: this makes the variance unbiased where rows
are white and equally noisy, and nearly so otherwise (CR2, [bell2002]_, [pustejovsky2018]_). With m
periods squares grow by ``m/(m − 1)``, and there are ``m − 1`` degrees of freedom. As
``X^T·f(X·X^T) = f(X^T·X)·X^T`` only b×b matrices are needed. They are those of columns ``X·T`` that
are orthonormal over all rows: then the products lose nothing to rounding. The variance itself is
uncertain; the degrees of freedom of its Student's t are those of Satterthwaite's approximation, for
every parameter its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.errors import DataError
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.whitening import weights, whitened_chunks
from sdpid.estimation.information import information_root, information_rows
from sdpid.estimation.problem import Problem

Groups = Literal["blocks", "periods"]

# Fewer blocks than this say next to nothing about a variance.
FEWEST_BLOCKS = 8

# Where a group alone determines a direction its residual there is zero, and holds no information.
ALONE = 1e-9


@dataclass(frozen=True, eq=False)
class ScoreBlocks:
    """The rows of a problem in independent groups.

    Attributes
    ----------
    groups : {"blocks", "periods"}
        What a group is.
    information : ndarray, shape (G, r, r)
        H_g of the columns X·T. Of periods, one share of the whole each: all have one regressor.
    target : ndarray, shape (G, r)
        c_g.
    coordinates : ndarray, shape (b, r)
        T.
    """

    groups: Groups
    information: Array
    target: Array
    coordinates: Array

    @classmethod
    def of(
        cls, problem: Problem, groups: Groups = "blocks", *, size: int | None = None
    ) -> ScoreBlocks:
        """Gather the rows of a problem.

        Parameters
        ----------
        problem : Problem
            The problem.
        groups : {"blocks", "periods"}, optional
            What a group is.
        size : int, optional
            Samples a block; by default those of the samples.

        Raises
        ------
        DataError
            When the record has too few groups, or no single periods.
        """
        if groups == "periods":
            return cls._of_periods(problem)
        exponent = 0.5 * problem.score_exponent
        rows = problem.require_rows("standard errors")
        T = problem.excitation.root
        found = rows.map(_block_products, exponent, size, T, sigma=problem.sigma)
        products = np.concatenate(found)
        information, target = products[:, :, :-1], products[:, :, -1]
        if len(information) < FEWEST_BLOCKS:
            raise DataError(
                f"standard errors: {len(information)} blocks of {size or problem.samples.block} "
                f"samples, at least {FEWEST_BLOCKS} are needed; record longer, or decimate less."
            )
        return cls("blocks", frozen(information), frozen(target), T)

    @classmethod
    def _of_periods(cls, problem: Problem) -> ScoreBlocks:
        rows = problem.require_rows_here("standard errors")
        efforts = rows.samples.effort_periods
        if efforts is None or len(efforts) < 2:
            raise DataError(
                "standard errors: groups='periods' needs samples with efforts of single periods "
                "(Samples.effort_periods); use groups='blocks'."
            )
        T = problem.excitation.root
        count = T.shape[1]
        H, target = np.zeros((count, count)), np.zeros((len(efforts), count))
        for part, W, _, mask in rows.chunks():
            sigma = problem.sigma if problem.sigma.ndim == 2 else problem.sigma[part]
            weight = np.take(*weights(sigma, mask, 0.5 * problem.score_exponent), axis=0)
            X = weight @ (W @ T)
            H += np.einsum("kib,kic->bc", X, X, optimize=True)
            weighted = np.einsum("kij,kib->kjb", weight, X)
            target += np.einsum("kjb,pkj->pb", weighted, efforts[:, part], optimize=True)
        share = np.broadcast_to(H / len(efforts), (len(efforts), count, count))
        return cls("periods", frozen(share), frozen(target / len(efforts)), T)

    @property
    def count(self) -> int:
        """Number of groups."""
        return len(self.target)

    @property
    def root(self) -> Array:
        """T (b, r) with ``T·T^T = H^(-1)`` on what the data determine."""
        return np.asarray(self.coordinates @ self._root)

    @cached_property
    def _root(self) -> Array:
        return information_root(information_rows(self.information.sum(axis=0)))

    @cached_property
    def _shares(self) -> Array:
        """K_g, the information of each group in the coordinates of `root`, (G, r, r)."""
        return np.asarray(self._root.T @ self.information @ self._root)

    @cached_property
    def _factors(self) -> Array:
        """(E − K_g)^(-1/2) in the coordinates of `root`."""
        values, vectors = np.linalg.eigh(self._shares)
        room = 1.0 - values
        factor = np.where(room > ALONE, 1.0 / np.sqrt(np.maximum(room, ALONE)), 0.0)
        return np.asarray((vectors * factor[:, None, :]) @ np.swapaxes(vectors, 1, 2))

    @cached_property
    def scores(self) -> Array:
        """Covariance of the fit in the coordinates of `root`, corrected for leverage, (r, r)."""
        fit = self._root @ (self._root.T @ self.target.sum(axis=0))
        scores = (self.target - self.information @ fit) @ self._root
        errors = np.einsum("gij,gj->gi", self._factors, scores)
        return np.asarray(errors.T @ errors)

    @property
    def covariance(self) -> Array:
        """Covariance of the unconstrained fit, (b, b)."""
        return np.asarray(self.root @ self.scores @ self.root.T)

    def freedom(self, directions: Array) -> Array:
        """Return the degrees of freedom of variances along directions (k, r) of `root`."""
        out = np.ones(len(directions))
        for k, direction in enumerate(directions):
            size = float(np.linalg.norm(direction))
            if size == 0.0:
                continue
            p = self._factors @ (direction / size)
            u = np.einsum("gij,gj->gi", self._shares, p)
            own = np.einsum("gi,gi->g", p, u)
            # The groups' contributions have the covariance diag(own) − u·u^T.
            cross = np.sum(u**2, axis=1)
            trace = float(np.sum(own - cross))
            square = float(np.sum(own**2) - 2.0 * own @ cross + np.sum((u.T @ u) ** 2))
            out[k] = max(trace**2 / max(square, np.finfo(float).tiny), 1.0)
        return out


def _block_products(
    rows: RowSource, sigma: Array, exponent: float, block: int | None, T: Array
) -> Array:
    """Return H_g and c_g of all blocks, (G, r, r + 1)."""
    found, block = [], block or rows.samples.block
    size = max(rows.chunk_size // block, 1) * block
    for _, weighted, _ in whitened_chunks(rows, sigma, exponent, size=size):
        for start in range(0, len(weighted), block):
            own = weighted[start : start + block].reshape(-1, weighted.shape[2])
            turned = own[:, :-1] @ T
            found.append(turned.T @ np.column_stack([turned, own[:, -1]]))
    return np.asarray(found)
