"""Whether a recorded velocity or the pose tells accelerations of a base with less noise.

White noise of a channel is seen in its fourth differences, which hardly pass motion. Its share of
the acceleration is what differences and filter make of it: a position is differentiated twice, a
velocity once, so that the worse sensor may still be the better source.
"""

from __future__ import annotations

import enum

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.processing.floating.on_grid import OnGrid

__all__ = ["Quieter", "angle_noise", "quieter", "white_noise"]

# Fourth differences of motion are less than this of its amplitude at a tenth of the sampling rate;
# white noise of variance one has a variance of this in them: 1 + 16 + 36 + 16 + 1.
_DIFFERENCES = 4
_GAIN = 70.0


class Quieter(enum.Enum):
    """What has less noise."""

    VELOCITY = "velocity"
    POSE = "pose"


def quieter(on_grid: OnGrid, velocity: Array, pose_noise: float, unit: str) -> tuple[Quieter, str]:
    """Return what tells accelerations with less noise, and both noises in words.

    Parameters
    ----------
    on_grid : OnGrid
        Differences and filter.
    velocity : (M, 3) ndarray
        As it was recorded.
    pose_noise : float
        Of a position in m, or of an angle in rad: rms in a sample (`white_noise`, `angle_noise`).
    unit : str
        Of the acceleration.
    """
    # As long as the filter sees at least, and its differences.
    around = 2 * on_grid.chain.low_pass.reach + 2 * on_grid.chain.stencil.margin
    impulse = np.zeros((2 * around + 1, 1))
    impulse[around] = 1.0
    once, twice = (
        float(np.linalg.norm(on_grid.filtered(each)))
        for each in (on_grid.rate(impulse), on_grid.second(impulse))
    )
    of_velocity, of_pose = white_noise(velocity) * once, pose_noise * twice
    chosen = Quieter.VELOCITY if of_velocity < of_pose else Quieter.POSE
    less, more = sorted((of_velocity, of_pose))
    other = "the pose" if chosen is Quieter.VELOCITY else "the recorded velocity"
    return chosen, f" (noise of {less:.2g} {unit}, from {other} {more:.2g})"


def white_noise(table: Array) -> float:
    """Return the white noise of channels (M, c), rms in a sample of one."""
    if len(table) <= _DIFFERENCES:
        return 0.0
    return float(np.sqrt(np.mean(np.diff(table, _DIFFERENCES, axis=0) ** 2) / _GAIN))


def angle_noise(quaternions: Array) -> float:
    """Return the white noise of unit quaternions (M, 4) as an angle about each axis, rad."""
    # A turn by a small angle moves a quaternion by half of it: four channels share three angles.
    return 2.0 * float(np.sqrt(4.0 / 3.0)) * white_noise(quaternions)
