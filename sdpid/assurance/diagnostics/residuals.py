"""Statistics of prediction errors: spectrum, autocorrelation, dependence on velocity.

Errors of a model that lacks nothing are noise: a flat spectrum below the filter's cut-off, an
autocorrelation that falls at once, and a mean of zero at every velocity. Where they are not, their
shape says what is missing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen
from sdpid.assurance.diagnostics.validation import Validation
from sdpid.estimation.compression.covariance import LaggedSums, integrated_time
from sdpid.experiment.processing.samples import Samples

# Velocities are sorted into this many bins of equally many rows: enough for the two sides of a
# friction curve with a bend in each, few enough for a steady mean in every one.
BINS = 16

# Samples a piece of the spectrum (Welch's): a few hundred frequencies are what a plot shows.
_PIECE = 1024

# Lags of the autocorrelation that are kept: a tenth of the record, at most this many seconds.
_LAG_SHARE, _LAG_SECONDS = 0.1, 2.0


@dataclass(frozen=True, kw_only=True, eq=False)
class JointErrors:
    """The errors of one joint.

    Attributes
    ----------
    joint : str
        The joint.
    frequency : ndarray, shape (f,)
        In Hz; per sample where the samples have no time.
    effort_density, error_density : ndarray, shape (f,)
        Amplitude densities of measured effort and of its error, N·m/√Hz.
    lag : ndarray, shape (l,)
        In s; in samples where they have no time.
    autocorrelation : ndarray, shape (l,)
        Of the errors; 1 at lag 0.
    independent : float
        About how many independent ones the rows are worth.
    velocity, mean, low, high : ndarray, shape (bins,)
        Mean velocity of each bin (rad/s), mean of its errors, and the tenth and the ninetieth of
        a hundred of them, N·m. Empty where the joint does not move.
    share : float
        Share of the errors' variance that goes with the velocity's bin, less what chance gives.
    with_sign, with_velocity : float
        Squared correlations of the errors with the velocity's sign and with the velocity.
    """

    joint: str
    frequency: Array
    effort_density: Array
    error_density: Array
    lag: Array
    autocorrelation: Array
    independent: float
    velocity: Array
    mean: Array
    low: Array
    high: Array
    share: float
    with_sign: float
    with_velocity: float


def joint_errors(samples: Samples, fit: Validation) -> tuple[JointErrors, ...]:
    """Return the error statistics of every joint.

    Parameters
    ----------
    samples : Samples
        The measurements that were predicted.
    fit : Validation
        Their prediction.

    Returns
    -------
    tuple of JointErrors
        One for every joint with rows that are not masked.
    """
    rate = 1.0 / period(samples)
    error = samples.effort - fit.effort_predicted
    found = []
    for j, name in enumerate(fit.joint_names):
        kept = samples.used[:, j]
        if np.count_nonzero(kept) < 2 or j < fit.n_base:
            continue
        found.append(_of_joint(name, error[:, j], samples, j, kept, rate))
    return tuple(found)


def period(samples: Samples) -> float:
    """Return the seconds between samples, by their median; 1 where they have no time."""
    if samples.time is None or len(samples.time) < 2:
        return 1.0
    step = float(np.median(np.diff(samples.time)))
    return step if step > 0.0 else 1.0


def _of_joint(
    name: str, error: Array, samples: Samples, j: int, kept: Mask, rate: float
) -> JointErrors:
    mean = float(error[kept].mean())
    centerd = np.where(kept, error - mean, 0.0)
    lags = int(max(min(_LAG_SHARE * len(error), _LAG_SECONDS * rate), 1)) + 1
    paired = LaggedSums.of(centerd[:, None], kept[:, None], samples.parts)
    correlation = paired.correlation[0, :lags]
    effort = samples.effort[:, j]
    densities = []
    for signal in (np.where(kept, effort - effort[kept].mean(), 0.0), centerd):
        frequency, density = _density(signal, samples.parts, rate)
        # Rows that are not used are zero; the others carry all of the power.
        densities.append(np.sqrt(np.maximum(density, 0.0) * len(kept) / kept.sum()))
    independent = max(float(kept.sum()) / integrated_time(paired.correlation[0]), 1.0)
    v, e = samples.velocity[kept, j], error[kept]
    binned, share = _over_velocity(v, e, independent)
    return JointErrors(
        joint=name,
        frequency=frozen(frequency),
        effort_density=frozen(densities[0]),
        error_density=frozen(densities[1]),
        lag=frozen(np.arange(len(correlation)) / rate),
        autocorrelation=frozen(correlation),
        independent=independent,
        velocity=frozen(binned[0]),
        mean=frozen(binned[1]),
        low=frozen(binned[2]),
        high=frozen(binned[3]),
        share=share,
        with_sign=_squared_correlation(np.sign(v), e),
        with_velocity=_squared_correlation(v, e),
    )


def density(signal: Array, samples: Samples) -> Array:
    """Return the power density of a signal (K,) of samples, at the frequencies of `JointErrors`."""
    return _density(signal, samples.parts, 1.0 / period(samples))[1]


def _density(signal: Array, parts: tuple[slice, ...], rate: float) -> tuple[Array, Array]:
    """Return frequencies and the power density of a signal; no piece of it lies across a break."""
    lengths = [part.stop - part.start for part in parts]
    size = min(_PIECE, *lengths)
    total: Array = np.zeros(size // 2 + 1)
    for part, length in zip(parts, lengths, strict=True):
        total += _welch(signal[part], size, rate) * (length / len(signal))
    return np.asarray(np.fft.rfftfreq(size, 1.0 / rate), dtype=np.float64), total


def _welch(signal: Array, size: int, rate: float) -> Array:
    """Return the power density of a signal by pieces of `size` that overlap by half.

    As SciPy's `welch`, whose module takes longer to load than all the rest of a report to write.
    """
    window = np.sin(np.pi * np.arange(size) / size) ** 2 if size > 1 else np.ones(1)
    pieces = np.lib.stride_tricks.sliding_window_view(signal, size)[:: size - size // 2]
    power = np.mean(np.abs(np.fft.rfft(pieces * window)) ** 2, axis=0)
    # Of a real signal negative frequencies have as much; there are none of zero and of the last.
    power[1 : (size + 1) // 2] *= 2.0
    return np.asarray(power / (rate * np.sum(window**2)))


def _over_velocity(v: Array, e: Array, independent: float) -> tuple[Array, float]:
    """Return velocity, mean, low and high (4, bins), and the share that goes with them."""
    edges = np.unique(np.quantile(v, np.linspace(0.0, 1.0, BINS + 1)))
    if len(edges) < 3:
        return np.zeros((4, 0)), 0.0
    index = np.clip(np.searchsorted(edges, v, side="right") - 1, 0, len(edges) - 2)
    rows, between = [], 0.0
    for k in range(len(edges) - 1):
        inside = index == k
        if not inside.any():
            continue
        part = e[inside]
        rows.append((v[inside].mean(), part.mean(), *np.quantile(part, (0.1, 0.9))))
        between += len(part) * (rows[-1][1] - e.mean()) ** 2
    total = float(np.sum((e - e.mean()) ** 2))
    if total <= 0.0:
        return np.asarray(rows).T, 0.0
    chance = (len(rows) - 1) / max(independent - 1.0, 1.0)
    return np.asarray(rows).T, float(np.clip(between / total - chance, 0.0, 1.0))


def _squared_correlation(x: Array, e: Array) -> float:
    x, e = x - x.mean(), e - e.mean()
    size = float((x @ x) * (e @ e))
    return float(x @ e) ** 2 / size if size > 0.0 else 0.0
