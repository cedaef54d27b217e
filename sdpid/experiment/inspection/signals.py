"""Statistics of recorded channels: noise, bandwidth, gaps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.recording.recording import Recording

__all__ = ["bandwidth", "gaps", "noise"]

# A difference of order k multiplies the variance of white noise by binomial(2 k, k), and the
# fourth all but removes a motion that is ten times slower than the samples.
_ORDER = 4
# This share of the power of the motion lies below its bandwidth.
_SHARE = 0.95
# A step longer than this many nominal ones is a gap; less is jitter.
_GAP = 1.5


def noise(column: Array) -> float:
    """Return the standard deviation of the white noise of a channel.

    From its differences of fourth order, in which a motion well below the sampling rate does not
    show; for a motion that is not, it is an upper bound.
    """
    if column.size <= _ORDER:
        return 0.0
    differences = np.diff(column, n=_ORDER)
    scale = math.comb(2 * _ORDER, _ORDER)
    return float(np.sqrt(np.mean(differences * differences) / scale))


def bandwidth(column: Array, rate_hz: float) -> tuple[float, float] | None:
    """Return the dominant frequency and the one below which 95 % of the power lies, in Hz.

    The mean is removed and a Hann window applied. None for a channel that does not change.
    """
    centred = column - column.mean()
    if not np.any(centred):
        return None
    power = np.abs(np.fft.rfft(np.hanning(column.size) * centred)) ** 2
    power[0] = 0.0
    total = float(power.sum())
    if not total > 0.0 or not math.isfinite(total):
        return None
    below = int(np.searchsorted(np.cumsum(power), _SHARE * total))
    per_bin = rate_hz / column.size
    return float(np.argmax(power)) * per_bin, below * per_bin


def gaps(recording: Recording) -> dict[str, Any]:
    """Return how many steps are longer than 1.5 nominal ones, and the longest of all.

    Returns
    -------
    dict
        ``gaps``, ``longest_step_s`` and ``longest_step_row``: the row that ends it.
    """
    steps = np.diff(recording.time)
    row = int(np.argmax(steps))
    return {
        "gaps": int(np.count_nonzero(steps > _GAP * recording.step)),
        "longest_step_s": float(steps[row]),
        "longest_step_row": row + 1,
    }
