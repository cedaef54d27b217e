"""By how much landings move the unconstrained fit.

At a landing joint speeds jump within a sample: differences of positions give another acceleration
than that of the sampled effort, and within the filter's memory the robot moves on. The errors
repeat with every step, so that no residual shows them as noise, and no longer log averages them
out. The same log without the samples near landings is fitted, too: its fit knows less and has none
of these errors. The two differ by what landings do, and by noise, whose variance is the difference
of theirs [hausman1978]_. What noise would make of the difference is taken off its mean square.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.errors import DataError
from sdpid.estimation.noise_spectrum import NoiseSpectrum
from sdpid.estimation.problem import Problem
from sdpid.experiment.preparation.for_robot import prepare
from sdpid.experiment.preparation.joined_contacts import join_samples
from sdpid.experiment.processing.floating.feet import landing_share
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.recording import Recording


def landings_used(problem: Problem, logs: Sequence[Recording], processing: Processing) -> bool:
    """Return whether samples near a landing were used: by choice, or as too few others would stay.

    Parameters
    ----------
    problem : Problem
        Of these recordings.
    logs : sequence of Recording
        What its samples were made of.
    processing : Processing
        How.
    """
    contacts, around = problem.samples.contacts, processing.impact_s
    if contacts is None:
        return False
    # As far as the filter sees; flags' own margin is not told apart from it, and widens this.
    seen = (contacts.widened_s or 0.0) + (around or 0.0)
    most = 0.0 if around is None else 1.0 - processing.kept_share
    return any(
        landing_share(log.contacts, round(seen / log.step)) > most
        for log in logs
        if log.contacts is not None
    )


def away_from_landings(
    problem: Problem, logs: Sequence[Recording], processing: Processing
) -> Mask | None:
    """Return which rows (K, n) of a problem's samples see no landing, None where all are used.

    Parameters
    ----------
    problem : Problem
        Of these recordings.
    logs : sequence of Recording
        What its samples were made of.
    processing : Processing
        How: one that leaves all landings out has none to look for.
    """
    if not landings_used(problem, logs, processing):
        return None

    def rows(**changed: float | None) -> Mask:
        own = replace(processing, **changed)  # type: ignore[arg-type]
        return join_samples([prepare(problem.robot, log, own) for log in logs]).used

    try:
        if processing.impact_s is None:
            clear = rows(impact_s=0.0)
        else:
            # `kept_share` kept them, and rows that are slow, which are not asked for here.
            clear = rows(kept_share=0.0) | ~rows(kept_share=0.0, impact_s=None)
    except DataError:
        # No sample of a recording is away from all landings.
        return None
    used = problem.samples.used
    apart_used: Mask = used & clear
    return None if np.array_equal(apart_used, used) else apart_used


def beyond_noise(problem: Problem, apart: Problem, moved: Array) -> Array | None:
    """Return the difference of two fits, as large as it is beyond its noise.

    Parameters
    ----------
    problem : Problem
        Of all samples.
    apart : Problem
        Of those away from landings, or of samples of another filter.
    moved : ndarray, shape (b,)
        By how much the first's fit is above the second's.

    Returns
    -------
    ndarray, shape (b,), or None
        None where the other samples leave directions open.
    """
    if len(apart.excitation.weak()) > len(problem.excitation.weak()):
        return None
    own, others = (np.diag(NoiseSpectrum.of(each).covariance) for each in (problem, apart))
    return beyond(moved, own, others)


def beyond(moved: Array, own: Array, others: Array) -> Array:
    """Return the difference of an efficient fit and another, as large as it is beyond its noise.

    Parameters
    ----------
    moved : ndarray, shape (b,)
        By how much the first fit is above the second.
    own, others : ndarray, shape (b,)
        Variances of the first and of the second.
    """
    seen = own > 0.0
    noise = float(np.sum(np.maximum(others[seen] / own[seen] - 1.0, 0.0)))
    found = float(np.sum(moved[seen] ** 2 / own[seen]))
    return np.asarray(np.sqrt(max(1.0 - noise / found, 0.0) if found else 0.0) * moved)
