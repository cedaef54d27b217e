"""Draw periodic motions: the paper's excitation (Table II), and one within any robot's limits."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, generator
from sdpid._common.files import load_toml
from sdpid.errors import DataError
from sdpid.experiment.trajectory.fourier import FourierSeries
from sdpid.experiment.trajectory.trajectory import Trajectory, connection_points
from sdpid.robot.description.catalog import bundled_folder, bundled_robots
from sdpid.robot.model.arms import require_fixed_robot
from sdpid.robot.model.model import RobotModel

# The limit frequencies are printed with four decimals; a harmonic on the limit is not above it.
_ON_LIMIT = 1e-9
# Points at which a connection is checked, and starts that are tried, per period.
_CHECKS, _STARTS = 61, 4000
# What a connection must keep clear of its limits at those points, as a fraction of them: between
# two points it may come closer by about half as much.
_CLEAR = 0.005


def paper_excitation(
    folder: str | os.PathLike[str],
    seed: int | np.random.Generator,
    *,
    periods: int | None = None,
    period: float | None = None,
) -> Trajectory:
    """Draw an excitation by the paper's rule (its Table II and section III-B).

    Each axis gets a sum of sinusoids of equal amplitude and random phase. Their frequencies are
    distinct multiples of the fundamental, drawn without replacement from those not above the
    axis's limit frequency. The sum is scaled so that its largest excursion from the center is
    half of the axis's range. By Bernstein's inequality its speed then stays below 2π times the
    limit frequency times half the range, which is how the table's velocity limit is made.

    The origin of each axis's period is moved to the first instant from which the connections
    stay within the axis's range and velocity limit (from a random start axis 3 would swing out
    by more than its range). This changes the phases, not the motion.

    Parameters
    ----------
    folder : str or path
        Name of a bundled robot, or a folder with an ``excitation.toml``.
    seed : int or numpy.random.Generator
        The only source of randomness.
    periods : int, optional
        Number of periods; by default the file's (12).
    period : float, optional
        Length of a period in s; by default the file's (380 s). With a shorter one fewer harmonics
        lie below the limit; then all of them are used, and `notes` says so.

    Returns
    -------
    Trajectory

    Raises
    ------
    DataError
        When the file is missing or misses an entry, or no harmonic lies below a limit.

    Examples
    --------
    >>> motion = sdpid.paper_excitation("denso_vp6242", seed=0, periods=2, period=10.0)
    >>> motion
    Trajectory(6 joints, 2 periods of 10 s at 1000 Hz)
    >>> motion.velocity_peak.round(1)
    array([1.5, 1.2, 1.8, 2.5, 1.9, 2.8])
    """
    path = plant_folder(folder) / "excitation.toml"
    table = load_toml(path)
    try:
        axes: Sequence[Mapping[str, Any]] = table["axis"]
        names = tuple(str(axis["name"]) for axis in axes)
        ranges = np.radians([axis["range_deg"] for axis in axes]).reshape(len(axes), 2)
        velocity = np.radians([float(axis["velocity_deg_s"]) for axis in axes])
        limits = [float(axis["limit_hz"]) for axis in axes]
        wanted, rate = int(table["sinusoids"]), float(table["rate_hz"])
        period = float(table["period_s"] if period is None else period)
        periods = int(table["periods"] if periods is None else periods)
        rest, connection = float(table["rest_s"]), float(table["connection_s"])
    except (KeyError, TypeError, ValueError) as cause:
        raise DataError(f"{path}: {cause!r}: an entry is missing or not a number.") from None
    if not (np.isfinite(period) and period > 0.0):
        raise DataError(f"period: is {period}; give a positive time in s.")
    rng = generator(seed)
    harmonics = np.zeros((len(axes), wanted), dtype=np.int64)
    phases = np.zeros((len(axes), wanted))
    notes = []
    for j, limit in enumerate(limits):
        available = int(np.floor(limit * period + _ON_LIMIT))
        if available < 1:
            raise DataError(
                f"{names[j]}: no harmonic of {1.0 / period:.4g} Hz lies below the limit frequency "
                f"of {limit} Hz; give a period of at least {1.0 / limit:.4g} s."
            )
        count = min(wanted, available)
        if count < wanted:
            notes.append(
                f"{names[j]}: only {count} of {wanted} harmonics of 1/{period:g} Hz lie below "
                f"{limit} Hz; all of them are used."
            )
        drawn = rng.choice(np.arange(1, available + 1), size=count, replace=False)
        harmonics[j, :count] = np.sort(drawn)
        phases[j, :count] = rng.uniform(0.0, 2.0 * np.pi, count)
    series = filled(period, ranges, harmonics, phases, rate)
    motion = Trajectory(
        joint_names=names,
        series=series,
        rate_hz=rate,
        periods=periods,
        rest=rest,
        connection=connection,
        position_range=ranges,
        velocity_limit=velocity,
        notes=tuple(notes),
    )
    return quiet_start(motion, series)


def plant_folder(folder: str | os.PathLike[str]) -> Path:
    """Return the folder of a bundled robot, or the path as it is."""
    bundled = isinstance(folder, str) and folder in bundled_robots()
    return bundled_folder(str(folder)) if bundled else Path(folder)


def filled(
    period: float, ranges: Array, harmonics: Any, phases: Array, rate: float
) -> FourierSeries:
    """Return the sum of equal sinusoids, scaled to fill each range about its center."""
    used = (harmonics > 0).astype(np.float64)
    unit = FourierSeries(
        period=period,
        center=np.zeros(len(ranges)),
        harmonics=harmonics,
        amplitudes=used,
        phases=phases,
    )
    peak = np.abs(unit.one_period(round(period * rate))).max(axis=0)
    half = 0.5 * (ranges[:, 1] - ranges[:, 0])
    amplitudes = used * (half / peak)[:, None]
    return replace(unit, center=ranges.mean(axis=1), amplitudes=amplitudes)


def quiet_start(trajectory: Trajectory, series: FourierSeries) -> Trajectory:
    """Let each joint's period start where connections are quiet; note where no start is."""
    from scipy.interpolate import BPoly

    ranges, connection = trajectory.position_range, trajectory.connection
    samples = trajectory.samples_per_period
    stride = max(1, samples // _STARTS)
    states = [series.one_period(samples, derivative=order)[::stride] for order in range(3)]
    states[0] = states[0] - series.center
    basis = BPoly(np.eye(6)[:, None], [0.0, 1.0])
    time = np.linspace(0.0, 1.0, _CHECKS)
    margins = []
    for seconds in (connection, -connection):
        points = connection_points(series.center, seconds, *states)
        position, velocity = (np.tensordot(basis(time, order), points, 1) for order in range(2))
        inside = np.minimum(ranges[:, 1] - position, position - ranges[:, 0]).min(axis=0)
        # In units of the half range and of the limit, so that the worse of the two counts.
        inside /= 0.5 * (ranges[:, 1] - ranges[:, 0])
        slow = 1.0 - (np.abs(velocity / connection) / trajectory.velocity_limit).max(axis=0)
        margins.append(np.minimum(inside, slow))
    margin = np.minimum(*margins)
    shift = np.empty(series.n)
    notes = list(trajectory.notes)
    for j, name in enumerate(trajectory.joint_names):
        good = np.flatnonzero(margin[:, j] >= _CLEAR)
        best = int(good[0]) if good.size else int(np.argmax(margin[:, j]))
        shift[j] = best * stride / trajectory.rate_hz
        if not good.size:
            notes.append(
                f"{name}: from every start of the period the connection comes closer than "
                f"{100.0 * _CLEAR:g} % to the end of the range or the velocity limit; from the "
                f"one taken {100.0 * margin[best, j]:.1f} % are left."
            )
    return replace(trajectory, series=series.delayed(shift), notes=tuple(notes))


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
    widest = _UNLIMITED * robot.gears
    low, high = np.where(limited, low, -widest), np.where(limited, high, widest)
    center = (low + high) / 2.0
    half = np.minimum(np.where(limited, _PART, 1.0) * (high - center), _WIDEST * robot.gears)
    speeds = np.minimum(robot.velocity_limits, _FASTEST * robot.gears)
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
