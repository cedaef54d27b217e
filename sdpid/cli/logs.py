"""Options about logs, the problem made of them, and what the library makes of these options."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sdpid.cli.commands import Given, panel, rows_of
from sdpid.cli.endings import TERMS
from sdpid.errors import DataError

if TYPE_CHECKING:
    from sdpid.estimation.constraints.condition import Condition
    from sdpid.estimation.prior.prior import Prior
    from sdpid.estimation.problem import Problem
    from sdpid.experiment.preparation.prepare import Prepared
    from sdpid.experiment.recording.recording import Recording
    from sdpid.robot.model.model import RobotModel

LOG = {"log LOG": "CSV, Parquet, NPZ, MAT, HDF5 file or ROS bag."}

LOGS_OF_A_RUN = {"--log LOG ... = required": "Log as for `sdpid identify`. May be repeated."}

ROBOT = {"--robot ROBOT = required": "URDF or MJCF file, or name of a bundled or example robot."}

READING = panel(
    "Reading the log",
    {
        "--column QUANTITY=NAME ...": "Name in the file, such as effort=tau_measured, "
        "effort=i1,i2,i3 or velocity=none. Quantities: time, position, velocity, effort, ... May "
        "be repeated.",
        "--unit QUANTITY=UNIT ...": "Unit in the file where it is not SI, such as position=deg or "
        "time=ms. May be repeated.",
        "--joint-names A,B,...": "Names of the joints, in the order of the columns.",
        "--effort-scale X,Y,...": "N.m per unit of effort of each joint: torque constant times "
        "gear ratio, for efforts in A.",
        "--gains FILE": "Gains of the drives, for efforts in A: the file of 'sdpid gains'. Their "
        "errors count in every interval.",
        "--mapping FILE|none": "TOML file with names, units and motors. Default: the one beside "
        "the log, run.toml for run.csv; 'none' ignores that too. Other options win over it.",
        "--topic NAME": "Topic of a ROS bag that has several.",
        "--missing refuse|drop|interpolate": "What to do with samples that lack a value: leave "
        "them out, or interpolate over gaps of at most 10. Default: refuse the log.",
    },
)

PERIODS = panel(
    "Reading the log",
    {
        "--period S": "Period of the motion, s.",
        "--start S": "Time at which the first period begins, s.",
        "--periods N": "Number of whole periods.",
    },
)

PROCESSING = panel(
    "Processing",
    {
        "--cutoff HZ": "Cut-off frequency of the low-pass filter, Hz.",
        "--order N": "Order of the filter in one of its two passes.",
        "--velocity measured|differentiated": "Use the recorded velocity, or differentiate the "
        "position.",
        "--mask/--no-mask": "Leave out rows near reversals and at rest, or keep all. Default: "
        "leave them out.",
        "--mask-speed X": "Speed below which rows are left out, rad/s (default 0.02).",
        "--mask-time S": "Rows this near to a slower one are left out too, s.",
        "--filter-friction/--no-filter-friction": "Let friction columns pass the filter of the "
        "efforts (default), or take friction at the filtered velocity.",
    },
)

ACCEPTANCE = panel(
    "Reading the log",
    {
        "--accept KIND ...": "Use a log that is refused for a finding of this kind, such as "
        "effort_sign. Repeat for each kind."
    },
)

LAW = panel(
    "Estimation",
    {
        "--law NAME|FILE": "The law that turned commanded positions into efforts, of a log without "
        "measured efforts: pd with --kp and --kd, or a file with both: TOML, or MJCF with its "
        "actuators.",
        "--kp X,Y,...": "Gain of the law, N.m/rad: one for all joints, or one a joint. Left out, "
        "it is found from the described masses.",
        "--kd X,Y,...": "Gain of the law, N.m.s/rad.",
        "--delay S": "Time from a command to its effort, s. Default: found.",
        "--limit X,Y,...": "Largest effort of the drives, N.m.",
        "--for mujoco|isaac|urdf": "Where the model will be used: what that cannot hold is given "
        "up at the end, and a note says what it costs. Default with a law: mujoco.",
        "--tendons/--no-tendons = off": "Write friction over position into identified.xml, as "
        "tendons.",
    },
)

WITHOUT_EFFORT = panel(
    "Estimation",
    {
        "--without-effort A,B,...": "Joints whose effort was not measured, or is wrong; only their "
        "motion is used."
    },
)

ESTIMATION = (
    *panel(
        "Estimation",
        {
            "--consistency pseudo_inertia|spatial_inertia|none = pseudo_inertia": "Physical "
            "consistency that every link must have.",
            "--margin X = 0": "Smallest margin of every link, kg.m2.",
            "--mass-max KG": "Largest mass of a link, kg. Default: 3 times the described robot's.",
            "--total-mass KG[,TOL]": "Mass of all moving links together, from a scale, and by how "
            "much it may differ.",
            "--mirror": "Right links are mirror images of the left ones, as their names tell: legs "
            "that were built alike.",
            "--mirror-within SHARE": "Right links are nearly mirror images of the left ones: "
            "believed to differ by this share (one standard deviation), such as 5%. Goes with the "
            "prior.",
            "--mirror-friction SHARE": "Friction and rotor inertia of right joints differ from "
            "those of left ones by at most this share, such as 20%; 0 for equal ones.",
            "--prior/--no-prior": "Regularize towards the inertias in the robot's description. "
            "Default: with the weighting residual, which logs without periods have.",
            "--friction TERM ...": f"{TERMS}, or coupling=A,B (of two joints); coulomb=0.02 is "
            "smooth within 0.02 rad/s, coulomb=fit within the speed that fits best. Repeat for "
            "each term. They replace the default terms; +stribeck adds to them.",
            "--effects auto|none|A,B,... = auto": "Effects beside the friction terms: those that "
            "the log shows, none, or some of tilt, load, rotor_inertia, coupling, falling, "
            "hysteresis and position, which is by name alone.",
            "--weighting gls|gls_per_sample|eq9|eq18|residual": "Weighting of the residuals. "
            "Default: gls with periods, else residual.",
        },
    ),
    *WITHOUT_EFFORT,
)

# Of commands that solve what `sdpid identify` solves.
PROBLEM = rows_of(ROBOT, READING, PERIODS, PROCESSING, ESTIMATION, ACCEPTANCE)


def reading(given: Given) -> dict[str, Any]:
    """Return the arguments of `read_recording`, but for periods."""
    columns: dict[str, Any] = {}
    for key, value in given.column.items():
        columns[key] = value.split(",") if "," in value else value
        if value.lower() == "none":
            columns[key] = None
    return {
        "columns": columns or None,
        "units": given.unit or None,
        "mapping": False if given.mapping == "none" else given.mapping,
        **given.chosen("joint_names effort_scale gains topic missing"),
    }


def periods(given: Given) -> dict[str, Any]:
    """Return the arguments of `read_recording` about the periods of the motion."""
    return given.chosen("period start periods")


def read(given: Given, log: Path, **more: Any) -> Recording:
    """Read a log."""
    from sdpid.experiment.readers.read import read_recording

    return read_recording(log, **reading(given), **more)


def processing(given: Given) -> dict[str, Any]:
    """Return the settings that were given, by their names in `Processing`.

    Raises
    ------
    DataError
        When rows are to be kept and a time or speed to leave them out is given.
    """
    if given.mask is False and not (given.mask_speed is None and given.mask_time is None):
        raise DataError("mask: is off, but mask-speed or mask-time is given; leave one out.")
    settings: dict[str, Any] = {
        "cutoff_hz": given.cutoff,
        "order": given.order,
        "velocity": given.velocity,
        "reversal_speed": given.mask_speed,
        "reversal_time": given.mask_time,
        "filter_friction": given.filter_friction,
    }
    changed = {name: value for name, value in settings.items() if value is not None}
    return {**changed, "reversal_time": None} if given.mask is False else changed


def formulation(given: Given, robot: RobotModel) -> dict[str, Any]:
    """Return the arguments of `formulate`: bounds follow the robot's size where not given."""
    from sdpid.estimation.constraints.constraints import Constraints

    others, bounds = tuple(_conditions(given, robot)), given.chosen("margin mass_max")
    return {
        "friction": given.friction,
        "without_effort": given.without_effort or [],
        "weighting": given.weighting,
        "consistency": given.consistency,
        "constraints": Constraints.of_size(robot, others=others, **bounds),
        "prior": _prior(given, robot),
        "effects": given.effects,
    }


def _prior(given: Given, robot: RobotModel) -> Prior | bool | None:
    """Return whether there is a prior, or one that believes that left and right are alike."""
    if given.mirror_within is None:
        return given.prior  # type: ignore[no-any-return]
    if given.mirror or given.prior is False:
        other = "--mirror" if given.mirror else "--no-prior"
        raise DataError(
            "--mirror-within: is a part of the prior, and beside "
            f"{other} it says nothing; leave one of them out."
        )
    if given.mirror_within == 0.0:
        raise DataError("--mirror-within: is 0; links that are mirror images have --mirror.")
    from sdpid.estimation.constraints.pairs import mirror_pairs
    from sdpid.estimation.prior.prior import Prior

    return Prior(alike=mirror_pairs(robot), within=given.mirror_within)


def _conditions(given: Given, robot: RobotModel) -> Iterable[Condition]:
    """Yield what is known beside bounds: the mass of all links, and that sides are alike."""
    from sdpid.estimation.constraints.mass import TotalMass
    from sdpid.estimation.constraints.pairs import equal_friction, mirror_pairs

    if given.total_mass is not None:
        mass, *tolerance = given.total_mass
        if len(tolerance) > 1:
            raise DataError(
                "--total-mass: expected a mass in kg, or a mass and by how much it may differ."
            )
        yield TotalMass(mass, tolerance=tolerance[0] if tolerance else 0.0)
    if given.mirror:
        yield from mirror_pairs(robot)
    if given.mirror_friction is not None:
        yield from equal_friction(robot, within=given.mirror_friction)


def law(given: Given, robot: RobotModel) -> dict[str, Any]:
    """Return the arguments of `identify` about the law that ran."""
    own, found = "kp kd delay limit", {"target": given.for_}
    if given.law is None:
        given.refuse(own, "is of a law; give --law pd as well.")
        return found
    from sdpid.experiment.simulation.law import law_of

    return {"law": law_of(given.law, robot, given.chosen(own)), **found}


def robot_and_logs(given: Given, logs: Iterable[Path]) -> tuple[RobotModel, list[Recording]]:
    """Return the robot, with a floating base where a log has one, and the recordings."""
    from sdpid.experiment.preparation.prepare import columns_without
    from sdpid.experiment.recording.joints import robot_of

    absent = columns_without(given.robot, given.without_effort or [])
    records = [read(given, log, without_effort=absent, **periods(given)) for log in logs]
    return robot_of(given.robot, records), records


def formulated(given: Given, logs: Iterable[Path]) -> tuple[Problem, Prepared]:
    """Return the problem that `sdpid identify` solves with these options, and its recordings."""
    from sdpid.workflow.formulate import Formulation

    model, records = robot_and_logs(given, logs)
    options = formulation(given, model)
    how = {"without_effort": options.pop("without_effort"), "accept": given.accept}
    asked = Formulation(**options)
    prepared = asked.prepare(model, records, processing=processing(given), **how)
    return asked.problem(prepared), prepared
