"""`Trajectory`: desired joint motion, sample by sample, from any `Curve`."""

from __future__ import annotations

import os
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sdpid._common.arrays import Array, frozen, frozen_view, shaped
from sdpid._common.files import atomic_write_text, load_toml
from sdpid._common.tables import Shown, plain
from sdpid.errors import DataError, ExportError
from sdpid.experiment.trajectory.curve import (
    Curve,
    SampledCurve,
    Spline,
    end_states,
    is_closed,
    rests_at_ends,
)
from sdpid.experiment.trajectory.fourier import FourierSeries

# A duration counts as a whole number of samples when it is this close to one, in samples: far
# above the rounding of the product, far below any intended timing.
_WHOLE = 1e-6
# No motion has as many samples, or periods, nor a controller such a rate (Hz).
_LARGEST = 1e9
# Samples of a motion as it is looked at; beyond as many the rate falls.
_MOST_PLAYED = 6000
# How speeds are told of joints that turn.
_DEGREES = 180.0 / np.pi, "deg/s", ".2f"
# Entries of a trajectory's file: of the whole, of each joint, and of each kind of curve, those of
# the whole by the names of fields, then those of the joints and the axis on which joints lie.
_DURATIONS, _LIMITS = ("rate_hz", "rest", "connection"), ("position_range", "velocity_limit")
_SERIES = ("center", "harmonics", "amplitudes", "phases")
_KINDS: tuple[tuple[Any, dict[str, str], tuple[str, ...], int], ...] = (
    (Spline, {"period": "duration", "degree": "degree"}, ("control_points",), 1),
    (SampledCurve, {"time": "time"}, ("position", "velocity", "acceleration"), 1),
    (FourierSeries, {"period": "period"}, _SERIES, 0),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory(Shown):
    """A motion to run: rest, connection, whole periods of a curve, connection, rest.

    The joints rest at the center of a Fourier series; before and after any other curve they rest
    where it starts and ends. The connections are polynomials of fifth degree: position, velocity
    and acceleration are continuous throughout. A curve that starts and ends at rest needs none.

    Attributes
    ----------
    joint_names : tuple of str
        The n joints.
    series : FourierSeries, Spline, SampledCurve or another Curve
        The motion of one period.
    rate_hz : float
        Samples per second.
    periods : int
        Number of periods; 1 where the curve does not end in the state that it starts from.
    rest, connection : float
        Durations at either end, in s.
    position_range : ndarray, shape (n, 2)
        Range that each joint may use, in rad (m for prismatic joints); infinite without limits.
    velocity_limit : ndarray, shape (n,)
        Largest speed of each joint, in rad/s (m/s).
    notes : tuple of str
        Where the trajectory departs from the rule that made it, and why.

    Raises
    ------
    DataError
        When the number of joints differs between the arguments, a duration is not a whole
        number of samples, the curve cannot be repeated, or it needs a connection.

    Examples
    --------
    >>> motion
    Trajectory(6 joints, 2 periods of 10 s at 1000 Hz)
    >>> motion.duration, motion.period, motion.samples_per_period
    (38.0, 10.0, 10000)
    >>> position, velocity, acceleration = motion.sample()
    >>> position.shape
    (38000, 6)
    >>> motion.to_toml("trajectory.toml")
    >>> sdpid.Trajectory.from_toml("trajectory.toml").with_periods(5)
    Trajectory(6 joints, 5 periods of 10 s at 1000 Hz)
    """

    joint_names: tuple[str, ...]
    series: Curve
    rate_hz: float
    periods: int
    rest: float
    connection: float
    position_range: Array
    velocity_limit: Array
    notes: tuple[str, ...] = ()

    _facts = ("joint_names", "periods", "period, s", "rate_hz", "duration, s")

    def __repr__(self) -> str:
        return (
            f"Trajectory({len(self.joint_names)} joints, {self.periods} periods of "
            f"{self.period:g} s at {self.rate_hz:g} Hz)"
        )

    def __post_init__(self) -> None:
        n = self.series.n
        if len(self.joint_names) != n:
            raise DataError(
                f"trajectory: {n} joints in the series, {len(self.joint_names)} names; give {n}."
            )
        for name, shape in (("position_range", (n, 2)), ("velocity_limit", (n,))):
            limits = shaped(getattr(self, name), f"trajectory: {name}", shape, infinite=True)
            object.__setattr__(self, name, limits)
        if not 0.0 < self.rate_hz <= _LARGEST:
            raise DataError(
                f"trajectory: rate_hz is {self.rate_hz:.6g}; give a positive rate, at most "
                f"{_LARGEST:g} Hz."
            )
        if not 1 <= self.periods <= _LARGEST or int(self.periods) != self.periods:
            raise DataError(
                f"trajectory: periods is {self.periods:.6g}; give a whole number from 1 to "
                f"{_LARGEST:g}."
            )
        for name, seconds, least in (
            ("period", self.period, 2),
            ("rest", self.rest, 0),
            ("connection", self.connection, 0),
        ):
            count = seconds * self.rate_hz
            if not least <= count <= _LARGEST or abs(count - round(count)) > _WHOLE:
                raise DataError(
                    f"trajectory: {name} of {seconds:.6g} s is {count:.6g} samples at "
                    f"{self.rate_hz:g} Hz; give a whole number from {least} to {_LARGEST:g}."
                )
        if self.periods > 1 and not self.closed:
            raise DataError(
                f"trajectory: {self.periods} periods of a motion that does not end as it starts; "
                "give periods=1, or a closed motion."
            )
        if self.rest and not self.connection and not rests_at_ends(self.series):
            raise DataError(
                "trajectory: the motion does not start and end at rest; give a connection."
            )
        object.__setattr__(self, "periods", int(self.periods))

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.series.n

    @property
    def period(self) -> float:
        """Length of one period in s."""
        return self.series.duration

    @cached_property
    def closed(self) -> bool:
        """Whether the curve ends in the state that it starts from, so that periods can follow."""
        return isinstance(self.series, FourierSeries) or is_closed(self.series)

    @property
    def center(self) -> Array:
        """Where the joints rest before the motion, shape (n,): the center of a Fourier series."""
        return self._poses[0]

    @cached_property
    def _poses(self) -> tuple[Array, Array]:
        """Positions (n,) at which the joints rest before and after the motion."""
        if isinstance(self.series, FourierSeries):
            return self.series.center, self.series.center
        start, end = end_states(self.series)[0]
        return frozen(start), frozen(start if self.closed else end)

    @property
    def samples_per_period(self) -> int:
        """Samples of one period."""
        return round(self.period * self.rate_hz)

    @property
    def lead_samples(self) -> int:
        """Samples of rest and connection at either end."""
        return round(self.rest * self.rate_hz) + round(self.connection * self.rate_hz)

    @property
    def n_samples(self) -> int:
        """Samples of the whole trajectory."""
        return 2 * self.lead_samples + self.periods * self.samples_per_period

    @property
    def duration(self) -> float:
        """Duration of the whole trajectory in s."""
        return self.n_samples / self.rate_hz

    @cached_property
    def _states(self) -> tuple[Array, Array, Array]:
        """Positions, velocities and accelerations of one period."""
        count = self.samples_per_period
        if isinstance(self.series, FourierSeries):
            states = [self.series.one_period(count, derivative=order) for order in range(3)]
        else:
            time = np.arange(count) / self.rate_hz
            states = [self.series.evaluate(time, derivative=order) for order in range(3)]
        position, velocity, acceleration = map(frozen_view, states)
        return position, velocity, acceleration

    @property
    def position_period(self) -> Array:
        """Positions of one period, shape (samples_per_period, n), in rad."""
        return self._states[0]

    @property
    def velocity_period(self) -> Array:
        """Velocities of one period, shape (samples_per_period, n), in rad/s."""
        return self._states[1]

    @property
    def acceleration_period(self) -> Array:
        """Accelerations of one period, shape (samples_per_period, n), in rad/s²."""
        return self._states[2]

    @property
    def velocity_peak(self) -> Array:
        """Largest speed of each joint over a period, shape (n,), in rad/s."""
        return np.asarray(np.abs(self.velocity_period).max(axis=0))

    def velocity_report(self, sliding: Collection[str] = ()) -> tuple[str, ...]:
        """Return one line a joint: its largest speed against the limit, in deg/s.

        Parameters
        ----------
        sliding : collection of str, optional
            Names of the prismatic joints, whose speeds are in m/s.
        """
        lines = []
        speeds = zip(self.joint_names, self.velocity_peak, self.velocity_limit, strict=True)
        for name, peak, limit in speeds:
            scale, unit, digits = (1.0, "m/s", ".4g") if name in sliding else _DEGREES
            told = "no limit"
            if np.isfinite(limit):
                told = f"{'within' if peak <= limit else 'ABOVE'} the limit of "
                told += f"{scale * limit:{digits}} {unit}"
                # Of a limit next to zero no motion is a share worth telling.
                told += f" ({100.0 * peak / limit:.0f} %)" if 1e-3 * peak < limit else ""
            lines.append(f"{name}: peak velocity {scale * peak:{digits}} {unit}, {told}")
        return tuple(lines)

    def with_periods(self, periods: int) -> Trajectory:
        """Return the same motion with another number of periods."""
        return replace(self, periods=periods)

    def to_toml(self, path: str | os.PathLike[str]) -> None:
        """Write the trajectory to a TOML file, without loss.

        Raises
        ------
        ExportError
            When the file cannot be written.
        """
        import tomli_w

        kinds = [each for each in _KINDS if isinstance(self.series, each[0])]
        if not kinds:
            what = type(self.series).__name__
            raise ExportError(f"trajectory: a curve of type {what} cannot be written.")
        _, whole, of_joints, axis = kinds[0]
        given = {name: getattr(self.series, name) for name in of_joints}
        rows = {k: np.moveaxis(v, axis, 0) for k, v in given.items() if v is not None}
        rows |= {name: getattr(self, name) for name in _LIMITS}
        table: dict[str, Any] = {name: float(getattr(self, name)) for name in _DURATIONS}
        table["periods"] = self.periods
        table |= {key: plain(getattr(self.series, name)) for key, name in whole.items()}
        table["notes"] = list(self.notes)
        table["joint"] = [
            {"name": name, **{key: row[j].tolist() for key, row in rows.items()}}
            for j, name in enumerate(self.joint_names)
        ]
        atomic_write_text(Path(path), tomli_w.dumps(table))

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str]) -> Trajectory:
        """Read a file that `to_toml` wrote.

        Raises
        ------
        DataError
            When it cannot be read, lacks an entry, or holds no trajectory.
        """
        table = load_toml(path)
        try:
            joints = table["joint"]
            known = ("name", *_LIMITS, *(key for _, _, keys, _ in _KINDS for key in keys))
            there = [key for key in known if key in joints[0]]
            rows: Any = {key: np.array([joint[key] for joint in joints]) for key in there}
            kind, whole, of_joints, axis = next(each for each in _KINDS if each[2][0] in rows)
            given = {name: np.moveaxis(rows[name], 0, axis) for name in of_joints if name in rows}
            return cls(
                joint_names=tuple(map(str, rows["name"])),
                series=kind(**{name: table[key] for key, name in whole.items()}, **given),
                notes=tuple(table.get("notes", ())),
                **{name: rows[name] for name in _LIMITS},
                **{name: table[name] for name in ("periods", *_DURATIONS)},
            )
        except (LookupError, TypeError, ValueError, OverflowError, StopIteration) as cause:
            raise DataError(
                f"{path}: {cause!r}: an entry of the trajectory is missing or of another type."
            ) from None
        except DataError as cause:
            raise DataError(f"{path}: {cause}") from None

    def sample(self, start: int = 0, stop: int | None = None) -> tuple[Array, Array, Array]:
        """Return positions, velocities and accelerations of a range of samples.

        Parameters
        ----------
        start, stop : int
            Sample indices of the whole trajectory, rest and connections included; `stop` is
            excluded and by default the end.

        Returns
        -------
        position, velocity, acceleration : ndarray, shape (stop - start, n)

        Raises
        ------
        DataError
            When the range is not within the trajectory.
        """
        stop = self.n_samples if stop is None else stop
        if not 0 <= start <= stop <= self.n_samples:
            raise DataError(
                f"trajectory: samples {start} to {stop} are not within 0 to {self.n_samples}."
            )
        out = np.zeros((3, stop - start, self.n))
        index = np.arange(start, stop)
        out[0] = np.where(index[:, None] < self.n_samples - self.lead_samples, *self._poses)
        for begin, curve in self.curves():
            periods = self.periods if curve is self.series else 1
            steps, count = index - round(begin * self.rate_hz), round(curve.duration * self.rate_hz)
            inside = (steps >= 0) & (steps < count * periods)
            rows = steps[inside] % count
            for order in range(3 if rows.size else 0):
                if curve is self.series:
                    out[order, inside] = self._states[order][rows]
                else:
                    time = rows / self.rate_hz
                    out[order, inside] = curve.evaluate(time, derivative=order)
        return out[0], out[1], out[2]

    def curves(self) -> tuple[tuple[float, Curve], ...]:
        """Return the distinct parts of the motion and when each starts, in s.

        They are the connection in, one period, and the connection out; the connections only where
        there are any. The joints rest in the states at the ends of the parts.
        """
        start = self.rest + self.connection
        parts: list[tuple[float, Curve]] = [(start, self.series)]
        if self.connection:
            (before, after), c = self._poses, self.connection
            enter = connection_points(before, c, *self._ends[:, 0])
            leave = connection_points(after, -c, *self._ends[:, 1])[::-1]
            parts.insert(0, (self.rest, Spline(duration=c, control_points=enter)))
            end = start + self.periods * self.period
            parts.append((end, Spline(duration=c, control_points=leave)))
        return tuple(parts)

    @cached_property
    def _ends(self) -> Array:
        """Offset from the rest, velocity, acceleration at the curve's start and end, (3, 2, n)."""
        states = end_states(self.series)
        if self.closed:
            states[:, 1] = states[:, 0]
        states[0] -= self._poses
        return states


def connection_points(pose: Array, seconds: float, *state: Array) -> Array:
    """Return the control points (6, ..., n) of the quintic from rest in a pose to a moving end.

    Parameters
    ----------
    pose : ndarray, shape (n,)
        Where the joints rest.
    seconds : float
        Duration in s; negative runs the time backwards (a moving start that comes to rest).
    *state : three ndarrays, shape (..., n)
        Offset from the pose, velocity and acceleration at the moving end.
    """
    offset, velocity, acceleration = state
    end = pose + offset
    near = end - velocity * seconds / 5.0
    before = 2.0 * near - end + acceleration * seconds**2 / 20.0
    return np.stack(np.broadcast_arrays(pose, pose, pose, before, near, end))


class Played(NamedTuple):
    """A trajectory as it is looked at: connection in, one period, connection out.

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
    starts = np.array([start - parts[0][0] for start, _ in parts])
    seconds = starts[-1] + parts[-1][1].duration
    count = min(max(int(np.ceil(seconds * rate_hz)) + 1, 2), _MOST_PLAYED)
    time = np.linspace(0.0, seconds, count)
    out = np.zeros((4, count, trajectory.n))
    owner = np.maximum(np.searchsorted(starts, time, side="right") - 1, 0)
    for k, (_, curve) in enumerate(parts):
        own = np.clip(time[owner == k] - starts[k], 0.0, curve.duration)
        for order in range(4):
            out[order, owner == k] = curve.evaluate(own, derivative=order)
    return Played(time, *out)
