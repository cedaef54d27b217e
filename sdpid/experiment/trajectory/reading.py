"""`read_trajectory`: a motion from the file of any tool."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.readers.columns import Columns, LogTable, named
from sdpid.experiment.readers.conversion import in_seconds, in_si
from sdpid.experiment.readers.formats.loaders import BY_SUFFIX, suffix_of
from sdpid.experiment.trajectory.curve import SampledCurve, rests_at_ends
from sdpid.experiment.trajectory.trajectory import Trajectory

# Names of accelerations, which logs do not have; those of the rest are the readers'.
_ACCELERATIONS = ("acceleration", "accelerations", "ddq", "qdd", "acc")
# A column is the derivative of another when it integrates to it within this factor: far from the
# 57 between radians and degrees, above what steps of half a second between samples cost.
_DERIVATIVE = 1.5
# A joint that moves less than this (rad, rad/s) in all is not looked at.
_STILL = 1e-4
# Motions are simulated at this rate (Hz) or more, between rests (s), with connections (s) where
# they do not rest at their ends.
_LEAST_RATE, _REST, _CONNECTION = 250.0, 1.0, 2.0


def read_trajectory(
    path: str | os.PathLike[str], joint_names: Sequence[str] | None = None
) -> Trajectory:
    """Read a motion: samples of any tool, or the file of `Trajectory.to_toml`.

    Samples are CSV (also ``.csv.gz``, ``.tsv``, ``.txt``), Parquet or NPZ with ``time``,
    ``position_<joint>`` and, where there are any, ``velocity_<joint>`` and
    ``acceleration_<joint>``; other usual names and units are found as by `read_recording`. The
    motion goes through the samples, see `SampledCurve`.

    Parameters
    ----------
    path : path-like
        The file; its suffix tells the format.
    joint_names : sequence of str, optional
        The robot's joints; the file must have the same, in any order, or as many without names.

    Returns
    -------
    Trajectory
        Of samples, one period without rest, connections and limits.

    Raises
    ------
    DataError
        When the file cannot be read, columns are missing, joints are unknown, a value is missing,
        time does not increase, or a column is not the derivative of the one before.
    MissingExtraError
        When the format needs a package that is not installed.
    """
    file = Path(path)
    if file.suffix.lower() == ".toml":
        motion = Trajectory.from_toml(file)
        if joint_names is not None and motion.joint_names != tuple(joint_names):
            raise DataError(f"{file}: {_other_joints(motion.joint_names, joint_names)}")
        return motion
    known = {suffix: each for suffix, each in sorted(BY_SUFFIX.items()) if each.moves}
    suffix = suffix_of(file)
    if suffix not in known:
        raise DataError(
            f"{file}: '{suffix}' is no format of trajectories; known are .toml, {', '.join(known)}."
        )
    if not file.is_file():
        raise DataError(f"{file}: there is no such file.")
    with named(file):
        curve, names = _sampled(file, known[suffix].load(file), joint_names)
    return Trajectory(
        joint_names=names,
        series=curve,
        rate_hz=max(len(curve.time) - 1, 2) / curve.duration,
        periods=1,
        rest=0.0,
        connection=0.0,
        position_range=np.tile([-np.inf, np.inf], (curve.n, 1)),
        velocity_limit=np.full(curve.n, np.inf),
    )


def sampled_curve(columns: Any, joint_names: Sequence[str]) -> SampledCurve:
    """Return the curve through samples in a mapping or a data frame, columns as in a file."""
    names, motion = columns.keys(), Path("motion")
    table = LogTable({str(name): partial(np.asarray, columns[name]) for name in names})
    with named(motion):
        return _sampled(motion, table, joint_names)[0]


def between_rests(motion: Trajectory) -> Trajectory:
    """Return a motion of samples with rest before and after it, and connections if it needs them.

    Its rate is raised to a multiple of at least 250 Hz.
    """
    rate = motion.rate_hz * np.ceil(_LEAST_RATE / motion.rate_hz)
    connection = 0.0 if rests_at_ends(motion.series) else round(_CONNECTION * rate) / rate
    return replace(
        motion, rate_hz=float(rate), rest=round(_REST * rate) / rate, connection=connection
    )


def _sampled(
    file: Path, table: LogTable, wanted: Sequence[str] | None
) -> tuple[SampledCurve, tuple[str, ...]]:
    """Return the curve through the samples of a file, and the names of its joints."""
    # An array, or columns by joint.
    called = re.compile(rf"({'|'.join(_ACCELERATIONS)})(?:$|[_./\s\-\[\d])", re.IGNORECASE)
    there = {match[1].lower() for match in map(called.match, table.arrays) if match}
    acceleration = next((key for key in _ACCELERATIONS if key in there), None)
    log = Columns(file, table, {"acceleration": acceleration})
    time, _ = log.read("time")
    position, labels = log.read("position", wanted)
    if time is None or position is None:
        raise DataError(
            f"column {'time' if time is None else 'position_<joint>'} is missing; give time in s, "
            "position_<joint> and, where there are any, velocity_<joint> and "
            f"acceleration_<joint>. Found: {', '.join(list(table.arrays)[:40]) or 'nothing'}."
        )
    names: Sequence[str] | None = labels or log.names()
    unnamed = names is None or all(name.isdigit() for name in names)
    if wanted is None or (unnamed and len(wanted) == position.shape[1]):
        # Numbers are no names of a robot's joints.
        names = wanted or names or [f"joint_{j + 1}" for j in range(position.shape[1])]
        order = list(range(position.shape[1]))
    elif names is None or set(names) != set(wanted):
        raise DataError(_other_joints(names or (), wanted))
    else:
        order = [list(names).index(name) for name in wanted]
        names = wanted
    values = {"time": in_seconds(np.asarray(time).ravel()), "position": position}
    for quantity in ("velocity", "acceleration"):
        found, label = log.read(quantity, labels)
        if found is not None and (label != labels or found.shape != position.shape):
            raise DataError(
                f"{quantity} has {found.shape[1]} columns ({_listed(label)}), position has "
                f"{position.shape[1]} ({_listed(labels)}); give the same joints."
            )
        if found is not None:
            values[quantity] = found
    for quantity, array in values.items():
        columns = log.used[quantity]
        if array.dtype.kind not in "fiu":
            raise DataError(f"{', '.join(columns)}: holds {array.dtype}, expected numbers.")
        bad = np.argwhere(~np.isfinite(array.reshape(len(array), -1)))
        if len(bad):
            row, column = bad[0].tolist()
            whole = len(columns) <= column
            name = f"{columns[0]}, column {column + 1}" if whole else columns[column]
            raise DataError(f"{table.place(row)}: {name} has no finite value; repair it.")
        array = in_si(quantity, array, log.implied, None)
        values[quantity] = array if quantity == "time" else array[:, order]
    short = np.flatnonzero(np.diff(values["time"]) <= 0.0)
    if short.size:
        k = int(short[0]) + 1
        raise DataError(
            f"{table.place(k)}: time does not increase: {values['time'][k]} s after "
            f"{values['time'][k - 1]} s; leave out repeated samples."
        )
    curve = SampledCurve(**values)
    for word, value, rate in (
        ("velocity", curve.position, curve.velocity),
        ("acceleration", curve.velocity, curve.acceleration),
    ):
        if value is not None and rate is not None:
            _check_derivative(word, curve.time, value, rate, names)
    return curve, tuple(names)


def _check_derivative(
    word: str, time: Array, value: Array, rate: Array, names: Sequence[str]
) -> None:
    """Raise where a rate is far from the derivative of a value: in another unit, often."""
    moved = value[1:] - value[0]
    steps = 0.5 * np.diff(time)[:, None] * (rate[1:] + rate[:-1])
    integral = np.cumsum(steps, axis=0)
    for j, name in enumerate(names):
        square, product = integral[:, j] @ integral[:, j], integral[:, j] @ moved[:, j]
        if max(np.abs(moved[:, j]).max(), np.abs(integral[:, j]).max()) < _STILL:
            continue
        factor = square / product if product else np.inf
        if not 1.0 / _DERIVATIVE < factor < _DERIVATIVE:
            raise DataError(
                f"the {word} of {name} is {factor:.3g} times what its other columns say; give "
                "rad, rad/s and rad/s² (m for prismatic joints), or leave it out."
            )


def _other_joints(names: Sequence[str], wanted: Sequence[str]) -> str:
    """Return what is wrong with the names of joints."""
    unknown = [name for name in names if name not in wanted]
    missing = [name for name in wanted if name not in names]
    parts = [f"the robot has no joint {_listed(unknown)}"] if unknown else []
    parts += [f"positions of {_listed(missing)} are missing"] if missing else []
    said = "; ".join(parts) or "its joints are in another order"
    return f"{said}. The robot's joints are {_listed(wanted)}."


def _listed(names: Sequence[str] | None) -> str:
    return ", ".join(names or ("without names",))
