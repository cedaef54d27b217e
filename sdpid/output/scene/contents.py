"""What a scene shows together, and the motion that it plays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.experiment.processing.samples import Samples
from sdpid.robot.model.geometry import link_placements
from sdpid.robot.model.model import RobotModel

# Frames a second: the player blends between them.
FRAME_RATE = 25.0

# Share of a frame by which a recording may end before it.
_ROUNDING = 1e-6

# Frames of a recording: its first minute.
_MOST = 1500


@dataclass(frozen=True)
class Group:
    """What is shown and hidden together.

    Attributes
    ----------
    key : str
        Short name of letters.
    name : str
        What it is called beside the picture; groups without a name have no switch.
    color : str
        ``#rrggbb``.
    opacity : float
        Of surfaces; below one, what lies within is seen through them.
    filled : float
        Opacity of ellipsoids but for their rims, which are dashed in the picture without a player
        where this is zero.
    """

    key: str
    name: str
    color: str
    opacity: float = 1.0
    filled: float = 0.3


@dataclass(frozen=True, eq=False)
class Motion:
    """Positions on an even grid.

    Attributes
    ----------
    rate_hz : float
        Frames per second.
    position : ndarray, shape (F, n) or (F, nq)
        Joint positions, configurations with a floating base; F is at least one.
    note : str
        What part of a recording it is, a sentence; may be empty.
    sample : ndarray of int, shape (F,), optional
        The recorded sample that each frame is.
    """

    rate_hz: float
    position: Array
    note: str = ""
    sample: Indices | None = None

    def placements(self, robot: RobotModel) -> Array:
        """Return the placements of the links' joint frames, shape (F, links, 4, 4)."""
        return np.stack([link_placements(robot, q) for q in self.position])


def recorded_motion(samples: Samples) -> Motion:
    """Return the first minute of a motion that was recorded, pieces one after the other."""
    if samples.time is None:
        position = samples.position[:_MOST]
        told = f"The recording has no stamps: {FRAME_RATE:g} samples are played a second"
        if len(position) < samples.n_samples:
            told += f", the first {len(position):,} of {samples.n_samples:,}"
        return Motion(FRAME_RATE, position, f"{told}.", np.arange(len(position)))
    # Seconds of play: pieces follow each other without a break.
    steps = np.diff(samples.time, prepend=samples.time[0])
    usual = float(np.median(steps[1:])) if len(steps) > 1 else 1.0 / FRAME_RATE
    steps[list(samples.starts)] = usual
    steps[0] = 0.0
    played = np.cumsum(np.maximum(steps, 0.0))
    rate = min(FRAME_RATE, 1.0 / usual) if usual > 0.0 else FRAME_RATE
    frames = np.arange(int(played[-1] * rate + _ROUNDING) + 1) / rate
    nearest = np.searchsorted(played, frames[:_MOST] - 0.5 * usual).clip(0, len(played) - 1)
    seconds = min(frames[-1], (_MOST - 1) / rate)
    told = ""
    if len(frames) > _MOST:
        told = f"The first {seconds:.0f} s of {played[-1]:.0f} s are played."
    return Motion(rate, samples.position[nearest], told, nearest)
