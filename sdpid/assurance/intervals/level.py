"""How far the cost may rise above the estimate's, for a linear function c·theta at an extreme.

**One direction.** The cost is a log-likelihood only up to the size and correlation of the errors.
Were it one, a rise of z² would make an interval. Where the extreme is taken, theta has moved away
from the estimate by a residual d = G·(theta − theta*), and to first order it is this combination of
the data, d·h, that decides how far. So the rise is t²·(d^T·N·d)/(d^T·d) with N the covariance of h
that the residuals show (the prior's rows count as stated: variance one), t the quantile of
Student's t with the degrees of freedom of that combination. For a base parameter of a problem
without active constraints that is Gauss-Markov's interval; where a constraint is active only the
directions count along which it lets theta move.

**Several.** Where the extreme pins other parameters too, as at the apex of a cone, d is but one of
the combinations of the data that decide. Let R be the derivative of the fitted rows with respect to
the data (see `sdpid.estimation.conic.fit_response`), D the positive part of the estimate's less the
extreme's, and nu the difference of their traces: the degrees of freedom that the fit loses. The
rise is then nu·F·tr(D·N)/tr(D) with F the quantile of Fisher's distribution with nu degrees of
freedom: chi² with as many as are lost [susko2013]_ [almohamad2020]_. What is proven of
this rule, and under which conditions, stands in docs/theory, section 12.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.duality.bound import cost_scale
from sdpid.estimation.posterior import FitErrors, error_sources, rows_covariance
from sdpid.estimation.problem import Problem

# The estimate itself is known to this share of its cost.
_LEAST_RISE = 1e-6

# A residual that moves by less than this share of the least rise has not moved.
_STILL = 1e-3

# Degrees of freedom this near to one are one: the rest is what a solver leaves of multipliers.
_ONE = 1.01

# So many degrees of freedom of a variance are a variance that is known.
_MANY = 1e8


class Level:
    """The rise of the cost that an interval admits.

    Parameters
    ----------
    problem : Problem
        The problem.
    errors : FitErrors
        What is known of the errors.
    probability : float
        Of the intervals, such as 0.95.
    cost : float
        The estimate's, without the floor.
    """

    def __init__(
        self, problem: Problem, errors: FitErrors, probability: float, cost: float
    ) -> None:
        self.errors, self.probability = errors, probability
        self.count = problem.base.count
        self.turned = problem.A @ errors.root
        self.least = _LEAST_RISE * max(cost, cost_scale(problem))
        self.sources = [(each, problem.A @ each.moves) for each in error_sources(problem)]
        data = rows_covariance(problem, errors)
        self.noise = np.eye(len(problem.squared.rhs))
        self.noise[: len(data), : len(data)] = data
        self._average = float(np.trace(data)) / self.count

    @property
    def typical(self) -> float:
        """The rise for one direction of average variance."""
        return max(4.0 * self._average, self.least)

    def highest(self, moves: Sequence[Array | None], spent: float) -> list[float]:
        """Return the rise for each of several ways to move, were all degrees of freedom lost.

        Parameters
        ----------
        moves : sequence of ndarray (r,) or None
            How the residual is thought to move.
        spent : float
            Degrees of freedom that the estimate spends on the data.
        """
        one = self.rises(moves, [None] * len(moves))
        several, single = (
            float(_quantile(count, np.inf, self.probability)) for count in (max(spent, 1.0), 1.0)
        )
        return [max(self._average * several, rise * several / single) for rise in one]

    def rises(self, moves: Sequence[Array | None], lost: Sequence[Array | None]) -> list[float]:
        """Return the rise for each extreme.

        Where the residual's move is not known or next to nothing, it is the typical one.

        Parameters
        ----------
        moves : sequence of ndarray (r,) or None
            How the residual moves from the estimate; None where that is not known.
        lost : sequence of ndarray (r, r) or None
            By how much less the fitted rows move with the data; None where a single direction is
            lost.
        """
        out = [self.typical] * len(moves)
        known = [
            (i, moved, gone)
            for i, (moved, gone) in enumerate(zip(moves, lost, strict=True))
            if moved is not None and float(moved @ moved) > self.least * _STILL
        ]
        if not known:
            return out
        d = np.array([moved for _, moved, _ in known])
        freedom = self._freedom(d[:, : self.count])
        variance = np.einsum("ki,ki->k", d @ self.noise, d) / np.einsum("ki,ki->k", d, d)
        one = variance * _quantile(1.0, freedom, self.probability)
        for (i, _, gone), own, rise in zip(known, freedom.tolist(), one.tolist(), strict=True):
            out[i] = max(rise, self._several(gone, own), self.least)
        return out

    def _freedom(self, moves: Array) -> Array:
        """Return the degrees of freedom of the variance of each combination (k, b) of the data."""
        moved = moves @ self.turned
        freedom = self.errors.freedom(moved)
        total = np.einsum("ki,ij,kj->k", moved, self.errors.scores, moved)
        spread = total**2 / freedom
        for source, rows in self.sources:
            variance = source.variance(moves @ rows)
            total = total + variance
            spread = spread + variance**2 / source.degrees(moves @ rows)
        out = np.full_like(total, np.inf)
        return np.asarray(np.divide(total**2, spread, out=out, where=spread > 0.0))

    def _several(self, lost: Array | None, freedom: float) -> float:
        """Return the rise where several directions are lost; 0 where it is but one."""
        if lost is None or float(np.trace(lost)) <= _ONE:
            return 0.0
        values, vectors = np.linalg.eigh(lost)
        weights = np.maximum(values, 0.0)
        variance = np.einsum("ik,ij,jk,k->", vectors, self.noise, vectors, weights, optimize=True)
        rise = _quantile(float(values.sum()), freedom, self.probability)
        return float(rise * variance / weights.sum())


def _quantile(count: float, freedom: Array | float, probability: float) -> Array:
    """Return the quantile of a sum of `count` squares over a variance with degrees of freedom."""
    from scipy.special import fdtri

    return np.asarray(count * fdtri(count, np.minimum(freedom, _MANY), probability))
