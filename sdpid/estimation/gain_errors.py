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

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.kept import kept
from sdpid.estimation.compression.covariance import PRINTED
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.compression.whitening import apply, weights_of
from sdpid.estimation.error_source import ErrorSource
from sdpid.estimation.problem import Problem


def error_sources(problem: Problem) -> tuple[ErrorSource, ...]:
    """Return all that moves the fit of a problem beside noise: its gains, and its biases."""
    gains = gain_errors(problem)
    return problem.errors if gains is None else (gains, *problem.errors)


# A pass over all rows.
@kept
def gain_errors(problem: Problem) -> ErrorSource | None:
    """Return the errors of the gains' logarithms, None where there are none."""
    gains = None if problem.rows is None else problem.rows.samples.gains
    if gains is None or not gains.covariance.any() or problem.rows is None:
        return None
    exponent = 0.5 * problem.score_exponent
    target = np.sum(problem.rows.map(_targets, exponent, sigma=problem.sigma), axis=0)
    T = problem.excitation.root
    # The normal equations are themselves the compressed rows of a printed weighting.
    turned = problem.A @ T if problem.weighting in PRINTED else T
    moves = frozen(T @ (turned.T @ target))
    return ErrorSource("gains", moves, gains.relative_covariance, gains.freedom, gains)


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
