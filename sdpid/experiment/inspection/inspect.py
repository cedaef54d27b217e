"""`inspect_recording`: run every check on a recording."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

from sdpid._common.arrays import is_number
from sdpid._common.tables import Table, facts_html
from sdpid.errors import DataError
from sdpid.experiment.inspection import (
    delay_checks,
    dynamics_checks,
    effort_checks,
    motion_checks,
    reference_checks,
    time_checks,
)
from sdpid.experiment.inspection.channels import rules
from sdpid.experiment.inspection.delays.find import LEAST
from sdpid.experiment.inspection.finding import CHECKS, Finding, Subject
from sdpid.experiment.inspection.floating import (
    base_checks,
    feet_checks,
    flight_checks,
)
from sdpid.experiment.inspection.forces import flag_checks, force_checks
from sdpid.experiment.inspection.joined import other_loads
from sdpid.experiment.inspection.places import imu_checks, point_checks
from sdpid.experiment.readers.read import is_frame, read_recording
from sdpid.experiment.recording.floating.robots import robot_of
from sdpid.experiment.recording.joints import joint_columns, match_joints
from sdpid.experiment.recording.loops.passive_joints import lacking
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.model import RobotModel

# Importing a file of checks adds them to the list. A new check is a function in one of these.
_FILES = (
    *(time_checks, motion_checks, reference_checks, effort_checks, dynamics_checks, delay_checks),
    *(base_checks, imu_checks, feet_checks, point_checks, flight_checks),
    *(flag_checks, force_checks),
)

# Wrong units of position or time make the dynamics meaningless: they are told alone.
_DROWNS = ("position_in_degrees", "position_jumps", "time_unit", "time_scale")
_OF_SPEED = (
    *("position_jumps", "velocity_scale", "velocity_late", "one_direction", "long_rest"),
    "reference_unlike",
)
# A wrong orientation makes all of these; a wrong joint what feet do.
_OF_FEET = ("foot_moves", "foot_high", "feet_exchanged", "contact_frame", "contact_point")
_OF_BASE = (
    *("base_velocity", "imu_gyroscope", "imu_accelerometer"),
    *("imu_axes", "imu_place", "imu_bias", "imu_scale", *_OF_FEET),
    *(f"{channel}_late" for channel in LEAST),
)
# What efforts are compared with, where the base is free.
_BEFORE_EFFORTS = (
    *("base_orientation", "base_velocity", "imu_gyroscope", "imu_accelerometer"),
    *("contacts_missing", "contact_frame", "position_coarse"),
)
# What one mistake makes of other channels.
_OF_FORCES = (
    *("forces_exchanged", "forces_axes", "forces_scale", "forces_offset"),
    *("forces_unlike_motion", "wrenches_moments", "wrenches_point"),
)
_MAKES = {
    **dict.fromkeys(("time_unit", "time_scale"), _OF_SPEED),
    "base_orientation": _OF_BASE,
    "contact_frame": ("foot_moves", "foot_high"),
    **dict.fromkeys(("joint_order", "position_sign", "axis_sign", "position_zero"), _OF_FEET),
    **dict.fromkeys(("effort_scale", "effort_unlike_description"), _OF_FORCES),
    "feet_exchanged": ("flags_unlike_forces", "flags_unlike_motion"),
    "forces_exchanged": ("flags_unlike_forces", "flags_unlike_motion"),
    "forces_offset": ("flags_unlike_forces",),
    "flags_unlike_forces": ("flags_unlike_motion",),
    # Forces that are late differ from those of their time.
    "contacts_late": (
        *("forces_unlike_motion", "forces_scale", "forces_offset"),
        *("wrenches_moments", "wrenches_point"),
    ),
    "forces_missing": (*_OF_FORCES, "flags_unlike_forces"),
    # Accelerations of a wrong place are those of another time.
    **dict.fromkeys(("imu_place", "imu_axes"), tuple(f"{channel}_late" for channel in LEAST)),
}
_DROWNED = (
    dynamics_checks.not_compared,
    dynamics_checks.wrong_channels,
    dynamics_checks.scales,
    dynamics_checks.unlike_the_description,
    delay_checks.late_channels,
    flag_checks.total_mass,
    force_checks.forces,
)


@dataclass(frozen=True, kw_only=True)
class Inspection:
    """The findings of all checks on a recording.

    Attributes
    ----------
    findings : tuple of Finding
        What is to be refused first, then warnings, then notes.

    Examples
    --------
    >>> still = sdpid.Recording(time=log.time, position=0.0 * log.position, effort=log.effort)
    >>> inspection = sdpid.inspect_recording(still, robot)
    >>> inspection.ok
    False
    >>> print(inspection.findings[0].message)
    joint_1 never moves (limit 0.001 rad)
    """

    findings: tuple[Finding, ...]

    @property
    def ok(self) -> bool:
        """Whether there is nothing to refuse and no warning."""
        return all(finding.severity == "note" for finding in self.findings)

    def __str__(self) -> str:
        lines = [finding.line(used=False) for finding in self.findings]
        return "\n".join(lines) or "nothing wrong was found"

    def __repr__(self) -> str:
        """Return how many findings there are of each severity, in a line."""
        counts = Counter(finding.severity for finding in self.findings)
        said = ", ".join(f"{count} {severity}" for severity, count in counts.items())
        return f"Inspection(ok={self.ok}, findings: {said or 'none'})"

    def _repr_html_(self) -> str:
        columns = ("severity", "kind", "joint", "message", "remedy")
        rows = (tuple(getattr(f, name) for name in columns) for f in self.findings)
        return facts_html("Inspection", {"ok": self.ok}, Table(columns, tuple(rows)))

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {"ok": self.ok, "findings": [finding.to_dict() for finding in self.findings]}


def inspect_recording(
    log: Recording | str | os.PathLike[str],
    robot: RobotModel | str | os.PathLike[str] | None = None,
    *,
    total_mass: float | None = None,
) -> Inspection:
    """Check a recording for defects that make parameters from it wrong.

    Parameters
    ----------
    log : Recording, path or data frame
        What was measured (see `read_recording`).
    robot : RobotModel, name or path, optional
        Whose joints these are (see `load_robot`): names, limits, and the efforts that the
        description's bodies need for this motion are then compared with the recording.
    total_mass : float, optional
        What a robot with a floating base weighs, kg, in place of the description's mass.

    Returns
    -------
    Inspection

    Raises
    ------
    DataError
        When the log cannot be read, or is no log; when the total mass is no positive number.
    ModelError
        When the robot cannot be read.

    Examples
    --------
    >>> inspection = sdpid.inspect_recording(log)
    >>> inspection.ok
    True
    >>> swapped = sdpid.Recording(time=log.time, position=log.effort, effort=log.position)
    >>> inspection = sdpid.inspect_recording(swapped, robot)
    >>> inspection.ok
    False
    >>> [(finding.severity, finding.kind) for finding in inspection.findings][:2]
    [('refuse', 'position_in_degrees')]
    """
    given: Any = log
    if not (isinstance(given, (Recording, str, os.PathLike)) or is_frame(given)):
        raise DataError(
            f"log: is {type(given).__name__} {given!r:.80}; give a Recording, the path of a log or "
            "a data frame."
        )
    if total_mass is not None and not (
        is_number(total_mass) and isfinite(total_mass) and total_mass > 0.0
    ):
        raise DataError(
            f"total_mass: is {total_mass!r:.80}; give what the robot weighs, a positive number, kg."
        )
    if not isinstance(log, Recording):
        log = read_recording(log)
    if robot is not None:
        robot = robot_of(robot, [log])
    return Inspection(findings=_looked_at(log, robot, total_mass=total_mass)[1])


def inspect_recordings(
    logs: Sequence[Recording],
    robot: RobotModel | None = None,
    *,
    name: str = "",
    without_effort: Iterable[str] = (),
    total_mass: float | None = None,
) -> tuple[Finding, ...]:
    """Return the findings of recordings, and of what does not fit between them.

    Parameters
    ----------
    logs : sequence of Recording
        What is to be used together.
    robot : RobotModel, optional
        Whose joints these are.
    name : str, optional
        Messages begin with it and, of several recordings, a number.
    without_effort : iterable of str, optional
        Joints whose effort is not used: what is wrong with it is not told.
    total_mass : float, optional
        What a robot with a floating base weighs, kg.
    """
    looked_at = [_looked_at(log, robot, frozenset(without_effort), total_mass) for log in logs]
    if len(logs) == 1 and not name:
        return looked_at[0][1]
    between: dict[int, Finding] = {}
    if len(logs) > 1:
        between = dict(other_loads([subject for subject, _ in looked_at]))
    resting = [{f.joint for f in found if f.kind == "joint_at_rest"} for _, found in looked_at]
    always = set.intersection(*resting)
    name = name or "recording"
    each = []
    for place, (_, findings) in enumerate(looked_at):
        own = (between[place], *findings) if place in between else findings
        for finding in own:
            told = replace(finding, message=f"{name} {place + 1}: {finding.message}")
            if finding.kind == "joint_at_rest" and finding.joint not in always:
                told = replace(told, remedy="nothing to do where it moves enough in another one")
            each.append(told)
    return tuple(each)


def _looked_at(
    log: Recording,
    robot: RobotModel | None,
    without: frozenset[str] = frozenset(),
    total_mass: float | None = None,
) -> tuple[Subject, tuple[Finding, ...]]:
    """Return one recording as checks see it, and its findings, what is to be refused first."""
    findings: list[Finding] = []
    if robot is not None:
        log, robot, findings = _matched(log, robot)
    # The dynamics of a robot that is fixed say nothing about one that is not.
    fixed, floating = (robot, None) if log.base is None else (None, robot)
    subject = Subject(
        log=log, robot=fixed, without=without, floating=floating, total_mass=total_mass
    )
    left_out = [*effort_checks.silent(subject)]
    subject = replace(subject, without=without | {f.joint for f in left_out if f.joint})
    # What a wrong row makes of other channels, and of other joints, is not told.
    wrong, subject = rules.wrong_channels(subject)
    findings += wrong
    for each in CHECKS:
        if each not in _DROWNED:
            findings += each(subject)
    # A channel that stays at its largest value is not clipped as well.
    stays = {each.joint for each in wrong if each.kind.endswith("_frozen")}
    findings = [f for f in findings if not (f.kind.endswith("_clipped") and f.joint in stays)]
    refused = {finding.kind for finding in findings if finding.severity == "refuse"}
    kinds = {finding.kind for finding in findings}
    if not (refused & set(_DROWNS) or kinds & set(_BEFORE_EFFORTS)):
        told = [*dynamics_checks.of_another_size(subject), *delay_checks.late_efforts(subject)]
        own = {finding.joint for finding in told if finding.joint}
        subject = replace(subject, without=subject.without | own) if own else subject
        left_out += told
        for each in _DROWNED:
            findings += each(subject)
    if "position_in_degrees" in {finding.kind for finding in findings}:
        # Positions in degrees raise most of the other alarms as well.
        alone = ("position_in_degrees", "joints", "joints_unknown")
        findings = [finding for finding in findings if finding.kind in alone]
    exchanged = [finding for finding in findings if finding.kind == "feet_exchanged"]
    # Told by what stands still already, it is told once.
    findings = [finding for finding in findings if finding not in exchanged[1:]]
    findings = _without_repeats(findings)
    known = subject.without
    kept = [f for f in findings if not (f.kind.startswith("effort") and f.joint in known)]
    kept += [f for f in left_out if f.joint not in without]
    ranks = ("refuse", "warning", "note")
    return subject, tuple(sorted(kept, key=lambda finding: ranks.index(finding.severity)))


def _without_repeats(findings: list[Finding]) -> list[Finding]:
    """Leave out what other findings explain."""
    kinds = {finding.kind for finding in findings if finding.severity != "note"}
    drowned = {kind for cause, made in _MAKES.items() if cause in kinds for kind in made}
    if any(f.kind == "forces_exchanged" and f.numbers["flags"] for f in findings):
        drowned |= {"feet_exchanged"}
    return [finding for finding in findings if finding.kind not in drowned]


def _matched(
    log: Recording, robot: RobotModel
) -> tuple[Recording, RobotModel | None, list[Finding]]:
    """Return the recording in the robot's order, the robot, and findings about joint names."""
    try:
        matched = match_joints(robot, log)
    except DataError as cause:
        return log, None, [Finding(severity="refuse", kind="joints_unknown", message=str(cause))]
    missing = lacking(robot, log)
    own = tuple(name for name in robot.joint_names[robot.n_base :] if name not in missing)
    names = log.joint_names
    if names is None or set(own) <= set(names):
        left_out = () if names is None else sorted(set(names) - set(own))
        if left_out:
            message = f"columns of joints that the robot lacks are left out: {', '.join(left_out)}"
        elif names is not None and names != own:
            message = (
                f"joints are taken in the robot's order, the columns are of {', '.join(names)}"
            )
        else:
            return matched, robot, []
    else:
        found = [names[column] for column in joint_columns(robot, names, own)]
        pairs = [f"{a} is {b}" for a, b in zip(found, own, strict=True)]
        message = f"joints have another prefix or suffix than the robot's: {', '.join(pairs)}"
    return matched, robot, [Finding(severity="note", kind="joints", message=message)]
