"""Bands for predicted efforts: what the parameters leave open, and what the model leaves out.

The half-width of the band of joint j in state x is

    1.96·sqrt(s_j² + Y_j(x)·C·Y_j(x)^T),

with the covariance C of the constrained estimate's base parameters (see
`sdpid.estimation.posterior`), the base regressor Y_j, and the rms error s_j of the joint
while it moves, on blocks held out where that can be done, else on the training rows. It is about
motion: at rest stiction holds what it will.

Efforts that were made of currents by the gains of the training are off by what the parameters are
off by: of the gains' errors there counts only what the parameters do not follow,
``Y_j(x)·S_i − δ_ij·tau_j`` for the gain of joint i, with S_i the parameters' slope by its
logarithm. About other efforts, the true torques, all of ``Y_j(x)·S_i`` counts.

Where samples have contacts, predicted efforts go with the forces that explain best what is left
(see `Problem.predict`): of what the parameters leave open, these forces take their part.
"""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.kept import kept
from sdpid._common.threads import one_thread
from sdpid.assurance.diagnostics.blocks import held_out_blocks, in_blocks, own, predicted_by
from sdpid.assurance.diagnostics.rest import moving_rows
from sdpid.estimation.compression.covariance import pooled
from sdpid.estimation.compression.whitening import effort_errors
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.gain_errors import gain_errors
from sdpid.estimation.posterior import Posterior
from sdpid.experiment.processing.samples import Samples

# Of a normal error, 95 % lie within so many standard deviations. Student's t does not apply: s_j
# rests on all moving rows held out, not on one number a block. With t of five blocks, 2.78, bands
# that hold 93 to 97 % of the rows on six robots (examples/studies/grades.py) would be 1.4 times
# as wide.
_QUANTILE = 1.96

# Errors of the model on another motion over those on the training rows, where no blocks can be
# held out (examples/studies/grades.py).
WIDER = 1.2

# Eigenvalues below this share of the largest, parameters scaled to unit deviations, are rounding.
_ROUNDING = 1e-13

# States of a random motion: their mean square is known to a few per cent.
_STATES = 400


def effort_band(estimate: Estimate, samples: Samples) -> Array:
    """Return the half-width (K, n) of the 95 % band about predicted efforts, N·m.

    Parameters
    ----------
    estimate : Estimate
        Its problem must have its rows.
    samples : Samples
        Where efforts are predicted.

    Raises
    ------
    DataError
        When the estimate's problem has no rows.
    """
    missed = _missed(estimate)
    return frozen(_QUANTILE * np.sqrt(missed**2 + _left_open(estimate, samples) ** 2))


def random_motion(estimate: Estimate) -> tuple[Array, Array]:
    """Return how well other motion within the recorded range could be known.

    States are drawn from the box of recorded positions, with velocities and accelerations of the
    recorded sizes, joint by joint independently: other motion, which the recorded one need not
    have shown.

    Returns
    -------
    ndarray, shape (n,)
        Root mean square of the standard deviation that the parameters leave of the effort, N·m.
    ndarray, shape (K, n)
        The predicted efforts.
    """
    problem = estimate.problem
    seen = problem.samples
    rng = np.random.default_rng(0)
    low, high = seen.position.min(axis=0), seen.position.max(axis=0)
    size = (_STATES, seen.n)
    motion = [
        np.sqrt(np.mean(each**2, axis=0)) * rng.standard_normal(size)
        for each in (seen.velocity, seen.acceleration)
    ]
    states = Samples(
        position=low + (high - low) * rng.random((_STATES, len(low))),
        velocity=motion[0],
        acceleration=motion[1],
        effort=np.zeros(size),
    )
    deviation = np.sqrt(np.mean(_left_open(estimate, states) ** 2, axis=0))
    return deviation, problem.predict(estimate.base, states)


@kept
def parameter_root(estimate: Estimate) -> tuple[Array, Array]:
    """Return the errors of the estimate's base parameters by their sources.

    Returns
    -------
    ndarray, shape (b, r)
        L whose L·L^T is their covariance, errors of gains aside.
    ndarray, shape (b, n)
        How they move with the logarithm of each gain.
    """
    posterior, B = Posterior.of(estimate), estimate.problem.base.matrix
    covariance, gains = posterior.covariance(B, without=("gains",)), gain_errors(estimate.problem)
    scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    known = values > _ROUNDING * max(float(values[-1]), 0.0)
    root = np.asarray(scale[:, None] * vectors[:, known] * np.sqrt(values[known]))
    return root, np.zeros((len(B), 0)) if gains is None else posterior.slopes(gains, B)


# Several recordings may be predicted.
@kept
def _missed(estimate: Estimate) -> Array:
    """Return the rms error (n,) of moving joints on what was held out of the training rows."""
    problem = estimate.problem
    blocks = held_out_blocks(problem)
    samples, wider = problem.samples, 1.0 if blocks else WIDER
    if blocks:
        predicted = predicted_by(blocks, problem, {"": own})[""]
    else:
        predicted = problem.predict(estimate.base)
    used, moving = samples.used, moving_rows(samples, problem.robot.slides)
    # A joint that never moves is judged at rest.
    counted = np.where(moving.any(axis=0), moving, used)
    if blocks:
        counted = counted & in_blocks(blocks, samples.n_samples)[:, None]
    square = np.where(counted, (samples.effort - predicted) ** 2, 0.0).sum(axis=0)
    return np.asarray(wider * np.sqrt(square / np.maximum(counted.sum(axis=0), 1)))


@one_thread
def _left_open(estimate: Estimate, samples: Samples) -> Array:
    """Return the standard deviation (K, n) that the parameters leave of predicted efforts."""
    problem = estimate.problem
    root, slopes = parameter_root(estimate)
    rows, gains = problem.rows_of(samples), gain_errors(problem)
    if gains is None:
        sigma = pooled(problem.sigma)
        pieces = [
            np.linalg.norm(effort_errors(rows, part, sigma, W @ root), axis=2)
            for part, W, _, _ in rows.chunks()
        ]
        return np.concatenate(pieces)
    own, theirs = gains.gains, samples.gains
    alike = own is not None and theirs is not None and own.same_errors(theirs)
    found = []
    for _, W, _, _ in rows.chunks():
        moved = W @ slopes
        if alike:
            moved = moved - (W @ estimate.base)[:, :, None] * np.eye(samples.n)
        variance = np.einsum("kji,im,kjm->kj", moved, gains.covariance, moved)
        found.append(np.sqrt(np.sum((W @ root) ** 2, axis=2) + np.maximum(variance, 0.0)))
    return np.concatenate(found)
