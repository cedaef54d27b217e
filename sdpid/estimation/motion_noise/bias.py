"""By how much noise in the motion, landings, and friction's law move the unconstrained fit.

Noise in positions enters the columns of the regression: least squares makes what multiplies
accelerations too small, by the share of noise in their power, and friction near reversals, too.
Noise of the same strength once more moves the fit as much again [cook1994]_. It is added to a copy
of each recording and taken off another, and both are processed and fitted like the first: what is
proportional to the noise cancels in their mean, and what is left beside the fit is its bias, but
for terms of fourth order. Fits with and without the samples near landings, each without its bias by
noise, tell what landings do (see `sdpid.estimation.motion_noise.landings`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.seeds import generator
from sdpid.errors import DataError
from sdpid.estimation.compression.factor import compressed
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.motion_noise.friction import friction_bias
from sdpid.estimation.motion_noise.landings import away_from_landings, beyond_noise
from sdpid.estimation.motion_noise.twins import twins
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.for_robot import prepare
from sdpid.experiment.preparation.joined_contacts import join_samples
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.recording import Recording

__all__ = ["with_motion_bias"]


def with_motion_bias(
    problem: Problem,
    logs: Sequence[Recording],
    processing: Processing,
    *,
    seed: int | np.random.Generator = 0,
) -> Problem:
    """Return a problem that knows how far noise in the motion, landings, and friction move its fit.

    The estimate stays as it is; intervals and standard errors count the biases as errors.

    Parameters
    ----------
    problem : Problem
        Of recordings without periods.
    logs : sequence of Recording
        What its samples were made of.
    processing : Processing
        How. Landings are looked for where any of them was used.
    seed : int or numpy.random.Generator, optional
        Of the noise.

    Raises
    ------
    DataError
        When the samples are not those of these recordings, or the problem has no rows here.
    """
    rows = problem.require_rows_here("bias by noise in the motion")
    masks = [problem.samples.mask]
    if (clear := away_from_landings(problem, logs, processing)) is not None:
        masks.append(clear)
    rng = generator(seed)
    moved = []
    for pair in zip(*(twins(log, rng) for log in logs), strict=True):
        samples = join_samples([prepare(problem.robot, log, processing) for log in pair])
        if not np.array_equal(samples.effort, problem.samples.effort):
            raise DataError(
                "bias by noise in the motion: the problem's samples are not those of the "
                f"recordings ({problem.n_samples} and {samples.n_samples} samples, or other "
                "efforts); give what it was built of, and how it was processed."
            )
        moved.append([_fit(_of(problem, rows, replace(samples, mask=mask))) for mask in masks])
    every = [problem]
    every += [_of(problem, rows, replace(problem.samples, mask=mask)) for mask in masks[1:]]
    fits = [_fit(each) for each in every]
    biases = [0.5 * (a + b) - fit for a, b, fit in zip(*moved, fits, strict=True)]
    found = replace(problem, motion_bias=frozen(biases[0]))
    if (law := friction_bias(problem, rows)) is not None:
        found = replace(found, friction_bias=frozen(law))
    if clear is None:
        return found
    apart = fits[0] - biases[0] - (fits[1] - biases[1])
    landings = beyond_noise(problem, every[1], apart)
    return found if landings is None else replace(found, landing_bias=frozen(landings))


def _of(problem: Problem, rows: RowSource, samples: Samples) -> Problem:
    """Return a problem of other samples, with the same weights."""
    own = rows.on(samples)
    A, rhs, _ = compressed(own, problem.sigma)[0].split()
    return replace(problem, A=A, rhs=rhs, rows=own)


def _fit(problem: Problem) -> Array:
    """Return the least-squares solution (b,)."""
    size = np.linalg.norm(problem.A, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    return np.asarray(np.linalg.lstsq(problem.A / size, problem.rhs, rcond=None)[0] / size)
