"""By how much the measured motion lags behind that of its instruments."""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.experiment.processing.samples import Samples

# Lags are looked for up to this many seconds either way, and this part of a piece of the log: arms
# follow within a few tenths, and longer ones are no lag but another run.
_LONGEST, _PART = 1.0, 0.25

# A lag is one if it explains this part of what the two velocities differ by.
_EXPLAINED = 0.5


def lag_of(measured: Samples, instruments: Samples) -> float | None:
    """Return by how many seconds the measured motion comes later than another, negative: earlier.

    Velocities are compared, all joints in units of their rms, so that sagging does not matter.

    Parameters
    ----------
    measured, instruments : Samples
        Row by row of the same times.

    Returns
    -------
    float or None
        None where no lag of at least one sample explains half of the difference.
    """
    if measured.time is None:
        return None
    pieces, time = measured.parts, measured.time
    steps = [float(np.median(np.diff(time[part]))) for part in pieces if part.stop - part.start > 2]
    if not steps:
        return None
    step = max(steps)
    shortest = min(part.stop - part.start for part in pieces)
    most = int(min(_LONGEST / step, _PART * shortest))
    size = np.sqrt(np.mean(measured.velocity**2, axis=0))
    moved = size > 0.0
    mine, other = (each.velocity[:, moved] / size[moved] for each in (measured, instruments))
    shifts = np.arange(-most, most + 1)
    left = np.array([_left(mine, other, pieces, int(shift)) for shift in shifts])
    best = int(np.argmin(left))
    if shifts[best] == 0 or not left[best] < (1.0 - _EXPLAINED) * left[most]:
        return None
    return float(step * (shifts[best] + _between(left, best)))


def _left(mine: Array, other: Array, pieces: tuple[slice, ...], shift: int) -> float:
    """Return the mean square of ``mine(t + shift) − other(t)`` over all pieces."""
    total, count = 0.0, 0
    for part in pieces:
        ahead, behind = mine[part], other[part]
        rows: Indices = np.arange(max(0, -shift), len(ahead) - max(0, shift))
        off = ahead[rows + shift] - behind[rows]
        total, count = total + float(np.sum(off**2)), count + off.size
    return total / max(count, 1)


def _between(left: Array, best: int) -> float:
    """Return where a parabola through the least value and its neighbors is least."""
    if not 0 < best < len(left) - 1:
        return 0.0
    before, here, after = left[best - 1 : best + 2]
    bend = before - 2.0 * here + after
    return float(0.5 * (before - after) / bend) if bend > 0.0 else 0.0


def lag_words(lag: float) -> str:
    """Return a lag in words: 'the measured motion lags 40 ms behind it'."""
    size = f"{1e3 * abs(lag):.3g} ms"
    if lag > 0.0:
        return f"the measured motion lags {size} behind it"
    return f"the measured motion runs {size} ahead of it"
