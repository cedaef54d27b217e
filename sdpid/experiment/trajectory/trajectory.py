"""`Trajectory`: desired joint motion, sample by sample, from any `Curve`."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, frozen, frozen_view, real_array
from sdpid._common.files import atomic_write_text, load_toml
from sdpid._common.tables import facts_html
from sdpid.errors import DataError, ExportError
from sdpid.experiment.trajectory.curve import Curve, end_states, is_closed, rests_at_ends
from sdpid.experiment.trajectory.fourier import FourierSeries
from sdpid.experiment.trajectory.sampled import SampledCurve
from sdpid.experiment.trajectory.spline import Spline

# A duration counts as a whole number of samples when it is this close to one, in samples: far
# above the rounding of the product, far below any intended timing.
_WHOLE = 1e-6
# No motion has as many samples, or periods, nor a controller such a rate (Hz).
_LARGEST = 1e9
# Samples of a motion as it is looked at; beyond as many the rate falls.
_MOST_PLAYED = 6000
# Entries of a trajectory's file.
_DURATIONS = ("rate_hz", "rest", "connection")
_SERIES = ("harmonics", "amplitudes", "phases")
_SAMPLES = ("position", "velocity", "acceleration")


def entries(curve: Curve) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the entries of the whole curve, and those of each joint.

    Raises
    ------
    ExportError
        When the curve is of another kind than those of this folder.
    """
    if isinstance(curve, Spline):
        whole = {"period": curve.duration, "degree": curve.degree}
        return whole, [{"control_points": points.tolist()} for points in curve.control_points.T]
    joints: list[dict[str, Any]] = []
    if isinstance(curve, FourierSeries):
        for j, center in enumerate(curve.center):
            rows = {key: np.asarray(getattr(curve, key))[j].tolist() for key in _SERIES}
            joints.append({"center": float(center), **rows})
        return {"period": curve.period}, joints
    if isinstance(curve, SampledCurve):
        given = {key: getattr(curve, key) for key in _SAMPLES if getattr(curve, key) is not None}
        joints = [{key: given[key][:, j].tolist() for key in given} for j in range(curve.n)]
        return {"time": curve.time.tolist()}, joints
    raise ExportError(f"trajectory: a curve of type {type(curve).__name__} cannot be written.")


def curve_of(table: Mapping[str, Any]) -> Curve:
    """Return the curve of a file's table, whose joints are its list ``joint``."""
    joints = table["joint"]

    def rows(key: str) -> Array:
        return np.array([joint[key] for joint in joints])

    if joints and "control_points" in joints[0]:
        points = rows("control_points").T
        return Spline(duration=table["period"], control_points=points, degree=table["degree"])
    if joints and "position" in joints[0]:
        given = {key: rows(key).T for key in _SAMPLES if key in joints[0]}
        return SampledCurve(time=table["time"], **given)
    return FourierSeries(
        period=table["period"], center=rows("center"), **{key: rows(key) for key in _SERIES}
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
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

    def __repr__(self) -> str:
        return (
            f"Trajectory({len(self.joint_names)} joints, {self.periods} periods of "
            f"{self.period:g} s at {self.rate_hz:g} Hz)"
        )

    def _repr_html_(self) -> str:
        facts: dict[str, object] = {
            "joints": ", ".join(self.joint_names),
            "periods": self.periods,
            "period, s": self.period,
            "rate, Hz": self.rate_hz,
            "seconds in all": self.duration,
        }
        return facts_html("Trajectory", facts)

    def __post_init__(self) -> None:
        ranges = real_array(self.position_range, "position_range", ndim=2, infinite=True)
        limits = real_array(self.velocity_limit, "velocity_limit", ndim=1, infinite=True)
        n = self.series.n
        if len(self.joint_names) != n or ranges.shape != (n, 2) or limits.shape != (n,):
            raise DataError(
                f"trajectory: {n} joints in the series, {len(self.joint_names)} names, "
                f"position_range {ranges.shape}, velocity_limit {limits.shape}; give {n} of each."
            )
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
        object.__setattr__(self, "position_range", frozen(ranges))
        object.__setattr__(self, "velocity_limit", frozen(limits))

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

    def _derivative(self, order: int) -> Array:
        if isinstance(self.series, FourierSeries):
            values = self.series.one_period(self.samples_per_period, derivative=order)
        else:
            time = np.arange(self.samples_per_period) / self.rate_hz
            values = self.series.evaluate(time, derivative=order)
        return np.asarray(frozen_view(values))

    @cached_property
    def position_period(self) -> Array:
        """Positions of one period, shape (samples_per_period, n), in rad."""
        return self._derivative(0)

    @cached_property
    def velocity_period(self) -> Array:
        """Velocities of one period, shape (samples_per_period, n), in rad/s."""
        return self._derivative(1)

    @cached_property
    def acceleration_period(self) -> Array:
        """Accelerations of one period, shape (samples_per_period, n), in rad/s²."""
        return self._derivative(2)

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
        for name, peak, limit in zip(
            self.joint_names, self.velocity_peak, self.velocity_limit, strict=True
        ):
            verdict = "within" if peak <= limit else "ABOVE"
            if name in sliding:
                speeds = f"{peak:.4g} m/s", f"{limit:.4g} m/s"
            else:
                speeds = f"{np.degrees(peak):.2f} deg/s", f"{np.degrees(limit):.2f} deg/s"
            # Of a limit next to zero no motion is a share worth telling.
            share = f" ({100.0 * peak / limit:.0f} %)" if 1e-3 * peak < limit else ""
            told = f"{verdict} the limit of {speeds[1]}{share}"
            told = told if np.isfinite(limit) else "no limit"
            lines.append(f"{name}: peak velocity {speeds[0]}, {told}")
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

        whole, joints = entries(self.series)
        table: dict[str, Any] = {name: float(getattr(self, name)) for name in _DURATIONS}
        table |= {"periods": self.periods, **whole, "notes": list(self.notes)}
        table["joint"] = [
            {
                "name": self.joint_names[j],
                **joint,
                "position_range": self.position_range[j].tolist(),
                "velocity_limit": float(self.velocity_limit[j]),
            }
            for j, joint in enumerate(joints)
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
            return cls(
                joint_names=tuple(str(joint["name"]) for joint in joints),
                series=curve_of(table),
                periods=table["periods"],
                position_range=np.array([joint["position_range"] for joint in joints]),
                velocity_limit=np.array([joint["velocity_limit"] for joint in joints]),
                notes=tuple(table.get("notes", ())),
                **{name: table[name] for name in _DURATIONS},
            )
        except (KeyError, TypeError, ValueError, OverflowError) as cause:
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
        first, per_period = self.lead_samples, self.samples_per_period
        end = first + self.periods * per_period
        index = np.arange(start, stop)
        out[0] = np.where(index[:, None] < end, *self._poses)
        inside = (index >= first) & (index < end)
        rows = (index[inside] - first) % per_period
        if rows.size:
            out[0, inside] = self.position_period[rows]
            out[1, inside] = self.velocity_period[rows]
            out[2, inside] = self.acceleration_period[rows]
        for begin, curve in self.curves():
            if curve is self.series:
                continue
            steps = index - round(begin * self.rate_hz)
            inside = (steps >= 0) & (steps < round(self.connection * self.rate_hz))
            for order in range(3 if inside.any() else 0):
                out[order, inside] = curve.evaluate(steps[inside] / self.rate_hz, derivative=order)
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
            enter = connection_points(before, c, *self._ends[0])
            leave = connection_points(after, -c, *self._ends[1])[::-1]
            parts.insert(0, (self.rest, Spline(duration=c, control_points=enter)))
            end = start + self.periods * self.period
            parts.append((end, Spline(duration=c, control_points=leave)))
        return tuple(parts)

    @cached_property
    def _ends(self) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        """Offset from the rest, velocity and acceleration where the curve starts and ends."""
        first = np.zeros(1)
        states = [
            np.concatenate([self.series.evaluate(time, derivative=order) for order in range(3)])
            for time in (first, first + (0.0 if self.closed else self.period))
        ]
        for state, pose in zip(states, self._poses, strict=True):
            state[0] -= pose
        return tuple(states[0]), tuple(states[1])


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


@dataclass(frozen=True)
class Played:
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
    begin = parts[0][0]
    seconds = parts[-1][0] + parts[-1][1].duration - begin
    count = min(max(int(np.ceil(seconds * rate_hz)) + 1, 2), _MOST_PLAYED)
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
