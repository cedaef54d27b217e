"""A trajectory as it is looked at: each part once, on an even grid, with jerk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.trajectory.trajectory import Trajectory

# Of the highest rate; beyond as many samples the rate falls.
_MOST = 6000


@dataclass(frozen=True)
class Played:
    """Connection in, one period and connection out of a trajectory.

    Attributes
    ----------
    time : ndarray, shape (K,)
        Evenly spaced from zero, s.
    position, velocity, acceleration, jerk : ndarray, shape (K, n)
        In rad (m where a joint slides) and s.
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    jerk: Array

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return float((len(self.time) - 1) / self.time[-1])


def played(trajectory: Trajectory, rate_hz: float) -> Played:
    """Return the distinct parts of a trajectory, one after the other without rests.

    Parameters
    ----------
    trajectory : Trajectory
        Of its periods one is played.
    rate_hz : float
        About how many samples a second; fewer for a long motion.
    """
    parts = trajectory.with_periods(1).curves()
    begin = parts[0][0]
    seconds = parts[-1][0] + parts[-1][1].duration - begin
    count = min(max(int(np.ceil(seconds * rate_hz)) + 1, 2), _MOST)
    time = np.linspace(0.0, seconds, count)
    out = np.zeros((4, count, trajectory.n))
    starts = np.array([start - begin for start, _ in parts])
    owner = np.maximum(np.searchsorted(starts, time, side="right") - 1, 0)
    for k, (_, curve) in enumerate(parts):
        inside = owner == k
        own = np.clip(time[inside] - starts[k], 0.0, curve.duration)
        for order in range(4):
            out[order, inside] = curve.evaluate(own, derivative=order)
    return Played(time, *out)
