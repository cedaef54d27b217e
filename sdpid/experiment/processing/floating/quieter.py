"""Whether a recorded velocity or the pose tells accelerations of a base with less noise.

White noise of a channel is seen in its fourth differences, which hardly pass motion. Its share of
the acceleration is what differences and filter make of it: a position is differentiated twice, a
velocity once, so that the worse sensor may still be the better source.
"""

from __future__ import annotations

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.processing.floating.on_grid import OnGrid
from sdpid.experiment.processing.motion import fourth_differences
from sdpid.experiment.recording.floating.base import BaseMotion

_GRAVITY = 9.81


def quieter(on_grid: OnGrid, velocity: Array, pose_noise: float, unit: str) -> tuple[bool, str]:
    """Return whether the velocity tells accelerations with less noise, and both noises in words.

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
    chosen = of_velocity < of_pose
    less, more = sorted((of_velocity, of_pose))
    other = "the pose" if chosen else "the recorded velocity"
    return chosen, f" (noise of {less:.2g} {unit}, from {other} {more:.2g})"


def white_noise(table: Array) -> float:
    """Return the white noise of channels (M, c), rms in a sample of one."""
    differences = fourth_differences(table)
    return float(np.sqrt(np.mean(differences**2))) if len(differences) else 0.0


def angle_noise(quaternions: Array) -> float:
    """Return the white noise of unit quaternions (M, 4) as an angle about each axis, rad."""
    # A turn by a small angle moves a quaternion by half of it: four channels share three angles.
    return 2.0 * float(np.sqrt(4.0 / 3.0)) * white_noise(quaternions)


def base_limit(base: BaseMotion, rate_hz: float, share: float, wanted: str = "auto") -> float:
    """Return the frequency in Hz up to which noise in a base's acceleration is at most a share.

    White noise of s m in a sample of the position, differentiated twice, has the power
    3·(2π)⁴·s²·2·f⁵/(5·rate) below f, in m²/s⁴ of three axes; of s m/s of a velocity
    3·(2π)²·s²·2·f³/(3·rate). The share is that of gravity's power. The quietest of what
    accelerations may be from (`wanted`, see `base_states`) decides; infinite with an accelerometer,
    or without noise.
    """
    if wanted in ("auto", "imu") and base.imu is not None and base.imu.accelerometer is not None:
        return np.inf
    limits = []
    for source, table, order in (
        ("twist", base.linear_velocity, 1),
        ("pose", base.position, 2),
    ):
        if table is not None and wanted in ("auto", source):
            slope = 2 * order + 1
            power = 3.0 * (2.0 * np.pi) ** (2 * order) * white_noise(table) ** 2 * 2.0
            power /= slope * rate_hz
            limit = (share * _GRAVITY**2 / power) ** (1.0 / slope) if power > 0.0 else np.inf
            limits.append(float(limit))
    return max(limits, default=np.inf)
