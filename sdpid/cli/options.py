"""What the commands share: options and their parsing."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from enum import Enum
from pathlib import Path
from typing import Annotated, Any

import typer

from sdpid._common.files import PathLike, require_other_files
from sdpid._common.text import printable
from sdpid.errors import DataError, ExportError


class Consistency(str, Enum):
    """What every link must obey."""

    pseudo_inertia = "pseudo_inertia"
    spatial_inertia = "spatial_inertia"
    none = "none"


class Weighting(str, Enum):
    """How residuals are weighted."""

    gls = "gls"
    gls_per_sample = "gls_per_sample"
    eq9 = "eq9"
    eq18 = "eq18"
    residual = "residual"


class Velocity(str, Enum):
    """Where velocities come from."""

    measured = "measured"
    differentiated = "differentiated"


class IntervalMethod(str, Enum):
    """How intervals are found."""

    gauss_markov = "gauss_markov"
    profile = "profile"
    bootstrap = "bootstrap"


_READING = "Reading the log"
_PROCESSING = "Processing"
_ESTIMATION = "Estimation"

Log = Annotated[Path, typer.Argument(metavar="LOG", help="CSV, Parquet, NPZ, MAT, HDF5, ROS bag.")]
Logs = Annotated[
    list[Path],
    typer.Argument(metavar="LOG...", help="One or several: CSV, Parquet, NPZ, MAT, HDF5, ROS bag."),
]
Robot = Annotated[
    str, typer.Option(metavar="ROBOT", help="URDF file, or name of a bundled or example robot.")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON, and nothing else, on stdout.")]
Column = Annotated[
    list[str] | None,
    typer.Option(
        metavar="QUANTITY=NAME",
        help="Name in the file, such as effort=tau_measured, effort=i1,i2,i3 or velocity=none. "
        "Quantities: time, position, velocity, effort, ... May be repeated.",
        rich_help_panel=_READING,
    ),
]
Unit = Annotated[
    list[str] | None,
    typer.Option(
        metavar="QUANTITY=UNIT",
        help="Unit in the file where it is not SI, such as position=deg or time=ms.",
        rich_help_panel=_READING,
    ),
]
JointNames = Annotated[
    str | None,
    typer.Option(
        metavar="A,B,...", help="Names of the joints (columns).", rich_help_panel=_READING
    ),
]
Mapping = Annotated[
    str | None,
    typer.Option(
        metavar="FILE",
        help="TOML file with names, units, motors, ...; by default the one beside the log, "
        "run.toml for run.csv, and with none not even that. Other options win over it.",
        rich_help_panel=_READING,
    ),
]
Topic = Annotated[
    str | None,
    typer.Option(
        metavar="NAME", help="Topic of a ROS bag that has several.", rich_help_panel=_READING
    ),
]
EffortScale = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,...",
        help="N.m per unit of effort of each joint: torque constant times gear ratio, for "
        "efforts in A.",
        rich_help_panel=_READING,
    ),
]
Period = Annotated[
    float | None,
    typer.Option(metavar="S", help="Period of the motion, s.", rich_help_panel=_READING),
]
Start = Annotated[
    float | None,
    typer.Option(
        metavar="S", help="Time at which the first period begins, s.", rich_help_panel=_READING
    ),
]
Periods = Annotated[
    int | None,
    typer.Option(metavar="N", help="Number of whole periods.", rich_help_panel=_READING),
]
Cutoff = Annotated[
    float | None,
    typer.Option(metavar="HZ", help="Cut-off of the low-pass filter.", rich_help_panel=_PROCESSING),
]
Order = Annotated[
    int | None,
    typer.Option(metavar="N", help="Order of one pass of it.", rich_help_panel=_PROCESSING),
]
Filter = Annotated[
    str | None,
    typer.Option(
        "--filter",
        metavar="TYPE",
        help="Type of the low-pass filter: butterworth or bessel.",
        rich_help_panel=_PROCESSING,
    ),
]
DerivativeBy = Annotated[
    str | None,
    typer.Option(
        "--derivative",
        metavar="SCHEME",
        help="central, central4, central6, savitzky_golay, or spectral (with periods).",
        rich_help_panel=_PROCESSING,
    ),
]
VelocityFrom = Annotated[
    Velocity | None,
    typer.Option(
        "--velocity", help="Recorded, or differences of the position.", rich_help_panel=_PROCESSING
    ),
]
WithoutEffort = Annotated[
    str | None,
    typer.Option(
        "--without-effort",
        metavar="A,B,...",
        help="Joints whose efforts nobody measured, or that are wrong; their motion is used.",
        rich_help_panel=_ESTIMATION,
    ),
]
ConsistencyOf = Annotated[
    Consistency,
    typer.Option("--consistency", help="What every link must obey.", rich_help_panel=_ESTIMATION),
]
Margin = Annotated[
    float,
    typer.Option(
        metavar="X", help="Least margin of every link, kg.m2.", rich_help_panel=_ESTIMATION
    ),
]
PriorOf = Annotated[
    bool | None,
    typer.Option(
        "--prior/--no-prior",
        help="Believe in the description's inertias; by default for logs without periods.",
        rich_help_panel=_ESTIMATION,
    ),
]
MassMax = Annotated[
    float | None,
    typer.Option(
        metavar="X", help="Largest mass of a link, kg (default 100).", rich_help_panel=_ESTIMATION
    ),
]
Friction = Annotated[
    list[str] | None,
    typer.Option(
        metavar="TERM",
        help="coulomb, coulomb=0.02 (smooth over so many rad/s), coulomb=fit (over as many as fit "
        "best), asymmetric_coulomb, viscous, offset, rotor_inertia, stribeck, sigmoid, "
        "square_root, or coupling=joint_5,joint_6. Repeat for each term.",
        rich_help_panel=_ESTIMATION,
    ),
]
WeightingOf = Annotated[
    Weighting | None,
    typer.Option(
        "--weighting",
        help="By default gls with periods, else residual.",
        rich_help_panel=_ESTIMATION,
    ),
]


def pairs(values: Iterable[str] | None, option: str) -> dict[str, str]:
    """Split ``key=value`` options.

    Raises
    ------
    DataError
        When one has no ``=``, or a key comes twice.
    """
    found: dict[str, str] = {}
    for text in values or ():
        key, equals, value = text.partition("=")
        key, value = key.strip(), value.strip()
        if not (equals and key and value):
            raise DataError(f"{option} {text}: expected a quantity, '=' and a value.")
        if key in found:
            raise DataError(f"{option}: {key} is given twice: {found[key]} and {value}.")
        found[key] = value
    return found


def reading(
    column: Sequence[str] | None,
    unit: Sequence[str] | None,
    joint_names: str | None,
    effort_scale: str | None,
    mapping: str | None = None,
    topic: str | None = None,
) -> dict[str, Any]:
    """Return the arguments of `read_recording` that hold for every log of a command."""
    columns: dict[str, Any] = {}
    for key, value in pairs(column, "--column").items():
        columns[key] = value.split(",") if "," in value else value
        if value.lower() == "none":
            columns[key] = None
    return {
        "columns": columns or None,
        "units": pairs(unit, "--unit") or None,
        "joint_names": None if joint_names is None else split_list(joint_names),
        "effort_scale": None if effort_scale is None else numbers(effort_scale, "--effort-scale"),
        "mapping": False if mapping == "none" else mapping,
        "topic": topic,
    }


def split_list(text: str) -> list[str]:
    """Split at commas."""
    return [part.strip() for part in text.split(",")]


def numbers(text: str, option: str) -> list[float]:
    """Split numbers at commas.

    Raises
    ------
    DataError
        When one is not a number.
    """
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise DataError(f"{option} {text}: expected numbers with commas between them.") from None


def require_folder(option: str, file: Path, inputs: Iterable[PathLike | None] = ()) -> None:
    """Refuse a file that cannot be written, before the work is done.

    Parameters
    ----------
    option : str
        The option that names the file.
    file : Path
        Will be written.
    inputs : iterable of path
        Files that are read.

    Raises
    ------
    ExportError
        When its folder is not there, it is a folder itself, or an input.
    """
    if not file.parent.is_dir() or file.is_dir():
        what = "is a folder" if file.is_dir() else f"there is no folder {file.parent}"
        raise ExportError(f"cannot write {file}: {what}.")
    require_other_files(option, [file], inputs)


def files_read(logs: Iterable[Path], *others: PathLike | None) -> list[PathLike | None]:
    """Return the files that a command reads: logs, the mappings beside them, and others."""
    beside = [log.with_suffix(".toml") if log.suffix else Path(f"{log}.toml") for log in logs]
    return [*logs, *beside, *others]


def listed(title: str, lines: Iterable[str]) -> str:
    """Return indented lines under a title; what would begin a line of its own is replaced."""
    return "\n".join((f"{title}:", *(f"  {printable(line)}" for line in lines)))


def echo(text: str) -> None:
    """Print text of several lines on stdout, without characters that a terminal would obey."""
    typer.echo(printable(text, keep="\n"))


def print_json(values: Any) -> None:
    """Print plain values as JSON on stdout."""
    from sdpid._common.json import json_text

    typer.echo(json_text(values))
