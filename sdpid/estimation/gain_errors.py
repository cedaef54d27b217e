"""What the errors of drive gains do to an estimate.

Efforts that were made of currents are gains times currents, ``y_j = k_j·i_j``: a gain that is off
by a share e_j moves all efforts of its joint by that share, and the compressed efforts
``rhs = Σ_j rhs_j`` by ``Σ_j e_j·rhs_j``, with rhs_j the share of the joint's own rows. The errors
are the same in every row, so that no residual shows them as noise, and no longer record averages
them out: they stand beside the errors that residuals show, as a further term of every covariance.
Weights, the prior and what the data chose stay: it is the first order. An error that all gains
have in common moves every parameter by the same share.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.kept import kept
from sdpid.estimation.compression.covariance import PRINTED
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.whitening import apply, weights_of
from sdpid.estimation.problem import Problem
from sdpid.experiment.drive_gains.gains import DriveGains


@dataclass(frozen=True, eq=False)
class GainErrors:
    """The errors of the gains behind a problem's efforts.

    Attributes
    ----------
    rows : ndarray, shape (b, n)
        How the compressed efforts move with the logarithm of each gain; no columns where efforts
        were not made of currents.
    covariance : ndarray, shape (n, n)
        Of the gains' logarithms.
    freedom : ndarray, shape (n,)
        Degrees of freedom of each variance.
    gains : DriveGains or None
        The gains.
    """

    rows: Array
    covariance: Array
    freedom: Array
    gains: DriveGains | None

    @classmethod
    def of(cls, problem: Problem) -> GainErrors:
        """Gather what is known of the gains' errors; computed once for each problem."""
        return _gather(problem)

    @property
    def any(self) -> bool:
        """Whether there are errors."""
        return bool(self.covariance.any())

    @property
    def root(self) -> Array:
        """How the compressed efforts move with independent errors of variance one, (b, n)."""
        values, vectors = np.linalg.eigh(self.covariance)
        return np.asarray(self.rows @ (vectors * np.sqrt(np.maximum(values, 0.0))))

    def variance(self, slopes: Array) -> Array:
        """Return the variances of functions with slopes (k, n) by the gains' logarithms, (k,)."""
        found = np.einsum("ki,ij,kj->k", slopes, self.covariance, slopes)
        return np.asarray(np.maximum(found, 0.0))

    def degrees(self, slopes: Array) -> Array:
        """Return degrees of freedom of these variances (k,): those of the gains that decide."""
        own = slopes**2 * np.diag(self.covariance)
        total, spread = own.sum(axis=1), (own**2 / self.freedom).sum(axis=1)
        out = np.full(len(own), np.inf)
        return np.asarray(np.divide(total**2, spread, out=out, where=spread > 0.0))


# A pass over all rows.
@kept
def _gather(problem: Problem) -> GainErrors:
    gains = None if problem.rows is None else problem.rows.samples.gains
    if gains is None or not gains.covariance.any() or problem.rows is None:
        n = 0 if gains is None else gains.n
        return GainErrors(
            np.zeros((problem.base.count, n)), np.zeros((n, n)), np.full(n, np.inf), gains
        )
    exponent = 0.5 * problem.score_exponent
    target = np.sum(problem.rows.map(_targets, exponent, sigma=problem.sigma), axis=0)
    # The normal equations are themselves the compressed rows of a printed weighting.
    rows = target
    if problem.weighting not in PRINTED:
        T = problem.excitation.root
        rows = problem.A @ T @ (T.T @ target)
    return GainErrors(frozen(rows), gains.relative_covariance, gains.freedom, gains)


def _targets(rows: RowSource, sigma: Array, exponent: float) -> Array:
    """Return the products (b, n) of whitened rows and the whitened efforts of each joint alone."""
    n, count = rows.robot.n, rows.base.count
    found = np.zeros((count, n))
    for part in rows.parts():
        own, mask = rows.rows(part), rows.mask(part)
        # The last column of rows may be another: that of a second stage of instruments.
        alone = rows.samples.effort[part][:, :, None] * np.eye(n)
        stacked = np.concatenate([own[:, :, :-1], alone], axis=2)
        weighted = apply(*weights_of(rows, part, sigma, exponent), stacked)
        weighted = np.where(mask[:, :, None], weighted, 0.0).reshape(-1, count + n)
        found += weighted[:, :count].T @ weighted[:, count:]
    return found
