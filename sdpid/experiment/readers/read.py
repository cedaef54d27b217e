"""`read_recording`: from a log file to a `Recording`, by names and units."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from inspect import Parameter, Signature
from pathlib import Path
from typing import Any, TypeAlias, overload

from sdpid._common.files import Source, unchanged
from sdpid._common.sandbox import run_in_sandbox
from sdpid.errors import DataError
from sdpid.experiment.readers.columns import named, row_number
from sdpid.experiment.readers.conversion import convert
from sdpid.experiment.readers.formats.loaders import BY_SUFFIX, FRAMES, MATRICES, Format, suffix_of
from sdpid.experiment.readers.formats.text_file import is_folder_of_matrices
from sdpid.experiment.readers.mapping import Arguments, checked, complete_arguments
from sdpid.experiment.readers.selection import Selection, select
from sdpid.experiment.recording.recording import Recording, with_source

# A file, or a data frame of pandas or polars.
Readable: TypeAlias = "str | os.PathLike[str] | Any"


@dataclass(frozen=True, kw_only=True)
class Reading:
    """A recording, and where in the file it was found.

    Attributes
    ----------
    recording : Recording
        What was read.
    file : str
        From which file.
    mapping : str or None
        The mapping that was followed.
    sources : dict
        For each quantity, what it was read from, in words.
    """

    recording: Recording
    file: str
    mapping: str | None = None
    sources: dict[str, str] = field(default_factory=dict)


@overload
def read_recording(path: Sequence[str | os.PathLike[str]], **how: Any) -> list[Recording]: ...
@overload
def read_recording(path: Readable, **how: Any) -> Recording: ...
def read_recording(path: Any, **how: Any) -> Any:
    """Read a log, or several that were logged in the same way.

    Formats: CSV (also ``.csv.gz``), Parquet, Feather, NPZ, MATLAB (``.mat``), HDF5, PyTorch's
    tensors (``.pt``), ROS bags with messages that have joints in them (``.db3``, ``.mcap``,
    ``.bag``, or the folder of a ROS 2 bag), folders of text matrices, and data frames of pandas or
    polars. Nothing is ever unpickled or run.

    Quantities are found by their usual names (``t``, ``q``, ``dq``, ``tau``, ``position_1``,
    ``actual_q``, ``time_ms``, ...). Other names come from the arguments or from a mapping, a TOML
    file beside the log (``run.toml`` for ``run.csv``) with the same names as the arguments, which
    win. All names, units and formats: docs/guides/logs.md.

    Parameters
    ----------
    path : path-like, data frame, or a sequence of paths
        The file; its suffix tells the format. A sequence gives a list, and all must then have the
        same joints.
    mapping : path-like, mapping or False, optional
        A mapping elsewhere, or its content; False ignores the one beside the log.
    stored : bool, optional
        Whether to keep the values of a Parquet file in temporary files that are mapped into
        memory, so that a log may be larger than memory; by default those of logs that would take
        more than 256 MB. `TMPDIR` says where they lie.
    columns : mapping, optional
        Where to find quantities that have other names: ``{"effort": "tau_current"}`` names an
        array (or the beginning of the names of its columns), ``{"effort": ["i1", "i2"]}`` lists
        columns, ``{"velocity": None}`` leaves a quantity out. Of a text file without names,
        numbers from 1: ``{"time": 1, "position": [2, 3]}``.
    units : mapping, optional
        Units of the file where they are not SI, as ``{"position": "deg", "time": "ms"}``; a list
        has one unit for each joint.
    motors : MotorSide or mapping, optional
        For what was logged at the motors: gear ratios, signs, offsets, or a full matrix where
        joints are coupled; a mapping as in `MotorSide.from_mapping`.
    joint_names : sequence of str, optional
        Joints in the order wanted: picks and orders those that the file names. Where the file
        has other names for as many joints, it renames them.
    topic : str, optional
        Topic of a ROS bag.
    rate_hz : float, optional
        Sample rate in Hz of a log without time stamps.
    missing : {"refuse", "drop", "interpolate"}, optional
        What to do with samples that have no value (NaN, or an empty field): refuse the log (the
        default), drop the samples, or interpolate linearly over gaps of at most 10 samples.
    period, start, periods : optional
        As in `Recording`; override what the file says.
    effort_scale : (n,) array_like, optional
        N·m per unit of effort, where efforts are currents on the joints' side: the torque constant
        times the gear ratio.
    gains : DriveGains, path-like or (n,) array_like, optional
        Gains of the drives, N·m/A, for efforts that are currents: those of ``gains.toml``, which
        ``sdpid gains`` writes, have errors that count in all that follows. Signs may stand in
        `effort_scale` beside them.
    currents : bool, optional
        Keep efforts as currents in A, to estimate gains from (`identify_drive_gains`); nothing
        else takes such a recording.
    without_effort : sequence of str, optional
        Joints whose effort may lack every value; it is then read as zero. Leave them out of the
        fit too (``identify(..., without_effort=...)``). Where the file has no names, numbers
        from 1.
    base : mapping, optional
        Of a floating base: ``quaternion``, ``"xyzw"`` or ``"wxyz"``, where the names of the
        columns do not say it; ``velocity_frame``, ``"world"`` or ``"base"``; in a ROS bag
        ``topic``, with its odometry. Of a base that was held, as in a stand: ``held``, the link,
        and its ``orientation`` x, y, z, w in the world, by default upright (`with_held_base`).
    imu : mapping, optional
        ``translation`` and ``rotation`` of the sensor in the base link, as in `Imu`; in a ROS bag
        its ``topic``.
    contacts : mapping, optional
        ``frames``, ``kind`` and ``offset`` as in `Contacts`; ``threshold`` above which numbers
        in the columns of contacts mean a closed one.
    rows : (int, int), optional
        First and last sample to read, counted from 1: one of several recordings in a file.

    Returns
    -------
    Recording, or a list of them
        What was logged, in SI units.

    Raises
    ------
    DataError
        When the file is missing or damaged, its format is unknown, a quantity is not found, a
        unit is unknown, or the data are not a valid recording.
    MissingExtraError
        When the format needs a package that is not installed.

    Examples
    --------
    >>> names = ["t", *(f"angle{i}" for i in range(1, 7)), *(f"tau{i}" for i in range(1, 7))]
    >>> rows = np.column_stack([log.time, np.rad2deg(log.position), log.effort])[:1000]
    >>> np.savetxt("run.csv", rows, delimiter=",", header=",".join(names), comments="")
    >>> sdpid.read_recording("run.csv", columns={"position": "angle"}, units={"position": "deg"})
    Recording(1000 samples, 6 joints, 1000 Hz)
    """
    if not isinstance(path, (list, tuple)):
        return read_described(path, **how).recording
    records = [read_described(one, **how).recording for one in path]
    for one, record in zip(path, records, strict=True):
        if (record.n, record.joint_names) != (records[0].n, records[0].joint_names):
            raise DataError(
                f"{one}: has the joints {', '.join(record.names)}, {path[0]} has "
                f"{', '.join(records[0].names)}; give joint_names=."
            )
    return records


def _signature() -> Signature:
    """Return what `read_recording` takes, for help and documentation."""
    names = {"mapping": None, "stored": None}
    names |= {each.name: getattr(Arguments(), each.name) or None for each in fields(Arguments)}
    named = [Parameter(name, Parameter.KEYWORD_ONLY, default=x) for name, x in names.items()]
    return Signature([Parameter("path", Parameter.POSITIONAL_OR_KEYWORD), *named])


vars(read_recording)["__signature__"] = _signature()


def read_described(
    path: Readable,
    *,
    mapping: str | os.PathLike[str] | Mapping[str, Any] | bool | None = None,
    stored: bool | None = None,
    **how: Any,
) -> Reading:
    """Return a log with the names its quantities were found under; see `read_recording`.

    Raises
    ------
    DataError
        As `read_recording`; also when an argument is not known.
    """
    frame = is_frame(path)
    try:
        file = Path("data frame" if frame else path)
    except TypeError:
        raise DataError(
            f"read_recording: is given {type(path).__name__}, expected the path of a log, a data "
            "frame, or a list of paths."
        ) from None
    arguments, mapped = complete_arguments(None if frame else file, mapping, how)
    place: Callable[[int], str] = row_number
    with named(file), unchanged(file):
        kind = FRAMES if frame else _format(file)
        choices = _choices(
            kind, "a data frame" if frame else f"a file {suffix_of(file)}", arguments, stored
        )
        if kind.sandboxed:
            plain = (str(file), choices, arguments.to_dict())
            found = Selection(**run_in_sandbox(_plain_selection, *plain, subject=str(file)))
        else:
            table = kind.load(path if frame else file, **choices)
            found, place = select(file, table, arguments), table.place
        recording, sources = convert(found, arguments, place)
        if not frame:
            recording = with_source(recording, Source.of(file, arguments.to_dict()))
    return Reading(recording=recording, file=str(file), mapping=mapped, sources=sources)


def _plain_selection(path: str, choices: dict[str, Any], how: dict[str, Any]) -> dict[str, Any]:
    """Load a log in a child process and return its `Selection` as plain values."""
    file = Path(path)
    return vars(select(file, _format(file).load(file, **choices), Arguments(**checked(how))))


def is_frame(source: Any) -> bool:
    """Tell whether a log is a data frame of pandas or polars."""
    return hasattr(source, "columns") and not isinstance(source, (str, os.PathLike))


def _choices(kind: Format, this: str, arguments: Arguments, stored: bool | None) -> dict[str, Any]:
    """Return the arguments that only the loader of one format takes."""
    said = {"base": arguments.base.get("topic"), "imu": arguments.imu.get("topic")}
    offered = {
        "topic": arguments.topic,
        "joint_names": arguments.joint_names,
        "topics": {name: topic for name, topic in said.items() if topic is not None},
        "stored": stored,
    }
    if arguments.topic is not None and "topic" not in kind.choices:
        raise DataError(f"topic is for ROS bags; this is {this}.")
    if stored and "stored" not in kind.choices:
        raise DataError(
            f"stored=True keeps the values of Parquet files on disk; this is {this}. Write it as "
            "Parquet (Recording.to_parquet), or leave stored out."
        )
    return {name: offered[name] for name in kind.choices}


def _format(file: Path) -> Format:
    """Return the format of a log, which its suffix tells, or what is in a folder."""
    if file.is_dir():
        if (file / "metadata.yaml").is_file():
            return BY_SUFFIX[".db3"]
        if is_folder_of_matrices(file):
            return MATRICES
        raise DataError(
            "is a folder without metadata.yaml, so it is no ROS 2 bag, and without text files "
            "(.dat, .txt, .csv, .tsv) that could be matrices."
        )
    suffix = suffix_of(file)
    if suffix not in BY_SUFFIX:
        known = ", ".join((*sorted(BY_SUFFIX), "folder"))
        raise DataError(f"format '{suffix}' is not known; supported are {known}.")
    if not file.is_file():
        raise DataError("is no regular file." if file.exists() else "there is no such file.")
    return BY_SUFFIX[suffix]
