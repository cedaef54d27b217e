"""The filter that leaves the least error of an acceleration, from the spectrum of positions.

A low-pass filter takes from the motion what lies above its cut-off and leaves of the noise what
lies below. Both can be told from the spectrum of a record. This is Winter's residual analysis
[winter2009]_ carried to the acceleration, which has the most noise and enters the equation of
motion, with the expected error in place of a knee in a curve.

Positions of real robots do not have white noise alone. Quanta, and stamps that are off while the
joint moves, leave errors whose rate is white, so both shapes are fitted to the upper part of the
spectrum and continued downwards. Motion is what lies below the frequency at which the spectrum
meets them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.processing.filters import FilterType, low_pass
from sdpid.experiment.recording.recording import Recording

__all__ = ["FoundFilter", "least_error_filter"]

# The noise is read off above this share of the sampling rate, where arms do not move.
_NOISE_ABOVE = 0.1
# The spectrum is summed over so many bands a decade, and so many cut-offs are tried in one: near
# its least the error changes little.
_BANDS = 40
_CUTOFFS = 12
# Motion ends where, over an octave, the power is no more than so many times that of the noise,
# whose shape is a guess. What stands out further up is vibration, which no rigid model explains.
_STANDS_OUT = 4.0
_ORDERS = (1, 2, 3, 4)
# In the order in which they are preferred.
_TYPES: tuple[FilterType, ...] = ("butterworth", "bessel")
# A higher order (longer memory) or another type must be better by this part of the error.
_SLACK = 0.05


@dataclass(frozen=True, kw_only=True)
class FoundFilter:
    """The best of all filters tried.

    Attributes
    ----------
    filter : {"butterworth", "bessel"}
    order : int
    cutoff_hz : float
        As in `Processing`.
    error, taken, left : float
        Expected error of the filtered acceleration, and its two parts: taken from the motion and
        left of the noise; rms over the joints, relative to each joint's acceleration.
    slack : float
        A filter of lower order was taken for an error larger by at most this part.
    """

    filter: FilterType
    order: int
    cutoff_hz: float
    error: float
    taken: float
    left: float
    slack: float = _SLACK


def least_error_filter(log: Recording, lowest_hz: float, highest_hz: float) -> FoundFilter:
    """Return the filter with the least expected error of the acceleration.

    Parameters
    ----------
    log : Recording
        Without gaps and wrapped angles.
    lowest_hz, highest_hz : float
        Between them the cut-off is looked for; the lowest is taken to be no higher than the other.

    Returns
    -------
    FoundFilter

    Raises
    ------
    DataError
        When no joint's motion stands out of its noise.
    """
    lowest_hz = min(lowest_hz, highest_hz)
    frequency, motion, noise = _accelerations(log)
    total = motion.sum(axis=0)
    moves = total > 0.0
    if not moves.any():
        raise DataError("position: no joint's motion stands out of its noise.")
    # Each joint counts alike.
    signal = (motion[:, moves] / total[moves]).mean(axis=1)
    floor = (noise[:, moves] / total[moves]).mean(axis=1)
    count = max(2, math.ceil(_CUTOFFS * math.log10(highest_hz / lowest_hz)) + 1)
    # The ends as they were given, to the last bit.
    between = np.geomspace(lowest_hz, highest_hz, count)[1:-1]
    tried = [lowest_hz, *between.tolist(), highest_hz]
    best: list[FoundFilter] = []
    for kind in _TYPES:
        for order in _ORDERS:
            found = []
            for cutoff in tried:
                gain = low_pass(kind, cutoff, order, log.rate_hz).gain(frequency, log.rate_hz)
                taken = float(signal @ (1.0 - gain) ** 2)
                left = float(floor @ gain**2)
                found.append(
                    FoundFilter(
                        filter=kind,
                        order=order,
                        cutoff_hz=cutoff,
                        error=math.sqrt(taken + left),
                        taken=math.sqrt(taken),
                        left=math.sqrt(left),
                    )
                )
            best.append(min(found, key=lambda each: each.error))
    least = min(each.error for each in best)
    good = [each for each in best if each.error <= (1.0 + _SLACK) * least]
    return min(good, key=lambda each: (_TYPES.index(each.filter), each.order))


def _accelerations(log: Recording) -> tuple[Array, Array, Array]:
    """Return the frequencies (B,) of bands, and power of acceleration and of its noise (B, n).

    Of second differences, which are what the filter is followed by; their spectrum is steep
    neither way, so that a window of Hann keeps bands apart.
    """
    count = log.n_samples - 2
    if count < 8:
        raise DataError(f"position: {log.n_samples} samples are too few for a spectrum.")
    differences = np.diff(np.asarray(log.position), n=2, axis=0)
    differences *= np.hanning(count)[:, None]
    power = np.abs(np.fft.rfft(differences, axis=0)[1:]) ** 2
    frequency = np.fft.rfftfreq(count, 1.0 / log.rate_hz)[1:]
    bands = np.unique(np.floor(_BANDS * np.log10(frequency / frequency[0])), return_index=True)[1]
    lines = np.diff(np.append(bands, frequency.size))
    seen = np.add.reduceat(power, bands, axis=0)
    # White noise of the rate of the position and of the position, differenced once and twice.
    shape = (2.0 * np.sin(math.pi * frequency / log.rate_hz)) ** 2
    shapes = np.column_stack([np.add.reduceat(shape**k, bands) for k in (1, 2)])
    centre = np.add.reduceat(frequency, bands) / lines
    noise = _noise(shapes, seen, centre > _NOISE_ABOVE * log.rate_hz)
    return centre, *_parted(seen, noise)


def _parted(seen: Array, noise: Array) -> tuple[Array, Array]:
    """Part what was seen (B, n) into motion, below where it meets the noise, and the rest."""
    octave = round(_BANDS * math.log10(2.0))
    motion, rest = np.zeros_like(seen), seen.copy()
    for j in range(seen.shape[1]):
        known = noise[:, j] > 0.0
        ratio = np.divide(seen[:, j], noise[:, j], out=np.full(len(seen), np.inf), where=known)
        # Over an octave, so that what lies between the harmonics of a motion is not its end.
        above = [ratio[b : b + octave].mean() <= _STANDS_OUT for b in range(len(ratio))]
        end = above.index(True) if True in above else len(above)
        rest[:end, j] = np.minimum(noise[:end, j], seen[:end, j])
        motion[:end, j] = seen[:end, j] - rest[:end, j]
    return motion, rest


def _noise(shapes: Array, seen: Array, quiet: NDArray[np.bool_]) -> Array:
    """Return the power of the noise (B, n): the two shapes, fitted where nothing moves."""
    from scipy.optimize import nnls

    noise = np.zeros_like(seen)
    for j in range(seen.shape[1]):
        used = quiet & (seen[:, j] > 0.0)
        if used.any():
            # Relative errors, since the power of a band scatters in proportion to itself.
            weights, _ = nnls(shapes[used] / seen[used, j, None], np.ones(np.count_nonzero(used)))
            noise[:, j] = shapes @ weights
    return noise
