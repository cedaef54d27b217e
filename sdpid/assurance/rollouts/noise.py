"""Recordings with as much sensor noise again: how far noise alone lets a simulation go astray."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.processing.motion import noise_of
from sdpid.experiment.recording.recording import Recording


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
