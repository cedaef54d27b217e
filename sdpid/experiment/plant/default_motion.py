"""Draw a periodic motion within the limits of any robot, for simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdpid._common.arrays import generator
from sdpid.errors import DataError
from sdpid.experiment.trajectory.paper import filled, quiet_start
from sdpid.experiment.trajectory.trajectory import Trajectory
from sdpid.robot.model.arms import require_fixed_robot
from sdpid.robot.model.model import RobotModel

# Joints use this part of their range, about its middle, and no more than this to either side (rad,
# or m). Joints without limits move by as much as a limited arm's do.
_PART, _WIDEST, _UNLIMITED = 0.8, np.pi, 2.0
# They use this part of their speed limit. Without one, or with one beyond it, the limit is 2 rad/s.
_SPEED_PART, _FASTEST = 0.8, 2.0
# Sinusoids of a joint, drawn from the harmonics below the highest frequency (Hz).
_SINUSOIDS, _HIGHEST = 5, 0.8
_PERIOD, _PERIODS, _RATE = 20.0, 5, 500.0
_REST, _CONNECTION = 1.0, 2.0


def default_motion(
    robot: RobotModel,
    seed: int | np.random.Generator = 0,
    *,
    period: float | None = None,
    periods: int | None = None,
) -> Trajectory:
    """Draw a periodic motion within a robot's position and velocity limits.

    Every joint gets five sinusoids of random phase, with distinct harmonics up to 0.8 Hz, scaled
    to 80 % of its range and of its speed limit, whichever it meets first. Collisions are not
    looked at: this is a motion for simulation.

    Parameters
    ----------
    robot : RobotModel
        The robot, on a fixed base.
    seed : int or numpy.random.Generator
        The only source of randomness.
    period : float, optional
        Length of a period in s; by default 20.
    periods : int, optional
        Number of periods; by default 5.

    Returns
    -------
    Trajectory

    Raises
    ------
    ModelError
        When the base floats.
    DataError
        When the period is shorter than 6.25 s, too short for five harmonics.
    """
    require_fixed_robot(
        robot,
        "motion",
        instead="On its legs, sdpid.simulate_legged (sdpid simulate --motion stand) moves it.",
    )
    period = _PERIOD if period is None else float(period)
    available = int(np.floor(_HIGHEST * period)) if 0.0 < period < 1e9 else 0
    if available < _SINUSOIDS:
        raise DataError(
            f"period: is {period:g} s; give at least {_SINUSOIDS / _HIGHEST:g} s, in which "
            f"{_SINUSOIDS} harmonics lie below {_HIGHEST:g} Hz."
        )
    rng = generator(seed)
    low, high = robot.position_limits.T
    limited = np.isfinite(low) & (low < high)
    low, high = np.where(limited, low, -_UNLIMITED), np.where(limited, high, _UNLIMITED)
    center = (low + high) / 2.0
    half = np.minimum(np.where(limited, _PART, 1.0) * (high - center), _WIDEST)
    speeds = np.minimum(robot.velocity_limits, _FASTEST)
    draws = [rng.choice(available, _SINUSOIDS, replace=False) + 1 for _ in range(robot.n)]
    harmonics = np.sort(draws, axis=1)
    phases = rng.uniform(0.0, 2.0 * np.pi, harmonics.shape)
    ranges = np.column_stack([center - half, center + half])
    series = filled(period, ranges, harmonics, phases, _RATE)
    fastest = np.abs(series.one_period(round(period * _RATE), derivative=1)).max(axis=0)
    slower = np.minimum(1.0, _SPEED_PART * speeds / fastest)
    series = replace(series, amplitudes=series.amplitudes * slower[:, None])
    drawn = Trajectory(
        joint_names=robot.joint_names,
        series=series,
        rate_hz=_RATE,
        periods=_PERIODS if periods is None else periods,
        rest=_REST,
        connection=_CONNECTION,
        position_range=ranges,
        velocity_limit=speeds,
    )
    return quiet_start(drawn, series)
