"""Tell rest from motion, joint by joint.

At rest a joint's effort is anything that stiction holds, and no function of the velocity explains
it; an error there says little of the model, and must not be mixed with that in motion. Rows around
reversals belong to the motion, although a fit may leave them out.
"""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.experiment.processing.samples import Samples

# A joint slower than this (rad/s) for longer than this (s) rests. Velocity noise at standstill
# stays below, and a reversal is over sooner: at the slowest accelerations of excitations
# (0.1 rad/s²) the velocity is below for 0.4 s.
REST_SPEED, REST_SECONDS = 0.02, 0.5
# The same of sliding joints (m/s): what that is 5 cm from the axis. Lifts of arms reach 20 mm/s.
_SLIDING_SPEED = 0.001


def rest_speeds(slides: Mask) -> Array:
    """Return the speed (n,) that joints at rest stay below: rad/s, or m/s of those that slide."""
    return np.where(slides, _SLIDING_SPEED, REST_SPEED)


def moving_rows(samples: Samples, slides: Mask | None = None) -> Mask:
    """Return the rows (K, n) that count in motion: not at rest, those masked for slowness too."""
    return _judged(samples, _slow(samples, slides)) & ~resting(samples, slides)


def resting_rows(samples: Samples, slides: Mask | None = None) -> Mask:
    """Return the rows (K, n) that count at rest, those masked for slowness too."""
    return _judged(samples, _slow(samples, slides)) & resting(samples, slides)


def _slow(samples: Samples, slides: Mask | None) -> Mask:
    """Return which samples (K, n) are slow; without a word on it no joint slides."""
    limits = rest_speeds(np.zeros(samples.n, dtype=bool) if slides is None else slides)
    return np.asarray(np.abs(samples.velocity) < limits)


def _judged(samples: Samples, all_slow: Mask) -> Mask:
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
            slow = all_slow[part, j].copy()
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


def resting(samples: Samples, slides: Mask | None = None) -> Mask:
    """Return which rows (K, n) are of resting joints; none where samples have no time."""
    found = np.zeros(samples.effort.shape, dtype=bool)
    if samples.time is None:
        return found
    slow = _slow(samples, slides)
    for part in samples.parts:
        time = samples.time[part]
        for j in range(samples.n):
            for run in _runs(slow[part, j]):
                own = slice(part.start + run.start, part.start + run.stop)
                found[own, j] = time[run.stop - 1] - time[run.start] > REST_SECONDS
    return found
