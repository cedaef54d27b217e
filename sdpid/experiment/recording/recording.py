"""`Recording`: what was measured, checked once, in SI units."""

from __future__ import annotations

import json
import os
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid._common.files import Source, atomic_path, atomic_write_text
from sdpid._common.tables import Table
from sdpid.errors import DataError, ExportError
from sdpid.experiment.drive_gains.gains import DriveGains
from sdpid.experiment.recording.floating import (
    EACH_JOINT,
    LARGEST,
    BaseMotion,
    Contacts,
    Sampled,
    distinct_names,
    samples,
)
from sdpid.experiment.recording.stored import ROWS, StoredArray, extremes

# What is measured, or commanded, of each joint.
CHANNELS = ("position", "effort", "velocity", "reference", "feedforward", "link_position")
# Those that no log is refused for, unless they are asked for by name, and that digests count where
# they are there.
OPTIONAL = CHANNELS[3:]

# Where the metadata of a recording stand in Parquet files, and their version.
KEY = b"sdpid"
FORMAT = 1
# The first line of mappings that are written beside CSV files, and may be replaced.
_MADE = "# What the columns of the log beside it cannot tell; written with it."
# A number this near to one of nine decimals, in m or a cosine, was that one before rounding: radii
# of feet are measured in meshes, and rotations are made of cosines.
_DECIMALS, _ROUNDED = 9, 1e-10
# The end of the last period may be off by this many samples. A period that does not divide the
# record is off by many; half a sample is where the nearest sample becomes another one.
_PERIOD_SLACK = 0.5
# Below two samples a period has no motion at all.
_LEAST_SAMPLES = 2
# A step longer than this many median steps may hold a lost sample, or end with a late stamp.
_LONG = 1.5
# To tell the two apart, stamps on either side are averaged: a lost sample shifts them all.
_NEIGHBORS = 8
# No robot's controller steps faster, in s.
_SHORTEST = 1e-9
# Steps of whole numbers, in the unit that makes a rate between 20 Hz and 20 kHz of them: each unit
# has three decades of its own. Longer steps are counts of nanoseconds all the same.
_LARGEST_STEPS = {"ms": 5e1, "us": 5e4}
# Seconds since 1970 in the years 2001 to 2096: first stamps in that range tell their unit.
_EPOCH = (1e9, 4e9)
_EPOCH_UNITS = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Recording(Sampled):
    """A log of joint positions and efforts over time.

    Large arrays are not copied: a C-contiguous float64 array is kept as a read-only view, so the
    caller must not change it afterwards.

    Parameters
    ----------
    time : (N,) array_like
        Time stamps in s, strictly increasing.
    position : (N, n) array_like
        Joint positions in rad (m for a prismatic joint).
    effort : (N, n) array_like, optional
        Joint efforts in N·m (N). `read_recording` turns currents into torques. With `currents` the
        motors' currents in A. None where none were measured: such a log needs commanded positions
        and the law that ran (``identify(..., law=...)``).
    velocity : (N, n) array_like, optional
        Measured joint velocities in rad/s (m/s).
    reference : (N, n) array_like, optional
        Commanded joint positions in rad (m): what the controller was to follow.
    feedforward : (N, n) array_like, optional
        Commanded efforts in N·m (N), which the drives added to those of their law.
    link_position : (N, n) array_like, optional
        Positions of the links behind the gears in rad (m), from encoders of their own; `position`
        is then that of the motors. A joint without such an encoder repeats its position.
    joint_names : sequence of str, optional
        One name a joint, in the order of the columns.
    period : float, optional
        Length of one period of a periodic excitation, in s; a whole number of samples.
    start : float, optional
        Time at which the first whole period begins, in s; by default the first sample.
    periods : int, optional
        Number of whole periods from `start` on. By default as many as the record holds, which
        then must be a whole number.
    notes : tuple of str
        What a reader had to infer, in words.
    currents : bool
        Whether `effort` holds currents in A, of which gains are identified (see
        `identify_drive_gains`). Everything else refuses them.
    gains : DriveGains, optional
        The gains that turned currents into these efforts (`DriveGains.torque`), one a column:
        their errors count in all that follows.
    base : BaseMotion, optional
        Pose of the base link of a robot that nothing holds: a quadruped or a humanoid. Positions
        and efforts stay those of the joints.
    contacts : Contacts, optional
        Its feet on the ground; only with `base`.

    Attributes
    ----------
    stamps : Stamps
        The time stamps in numbers.
    source : Source or None
        The file that `read_recording` made it of, and how; None for arrays, and for a recording
        that was changed since.

    Raises
    ------
    DataError
        When the arrays are ragged, not finite or of different lengths, when time does not
        increase, when names do not match the joints, when the period does not divide the record,
        or when there are contacts without a base.

    Examples
    --------
    >>> time = np.arange(0.0, 2.0, 0.01)
    >>> angle = np.sin(time)[:, None]
    >>> hip = sdpid.Recording(time=time, position=angle, effort=0.5 * angle, joint_names=("hip",))
    >>> hip
    Recording(200 samples, 1 joints, 100 Hz)
    >>> round(hip.rate_hz), round(hip.duration, 2), hip.names
    (100, 1.99, ('hip',))
    >>> hip.to_parquet("hip.parquet")
    """

    time: Array = samples("time", what="time stamps in s", needed=True)
    position: Array = samples("position", "names", what=EACH_JOINT, needed=True)
    effort: Array = samples("{self._efforts}", "names", what=EACH_JOINT)
    velocity: Array | None = samples("velocity", "names", what=EACH_JOINT)
    reference: Array | None = samples("reference", "names", what=EACH_JOINT)
    feedforward: Array | None = samples("feedforward", "names", what=EACH_JOINT)
    link_position: Array | None = samples("link_position", "names", what=EACH_JOINT)
    joint_names: tuple[str, ...] | None = None
    period: float | None = None
    start: float | None = None
    periods: int | None = None
    notes: tuple[str, ...] = ()
    currents: bool = False
    gains: DriveGains | None = None
    base: BaseMotion | None = None
    contacts: Contacts | None = None
    stamps: Stamps = field(init=False)
    source: Source | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        for name in ("time", "position", "effort"):
            lacks = getattr(self, name) is None
            if lacks and (name != "effort" or self.reference is None):
                raise DataError(
                    f"{name} is missing; a recording needs time, position and effort, or commanded "
                    "positions (reference) in place of effort."
                )
        given = self.joint_names
        # Numbers stand for the names until the number of joints is known.
        object.__setattr__(self, "joint_names", None)
        self._keep_samples(base=BaseMotion, contacts=Contacts)
        if self.n_samples < _LEAST_SAMPLES:
            raise DataError(
                f"time: has {self.n_samples} samples, at least {_LEAST_SAMPLES} are needed."
            )
        object.__setattr__(self, "stamps", Stamps.of(self.time))
        if given is not None:
            object.__setattr__(self, "joint_names", checked_names(given, self.n))
        if self.gains is not None and (self.currents or self.gains.n != self.n):
            raise DataError(
                f"gains: are of {self.gains.n} joints, for {self.n} columns of efforts in "
                f"{'A' if self.currents else 'N·m'}; torques have gains, one a column."
            )
        if self.contacts is not None and self.base is None:
            raise DataError(
                "contacts: are given without a base; give base=sdpid.BaseMotion(orientation=...). "
                "The forces at a fixed robot's tool are a payload's."
            )
        self._check_period()

    def _words(self) -> list[str]:
        words = [f"{self.n} joints", f"{self.rate_hz:.6g} Hz"]
        if (layout := self.period_layout) is not None:
            words.append(f"{layout[2]} periods of {self.period:.6g} s")
        if self.currents:
            words.append("efforts in A")
        words += [
            f"with {name.replace('_', ' ')}" for name in OPTIONAL if getattr(self, name) is not None
        ]
        if "effort" not in self.channels:
            words.append("no effort")
        if self.base is not None:
            words.append("floating base" + (" with IMU" if self.base.imu is not None else ""))
        if self.contacts is not None:
            words.append(f"{self.contacts.n} contact{'s' * (self.contacts.n > 1)}")
        return words

    def _tables(self) -> list[Table]:
        low, high = self.position_range
        columns: dict[str, Any] = {"joint": self.names, "least position": low.tolist()}
        columns |= {"greatest position": high.tolist()}
        if "effort" in self.channels:
            rms = np.sqrt(np.mean(np.square(self.effort), axis=0))
            columns |= {f"rms effort{', A' * self.currents}": rms.tolist()}
        return [Table.of_columns(columns)]

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.position.shape[1])

    @cached_property
    def position_range(self) -> tuple[Array, Array]:
        """Least and greatest position of each joint, (n,) each, rad."""
        return extremes(self.position)

    @property
    def duration(self) -> float:
        """Time from the first to the last sample, in s."""
        return self.stamps.last - self.stamps.first

    @property
    def step(self) -> float:
        """Nominal time step in s: the duration over the number of steps, lost samples counted.

        Where time stamps jitter, this mean is far more accurate than the median of the steps.
        """
        return self.stamps.step

    @property
    def stored(self) -> bool:
        """Whether the arrays lie in temporary files; see `read_recording`."""
        return isinstance(self.position, StoredArray) and self.position.mapped

    @property
    def rate_hz(self) -> float:
        """Nominal sample rate in Hz."""
        return 1.0 / self.step

    @property
    def names(self) -> tuple[str, ...]:
        """Joint names for messages and columns: the given ones, or numbers from 1."""
        if self.joint_names is not None:
            return self.joint_names
        return tuple(str(j + 1) for j in range(self.n))

    @property
    def period_layout(self) -> tuple[int, int, int] | None:
        """First sample, samples per period and number of periods; None without a period.

        The numbers count nominal steps from the first sample.
        """
        if self.period is None:
            return None
        per_period = round(self.period / self.step)
        first = 0 if self.start is None else round((self.start - self.stamps.first) / self.step)
        if self.periods is not None:
            return int(first), per_period, self.periods
        held = (self.duration / self.step + 1.0 - first) / per_period
        return int(first), per_period, round(held)

    @property
    def _efforts(self) -> str:
        """What columns of efforts are called."""
        return "current" if self.currents else "effort"

    def _check_period(self) -> None:
        """Check `period`, `start` and `periods` against the record and each other."""
        if self.period is None:
            for name in ("start", "periods"):
                if getattr(self, name) is not None:
                    raise DataError(f"{name} is given without a period; give period as well.")
            return
        period = _number(self.period, "period")
        if period <= 0.0:
            raise DataError(f"period: is {period:g}, expected a positive number.")
        object.__setattr__(self, "period", period)
        if (count := self.periods) is not None:
            if not isinstance(count, (int, np.integer)) or isinstance(count, bool) or count < 1:
                raise DataError(f"periods: is {count}, expected a whole number of at least 1.")
            object.__setattr__(self, "periods", int(count))
        step, begin, end = self.step, self.stamps.first, self.stamps.last
        if self.start is not None:
            start = _number(self.start, "start")
            if not begin - step / 2 <= start <= end:
                raise DataError(
                    f"start: {start:.9g} s is outside the record, which runs from {begin:.9g} s "
                    f"to {end:.9g} s."
                )
            object.__setattr__(self, "start", start)
        if period < _LEAST_SAMPLES * step * (1.0 - 1e-9):
            raise DataError(
                f"period: {period:.6g} s is shorter than {_LEAST_SAMPLES} steps of {step:.6g} s."
            )
        assert self.period_layout is not None
        first, per_period, count = self.period_layout
        held, exact = self.duration / step + 1.0 - first, period / step
        spare, off = held - count * per_period, abs(exact - per_period) * count
        record = (
            f"from {begin + first * step:.9g} s on the record holds {held:.10g} samples, that is "
            f"{held / exact:.6g} periods"
        )
        if self.periods is not None and spare < -_PERIOD_SLACK:
            raise DataError(
                f"periods: {count} periods of {exact:.10g} samples do not fit: {record}."
            )
        if self.periods is None and (count < 1 or abs(spare) > _PERIOD_SLACK):
            raise DataError(
                f"period: {period:.9g} s ({exact:.10g} samples) does not divide the record: "
                f"{record}; set `start` and `periods` to pick whole periods."
            )
        if off > _PERIOD_SLACK:
            raise DataError(
                f"period: {period:.9g} s is {exact:.10g} samples at {self.rate_hz:.9g} Hz, not a "
                f"whole number: after {count} periods the samples are {off:.3g} steps out of "
                "place; resample the record."
            )

    def with_held_base(
        self, link: str, *, orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0)
    ) -> Recording:
        """Return the recording of a robot on legs whose base was held: hung up, or on a stand.

        An arm's recording says the same of the legs, and cannot stand beside those of a base that
        moves. What holds the base is a contact at its link that transmits any force and moment.

        Parameters
        ----------
        link : str
            The base link, or a frame of it.
        orientation : (4,) array_like, optional
            Unit quaternion x, y, z, w that turns vectors of the base link's frame into the
            world's; by default upright.

        Returns
        -------
        Recording

        Raises
        ------
        DataError
            When the recording has a base already, or the quaternion is none.

        Examples
        --------
        >>> hanging = log.with_held_base("base_link")
        >>> hanging.contacts.frames, hanging.contacts.kind
        (('base_link',), ('plane',))
        """
        if self.base is not None:
            raise DataError("with_held_base: the recording has the motion of a base already.")
        count = self.n_samples
        turned, still = np.tile(orientation, (count, 1)), np.zeros((count, 3))
        down = np.ones((count, 1), dtype=np.bool_)
        held = Contacts(frames=(link,), kind=("plane",), down=down)
        return replace(self, base=BaseMotion(orientation=turned, position=still), contacts=held)

    def to_parquet(self, path: str | os.PathLike[str]) -> None:
        """Write the recording to a Parquet file, without loss, whole or not at all.

        Columns are ``time``, ``position_<joint>``, ``effort_<joint>`` (of currents
        ``current_<joint>``) and, when there are any, ``velocity_<joint>`` and
        ``reference_<joint>``; of a floating base ``base_position_x``, ``base_orientation_x``,
        ``gyroscope_x``, ``contact_<frame>`` and so on. The rest is kept in the file's metadata
        under the key ``sdpid``.
        Gains are not kept, and so neither are their errors: where they matter, write the currents.

        Raises
        ------
        ExportError
            When the file cannot be written.
        MissingExtraError
            When pyarrow is not installed (extra ``io``).
        """
        pa = require("pyarrow", extra="io")
        pq = require("pyarrow.parquet", extra="io")
        names = ("n", "joint_names", "period", "start", "periods", "currents")
        stated = {"format": FORMAT} | {name: getattr(self, name) for name in names}
        columns, count = self.columns(), self.n_samples
        schema = pa.schema([pa.field(name, pa.float64(), nullable=False) for name in columns])
        schema = schema.with_metadata({KEY: json.dumps(stated | self.settings()).encode()})
        # Noisy doubles do not repeat, so a dictionary is a waste; splitting their bytes compresses.
        options = {"compression": "zstd", "use_dictionary": False, "use_byte_stream_split": True}
        with atomic_path(path) as file, pq.ParquetWriter(file, schema, **options) as writer:
            for begin in range(0, count, ROWS):
                parts = (values[begin : begin + ROWS] for values in columns.values())
                arrays = [pa.array(np.ascontiguousarray(part)) for part in parts]
                writer.write_batch(pa.record_batch(arrays, schema=schema))

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the recording to a CSV file with all digits, whole or not at all.

        Columns are those of `to_parquet`. Where an IMU sits and what kind of contacts there are is
        written to a mapping beside it, ``run.toml`` for ``run.csv``. A CSV file has no place for
        the period of the motion: say it when it is read.

        Raises
        ------
        ExportError
            When a file cannot be written, or another mapping lies beside it.
        """
        log, lines = Path(path), []
        for table, content in self.settings().items():
            pairs = {key: _in_decimals(value) for key, value in content.items()}
            lines.append(f"[{table}]")
            lines += [f"{key} = {json.dumps(x, ensure_ascii=False)}" for key, x in pairs.items()]
        mapping = mapping_beside(log)
        there = mapping.read_text("utf-8", errors="replace") if mapping.is_file() else ""
        if lines and there and not there.startswith(_MADE):
            raise ExportError(
                f"{mapping}: is a mapping of another log, and would tell how {log.name} is read; "
                f"move it away, or write to another name than {log.name}."
            )
        if lines or there.startswith(_MADE):
            atomic_write_text(mapping, "".join(f"{line}\n" for line in (_MADE, *lines)))
        Table.of_columns({k: column.tolist() for k, column in self.columns().items()}).write(path)


def mapping_beside(log: Path) -> Path:
    """Return where the mapping of a log lies: `run.toml` for `run.csv`, `run.csv.gz` or `run`."""
    unpacked = log.with_suffix("") if log.suffix.lower() == ".gz" else log
    return log.parent / f"{unpacked.stem}.toml"


def _in_decimals(value: Any) -> Any:
    """Return nested values whose numbers are decimals where they all but are."""
    if isinstance(value, list):
        return [_in_decimals(each) for each in value]
    if isinstance(value, float) and abs(value - (near := round(value, _DECIMALS))) < _ROUNDED:
        return near + 0.0
    return value


def channels(log: Recording) -> dict[str, Any]:
    """Return the tables of samples × joints that a recording has, by the names of its fields."""
    return {name: table for name, table in log.channels.items() if name in CHANNELS}


def renamed(log: Recording, names: tuple[str, ...]) -> Recording:
    """Return a recording with other joint names; its arrays are not checked again."""
    if log.joint_names == names:
        return log
    checked = checked_names(names, log.n)
    gains = None if log.gains is None else log.gains.renamed(checked)
    return _unchecked(log, joint_names=checked, gains=gains, source=None)


def with_source(log: Recording, source: Source) -> Recording:
    """Return a recording that knows the file it was read from."""
    return _unchecked(log, source=source)


def _unchecked(log: Recording, **changes: Any) -> Recording:
    """Return a recording with other fields, which are not checked."""
    result = copy(log)
    for name, value in changes.items():
        object.__setattr__(result, name, value)
    return result


def checked_names(names: Any, n: int) -> tuple[str, ...]:
    """Return `names` as a tuple of `n` distinct, non-empty strings.

    Raises
    ------
    DataError
        When there is another number of names, or one is empty, repeated or not a string.
    """
    result = distinct_names(names, "joint_names", f"{n} names")
    if len(result) != n:
        raise DataError(
            f"joint_names: {len(result)} names ({', '.join(result)}) for {n} joints (columns)."
        )
    return result


def _number(value: Any, name: str) -> float:
    """Return `value` as a float, or raise when it is not a finite number."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = float("nan")
    if not abs(number) <= LARGEST:
        # Python refuses to print an int of thousands of digits.
        shown = "a huge number" if isinstance(value, int) else repr(value)
        raise DataError(f"{name}: is {shown}, expected a finite number of at most {LARGEST:g}.")
    return number


@dataclass(frozen=True)
class Stamps:
    """First and last time stamp, and nominal, shortest and longest step of a record.

    Attributes
    ----------
    first, last : float
        The first and the last one, in s.
    step : float
        The duration over the number of steps, samples counted that are missing between regular
        ones, in s.
    least, most : float
        The shortest and the longest step, in s.
    row : int
        The row that ends the (first) longest step.
    """

    first: float
    last: float
    step: float
    least: float
    most: float
    row: int

    @staticmethod
    def of(time: Any) -> Stamps:
        """Check all stamps.

        Where steps differ by half or more, lost samples are looked for.

        Parameters
        ----------
        time : (N,) ndarray
            The stamps, finite.

        Raises
        ------
        DataError
            When they do not increase, naming the first row that does not.
        """
        steps = np.diff(time)
        wrong = np.flatnonzero(steps <= 0.0)
        if wrong.size:
            row = int(wrong[0]) + 1
            how = "repeats" if time[row] == time[row - 1] else "runs backwards"
            raise DataError(
                f"time {how} at row {row + 1}: {time[row]:.9g} s after {time[row - 1]:.9g} s "
                f"({wrong.size} such rows); sort the rows or remove the duplicates."
            )
        first, last, row = float(time[0]), float(time[-1]), int(np.argmax(steps)) + 1
        if last - first < _SHORTEST * steps.size:
            raise DataError(
                f"time: {len(time)} samples within {last - first:.3g} s; say their unit."
            )
        least, most = float(steps.min()), float(steps.max())
        lost = 0 if most < _LONG * least else _lost_samples(np.asarray(time))
        step = (last - first) / (steps.size + lost)
        return Stamps(first, last, step, least, most, row)


def guess_time_unit(time: Any) -> str:
    """Return the unit of stamps that come without one: s, ms, us or ns.

    Stamps that count from 1970 are recognized by their size, other whole numbers by their median
    step: as seconds they would be a log at 1 Hz or less.

    Parameters
    ----------
    time : (N,) ndarray
        The stamps as they stand in the file.
    """
    values = np.asarray(time, dtype=np.float64)
    values = values[np.isfinite(values)]
    if values.size <= 1:
        return "s"
    for unit, factor in _EPOCH_UNITS.items():
        if _EPOCH[0] * factor <= values[0] < _EPOCH[1] * factor:
            return unit
    step = float(np.median(np.diff(values)))
    if step < 1.0 or np.any(values != np.rint(values)):
        return "s"
    return next((unit for unit, most in _LARGEST_STEPS.items() if step <= most), "ns")


def _lost_samples(time: Array) -> int:
    """Count the samples that are missing between regular ones."""
    steps = np.diff(time)
    median = float(np.median(steps))
    lost = 0
    for i in np.flatnonzero(steps > _LONG * median):
        # Late samples catch up within as many as the gap held.
        around = max(_NEIGHBORS, 2 * round(float(steps[i]) / median))
        width = min(around, int(i) + 1, time.size - 1 - int(i))
        before, after = time[i + 1 - width : i + 1], time[i + 1 : i + 1 + width]
        shift = float(np.median(after - before)) / median - width
        lost += max(0, min(round(shift), round(float(steps[i]) / median) - 1))
    return lost
