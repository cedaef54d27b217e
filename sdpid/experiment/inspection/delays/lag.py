"""`Delay`, and by how much one signal is later than another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.processing.filters import (
    BAND_OVER_RATE,
    Weights,
    ZeroPhaseFilter,
    low_pass,
    stencil,
)
from sdpid.experiment.processing.floating.rotations import body_rate, unit
from sdpid.experiment.recording.floating.base import BaseMotion
from sdpid.experiment.recording.recording import Recording

# Gauss-Newton steps of a lag end when one is this share of its error. Of motions three are enough
# from 20 ms away; of forces, which jump, ten and more.
_SETTLED, _STEPS = 0.02, 50
# Of filters.
_ORDER = 2
# Stretches of a recording whose errors count as independent.
_BLOCKS = 20


@dataclass(frozen=True, kw_only=True)
class Delay:
    """By how much a channel is late, and its standard error.

    Attributes
    ----------
    value, error : float
        s; negative values are early.
    """

    value: float
    error: float

    def sure(self, least: float, deviations: float) -> bool:
        """Tell whether it is longer than a limit and so many of its errors."""
        return abs(self.value) > max(least, deviations * self.error)

    def wider(self, error: float) -> Delay:
        """Return the delay with an error that is independent of its own added."""
        return Delay(value=self.value, error=float(np.hypot(self.error, error)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Smooth:
    """A low-pass filter for a recording without gaps, with derivatives.

    Attributes
    ----------
    low_pass : ZeroPhaseFilter
    weights : Weights
        Of derivatives of what has passed it.
    step : float
        Of the recording, s.
    cutoff_hz : float
    inner : slice
        The samples that its ends do not reach.
    """

    low_pass: ZeroPhaseFilter
    weights: Weights
    step: float
    cutoff_hz: float
    inner: slice

    @classmethod
    def of(cls, log: Recording, cutoff_hz: float, least: float) -> Smooth | None:
        """Return the filter; None of a recording shorter than `least` times its memory."""
        step = log.step
        cutoff = min(cutoff_hz, BAND_OVER_RATE / step)
        found = low_pass("finite", cutoff, _ORDER, 1.0 / step)
        if log.n_samples < least * found.reach:
            return None
        return cls(
            low_pass=found,
            weights=stencil("central4", cutoff_over_rate=cutoff * step),
            step=step,
            cutoff_hz=cutoff,
            inner=slice(2 * found.reach, log.n_samples - 2 * found.reach),
        )

    def low(self, values: Array) -> Array:
        """Return signals (N, ...) filtered."""
        return filtered(values.reshape(len(values), -1), self.low_pass).reshape(values.shape)

    def second(self, values: Array) -> Array:
        """Return the second derivative of signals (N, ...)."""
        from scipy.ndimage import correlate1d

        rate = correlate1d(values, self.weights.second, axis=0, mode="nearest")
        return np.asarray(rate / self.step**2)

    def turning(self, base: BaseMotion) -> Array:
        """Return the angular velocity of a base by its orientation, in its axes, (N, 3)."""
        return body_rate(unit(base.orientation), self.weights.first, self.step)


def filtered(values: Array, low_pass: ZeroPhaseFilter) -> Array:
    """Return signals (N, c) filtered, their ends continued by point reflection."""
    reach = min(low_pass.reach, len(values) - 1)
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
    return low_pass.apply(padded)[reach : reach + len(values)]


def block_error(scores: Array, power: float, blocks: int = _BLOCKS) -> float:
    """Return the standard error of sum(scores) / power, by blocks of the (N,) scores."""
    sums = np.array([part.sum() for part in np.array_split(scores, blocks)])
    return float(np.sqrt(sums @ sums)) / power


def lag(signal: Array, other: Array, step: float, *, gain: bool = False) -> Delay | None:
    """Return by how much a signal is later than another one of the same quantity.

    Parameters
    ----------
    signal, other : (N, c) ndarray
        Filtered alike; `signal` should be the one with less noise.
    step : float
        Sampling step, s.
    gain : bool, optional
        Whether they differ in scale, channel by channel.

    Returns
    -------
    Delay or None
        None where the signal does not change.
    """
    from scipy.interpolate import CubicSpline

    rows = np.arange(len(signal), dtype=np.float64)
    spline = CubicSpline(rows, signal, axis=0)
    delay, error = 0.0, 0.0
    for _ in range(_STEPS):
        at = np.clip(rows + delay / step, 0.0, rows[-1])
        moved, rate = _centered(spline(at)), _centered(spline(at, 1) / step)
        target = _centered(other)
        if gain:
            size = np.sum(moved**2, axis=0)
            moved, rate = (np.sum(moved * target, axis=0) / size * each for each in (moved, rate))
        left = target - moved
        weight = 1.0 / np.maximum(np.mean(left**2, axis=0), 1e-30)
        power = float(np.sum(rate**2 * weight))
        if not power > 0.0:
            return None
        change = float(np.sum(left * rate * weight)) / power
        error = block_error(np.sum((left - change * rate) * rate * weight, axis=1), power)
        delay += change
        if abs(change) <= _SETTLED * error:
            break
    return Delay(value=delay, error=error)


def pooled(values: Array, errors: Array) -> tuple[float, float]:
    """Return the mean of values with errors, and its error, in which their spread counts."""
    errors = np.maximum(errors, 1e-3 * np.abs(values).max(initial=1e-9))
    spread = 0.0
    for _ in range(20):
        weights = 1.0 / (errors**2 + spread)
        mean = float(weights @ values / weights.sum())
        # The spread between values that makes the deviations as large as their errors say.
        excess = float(weights @ (values - mean) ** 2) - (len(values) - 1)
        if excess <= 0.0 and spread == 0.0:
            break
        spread = max(0.0, spread + excess / float(weights.sum()))
    return mean, float(1.0 / np.sqrt(weights.sum()))


def _centered(values: Array) -> Array:
    return np.asarray(values - values.mean(axis=0))
