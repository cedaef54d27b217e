"""Recordings with as much sensor noise again: how far noise alone lets a simulation go astray."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.processing.motion import spectrum
from sdpid.experiment.recording.recording import Recording

# Above this share of half the sample rate an arm does not move: what is there is noise.
_NOISE_ONLY = 2.0 / 3.0


def noise_of(signals: Array, rate_hz: float) -> Array:
    """Return the standard deviation (n,) of white noise as strong as signals (N, n) are on top.

    The median of the power above two thirds of half the sample rate is that of noise, whatever
    single lines stand out; of noise that is white, it is ln 2 of the mean.
    """
    n_samples = len(signals)
    window = float(np.square(np.hanning(n_samples)).sum())
    levels = []
    for column in np.asarray(signals).T:
        frequency, power = spectrum(np.asarray(column), rate_hz, n_samples)
        top = power[frequency > _NOISE_ONLY * frequency[-1]]
        levels.append(np.sqrt(np.median(top) / (np.log(2.0) * window)) if top.size else 0.0)
    return np.array(levels)


def noisier(log: Recording, rng: np.random.Generator) -> Recording:
    """Return a recording with white noise added that is as strong as its own."""

    def again(signals: Array) -> Array:
        levels = noise_of(signals, log.rate_hz)
        return np.asarray(signals + levels * rng.standard_normal(signals.shape))

    return replace(
        log,
        position=again(log.position),
        effort=again(log.effort),
        velocity=None if log.velocity is None else again(log.velocity),
    )
