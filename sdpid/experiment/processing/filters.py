"""Zero-phase low-pass filters: Butterworth, Bessel, and one of finite memory."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.errors import DataError

FilterType = Literal["butterworth", "bessel", "finite"]

FILTERS: tuple[str, ...] = get_args(FilterType)

# After this many time constants exp(-45) = 3e-20 of a disturbance is left: below rounding, also
# with the polynomial factors of repeated passes.
_FORGOTTEN = 45.0
# Five time constants, which are cut off the ends of a record, are then the whole memory of a finite
# filter.
_CUT_OFF = 5.0


@dataclass(frozen=True, kw_only=True, eq=False)
class ZeroPhaseFilter:
    """A low-pass filter run forward and backward, so that it has no phase.

    Attributes
    ----------
    sections : (S, 6) ndarray
        Second-order sections of the filter of a single pass.
    time_constant : float
        Time in which its slowest mode decays by a factor of e, in samples.
    """

    sections: Array
    time_constant: float

    @property
    def reach(self) -> int:
        """Number of samples after which a disturbance has decayed below rounding."""
        return math.ceil(_FORGOTTEN * self.time_constant)

    @cached_property
    def _steady(self) -> Array:
        """State of the filter after a long constant one, (S, 2)."""
        from scipy.signal import sosfilt_zi

        return np.asarray(sosfilt_zi(np.array(self.sections)))

    def apply(self, signal: Array) -> Array:
        """Filter signals forward and backward along their first axis.

        Either pass starts from the steady state of its first value. The ends are therefore only
        as good as that guess; the caller provides `reach` extra samples and cuts them off.

        Parameters
        ----------
        signal : (N,) or (N, c) ndarray
            One signal, or c of them.

        Returns
        -------
        (N,) or (N, c) ndarray
        """
        from scipy.signal import sosfilt

        # SciPy asks for a writable array, though it does not write to it.
        sections, steady = np.array(self.sections), self._steady
        for _ in range(2):
            first = steady[..., None] * signal[0] if signal.ndim == 2 else steady * signal[0]
            signal, _state = sosfilt(sections, signal, axis=0, zi=first)
            signal = signal[::-1]
        return signal

    def gain(self, frequency_hz: Array | float, rate_hz: float) -> Array:
        """Return the gain of the forward and backward passes together at given frequencies."""
        from scipy.signal import sosfreqz

        _, response = sosfreqz(self.sections, worN=np.atleast_1d(frequency_hz), fs=rate_hz)
        gain: Array = np.abs(response) ** 2
        return gain


@dataclass(frozen=True, kw_only=True, eq=False)
class FiniteFilter(ZeroPhaseFilter):
    """A symmetric filter whose output depends on no sample farther away than `reach`.

    Attributes
    ----------
    weights : (2 reach + 1,) ndarray
        Of the neighbors; they sum to one.
    """

    weights: Array

    @property
    def reach(self) -> int:
        """Number of samples on either side that the filter sees."""
        return self.weights.size // 2

    def apply(self, signal: Array) -> Array:
        """Filter signals along their first axis; beyond the ends the outermost value is taken."""
        from scipy.ndimage import correlate1d

        filtered: Array = correlate1d(signal, self.weights, axis=0, mode="nearest")
        return filtered

    def gain(self, frequency_hz: Array | float, rate_hz: float) -> Array:
        """Return the gain at given frequencies."""
        lag = np.arange(-self.reach, self.reach + 1) / rate_hz
        phase = 2.0 * math.pi * np.multiply.outer(np.atleast_1d(frequency_hz), lag)
        gain: Array = np.cos(phase) @ self.weights
        return gain


def _finite(cutoff_hz: float, order: int, rate_hz: float) -> FiniteFilter:
    """Design a sinc under a Hann window of half length order / (2 cut-off), with 6 dB loss there.

    The sinc's own frequency is found by bisection; with order 1 it is 0, and the window alone has
    that loss.
    """
    half = max(1, round(order * rate_hz / (2.0 * cutoff_hz)))
    place = np.arange(-half, half + 1)
    window = np.cos(0.5 * math.pi * place / (half + 1)) ** 2
    oscillation = np.cos(2.0 * math.pi * cutoff_hz / rate_hz * place)

    def weights(frequency_hz: float) -> Array:
        values = np.sinc(2.0 * frequency_hz / rate_hz * place) * window
        return np.asarray(values / values.sum())

    low, high = 0.0, 1.5 * cutoff_hz
    for _ in range(60):
        middle = 0.5 * (low + high)
        if weights(middle) @ oscillation < 0.5:
            low = middle
        else:
            high = middle
    return FiniteFilter(
        sections=frozen(np.zeros((0, 6))),
        time_constant=max(1.0, half / _CUT_OFF),
        weights=frozen(weights(low)),
    )


def low_pass(kind: FilterType, cutoff_hz: float, order: int, rate_hz: float) -> ZeroPhaseFilter:
    """Design a zero-phase low-pass filter.

    Parameters
    ----------
    kind : {"butterworth", "bessel", "finite"}
        ``"butterworth"`` has the flattest pass band. ``"bessel"`` follows a step with next to no
        overshoot (0.3 % of it at order 4, where Butterworth has 6.8 %), forgets 2.6 times as fast
        there, and takes more from the pass band: at a tenth of the cut-off 0.64 %, where
        Butterworth takes 1e-8. ``"finite"`` is a sinc under a Hann window, which sees samples up
        to order / (2 cut-off) away and no others.
    cutoff_hz : float
        Frequency at which a single pass has lost 3 dB, in Hz; forward and backward lose 6 dB, as
        the finite filter does.
    order : int
        Order of a single pass; of the finite filter its half length in half periods of the cut-off.
    rate_hz : float
        Sample rate in Hz.

    Returns
    -------
    ZeroPhaseFilter

    Raises
    ------
    DataError
        When the type is unknown or the cut-off is not below half the sample rate.
    """
    if kind not in FILTERS:
        raise DataError(f"filter: {kind!r} is unknown; choose one of {', '.join(FILTERS)}.")
    if not cutoff_hz < rate_hz / 2.0:
        raise DataError(
            f"cutoff_hz: {cutoff_hz:g} Hz is not below half the sample rate of {rate_hz:.6g} Hz; "
            f"choose one below {rate_hz / 2.0:.6g} Hz."
        )
    if kind == "finite":
        return _finite(cutoff_hz, order, rate_hz)
    from scipy.signal import bessel, butter, zpk2sos

    if kind == "bessel":
        zeros, poles, factor = bessel(order, cutoff_hz, fs=rate_hz, norm="mag", output="zpk")
    else:
        zeros, poles, factor = butter(order, cutoff_hz, fs=rate_hz, output="zpk")
    sections = zpk2sos(zeros, poles, factor)
    slowest = float(np.abs(poles).max())
    # A cut-off close to half the rate puts the poles near the origin: at least one sample.
    time_constant = max(1.0, -1.0 / math.log(slowest)) if slowest > 0.0 else 1.0
    return ZeroPhaseFilter(sections=frozen(sections), time_constant=time_constant)
