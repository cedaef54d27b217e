"""Tell rest from motion, joint by joint.

At rest a joint's effort is anything that stiction holds, and no function of the velocity explains
it; an error there says little of the model, and must not be mixed with that in motion. Rows around
reversals belong to the motion, although a fit may leave them out.
"""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Mask
from sdpid.experiment.processing.samples import Samples

# A joint slower than this (rad/s) for longer than this (s) rests. Velocity noise at standstill
# stays below, and a reversal is over sooner: at the slowest accelerations of excitations
# (0.1 rad/s²) the velocity is below for 0.4 s.
REST_SPEED, REST_SECONDS = 0.02, 0.5


def moving_rows(samples: Samples) -> Mask:
    """Return the rows (K, n) that count in motion: not at rest, those masked for slowness too."""
    return _judged(samples) & ~resting(samples)


def resting_rows(samples: Samples) -> Mask:
    """Return the rows (K, n) that count at rest, those masked for slowness too."""
    return _judged(samples) & resting(samples)


def _judged(samples: Samples) -> Mask:
    """Return the rows in use (K, n), and stretches left out of them that slow motion is in.

    Of a joint without any row in use, whose effort was not measured, there are none. Nor are rows
    of samples with contacts that are left out: forces that nobody measured may push there at will.
    """
    used = samples.used
    if samples.contacts is not None:
        return used
    found = used.copy()
    for j in np.flatnonzero(used.any(axis=0) & ~used.all(axis=0)):
        for part in samples.parts:
            v = samples.velocity[part, j]
            slow = np.abs(v) < REST_SPEED
            # A reversal between two samples is at both.
            turns = np.flatnonzero(np.sign(v[1:]) != np.sign(v[:-1]))
            slow[turns] = slow[turns + 1] = True
            for stretch in _runs(~used[part, j]):
                if slow[stretch].any():
                    found[part.start + stretch.start : part.start + stretch.stop, j] = True
    return found


def _runs(values: Mask) -> list[slice]:
    """Return the stretches of True of a mask (K,)."""
    steps = np.diff(values.astype(np.int8), prepend=0, append=0)
    first, behind = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
    return [slice(a, b) for a, b in zip(first.tolist(), behind.tolist(), strict=True)]


def resting(samples: Samples) -> Mask:
    """Return which rows (K, n) are of resting joints; none where samples have no time."""
    found = np.zeros(samples.effort.shape, dtype=bool)
    if samples.time is None:
        return found
    for part in samples.parts:
        time = samples.time[part]
        slow = np.abs(samples.velocity[part]) < REST_SPEED
        for j in range(samples.n):
            for run in _runs(slow[:, j]):
                own = slice(part.start + run.start, part.start + run.stop)
                found[own, j] = time[run.stop - 1] - time[run.start] > REST_SECONDS
    return found
