"""`Trajectory`: desired joint motion, sample by sample, from any `FourierSeries`."""

from __future__ import annotations

import json
import os
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from sdpid._common.arrays import Array, frozen, frozen_view, real_array
from sdpid._common.files import atomic_write_text
from sdpid._common.toml import load_toml
from sdpid.errors import DataError
from sdpid.experiment.trajectory.fourier import FourierSeries, quintic

# A duration counts as a whole number of samples when it is this close to one, in samples: far
# above the rounding of the product, far below any intended timing.
_WHOLE = 1e-6
# Entries of a trajectory's file.
_DURATIONS = ("rate_hz", "rest", "connection")
_SERIES = ("harmonics", "amplitudes", "phases")


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """Rest, connection, whole periods of a Fourier series, connection, rest.

    At rest the joints stand at the center of the series. The connections are polynomials of
    fifth degree: position, velocity and acceleration are continuous throughout.

    Attributes
    ----------
    joint_names : tuple of str
        The n joints.
    series : FourierSeries
        The periodic part.
    rate_hz : float
        Samples per second.
    periods : int
        Number of periods.
    rest, connection : float
        Durations at either end, in s.
    position_range : ndarray, shape (n, 2)
        Range that each joint may use, in rad.
    velocity_limit : ndarray, shape (n,)
        Largest speed of each joint, in rad/s.
    notes : tuple of str
        Where the trajectory departs from the rule that made it, and why.

    Raises
    ------
    DataError
        When the number of joints differs between the arguments, or a duration is not a whole
        number of samples.
    """

    joint_names: tuple[str, ...]
    series: FourierSeries
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
            f"{self.series.period:g} s at {self.rate_hz:g} Hz)"
        )

    def __post_init__(self) -> None:
        ranges = real_array(self.position_range, "position_range", ndim=2)
        limits = real_array(self.velocity_limit, "velocity_limit", ndim=1)
        n = self.series.n
        if len(self.joint_names) != n or ranges.shape != (n, 2) or limits.shape != (n,):
            raise DataError(
                f"trajectory: {n} joints in the series, {len(self.joint_names)} names, "
                f"position_range {ranges.shape}, velocity_limit {limits.shape}; give {n} of each."
            )
        if not (np.isfinite(self.rate_hz) and self.rate_hz > 0.0):
            raise DataError(f"trajectory: rate_hz is {self.rate_hz}; give a positive rate.")
        if int(self.periods) != self.periods or self.periods < 1:
            raise DataError(f"trajectory: periods is {self.periods}; give a whole number from 1.")
        for name, seconds, least in (
            ("period", self.series.period, 2),
            ("rest", self.rest, 0),
            ("connection", self.connection, 1),
        ):
            count = seconds * self.rate_hz
            if not np.isfinite(count) or abs(count - round(count)) > _WHOLE or count < least:
                raise DataError(
                    f"trajectory: {name} of {seconds} s is {count:.6g} samples at "
                    f"{self.rate_hz:g} Hz; give a whole number of at least {least}."
                )
        object.__setattr__(self, "position_range", frozen(ranges))
        object.__setattr__(self, "velocity_limit", frozen(limits))

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.series.n

    @property
    def period(self) -> float:
        """Length of one period in s."""
        return self.series.period

    @property
    def center(self) -> Array:
        """Center of the motion, where the joints rest, shape (n,)."""
        return self.series.center

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
        values: Array = frozen_view(
            self.series.one_period(self.samples_per_period, derivative=order)
        )
        return values

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
            lines.append(
                f"{name}: peak velocity {speeds[0]}, {verdict} the limit of {speeds[1]} "
                f"({100.0 * peak / limit:.0f} %)"
            )
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
        series = self.series
        lines = [f"{name} = {float(getattr(self, name))!r}" for name in _DURATIONS]
        lines += [f"periods = {self.periods}", f"period = {series.period!r}"]
        lines += [f"notes = {json.dumps(list(self.notes))}"]
        for j, name in enumerate(self.joint_names):
            lines += ["", "[[joint]]", f"name = {json.dumps(name)}"]
            lines += [f"center = {float(series.center[j])!r}"]
            for key in _SERIES:
                lines.append(f"{key} = {np.asarray(getattr(series, key))[j].tolist()}")
            lines.append(f"position_range = {self.position_range[j].tolist()}")
            lines.append(f"velocity_limit = {float(self.velocity_limit[j])!r}")
        atomic_write_text(Path(path), "\n".join(lines) + "\n")

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
            series = FourierSeries(
                period=table["period"],
                center=np.array([joint["center"] for joint in joints]),
                **{key: np.array([joint[key] for joint in joints]) for key in _SERIES},
            )
            return cls(
                joint_names=tuple(str(joint["name"]) for joint in joints),
                series=series,
                periods=table["periods"],
                position_range=np.array([joint["position_range"] for joint in joints]),
                velocity_limit=np.array([joint["velocity_limit"] for joint in joints]),
                notes=tuple(table.get("notes", ())),
                **{name: table[name] for name in _DURATIONS},
            )
        except (KeyError, TypeError, ValueError) as cause:
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
        out[0] = self.center
        lead, per_period = self.lead_samples, self.samples_per_period
        rest, connection = lead - round(self.connection * self.rate_hz), lead
        end = lead + self.periods * per_period
        index = np.arange(start, stop)
        inside = (index >= lead) & (index < end)
        rows = (index[inside] - lead) % per_period
        if rows.size:
            out[0, inside] = self.position_period[rows]
            out[1, inside] = self.velocity_period[rows]
            out[2, inside] = self.acceleration_period[rows]
        steps = connection - rest
        for where, fraction, seconds in (
            ((index >= rest) & (index < lead), (index - rest) / steps, self.connection),
            ((index >= end) & (index < end + steps), 1 - (index - end) / steps, -self.connection),
        ):
            if where.any():
                out[:, where] += quintic(fraction[where], seconds, *self._start_state)
        return out[0], out[1], out[2]

    @cached_property
    def _start_state(self) -> tuple[Array, Array, Array]:
        """Offset from the center, velocity and acceleration at the start of a period."""
        first = np.zeros(1)
        position, velocity, acceleration = (
            self.series.evaluate(first, derivative=order)[0] for order in range(3)
        )
        return position - self.center, velocity, acceleration
