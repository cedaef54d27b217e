"""Tell rest from motion, joint by joint.

At rest a joint's effort is anything that stiction holds, and no function of the velocity explains
it; an error there says little of the model, and must not be mixed with that in motion.
"""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Mask
from sdpid.experiment.processing.samples import Samples

# A joint slower than this (rad/s) for longer than this (s) rests. Velocity noise at standstill
# stays below, and a reversal is over sooner: at the slowest accelerations of excitations
# (0.1 rad/s²) the velocity is below for 0.4 s.
REST_SPEED, REST_SECONDS = 0.02, 0.5


def rows_in_use(samples: Samples) -> Mask:
    """Return the mask (K, n) of the rows in use, all of them where the samples have none."""
    if samples.mask is None:
        return np.ones(samples.effort.shape, dtype=bool)
    return np.asarray(samples.mask)


def resting(samples: Samples) -> Mask:
    """Return which rows (K, n) are of resting joints; none where samples have no time."""
    found = np.zeros(samples.effort.shape, dtype=bool)
    if samples.time is None:
        return found
    for part in samples.parts:
        time = samples.time[part]
        slow = np.abs(samples.velocity[part]) < REST_SPEED
        for j in range(samples.n):
            steps = np.diff(slow[:, j].astype(np.int8), prepend=0, append=0)
            first, behind = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
            for a, b in zip(first.tolist(), behind.tolist(), strict=True):
                found[part.start + a : part.start + b, j] = time[b - 1] - time[a] > REST_SECONDS
    return found
