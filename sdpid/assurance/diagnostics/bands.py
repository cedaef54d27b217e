"""Blocks of a recording held out in turn, and the bands about predicted efforts that they show.

**Blocks.** Every choice that was made on the whole recording is kept: the samples, the friction
terms, the weights and the prior stay as they are; the parameters of each fit come from the rows
outside one block. As the cost is a sum over rows, the rows are compressed once, and each fit takes
one solve of the small problem.

**Bands** tell what the parameters leave open, and what the model leaves out. The half-width of the
band of joint j in state x is

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

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask, frozen
from sdpid._common.kept import kept
from sdpid._common.threads import one_thread
from sdpid.assurance.diagnostics.rest import moving_rows
from sdpid.errors import SdpidError
from sdpid.estimation.compression.covariance import PRINTED, pooled
from sdpid.estimation.compression.triangle import Triangle
from sdpid.estimation.compression.whitening import compress, effort_errors, with_contact_forces
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.information import require_excitation
from sdpid.estimation.posterior import Posterior, gain_errors
from sdpid.estimation.problem import Problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.experiment.processing.samples import Samples

# Blocks of a recording: a fifth is long enough to be a motion, and what is left holds most of it;
# of short recordings fewer, but with less than two thirds of it no fit is like that of the whole.
BLOCKS, FEWEST = 5, 3

# Rows up to which blocks are held out without being asked for: a few seconds of work.
MOST_ROWS = 3_000_000

# The share of `Samples.block` left out of training on both sides of a block. A block is 20 of the
# filter's time constants or more; after 5 the filter has forgotten all but a hundredth.
_GUARD = 0.25

# A block holds at least this many guards, or more is left out beside it than is predicted.
_LEAST_GUARDS = 2

# Of a normal error, 95 % lie within so many standard deviations. Student's t does not apply: s_j
# rests on all moving rows held out, not on one number a block. With t of five blocks, 2.78, bands
# that hold 93 to 97 % of the rows on six robots (examples/evidence/grades.py) would be 1.4 times
# as wide.
_QUANTILE = 1.96

# Errors of the model on another motion over those on the training rows, where no blocks can be
# held out (examples/evidence/grades.py).
WIDER = 1.2

# Eigenvalues below this share of the largest, parameters scaled to unit deviations, are rounding.
_ROUNDING = 1e-13

# States of a random motion: their mean square is known to a few per cent.
_STATES = 400


@dataclass(frozen=True, eq=False)
class Folds:
    """Fits to parts of a recording, and which one has not seen a sample.

    Attributes
    ----------
    estimates : tuple of Estimate
        The fits; those of blocks have no rows.
    owner : ndarray of int, shape (K,)
        The fit that saw neither a sample nor what the filter mixed with it; −1 for none.
    """

    estimates: tuple[Estimate, ...]
    owner: Indices

    @property
    def inside(self) -> Mask:
        """Which samples are in a block, (K, 1)."""
        return np.asarray(self.owner >= 0)[:, None]


# A verdict and bands of efforts ask for the same.
@kept
@one_thread
def held_out_blocks(problem: Problem) -> Folds | None:
    """Fit the problem without each block in turn.

    Parameters
    ----------
    problem : Problem
        With its rows. Every recording is cut into `BLOCKS`, or fewer, down to `FEWEST`, where all
        are too short for so many; those that are too short for that are in no block.

    Returns
    -------
    Folds or None
        None where blocks cannot be held out: the rows are on a cluster or more than `MOST_ROWS`,
        the weighting's cost is no sum over rows, the record is too short, or the rest of it leaves
        base parameters undetermined.
    """
    rows, sigma = problem.rows, problem.sigma
    if rows is None or rows.elsewhere is not None or problem.weighting in PRINTED:
        return None
    guard, parts = math.ceil(_GUARD * rows.samples.block), rows.samples.parts
    least = _LEAST_GUARDS * guard
    count = min(BLOCKS, max(part.stop - part.start for part in parts) // least)
    if count < FEWEST or problem.n_rows > MOST_ROWS:
        return None
    owner = np.full(rows.n_samples, -1, dtype=np.intp)
    # Rows that take part together, and the fits in which they do not.
    cells: list[tuple[set[int], Triangle]] = []
    for part in parts:
        if part.stop - part.start < count * least:
            cells.append((set(), compress(rows, sigma, part)[0]))
            continue
        edges = np.linspace(part.start, part.stop, count + 1).round().astype(int).tolist()
        for k, (start, stop) in enumerate(pairwise(edges)):
            owner[start:stop] = k
            ends = start, start + guard, stop - guard, stop
            # What is next to another block is left out with that one too.
            for cell, missing in zip(pairwise(ends), ({k - 1, k}, {k}, {k, k + 1}), strict=True):
                cells.append((missing, compress(rows, sigma, slice(*cell))[0]))
    estimates = []
    for k in range(count):
        triangle = Triangle(problem.base.count + 1)
        for missing, other in cells:
            if k not in missing:
                triangle.merge(other)
        A, rhs, floor = triangle.split()
        reduced = replace(problem, A=A, rhs=rhs, floor=floor, rows=None)
        try:
            if problem.prior is None:
                require_excitation(reduced.excitation)
            estimates.append(solve_sdp(reduced))
        except SdpidError:
            return None
    return Folds(tuple(estimates), owner)


@one_thread
def predicted_by(
    folds: Folds,
    problem: Problem,
    ways: Mapping[str, Callable[[Estimate], Array]],
    samples: Samples | None = None,
) -> dict[str, Array]:
    """Return the efforts (K, n) of samples, each predicted by a fit without it.

    Parameters
    ----------
    folds : Folds
        Fits of the problem. Samples of a recording too short to be cut are predicted by the first.
    problem : Problem
        With its rows.
    ways : mapping of str to callable
        By name, functions that return the base parameters to predict with, of a fit's estimate.
    samples : Samples, optional
        By default the problem's own.
    """
    own = problem.require_rows_here("blocks").samples if samples is None else samples
    rows, owner = problem.rows_of(own), np.maximum(folds.owner, 0)
    sigma = problem.sigma if samples is None else pooled(problem.sigma)
    values = {name: np.stack([*map(way, folds.estimates)], axis=1) for name, way in ways.items()}
    found = {name: np.empty(rows.samples.effort.shape) for name in ways}
    for part, W, _, _ in rows.chunks():
        for name, each in values.items():
            effort = np.take_along_axis(W @ each, owner[part][:, None, None], axis=2)
            found[name][part] = with_contact_forces(rows, part, sigma, effort[:, :, 0])
    return found


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
    samples, folds = problem.samples, held_out_blocks(problem)
    used, moving = samples.used, moving_rows(samples, problem.robot.slides)
    # A joint that never moves is judged at rest.
    counted = np.where(moving.any(axis=0), moving, used)
    if folds is None:
        predicted, wider = problem.predict(estimate.base), WIDER
    else:
        predicted, wider = predicted_by(folds, problem, {"": lambda fit: fit.base})[""], 1.0
        counted = counted & folds.inside
    square = np.where(counted, (samples.effort - predicted) ** 2, 0.0).sum(axis=0)
    return np.asarray(wider * np.sqrt(square / np.maximum(counted.sum(axis=0), 1)))


@one_thread
def _left_open(estimate: Estimate, samples: Samples) -> Array:
    """Return the standard deviation (K, n) that the parameters leave of predicted efforts."""
    problem = estimate.problem
    root, slopes = parameter_root(estimate)
    rows, gains, sigma = problem.rows_of(samples), gain_errors(problem), pooled(problem.sigma)
    own, theirs = None if gains is None else gains.gains, samples.gains
    alike = own is not None and theirs is not None and own.same_errors(theirs)
    found = []
    for part, W, _, _ in rows.chunks():
        variance = np.sum(effort_errors(rows, part, sigma, W @ root) ** 2, axis=2)
        if gains is not None:
            moved = W @ slopes
            if alike:
                moved = moved - (W @ estimate.base)[:, :, None] * np.eye(samples.n)
            moved = effort_errors(rows, part, sigma, moved)
            variance += gains.variance(moved.reshape(-1, moved.shape[2])).reshape(variance.shape)
        found.append(np.sqrt(variance))
    return np.concatenate(found)
