"""Options that several commands have, declared once, in groups.

A command names a group as the type of a parameter: `sdpid.cli.config.expand_groups` puts the
group's options in the parameter's place.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sdpid._common.files import PathLike, require_other_files
from sdpid.cli.values import friction_terms, numbers, pairs, share, split_list
from sdpid.errors import DataError, ExportError

if TYPE_CHECKING:
    from sdpid.estimation.constraints.condition import Condition
    from sdpid.estimation.constraints.constraints import Constraints
    from sdpid.estimation.prior.prior import Prior
    from sdpid.experiment.recording.recording import Recording
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


# Options under a title in the help.
_reading = functools.partial(typer.Option, rich_help_panel="Reading the log")
_processing = functools.partial(typer.Option, rich_help_panel="Processing")
_estimation = functools.partial(typer.Option, rich_help_panel="Estimation")


WithoutEffort = Annotated[
    str | None,
    _estimation(
        metavar="A,B,...",
        help="Joints whose effort was not measured, or is wrong; only their motion is used.",
    ),
]


def joints(given: str | None) -> list[str]:
    """Return the names of joints in an option; none where it was not given."""
    return [] if given is None else split_list(given)


def _beginning(words: Iterable[str]) -> Callable[[str], list[str]]:
    """Return a function that completes what is typed to one of some words."""
    return lambda incomplete: [word for word in words if word.startswith(incomplete)]


def _complete_friction(incomplete: str) -> list[str]:
    """Complete the name of a friction term."""
    from sdpid.robot.friction.terms import BY_NAME

    return _beginning([plus + name for plus in ("", "+") for name in BY_NAME])(incomplete)


def _complete_kind(incomplete: str) -> list[str]:
    """Complete the kind of a finding."""
    from sdpid.experiment.inspection.inspect import REFUSED

    return _beginning(REFUSED)(incomplete)


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
        _reading(
            metavar="QUANTITY=NAME",
            help="Name in the file, such as effort=tau_measured, effort=i1,i2,i3 or "
            "velocity=none. Quantities: time, position, velocity, effort, ... May be repeated.",
        ),
    ] = None
    unit: Annotated[
        list[str] | None,
        _reading(
            metavar="QUANTITY=UNIT",
            help="Unit in the file where it is not SI, such as position=deg or time=ms. May be "
            "repeated.",
        ),
    ] = None
    joint_names: Annotated[
        str | None,
        _reading(metavar="A,B,...", help="Names of the joints, in the order of the columns."),
    ] = None
    effort_scale: Annotated[
        str | None,
        _reading(
            metavar="X,Y,...",
            help="N.m per unit of effort of each joint: torque constant times gear ratio, for "
            "efforts in A.",
        ),
    ] = None
    gains: Annotated[
        Path | None,
        _reading(
            metavar="FILE",
            help="Gains of the drives, for efforts in A: the file of 'sdpid gains'. Their errors "
            "count in every interval.",
        ),
    ] = None
    mapping: Annotated[
        str | None,
        _reading(
            metavar="FILE",
            help="TOML file with names, units and motors. Default: the one beside the log, "
            "run.toml for run.csv; 'none' ignores that too. Other options win over it.",
        ),
    ] = None
    topic: Annotated[
        str | None, _reading(metavar="NAME", help="Topic of a ROS bag that has several.")
    ] = None
    missing: Annotated[
        str | None,
        _reading(
            metavar="drop|interpolate",
            help="What to do with samples that lack a value: leave them out, or interpolate over "
            "gaps of at most 10. Default: refuse the log.",
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
            "gains": self.gains,
            "mapping": False if self.mapping == "none" else self.mapping,
            "topic": self.topic,
            "missing": self.missing,
        }

    def read(self, log: Path, **periods: Any) -> Recording:
        """Read a log."""
        from sdpid.experiment.readers.read import read_recording

        return read_recording(log, **self.arguments(), **periods)

    def files(self, logs: Iterable[Path], *others: PathLike | None) -> list[PathLike | None]:
        """Return the files that a command reads: logs, mappings, and others."""
        from sdpid.experiment.recording.floating.columns import mapping_beside

        return [*logs, *map(mapping_beside, logs), self.mapping, self.gains, *others]


@dataclass(frozen=True, kw_only=True)
class Periods:
    """The periods of the motion."""

    period: Annotated[float | None, _reading(metavar="S", help="Period of the motion, s.")] = None
    start: Annotated[
        float | None, _reading(metavar="S", help="Time at which the first period begins, s.")
    ] = None
    periods: Annotated[int | None, _reading(metavar="N", help="Number of whole periods.")] = None

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `read_recording`."""
        return vars(self).copy()


@dataclass(frozen=True, kw_only=True)
class ProcessingOptions:
    """What differs from the processing that is chosen for the log."""

    cutoff: Annotated[
        float | None,
        _processing(metavar="HZ", help="Cut-off frequency of the low-pass filter, Hz."),
    ] = None
    order: Annotated[
        int | None, _processing(metavar="N", help="Order of the filter in one of its two passes.")
    ] = None
    velocity: Annotated[
        Velocity | None,
        _processing(help="Use the recorded velocity, or differentiate the position."),
    ] = None
    mask: Annotated[
        bool | None,
        _processing(
            "--mask/--no-mask",
            help="Leave out rows near reversals and at rest, or keep all. Default: leave them out.",
        ),
    ] = None
    mask_speed: Annotated[
        float | None,
        _processing(metavar="X", help="Speed below which rows are left out, rad/s (default 0.02)."),
    ] = None
    mask_time: Annotated[
        float | None,
        _processing(metavar="S", help="Rows this near to a slower one are left out too, s."),
    ] = None
    filter_friction: Annotated[
        bool | None,
        _processing(
            "--filter-friction/--no-filter-friction",
            help="Let friction columns pass the filter of the efforts (default), or take friction "
            "at the filtered velocity.",
        ),
    ] = None

    def changes(self) -> dict[str, Any]:
        """Return the settings that were given, by their names in `Processing`.

        Raises
        ------
        DataError
            When rows are to be kept and a time or speed to leave them out is given.
        """
        if self.mask is False and not (self.mask_speed is None and self.mask_time is None):
            raise DataError("mask: is off, but mask-speed or mask-time is given; leave one out.")
        settings: dict[str, Any] = {
            "cutoff_hz": self.cutoff,
            "order": self.order,
            "velocity": None if self.velocity is None else self.velocity.value,
            "reversal_speed": self.mask_speed,
            "reversal_time": self.mask_time,
            "filter_friction": self.filter_friction,
        }
        changed = {name: value for name, value in settings.items() if value is not None}
        return {**changed, "reversal_time": None} if self.mask is False else changed


@dataclass(frozen=True, kw_only=True)
class Acceptance:
    """Findings that do not refuse a log."""

    accept: Annotated[
        list[str] | None,
        _reading(
            metavar="KIND",
            help="Use a log that is refused for a finding of this kind, such as effort_sign. "
            "Repeat for each kind.",
            autocompletion=_complete_kind,
        ),
    ] = None

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `identify`."""
        return {"accept": tuple(self.accept or ())}


@dataclass(frozen=True, kw_only=True)
class Estimation:
    """The problem that is solved."""

    consistency: Annotated[
        Consistency, _estimation(help="Physical consistency that every link must have.")
    ] = Consistency.pseudo_inertia
    margin: Annotated[
        float, _estimation(metavar="X", help="Smallest margin of every link, kg.m2.")
    ] = 0.0
    mass_max: Annotated[
        float | None,
        _estimation(
            metavar="X", help="Largest mass of a link, kg. Default: 3 times the described robot's."
        ),
    ] = None
    total_mass: Annotated[
        str | None,
        _estimation(
            metavar="KG[,TOL]",
            help="Mass of all moving links together, from a scale, and by how much it may differ.",
        ),
    ] = None
    mirror: Annotated[
        bool,
        _estimation(
            "--mirror",
            help="Right links are mirror images of the left ones, as their names tell: legs that "
            "were built alike.",
        ),
    ] = False
    mirror_within: Annotated[
        str | None,
        _estimation(
            metavar="SHARE",
            help="Right links are nearly mirror images of the left ones: believed to differ by "
            "this share (one standard deviation), such as 5%. Goes with the prior.",
        ),
    ] = None
    mirror_friction: Annotated[
        str | None,
        _estimation(
            metavar="SHARE",
            help="Friction and rotor inertia of right joints differ from those of left ones by at "
            "most this share, such as 20%; 0 for equal ones.",
        ),
    ] = None
    prior: Annotated[
        bool | None,
        _estimation(
            "--prior/--no-prior",
            help="Regularize towards the inertias in the robot's description. Default: with the "
            "weighting residual, which logs without periods have.",
        ),
    ] = None
    friction: Annotated[
        list[str] | None,
        _estimation(
            metavar="TERM",
            help="coulomb, coulomb=0.02 (smooth within 0.02 rad/s), coulomb=fit (smooth within "
            "the speed that fits best), asymmetric_coulomb, viscous, offset, rotor_inertia, "
            "stribeck, sigmoid, square_root, load, tilt, or coupling=joint_5,joint_6. Repeat for "
            "each term. They replace the default terms; +stribeck adds to them.",
            autocompletion=_complete_friction,
        ),
    ] = None
    effects: Annotated[
        str,
        _estimation(
            metavar="auto|none|A,B,...",
            help="Effects beside the friction terms: those that the log shows, none, or some of "
            "tilt, load, rotor_inertia, coupling, falling.",
        ),
    ] = "auto"
    without_effort: WithoutEffort = None
    weighting: Annotated[
        Weighting | None,
        _estimation(help="Weighting of the residuals. Default: gls with periods, else residual."),
    ] = None

    def arguments(self, robot: RobotModel) -> dict[str, Any]:
        """Return the arguments of `formulate`."""
        return {
            "friction": friction_terms(self.friction),
            "without_effort": joints(self.without_effort),
            "weighting": None if self.weighting is None else self.weighting.value,
            "consistency": self.consistency.value,
            "constraints": self._constraints(robot),
            "prior": self._prior(robot),
            "effects": self.effects,
        }

    def _prior(self, robot: RobotModel) -> Prior | bool | None:
        """Return whether there is a prior, or one that believes that left and right are alike."""
        if self.mirror_within is None:
            return self.prior
        if self.mirror or self.prior is False:
            other = "--mirror" if self.mirror else "--no-prior"
            raise DataError(
                f"--mirror-within {self.mirror_within}: is a part of the prior, and beside {other} "
                "it says nothing; leave one of them out."
            )
        from sdpid.estimation.constraints.pairs import mirror_pairs
        from sdpid.estimation.prior.prior import Prior

        within = share(self.mirror_within, "--mirror-within")
        if within == 0.0:
            raise DataError("--mirror-within: is 0; links that are mirror images have --mirror.")
        return Prior(alike=mirror_pairs(robot), within=within)

    def _constraints(self, robot: RobotModel) -> Constraints:
        """Return bounds that follow the robot's size, but for those that were given."""
        from sdpid.estimation.constraints.constraints import Constraints

        bounds = {} if self.mass_max is None else {"mass_max": self.mass_max}
        others = tuple(self._conditions(robot))
        return Constraints.of_size(robot, margin=self.margin, others=others, **bounds)

    def _conditions(self, robot: RobotModel) -> Iterator[Condition]:
        """Yield what is known beside bounds: the mass of all links, and that sides are alike."""
        if self.total_mass is not None:
            from sdpid.estimation.constraints.mass import TotalMass

            mass, *tolerance = numbers(self.total_mass, "--total-mass")
            if len(tolerance) > 1:
                raise DataError(
                    f"--total-mass {self.total_mass}: expected a mass in kg, or a mass and by how "
                    "much it may differ."
                )
            yield TotalMass(mass, tolerance=tolerance[0] if tolerance else 0.0)
        if self.mirror:
            from sdpid.estimation.constraints.pairs import mirror_pairs

            yield from mirror_pairs(robot)
        if self.mirror_friction is not None:
            from sdpid.estimation.constraints.pairs import equal_friction

            yield from equal_friction(
                robot, within=share(self.mirror_friction, "--mirror-friction")
            )


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
