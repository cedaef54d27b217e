"""Frequencies of a recorded motion: where most of its power is, and below which 95 % of it lies."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.recording.plausible import AT_REST, moving
from sdpid.experiment.recording.recording import Recording

# This share of a motion's power lies below its highest frequency.
MOTION_SHARE = 0.95
# Records with more samples than this (four minutes at 1 kHz) are averaged over neighbors down to
# a rate of at least this many Hz before their spectrum is taken: arms do not move at half of that.
_LONG = 1 << 18
_RATE_OF_MOTION = 100.0
# Above this share of half the sample rate joints do not move: what is there is noise.
_NOISE_ONLY = 2.0 / 3.0
# Fourth differences of motion are less than this of its amplitude at a tenth of the sampling rate;
# white noise of variance one has a variance of this in them: 1 + 16 + 36 + 16 + 1.
_DIFFERENCES = 4
_GAIN = 70.0


def motion_frequency(log: Recording) -> float:
    """Return the frequency in Hz below which 95 % of the motion lies.

    The median over the joints that move: those at rest show nothing but noise.

    Raises
    ------
    DataError
        When no joint moves.
    """
    highest = [each[1] for each in joint_frequencies(log) if each is not None]
    if not highest:
        raise DataError(
            f"position: no joint moves by more than {AT_REST:g} rad; nothing can be identified."
        )
    return float(np.median(highest))


def joint_frequencies(log: Recording) -> list[tuple[float, float] | None]:
    """Return each joint's dominant frequency and the one below which 95 % of its power lies, Hz.

    The mean is removed and a Hann window applied. Of records of more than 2^18 samples positions
    are averaged over neighbors first, to a rate of at least 100 Hz, and the amplitudes that the
    average takes are given back. None for a joint that does not move (see `moving`).
    """
    moves = moving(*log.position_range).tolist()
    return [
        band(frequency, power) if moves_itself else None
        for (frequency, power), moves_itself in zip(_spectra(log), moves, strict=True)
    ]


def band(frequency: Array, power: Array) -> tuple[float, float] | None:
    """Return the dominant frequency and the one below which 95 % of the power lies, Hz."""
    total = power.sum()
    if not 0.0 < total < np.inf:
        return None
    below = int(np.count_nonzero(np.cumsum(power / total) < MOTION_SHARE))
    dominant = 1 + int(np.argmax(power[1:])) if power.size > 1 else 0
    return float(frequency[dominant]), float(frequency[below])


def noise_limit(log: Recording, share: float) -> float:
    """Return the frequency in Hz up to which noise is at most a share of joint accelerations.

    Noise of positions is white, as strong as they are on top (see `noise_of`). In accelerations it
    grows with the fourth power of the frequency. Of the joints that move, the one in the middle
    counts. Infinite where there is no such frequency.

    Parameters
    ----------
    log : Recording
        Without gaps; of longer ones the first 2^18 samples count.
    share : float
        Of noise in the power of accelerations below the frequency.
    """
    count = min(log.n_samples, _LONG)
    shares = []
    for j in np.flatnonzero(moving(*log.position_range)).tolist():
        position = np.asarray(log.position[:count, j])
        frequency, power = spectrum(position, log.rate_hz, count)
        noise = _on_top(frequency, power)
        weight = frequency**4
        whole = np.cumsum(weight * power)
        shares.append(noise * np.cumsum(weight) / np.where(whole > 0.0, whole, np.inf))
    if not shares:
        return np.inf
    # At 0 Hz there is none. Noise alone lies below the motion, too: the last such frequency counts.
    last = int(np.flatnonzero(np.median(shares, axis=0) <= share)[-1])
    return float(frequency[last]) if last + 1 < len(frequency) else np.inf


def noise_of(signals: Array, rate_hz: float) -> Array:
    """Return the standard deviation (n,) of white noise as strong as signals (N, n) are on top.

    The median of the power above two thirds of half the sample rate is that of noise, whatever
    single lines stand out; of noise that is white, it is ln 2 of the mean.
    """
    n_samples = len(signals)
    window = float(np.square(np.hanning(n_samples)).sum())
    columns = np.asarray(signals).T
    powers = [_on_top(*spectrum(np.asarray(each), rate_hz, n_samples)) for each in columns]
    return np.sqrt(np.array(powers) / window)


def fourth_differences(signals: Array) -> Array:
    """Return differences of signals (N, n) that hardly hold motion, but white noise in full.

    They are scaled so that white noise has the variance in them that it has in the signals.
    """
    return np.asarray(np.diff(signals, _DIFFERENCES, axis=0) / np.sqrt(_GAIN))


def white_noise(signals: Array) -> float:
    """Return the white noise of signals (N, ...) by fourth differences, rms in a sample of one.

    An upper bound where a motion is not well below the sampling rate.
    """
    differences = fourth_differences(signals)
    return float(np.sqrt(np.mean(differences**2))) if differences.size else 0.0


def _on_top(frequency: Array, power: Array) -> float:
    """Return the mean power of noise as strong as the highest frequencies."""
    top = power[frequency > _NOISE_ONLY * frequency[-1]]
    return float(np.median(top) / np.log(2.0)) if top.size else 0.0


def _spectra(log: Recording) -> Iterator[tuple[Array, Array]]:
    """Yield frequencies in Hz, and the power of the motion at them, for each joint."""
    long = log.n_samples > _LONG
    each = max(int(log.rate_hz / _RATE_OF_MOTION), 1) if long else 1
    count = log.n_samples // each
    # A product of small factors is transformed several times faster than any other length.
    step = 1 << max(count.bit_length() - 5, 0) if long else 1
    for j in range(log.n):
        means = np.asarray(log.position[: each * count, j]).reshape(count, each).mean(axis=1)
        # Of a joint that does not move nothing is left, not even rounding.
        frequency, power = spectrum(means - means[0], log.rate_hz / each, -(-count // step) * step)
        # The share of an oscillation's amplitude that the average over its neighbors leaves.
        angle = np.pi * frequency[1:] / log.rate_hz
        power[1:] /= (np.sin(each * angle) / (each * np.sin(angle))) ** 2
        yield frequency, power


def spectrum(position: Array, rate_hz: float, length: int) -> tuple[Array, Array]:
    """Return frequencies, and the power of positions (N,) at them, zeros appended to `length`."""
    # A window, so that a record that does not end where it began does not look fast.
    centered = np.hanning(position.size) * (position - position.mean())
    power: Array = np.abs(np.fft.rfft(centered, length)) ** 2
    return np.asarray(np.fft.rfftfreq(length, 1.0 / rate_hz), dtype=np.float64), power


def power_density(
    signal: Array, rate_hz: float, size: int, *, centered: bool = False
) -> tuple[Array, Array]:
    """Return frequencies and the power density of a signal (N,), of pieces of `size` rows.

    By pieces that overlap by half, as SciPy's `welch`, whose module takes longer to load than a log
    to look at. Where `centered`, each piece loses its mean.
    """
    window = np.sin(np.pi * np.arange(size) / size) ** 2 if size > 1 else np.ones(1)
    pieces = np.lib.stride_tricks.sliding_window_view(signal, size)[:: size - size // 2]
    if centered:
        pieces = pieces - pieces.mean(axis=1, keepdims=True)
    power = np.mean(np.abs(np.fft.rfft(pieces * window)) ** 2, axis=0)
    power = power / (rate_hz * np.sum(window**2))
    # Of a real signal negative frequencies have as much; there are none of zero and of the last.
    power[1 : (size + 1) // 2] *= 2.0
    return np.asarray(np.fft.rfftfreq(size, 1.0 / rate_hz), dtype=np.float64), power
