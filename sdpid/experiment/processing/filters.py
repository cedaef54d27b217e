"""Zero-phase low-pass filters, and derivatives of sampled signals."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.errors import DataError

FilterType = Literal["butterworth", "bessel", "finite"]

FILTERS: tuple[str, ...] = get_args(FilterType)

# After this many time constants exp(-45) = 3e-20 of a disturbance is left: below rounding, also
# with the polynomial factors of repeated passes.
_FORGOTTEN = 45.0
# Numbers from which on `scipy.signal` is worth its loading, 0.3 s once: it takes 6 ns for a section
# of a number, a triangular system 60 ns.
_LARGE = 2**19
# Five time constants, which are cut off the ends of a record, are then the whole memory of a finite
# filter.
_CUT_OFF = 5.0
Derivative = Literal["central", "central4", "central6", "savitzky_golay", "spectral"]

DERIVATIVES: tuple[str, ...] = get_args(Derivative)

# Differences of fourth order lose no more than 2 % of a velocity up to this share of the rate.
BAND_OVER_RATE = 1.0 / 7.5

# Degree of the local polynomials. A velocity is then exact on degree 4, and an acceleration,
# whose next odd term vanishes in the middle of the window, on degree 5: as with "central4", which
# is what the shortest window of 5 samples gives.
_DEGREE = 4


class Stencil(ABC):
    """How a uniformly sampled signal is differentiated."""

    @property
    @abstractmethod
    def margin(self) -> int:
        """Number of samples m needed on either side."""

    @abstractmethod
    def velocity(self, signal: Array, step: float) -> Array:
        """Return the first derivative of (N,) samples at the inner N - 2 m ones."""

    @abstractmethod
    def acceleration(self, signal: Array, step: float) -> Array:
        """Return the second derivative of (N,) samples at the inner N - 2 m ones."""

    def inner(self, signal: Array) -> Array:
        """Return the samples at which derivatives are known."""
        return signal[self.margin : signal.size - self.margin]


@dataclass(frozen=True, kw_only=True, eq=False)
class Weights(Stencil):
    """Weights of neighboring samples, for a unit step.

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


class Spectral(Stencil):
    """Derivatives of the Fourier series through one whole period; m is 0.

    Exact for signals without power at half the sampling rate or above.
    """

    @property
    def margin(self) -> int:
        """Number of samples needed on either side: a period is followed by itself."""
        return 0

    def velocity(self, signal: Array, step: float) -> Array:
        """Return the first derivative of one period (N,) at all its samples."""
        # At half the rate a sampled cosine says nothing of the sine beside it: the imaginary part
        # there is ignored.
        factor = 1j * _angular_frequencies(signal.size, step)
        derivative: Array = np.fft.irfft(factor * np.fft.rfft(signal), signal.size)
        return derivative

    def acceleration(self, signal: Array, step: float) -> Array:
        """Return the second derivative of one period (N,) at all its samples."""
        factor = -(_angular_frequencies(signal.size, step) ** 2)
        derivative: Array = np.fft.irfft(factor * np.fft.rfft(signal), signal.size)
        return derivative


def _angular_frequencies(count: int, step: float) -> Array:
    return np.asarray(2.0 * math.pi * np.fft.rfftfreq(count, step), dtype=np.float64)


# Half of the weights, from the middle outwards; the first derivative's are odd. [fornberg1988]_
_WEIGHTS: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "central": ((1 / 2,), (-2.0, 1.0)),
    "central4": ((2 / 3, -1 / 12), (-5 / 2, 4 / 3, -1 / 12)),
    "central6": ((3 / 4, -3 / 20, 1 / 60), (-49 / 18, 3 / 2, -3 / 20, 1 / 90)),
}


def stencil(name: str, *, cutoff_over_rate: float | None = None) -> Weights:
    """Return the weights of central differences or of local polynomials.

    Parameters
    ----------
    name : {"central", "central4", "central6", "savitzky_golay"}
        Central differences of order 2, 4 or 6 [fornberg1988]_, or the derivatives of polynomials
        of degree 4 fitted to windows of 2 m + 1 samples [savitzky1964]_.
    cutoff_over_rate : float, optional
        Cut-off of the low-pass filter over the sample rate, between 0 and 1/2: what local
        polynomials need for the length of their windows. It is the longest whose smoothing lets
        at least as much white noise pass as an ideal low-pass filter with this cut-off, a share
        of 2 cut-off / rate of its variance, so that the window takes nothing that the filter was
        to keep; about 1.76 rate / cut-off samples, and at least 5.

    Returns
    -------
    Weights

    Raises
    ------
    DataError
        When there is no such scheme, or the cut-off is missing for local polynomials.
    """
    if name == "savitzky_golay":
        if cutoff_over_rate is None or not 0.0 < cutoff_over_rate < 0.5:
            raise DataError(
                f"derivative: 'savitzky_golay' needs the cut-off over the sample rate, between 0 "
                f"and 0.5, for the length of its window; it is {cutoff_over_rate}."
            )
        return _savitzky_golay(_half_window(2.0 * cutoff_over_rate))
    if name not in _WEIGHTS:
        raise DataError(
            f"derivative: {name!r} is unknown here; choose one of {', '.join(_WEIGHTS)}, "
            "savitzky_golay."
        )
    odd, even = _WEIGHTS[name]
    return Weights(
        first=frozen([-w for w in odd[::-1]] + [0.0] + list(odd)),
        second=frozen(list(even[:0:-1]) + list(even)),
    )


def _passed_noise(half: int) -> float:
    """Return the share of white noise's variance that a fit of degree 4 lets pass.

    It is the middle weight of the smoothing, since smoothing is a projection.
    """
    place = np.arange(-half, half + 1) / half
    even = np.stack([place**0, place**2, place**4])
    return float(np.linalg.lstsq(even, np.array([1.0, 0.0, 0.0]))[0][half])


def _half_window(share: float) -> int:
    """Return the largest m whose window lets at least this share of white noise pass."""
    low, high = _DEGREE // 2, _DEGREE
    while _passed_noise(high) >= share:
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        if _passed_noise(middle) >= share:
            low = middle
        else:
            high = middle
    return low


def _savitzky_golay(half: int) -> Weights:
    """Return the derivatives of polynomials fitted to 2 half + 1 samples.

    The same as SciPy's savgol_coeffs, which takes powers of the sample number as they are and so
    leaves rounding that shows in accelerations once a window has hundreds of samples.
    """
    place = np.arange(-half, half + 1) / half
    # The shortest weights that give each power its derivative in the middle; by symmetry the
    # first derivative concerns odd powers alone, the second even ones.
    odd, even = np.stack([place, place**3]), np.stack([place**0, place**2, place**4])
    first = np.linalg.lstsq(odd, np.array([1.0, 0.0]))[0] / half
    second = np.linalg.lstsq(even, np.array([0.0, 2.0, 0.0]))[0] / half**2
    # Antisymmetric and without effect on a constant to the last bit.
    first = (first - first[::-1]) / 2.0
    second = (second + second[::-1]) / 2.0
    second[half] -= second.sum()
    return Weights(first=frozen(first), second=frozen(second))


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
        for _ in range(2):
            # A constant passes as it is: what is added to it starts from rest.
            signal = (signal[:1] + self._passed(signal - signal[:1]))[::-1]
        return signal

    def _passed(self, signal: Array) -> Array:
        """Return signals (N,) or (N, c) after all sections, which were at rest.

        ``y_k + a1 y_(k-1) + a2 y_(k-2) = b0 x_k + b1 x_(k-1) + b2 x_(k-2)`` is a banded triangular
        system, for which `scipy.signal` need not be loaded; large ones are solved faster by it.
        """
        if signal.size > _LARGE:
            from scipy.signal import sosfilt

            # SciPy asks for a writable array, though it does not write to it.
            return np.asarray(sosfilt(np.array(self.sections), signal, axis=0))
        from scipy.linalg.lapack import dtbtrs

        x = signal.reshape(len(signal), -1)
        for section in self.sections:
            driven = section[0] * x
            driven[1:] += section[1] * x[:-1]
            driven[2:] += section[2] * x[:-2]
            x, _ = dtbtrs(np.repeat(section[3:, None], len(x), axis=1), driven, uplo="L")
        return x.reshape(signal.shape)

    def gain(self, frequency_hz: Array | float, rate_hz: float) -> Array:
        """Return the gain of the forward and backward passes together at given frequencies."""
        delay = np.exp(-2j * math.pi * np.atleast_1d(frequency_hz) / rate_hz)
        powers = np.stack([np.ones_like(delay), delay, delay**2])
        response = (self.sections[:, :3] @ powers) / (self.sections[:, 3:] @ powers)
        return np.asarray(np.abs(response.prod(axis=0)) ** 2)


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
        return correlated(signal, self.weights)

    def gain(self, frequency_hz: Array | float, rate_hz: float) -> Array:
        """Return the gain at given frequencies."""
        lag = np.arange(-self.reach, self.reach + 1) / rate_hz
        phase = 2.0 * math.pi * np.multiply.outer(np.atleast_1d(frequency_hz), lag)
        gain: Array = np.cos(phase) @ self.weights
        return gain


def correlated(signal: Array, weights: Array) -> Array:
    """Return sums of each sample's neighbors in signals (N, ...) with weights (2 reach + 1,).

    Beyond the ends the outermost value is taken. As SciPy's `correlate1d`, which loads long.
    """
    reach = len(weights) // 2
    padded = np.pad(signal.reshape(len(signal), -1), ((reach, reach), (0, 0)), mode="edge")
    found = [np.correlate(column, weights, "valid") for column in padded.T]
    return np.stack(found, axis=1).reshape(signal.shape)


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
    if kind == "bessel":
        from scipy.signal import bessel

        _, poles, _ = bessel(order, cutoff_hz, fs=rate_hz, norm="mag", output="zpk")
    else:
        # On a half circle in continuous time, and from there by the bilinear transform.
        angles = math.pi * (2.0 * np.arange(order) + order + 1.0) / (2.0 * order)
        continuous = 2.0 * math.tan(math.pi * cutoff_hz / rate_hz) * np.exp(1j * angles)
        poles = (2.0 + continuous) / (2.0 - continuous)
    sections = _sections(poles)
    slowest = float(np.abs(poles).max())
    # A cut-off close to half the rate puts the poles near the origin: at least one sample.
    time_constant = max(1.0, -1.0 / math.log(slowest)) if slowest > 0.0 else 1.0
    return ZeroPhaseFilter(sections=frozen(sections), time_constant=time_constant)


def _sections(poles: Array) -> Array:
    """Return the second-order sections (S, 6) of a low-pass filter by its poles.

    All its zeros are at half the sample rate, and each section passes a constant as it is.
    """
    upper = poles[np.argsort(-poles.imag)][: (len(poles) + 1) // 2]
    own = np.stack([np.ones(len(upper)), -2.0 * upper.real, np.abs(upper) ** 2], axis=1)
    zeros = np.tile([1.0, 2.0, 1.0], (len(upper), 1))
    if len(poles) % 2:
        # The one in the middle is real, but for rounding.
        own[-1], zeros[-1] = (1.0, -upper[-1].real, 0.0), (1.0, 1.0, 0.0)
    zeros *= own.sum(axis=1, keepdims=True) / zeros.sum(axis=1, keepdims=True)
    return np.hstack([zeros, own])
