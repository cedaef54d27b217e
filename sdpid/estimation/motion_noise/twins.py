"""Recordings whose motion has its own noise once more: added to one, taken off the other."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.processing.floating.rotations import unit
from sdpid.experiment.processing.motion import fourth_differences, noise_of
from sdpid.experiment.recording.floating.base import BaseMotion, Imu
from sdpid.experiment.recording.recording import Recording

# Median of the size of a normal variable, in standard deviations.
_MEDIAN = 0.6745


def twins(log: Recording, rng: np.random.Generator) -> tuple[Recording, Recording]:
    """Return a recording with noise added to its motion, and with the same noise taken off.

    It is white and as strong as the recording's own. What acts on the fit in proportion to the
    noise differs in sign between the two, and cancels in their mean.

    Parameters
    ----------
    log : Recording
        Without periods.
    rng : numpy.random.Generator
        Of the noise.
    """
    draw = _Draw(log.rate_hz, rng)
    position = draw.like(log.position)
    velocity = None if log.velocity is None else draw.like(log.velocity)
    base = None if log.base is None else _of_base(log.base, draw)
    first, second = (
        replace(
            log,
            position=log.position + sign * position,
            velocity=None if velocity is None else np.asarray(log.velocity) + sign * velocity,
            base=None if base is None or log.base is None else _moved(log.base, base, sign),
        )
        for sign in (1.0, -1.0)
    )
    return first, second


class _Draw:
    """Draws noise that is as strong as that of signals."""

    def __init__(self, rate_hz: float, rng: np.random.Generator) -> None:
        self.rate_hz, self.rng = rate_hz, rng

    def level(self, signals: Array) -> Array:
        """Return the noise of channels (N, c): of two estimates the lower one, (c,).

        Landings fill the whole spectrum of an accelerometer, but little of the time; encoders of
        coarse steps do not change for most of the time.
        """
        top = noise_of(signals, self.rate_hz)
        quiet = np.median(np.abs(fourth_differences(signals)), axis=0) / _MEDIAN
        return np.where(quiet > 0.0, np.minimum(top, quiet), top)

    def like(self, signals: Array) -> Array:
        """Return noise (N, c) for channels."""
        values = np.asarray(signals)
        return np.asarray(self.level(values) * self.rng.standard_normal(values.shape))


def _of_base(base: BaseMotion, draw: _Draw) -> dict[str, Array]:
    """Return noise of the channels of a base, by name."""
    noise = {}
    for name in ("orientation", "position", "linear_velocity", "angular_velocity"):
        if (values := getattr(base, name)) is not None:
            noise[name] = draw.like(values)
    for name in ("gyroscope", "accelerometer"):
        if base.imu is not None and (values := getattr(base.imu, name)) is not None:
            noise[name] = draw.like(values)
    return noise


def _moved(base: BaseMotion, noise: dict[str, Array], sign: float) -> BaseMotion:
    """Return a base whose channels have noise added."""

    def added(owner: BaseMotion | Imu, *names: str) -> dict[str, Array]:
        return {k: getattr(owner, k) + sign * noise[k] for k in names if k in noise}

    imu = base.imu
    if imu is not None:
        imu = replace(imu, **added(imu, "gyroscope", "accelerometer"))
    changes: dict[str, Any] = added(base, "position", "linear_velocity", "angular_velocity")
    orientation = unit(base.orientation + sign * noise["orientation"])
    return replace(base, orientation=orientation, imu=imu, **changes)
