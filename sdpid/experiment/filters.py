"""Zero-phase Butterworth filters and central differences."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sdpid._arrays import Array, frozen
from sdpid.errors import DataError

__all__ = ["Derivative", "Stencil", "ZeroPhaseFilter", "butterworth", "stencil"]

Derivative = Literal["central", "central4", "central6"]

# After so many time constants exp(-45) = 3e-20 of a disturbance is left: below rounding, also
# with the polynomial factors that repeated passes bring.
_FORGOTTEN = 45.0


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
        """Number of samples after which a disturbance is forgotten to rounding."""
        return math.ceil(_FORGOTTEN * self.time_constant)

    def apply(self, signal: Array) -> Array:
        """Filter a signal forward and backward.

        Either pass starts from the steady state of its first value. The ends are therefore only
        as good as that guess; the caller provides `reach` extra samples and cuts them off.

        Parameters
        ----------
        signal : (N,) ndarray
            The signal.

        Returns
        -------
        (N,) ndarray
        """
        from scipy.signal import sosfilt, sosfilt_zi

        # SciPy asks for a writable array, though it does not write to it.
        sections = np.array(self.sections)
        steady = sosfilt_zi(sections)
        for _ in range(2):
            signal, _state = sosfilt(sections, signal, zi=steady * signal[0])
            signal = signal[::-1]
        return signal

    def gain(self, frequency_hz: Array | float, rate_hz: float) -> Array:
        """Return the gain of the forward and backward passes together at given frequencies."""
        from scipy.signal import sosfreqz

        _, response = sosfreqz(self.sections, worN=np.atleast_1d(frequency_hz), fs=rate_hz)
        gain: Array = np.abs(response) ** 2
        return gain


def butterworth(cutoff_hz: float, order: int, rate_hz: float) -> ZeroPhaseFilter:
    """Design a zero-phase Butterworth low-pass filter.

    Parameters
    ----------
    cutoff_hz : float
        Frequency at which a single pass has lost 3 dB, in Hz; forward and backward lose 6 dB.
    order : int
        Order of a single pass.
    rate_hz : float
        Sample rate in Hz.

    Returns
    -------
    ZeroPhaseFilter

    Raises
    ------
    DataError
        When the cut-off is not below half the sample rate.
    """
    if not cutoff_hz < rate_hz / 2.0:
        raise DataError(
            f"cutoff_hz: {cutoff_hz:g} Hz is not below half the sample rate of {rate_hz:.6g} Hz; "
            f"choose one below {rate_hz / 2.0:.6g} Hz."
        )
    from scipy.signal import butter, sos2zpk

    sections = butter(order, cutoff_hz, fs=rate_hz, output="sos")
    slowest = float(np.abs(sos2zpk(sections)[1]).max())
    # A cut-off close to half the rate puts the poles near the origin: at least one sample.
    time_constant = max(1.0, -1.0 / math.log(slowest)) if slowest > 0.0 else 1.0
    return ZeroPhaseFilter(sections=frozen(sections), time_constant=time_constant)


@dataclass(frozen=True, kw_only=True, eq=False)
class Stencil:
    """Weights of central differences, for a unit step.

    Attributes
    ----------
    first, second : (2 m + 1,) ndarray
        Weights of the first and of the second derivative.
    """

    first: Array
    second: Array

    @property
    def margin(self) -> int:
        """Number of samples m needed on either side."""
        return self.first.size // 2

    def velocity(self, signal: Array, step: float) -> Array:
        """Return the first derivative of (N,) samples at the inner N - 2 m ones."""
        return np.correlate(signal, self.first, mode="valid") / step

    def acceleration(self, signal: Array, step: float) -> Array:
        """Return the second derivative of (N,) samples at the inner N - 2 m ones."""
        return np.correlate(signal, self.second, mode="valid") / step**2


# Half of the weights, from the middle outwards; the first derivative's are odd. [fornberg1988]_
_WEIGHTS: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "central": ((1 / 2,), (-2.0, 1.0)),
    "central4": ((2 / 3, -1 / 12), (-5 / 2, 4 / 3, -1 / 12)),
    "central6": ((3 / 4, -3 / 20, 1 / 60), (-49 / 18, 3 / 2, -3 / 20, 1 / 90)),
}


def stencil(name: str) -> Stencil:
    """Return the central differences of order 2 (``"central"``), 4 or 6.

    Raises
    ------
    DataError
        When there is no such scheme.
    """
    if name not in _WEIGHTS:
        raise DataError(f"derivative: {name!r} is unknown; choose one of {', '.join(_WEIGHTS)}.")
    odd, even = _WEIGHTS[name]
    return Stencil(
        first=frozen([-w for w in odd[::-1]] + [0.0] + list(odd)),
        second=frozen(list(even[:0:-1]) + list(even)),
    )
