"""Tell rest from motion, joint by joint.

At rest a joint's effort is anything that stiction holds, and no function of the velocity explains
it; an error there says little of the model, and must not be mixed with that in motion. Rows around
reversals belong to the motion, although a fit may leave them out.
"""

from __future__ import annotations

from itertools import product

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
    return moving_and_resting(samples, slides)[0]


def moving_and_resting(samples: Samples, slides: Mask | None = None) -> tuple[Mask, Mask]:
    """Return the rows (K, n) that count in motion, and those that count at rest.

    Those count that are in use, and stretches left out of them that slow motion is in. Of a joint
    without any row in use, whose effort was not measured, there are none. Nor are rows of samples
    with contacts that are left out: forces that nobody measured may push there at will. Without a
    time nothing is known to rest, and without a word on it no joint slides.
    """
    used = samples.used
    limits = rest_speeds(np.zeros(samples.n, dtype=bool) if slides is None else slides)
    slow = np.abs(samples.velocity) < limits
    counted, resting = used.copy(), np.zeros(used.shape, dtype=bool)
    for j, part in product(range(samples.n), samples.parts):
        if samples.time is not None:
            time = samples.time[part]
            for run in _runs(slow[part, j]):
                resting[part][run, j] = time[run][-1] - time[run][0] > REST_SECONDS
        if samples.contacts is None and used[:, j].any():
            near, v = slow[part, j].copy(), samples.velocity[part, j]
            # A reversal between two samples is at both.
            turns = np.flatnonzero(np.sign(v[1:]) != np.sign(v[:-1]))
            near[turns] = near[turns + 1] = True
            for stretch in _runs(~used[part, j]):
                counted[part][stretch, j] = near[stretch].any()
    return counted & ~resting, counted & resting


def _runs(values: Mask) -> list[slice]:
    """Return the stretches of True of a mask (K,)."""
    steps = np.diff(values.astype(np.int8), prepend=0, append=0)
    first, behind = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
    return [slice(a, b) for a, b in zip(first.tolist(), behind.tolist(), strict=True)]
