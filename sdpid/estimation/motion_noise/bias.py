"""By how much noise in the motion, landings, the filter, and friction's law move the fit.

Noise in positions enters the columns of the regression: least squares makes what multiplies
accelerations too small, by the share of noise in their power, and friction near reversals, too.
Noise of the same strength once more moves the fit as much again [cook1994]_. It is added to a copy
of each recording and taken off another, and both are processed and fitted like the first: what is
proportional to the noise cancels in their mean, and what is left beside the fit is its bias, but
for terms of fourth order. Other fits of the same recordings, each without its bias by noise, tell
what landings do where their samples are kept, and what the filter does where they are not (see
`sdpid.estimation.motion_noise.landings`): a filter takes away what it does not let pass, and
Jacobians of contacts and signs of speeds turn within its memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.seeds import generator
from sdpid.errors import DataError
from sdpid.estimation.compression.factor import compressed
from sdpid.estimation.compression.rows import RowSource
from sdpid.estimation.error_source import ErrorSource
from sdpid.estimation.information import least_squares
from sdpid.estimation.motion_noise.friction import friction_bias
from sdpid.estimation.motion_noise.landings import (
    away_from_landings,
    beyond_noise,
    landings_used,
)
from sdpid.estimation.motion_noise.twins import twins
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.for_robot import prepare
from sdpid.experiment.preparation.joined_contacts import join_samples
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.recording import Recording

# A cut-off this many times higher tells what the filter does: of nine logs of quadrupeds (stand,
# trot and hang of 10 s) intervals then held 97 % of the truth on average, 93 before; twice as high
# a cut-off lets so much more noise pass that one difference of seven was hardly seen.
_FASTER = 1.5


def with_motion_bias(
    problem: Problem,
    logs: Sequence[Recording],
    processing: Processing,
    *,
    seed: int | np.random.Generator = 0,
) -> Problem:
    """Return a problem that knows how far noise, landings, the filter and friction move its fit.

    The estimate stays as it is; intervals and standard errors count the biases as errors.

    Parameters
    ----------
    problem : Problem
        Of recordings without periods.
    logs : sequence of Recording
        What its samples were made of.
    processing : Processing
        How. Landings are looked for where any of them was used, what the filter does elsewhere.
    seed : int or numpy.random.Generator, optional
        Of the noise.

    Raises
    ------
    DataError
        When the samples are not those of these recordings, or the problem has no rows here.
    """
    rows = problem.require_rows_here("bias by noise in the motion")
    rng = generator(seed)
    pairs = tuple(zip(*(twins(log, rng) for log in logs), strict=True))
    noisy = [_processed(problem, pair, processing) for pair in pairs]
    for samples in noisy:
        if not np.array_equal(samples.effort, problem.samples.effort):
            raise DataError(
                "bias by noise in the motion: the problem's samples are not those of the "
                f"recordings ({problem.n_samples} and {samples.n_samples} samples, or other "
                "efforts); give what it was built of, and how it was processed."
            )
    mask = problem.samples.mask
    fit, bias = _fits(problem, [_of(problem, rows, replace(each, mask=mask)) for each in noisy])
    sources = [ErrorSource.bias("motion", bias)]
    name, others = _others(problem, logs, pairs, noisy, processing)
    if others:
        apart, *moved = (_of(problem, rows, each) for each in others)
        fit_apart, bias_apart = _fits(apart, moved)
        counted = beyond_noise(problem, apart, fit - bias - (fit_apart - bias_apart))
        sources += [] if counted is None else [ErrorSource.bias(name, counted)]
    if (law := friction_bias(problem, rows)) is not None:
        sources.append(ErrorSource.bias("friction", law))
    return replace(problem, errors=tuple(sources))


def _others(
    problem: Problem,
    logs: Sequence[Recording],
    pairs: Sequence[Sequence[Recording]],
    noisy: Sequence[Samples],
    processing: Processing,
) -> tuple[str, list[Samples]]:
    """Return what to look for, and samples without it: of the logs, then of those with noise."""
    if (clear := away_from_landings(problem, logs, processing)) is not None:
        return "landing", [replace(each, mask=clear) for each in (problem.samples, *noisy)]
    # Covariances of samples of their own are not those of another filter's samples.
    if problem.sigma.ndim > 2 or landings_used(problem, logs, processing):
        return "filter", []
    faster = replace(processing, cutoff_hz=_FASTER * processing.cutoff_hz)
    try:
        others = [_processed(problem, each, faster) for each in (logs, *pairs)]
    except DataError:
        # The rate of a recording allows no such cut-off.
        return "filter", []
    return "filter", [replace(each, mask=others[0].mask) for each in others]


def _processed(problem: Problem, logs: Sequence[Recording], processing: Processing) -> Samples:
    """Return the samples of all recordings."""
    return join_samples([prepare(problem.robot, log, processing) for log in logs])


def _fits(problem: Problem, noisy: Sequence[Problem]) -> tuple[Array, Array]:
    """Return the fit (b,) of a problem, and its bias by noise, from those with noise once more."""
    fit = _fit(problem)
    return fit, np.mean([_fit(each) for each in noisy], axis=0) - fit


def _of(problem: Problem, rows: RowSource, samples: Samples) -> Problem:
    """Return a problem of other samples, with the same weights."""
    own = rows.on(samples)
    A, rhs, _ = compressed(own, problem.sigma)[0].split()
    return replace(problem, A=A, rhs=rhs, rows=own)


def _fit(problem: Problem) -> Array:
    """Return the least-squares solution (b,)."""
    return least_squares(problem.A, problem.rhs)
