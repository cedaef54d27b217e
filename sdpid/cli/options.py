"""Options that several commands have, declared once in groups, and how their values are read.

A command names a group as the type of a parameter: `expand_groups` puts the group's options in
the parameter's place. Every command has the group `Printing`, and with it ``--config``.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from sdpid._common.files import PathLike, require_other_files
from sdpid._common.progress import hidden_progress
from sdpid._common.text import printable
from sdpid.cli.config import PARAMETERS, read_config
from sdpid.errors import DataError, ExportError, ModelError

if TYPE_CHECKING:
    from sdpid.assurance.diagnostics.validation import Validation
    from sdpid.estimation.constraints.constraints import Constraints
    from sdpid.experiment.recording.recording import Recording
    from sdpid.robot.friction.term import FrictionTerm
    from sdpid.robot.model.model import RobotModel


class Consistency(str, Enum):
    """The physical consistency that every link must have."""

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
    """How confidence intervals are computed."""

    gauss_markov = "gauss_markov"
    profile = "profile"
    bootstrap = "bootstrap"


_READING = "Reading the log"
_PROCESSING = "Processing"
_ESTIMATION = "Estimation"
_PRINTING = "Configuration and output"

_FRICTION_TERMS = (
    *("coulomb", "asymmetric_coulomb", "viscous", "offset", "rotor_inertia"),
    *("stribeck", "sigmoid", "square_root"),
)


def _beginning(words: Iterable[str]) -> Callable[[str], list[str]]:
    """Return a function that completes what is typed to one of some words."""
    return lambda incomplete: [word for word in words if word.startswith(incomplete)]


def complete_robot(incomplete: str) -> list[str]:
    """Complete the name of a robot; where none begins so, the shell completes files."""
    from sdpid.robot.description.catalog import robot_names

    return _beginning(robot_names())(incomplete)


Log = Annotated[
    Path, typer.Argument(metavar="LOG", help="CSV, Parquet, NPZ, MAT, HDF5 file or ROS bag.")
]
Logs = Annotated[
    list[Path],
    typer.Argument(
        metavar="LOG...",
        help="One or several: CSV, Parquet, NPZ, MAT, HDF5 file or ROS bag.",
        # Without a variable of the environment, older versions of typer do not look up --config for
        # an argument of any number of values.
        envvar="SDPID_LOGS",
        show_envvar=False,
    ),
]
Robot = Annotated[
    str,
    typer.Option(
        metavar="ROBOT",
        help="URDF or MJCF file, or name of a bundled or example robot.",
        autocompletion=complete_robot,
    ),
]
OptionalRobot = Annotated[
    str | None,
    typer.Option(
        metavar="ROBOT",
        help="Robot to compare with: URDF or MJCF file, or name.",
        autocompletion=complete_robot,
    ),
]


@dataclass(frozen=True, kw_only=True)
class Reading:
    """How every log of a command is read."""

    column: Annotated[
        list[str] | None,
        typer.Option(
            metavar="QUANTITY=NAME",
            help="Name in the file, such as effort=tau_measured, effort=i1,i2,i3 or "
            "velocity=none. Quantities: time, position, velocity, effort, ... May be repeated.",
            rich_help_panel=_READING,
        ),
    ] = None
    unit: Annotated[
        list[str] | None,
        typer.Option(
            metavar="QUANTITY=UNIT",
            help="Unit in the file where it is not SI, such as position=deg or time=ms. May be "
            "repeated.",
            rich_help_panel=_READING,
        ),
    ] = None
    joint_names: Annotated[
        str | None,
        typer.Option(
            metavar="A,B,...",
            help="Names of the joints, in the order of the columns.",
            rich_help_panel=_READING,
        ),
    ] = None
    effort_scale: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,...",
            help="N.m per unit of effort of each joint: torque constant times gear ratio, for "
            "efforts in A.",
            rich_help_panel=_READING,
        ),
    ] = None
    mapping: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="TOML file with names, units and motors. Default: the one beside the log, "
            "run.toml for run.csv; 'none' ignores that too. Other options win over it.",
            rich_help_panel=_READING,
        ),
    ] = None
    topic: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Topic of a ROS bag that has several.", rich_help_panel=_READING
        ),
    ] = None

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `read_recording`."""
        columns: dict[str, Any] = {}
        for key, value in pairs(self.column, "--column").items():
            columns[key] = value.split(",") if "," in value else value
            if value.lower() == "none":
                columns[key] = None
        scale = self.effort_scale
        return {
            "columns": columns or None,
            "units": pairs(self.unit, "--unit") or None,
            "joint_names": None if self.joint_names is None else split_list(self.joint_names),
            "effort_scale": None if scale is None else numbers(scale, "--effort-scale"),
            "mapping": False if self.mapping == "none" else self.mapping,
            "topic": self.topic,
        }

    def read(self, log: Path, **periods: Any) -> Recording:
        """Read a log."""
        from sdpid.experiment.readers.read import read_recording

        return read_recording(log, **self.arguments(), **periods)

    def files(self, logs: Iterable[Path], *others: PathLike | None) -> list[PathLike | None]:
        """Return the files that a command reads: logs, mappings, and others."""
        beside = [log.with_suffix(".toml") if log.suffix else Path(f"{log}.toml") for log in logs]
        return [*logs, *beside, self.mapping, *others]


@dataclass(frozen=True, kw_only=True)
class Periods:
    """The periods of the motion."""

    period: Annotated[
        float | None,
        typer.Option(metavar="S", help="Period of the motion, s.", rich_help_panel=_READING),
    ] = None
    start: Annotated[
        float | None,
        typer.Option(
            metavar="S", help="Time at which the first period begins, s.", rich_help_panel=_READING
        ),
    ] = None
    periods: Annotated[
        int | None,
        typer.Option(metavar="N", help="Number of whole periods.", rich_help_panel=_READING),
    ] = None

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `read_recording`."""
        return vars(self).copy()


@dataclass(frozen=True, kw_only=True)
class ProcessingOptions:
    """What differs from the processing that is chosen for the log."""

    cutoff: Annotated[
        float | None,
        typer.Option(
            metavar="HZ",
            help="Cut-off frequency of the low-pass filter, Hz.",
            rich_help_panel=_PROCESSING,
        ),
    ] = None
    order: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Order of the filter in one of its two passes.",
            rich_help_panel=_PROCESSING,
        ),
    ] = None
    velocity: Annotated[
        Velocity | None,
        typer.Option(
            help="Use the recorded velocity, or differentiate the position.",
            rich_help_panel=_PROCESSING,
        ),
    ] = None
    filter: Annotated[
        str | None,
        typer.Option(
            metavar="TYPE",
            help="Type of the low-pass filter: butterworth or bessel.",
            rich_help_panel=_PROCESSING,
            autocompletion=_beginning(("butterworth", "bessel")),
        ),
    ] = None
    derivative: Annotated[
        str | None,
        typer.Option(
            metavar="SCHEME",
            help="central, central4, central6, savitzky_golay, or spectral (with periods).",
            rich_help_panel=_PROCESSING,
            autocompletion=_beginning(
                ("central", "central4", "central6", "savitzky_golay", "spectral")
            ),
        ),
    ] = None

    def changes(self) -> dict[str, Any]:
        """Return the settings that were given, by their names in `Processing`."""
        settings: dict[str, Any] = {
            "cutoff_hz": self.cutoff,
            "order": self.order,
            "velocity": None if self.velocity is None else self.velocity.value,
            "filter": self.filter,
            "derivative": self.derivative,
        }
        return {name: value for name, value in settings.items() if value is not None}


@dataclass(frozen=True, kw_only=True)
class Estimation:
    """The problem that is solved."""

    consistency: Annotated[
        Consistency,
        typer.Option(
            help="Physical consistency that every link must have.", rich_help_panel=_ESTIMATION
        ),
    ] = Consistency.pseudo_inertia
    margin: Annotated[
        float,
        typer.Option(
            metavar="X", help="Smallest margin of every link, kg.m2.", rich_help_panel=_ESTIMATION
        ),
    ] = 0.0
    mass_max: Annotated[
        float | None,
        typer.Option(
            metavar="X",
            help="Largest mass of a link, kg (default 100).",
            rich_help_panel=_ESTIMATION,
        ),
    ] = None
    prior: Annotated[
        bool | None,
        typer.Option(
            "--prior/--no-prior",
            help="Regularize towards the inertias in the robot's description. Default: for logs "
            "without periods.",
            rich_help_panel=_ESTIMATION,
        ),
    ] = None
    friction: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TERM",
            help="coulomb, coulomb=0.02 (smooth within 0.02 rad/s), coulomb=fit (smooth within "
            "the speed that fits best), asymmetric_coulomb, viscous, offset, rotor_inertia, "
            "stribeck, sigmoid, square_root, or coupling=joint_5,joint_6. Repeat for each term.",
            rich_help_panel=_ESTIMATION,
            autocompletion=_beginning(_FRICTION_TERMS),
        ),
    ] = None
    without_effort: Annotated[
        str | None,
        typer.Option(
            metavar="A,B,...",
            help="Joints whose effort was not measured, or is wrong; only their motion is used.",
            rich_help_panel=_ESTIMATION,
        ),
    ] = None
    weighting: Annotated[
        Weighting | None,
        typer.Option(
            help="Weighting of the residuals. Default: gls with periods, else residual.",
            rich_help_panel=_ESTIMATION,
        ),
    ] = None

    def arguments(self, robot: RobotModel) -> dict[str, Any]:
        """Return the arguments of `formulate`."""
        return {
            "friction": friction_terms(self.friction),
            "without_effort": ()
            if self.without_effort is None
            else split_list(self.without_effort),
            "weighting": None if self.weighting is None else self.weighting.value,
            "consistency": self.consistency.value,
            "constraints": self._constraints(robot),
            "prior": self.prior,
        }

    def _constraints(self, robot: RobotModel) -> Constraints:
        """Return bounds that follow the robot's size, but for those that were given."""
        from sdpid.estimation.constraints.constraints import Constraints

        given = {} if self.mass_max is None else {"mass_max": self.mass_max}
        return Constraints.of_size(robot, margin=self.margin, **given)


@dataclass(frozen=True, kw_only=True)
class Printing:
    """Where options come from, and what is printed."""

    config: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="TOML file with values of options (cutoff = 10.0, friction = ['coulomb', "
            "'viscous']) and of LOG (log = 'run.csv'); options given here win over it.",
            is_eager=True,
            callback=read_config,
            rich_help_panel=_PRINTING,
        ),
    ] = None
    json: Annotated[
        bool,
        typer.Option("--json", help="Print results as JSON.", rich_help_panel=_PRINTING),
    ] = False
    quiet: Annotated[
        bool,
        typer.Option("--quiet", "-q", help="Print nothing but errors.", rich_help_panel=_PRINTING),
    ] = False

    def show(self, values: Any, text: str) -> None:
        """Print the values as JSON, or the text, or nothing, as was asked for."""
        if self.quiet:
            return
        if self.json:
            from sdpid._common.tables import json_text

            typer.echo(json_text(values))
        else:
            typer.echo(printable(text, keep="\n"))


def expand_groups(function: Callable[..., None]) -> Callable[..., None]:
    """Return a command whose parameters that are option groups are replaced by their options."""
    parameters: list[inspect.Parameter] = []
    groups: dict[str, Any] = {}
    for parameter in inspect.signature(function, eval_str=True).parameters.values():
        group = parameter.annotation
        if not is_dataclass(group):
            parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))
            continue
        groups[parameter.name] = group
        types = get_type_hints(group, include_extras=True)
        for field in fields(group):
            option = inspect.Parameter(
                field.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=field.default,
                annotation=types[field.name],
            )
            parameters.append(option)

    PARAMETERS[function.__name__] = parameters

    @functools.wraps(function)
    def command(**values: Any) -> None:
        with hidden_progress(values["quiet"]):
            for name, group in groups.items():
                values[name] = group(**{each.name: values.pop(each.name) for each in fields(group)})
            function(**values)

    del command.__wrapped__
    signature = inspect.Signature(parameters)
    command.__signature__ = signature  # type: ignore[attr-defined]
    command.__annotations__ = {each.name: each.annotation for each in parameters}
    return command


def pairs(values: Iterable[str] | None, option: str) -> dict[str, str]:
    """Split ``key=value`` options.

    Raises
    ------
    DataError
        When one has no ``=``, or a key comes twice.
    """
    split: dict[str, str] = {}
    for text in values or ():
        key, equals, value = text.partition("=")
        key, value = key.strip(), value.strip()
        if not (equals and key and value):
            raise DataError(f"{option} {text}: expected a quantity, '=' and a value.")
        if key in split:
            raise DataError(f"{option}: {key} is given twice: {split[key]} and {value}.")
        split[key] = value
    return split


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


def friction_terms(texts: list[str] | None) -> list[str | FrictionTerm] | None:
    """Return the terms of ``--friction``: names, or names with a speed or joints.

    Raises
    ------
    DataError
        When a speed is no number.
    ModelError
        When a term takes no value, or another number of them.
    """
    from sdpid.robot.friction.terms import (
        AsymmetricCoulomb,
        Coulomb,
        Coupling,
        SigmoidFriction,
        Stribeck,
    )

    with_speed: dict[str, Callable[[float | None], FrictionTerm]] = {
        "coulomb": lambda width: Coulomb(width=width),
        "asymmetric_coulomb": lambda width: AsymmetricCoulomb(width=width),
        "stribeck": lambda speed: Stribeck(velocity=speed),
        "sigmoid": lambda speed: SigmoidFriction(velocity=speed),
    }
    terms: list[str | FrictionTerm] = []
    for text in texts or ():
        name, equals, value = text.partition("=")
        if not equals:
            terms.append(text)
        elif name in with_speed:
            speeds = [None] if value == "fit" else numbers(value, f"--friction {name}")
            if len(speeds) != 1:
                raise ModelError(
                    f"--friction {text}: has {len(speeds)} speeds; give one, which holds for every "
                    "joint, or fit, which chooses one for each."
                )
            terms.append(with_speed[name](speeds[0]))
        elif name == "coupling" and value.count(",") == 1:
            first, second = split_list(value)
            terms.append(Coupling(first, second))
        else:
            raise ModelError(
                f"--friction {text}: takes no value; with one there are coulomb=WIDTH, "
                "asymmetric_coulomb=WIDTH, stribeck=SPEED, sigmoid=SPEED (a speed in rad/s, or "
                "fit) and coupling=JOINT,JOINT."
            )
    return terms or None


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


def listed(title: str, lines: Iterable[object]) -> str:
    """Return indented lines under a title; what would begin a line of its own is replaced."""
    return "\n".join((f"{title}:", *(f"  {printable(str(line))}" for line in lines)))


def errors_table(fits: dict[str, Validation]) -> str:
    """Return the errors of every joint, a pair of columns for each fit."""
    from sdpid._common.tables import Table

    names = next(iter(fits.values())).joint_names
    header = ["joint"]
    columns: list[list[Any]] = [list(names)]
    for label, fit in fits.items():
        header += [f"{label} RMSE [N.m]", "NRMSE [%]"]
        for values in (fit.rmse, 100.0 * fit.nrmse):
            rows = fit.rows.tolist()
            columns.append([x if k else None for x, k in zip(values.tolist(), rows, strict=True)])
    return Table(tuple(header), tuple(zip(*columns, strict=True))).text(4)
