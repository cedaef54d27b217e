"""By how much noise in the measured motion moves the unconstrained fit.

Noise in positions enters the columns of the regression: least squares makes what multiplies
accelerations too small, by the share of noise in their power, and friction near reversals, too.
Noise of the same strength once more moves the fit as much again [cook1994]_. It is added to a copy
of each recording and taken off another, and both are processed and fitted like the first: what is
proportional to the noise cancels in their mean, and what is left beside the fit is its bias, but
for terms of fourth order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid._common.seeds import generator
from sdpid.errors import DataError
from sdpid.estimation.compression.factor import compressed
from sdpid.estimation.motion_noise.twins import twins
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.for_robot import prepare
from sdpid.experiment.preparation.joined_contacts import join_samples
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
    """Return a problem that knows how far noise in the motion moves its fit.

    The estimate stays as it is; intervals and standard errors count the bias as an error.

    Parameters
    ----------
    problem : Problem
        Of recordings without periods.
    logs : sequence of Recording
        What its samples were made of.
    processing : Processing
        How.
    seed : int or numpy.random.Generator, optional
        Of the noise.

    Raises
    ------
    DataError
        When the samples are not those of these recordings, or the problem has no rows here.
    """
    rows = problem.require_rows_here("bias by noise in the motion")
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
        own = replace(samples, mask=problem.samples.mask)
        triangle, _ = compressed(rows.on(own), problem.sigma)
        moved.append(_fit(*triangle.split()[:2]))
    bias = 0.5 * (moved[0] + moved[1]) - _fit(problem.A, problem.rhs)
    return replace(problem, motion_bias=frozen(bias))


def _fit(A: Array, rhs: Array) -> Array:
    """Return the least-squares solution (b,)."""
    size = np.linalg.norm(A, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    return np.asarray(np.linalg.lstsq(A / size, rhs, rcond=None)[0] / size)
