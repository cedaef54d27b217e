"""Zero-phase low-pass filters, and derivatives of sampled signals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sdpid._common.arrays import Array, frozen
from sdpid.errors import DataError

FilterType = Literal["butterworth", "finite"]
Derivative = Literal["central", "central4", "central6"]

# After this many time constants exp(-45) = 3e-20 of a disturbance is left: below rounding, also
# with the polynomial factors of repeated passes.
_FORGOTTEN = 45.0
# Samples before the first kept one and behind the last, in time constants: exp(-20) is 2e-9 of what
# the guess at the ends would be off.
_LEAD = 20.0
# Numbers from which on `scipy.signal` is worth its loading, 0.3 s once: it takes 6 ns for a section
# of a number, a triangular system 60 ns.
_LARGE = 2**19
# Five time constants, which are cut off the ends of a record, are then the whole memory of a finite
# filter.
_CUT_OFF = 5.0

# Differences of fourth order lose no more than 2 % of a velocity up to this share of the rate.
BAND_OVER_RATE = 1.0 / 7.5

# Half of the weights, from the middle outwards; the first derivative's are odd. [fornberg1988]_
_WEIGHTS: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "central": ((1 / 2,), (-2.0, 1.0)),
    "central4": ((2 / 3, -1 / 12), (-5 / 2, 4 / 3, -1 / 12)),
    "central6": ((3 / 4, -3 / 20, 1 / 60), (-49 / 18, 3 / 2, -3 / 20, 1 / 90)),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Weights:
    """Weights of neighboring samples that make derivatives of uniformly sampled signals.

    Attributes
    ----------
    first, second : (2 m + 1,) ndarray
        Weights of the first and of the second derivative, for a unit step.
    """

    first: Array
    second: Array

    @property
    def margin(self) -> int:
        """Number of samples m needed on either side."""
        return self.first.size // 2

    def velocity(self, signal: Array, step: float) -> Array:
        """Return the first derivative of (N,) or (N, c) samples at the inner N - 2 m ones."""
        return _neighbors(signal, self.first) / step

    def acceleration(self, signal: Array, step: float) -> Array:
        """Return the second derivative of (N,) or (N, c) samples at the inner N - 2 m ones."""
        return _neighbors(signal, self.second) / step**2


def stencil(name: Derivative) -> Weights:
    """Return the weights of central differences of order 2, 4 or 6 [fornberg1988]_."""
    odd, even = _WEIGHTS[name]
    return Weights(
        first=frozen([-w for w in odd[::-1]] + [0.0] + list(odd)),
        second=frozen(list(even[:0:-1]) + list(even)),
    )


def correlated(signal: Array, weights: Array) -> Array:
    """Return sums of each sample's neighbors in signals (N, ...) with weights (2 reach + 1,).

    Beyond the ends the outermost value is taken. As SciPy's `correlate1d`, which loads long.
    """
    reach = len(weights) // 2
    flat = signal.reshape(len(signal), -1)
    padded = np.pad(flat, ((reach, reach), (0, 0)), mode="edge")
    return _neighbors(padded, weights).reshape(signal.shape)


def _neighbors(signal: Array, weights: Array) -> Array:
    """Return the weighted sums of neighbors in signals (N,) or (N, c), without the ends."""
    if signal.ndim == 1:
        return np.correlate(signal, weights, "valid")
    return np.stack([np.correlate(column, weights, "valid") for column in signal.T], axis=1)


def reflected(signal: Array, left: int, right: int) -> Array:
    """Continue signals (N, ...) by point reflection at their ends, then by the last values."""
    if not left and not right:
        return signal
    before, after = min(left, len(signal) - 1), min(right, len(signal) - 1)
    rest = [(0, 0)] * (signal.ndim - 1)
    extended = np.pad(signal, [(before, after), *rest], mode="reflect", reflect_type="odd")
    return np.pad(extended, [(left - before, right - after), *rest], mode="edge")


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

    @property
    def lead(self) -> int:
        """Number of samples on either side of what is wanted that make its ends good to 2e-9."""
        return min(math.ceil(_LEAD * self.time_constant), self.reach)

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

    def whole(self, signal: Array) -> Array:
        """Filter signals (N, ...) whose ends are continued by point reflection."""
        flat = signal.reshape(len(signal), -1)
        reach = min(self.reach, len(flat) - 1)
        passed = self.apply(reflected(flat, reach, reach))[reach : reach + len(flat)]
        return passed.reshape(signal.shape)

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
        return np.asarray(np.cos(phase) @ self.weights)


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
    kind : {"butterworth", "finite"}
        ``"butterworth"`` has the flattest pass band. ``"finite"`` is a sinc under a Hann window,
        which sees samples up to order / (2 cut-off) away and no others.
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
        When the cut-off is not below half the sample rate.
    """
    if not cutoff_hz < rate_hz / 2.0:
        raise DataError(
            f"cutoff_hz: {cutoff_hz:g} Hz is not below half the sample rate of {rate_hz:.6g} Hz; "
            f"choose one below {rate_hz / 2.0:.6g} Hz."
        )
    if kind == "finite":
        return _finite(cutoff_hz, order, rate_hz)
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
