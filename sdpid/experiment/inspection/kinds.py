"""Kinds of findings, one row each: how serious, in what words, and what else they explain.

A check yields ``found("foot_moves", foot=..., speed=..., limit=...)``: the row has the words.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from string import Formatter
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.inspection.finding import Finding, Severity

_VELOCITIES = ("position_jumps", "velocity_scale", "velocity_late", "one_direction", "long_rest")
_OF_SPEED = (*_VELOCITIES, "reference_unlike")
_LATE = ("effort_late", "imu_late", "base_late", "contacts_late")
_OF_FEET = ("foot_moves", "foot_high", "feet_exchanged", "contact_frame", "contact_point")
_OF_BASE = (
    *("base_velocity", "imu_gyroscope", "imu_accelerometer"),
    *("imu_axes", "imu_place", "imu_bias", "imu_scale", *_OF_FEET, *_LATE),
)
# Forces that are late differ from those of their time.
_OF_LATE_FORCES = (
    *("forces_unlike_motion", "forces_scale", "forces_offset"),
    *("wrenches_moments", "wrenches_point"),
)
_OF_FORCES = ("forces_exchanged", "forces_axes", *_OF_LATE_FORCES)
_OF_FLAGS = ("flags_unlike_forces", "flags_unlike_motion")

_STAYS = " of {joint} stays at {value:.4g} from {begin:.4g} to {end:.4g} s (rows {row} to {last})"
_LEAVE = "leave those rows out"
_GIVE_UNIT = "give the unit: units={{'time': 's'}} (--unit time=s), or ms, us, ns"
_OF_COLUMNS = "give the contacts' frames in the order of their columns"
_DELAYS = "delays are told once this is mended"


@dataclass(frozen=True)
class Kind:
    """One kind of finding.

    Attributes
    ----------
    severity : {"refuse", "warning", "note"}
        Unless the check says another.
    words, remedy : str
        Message, and what to do next, with fields in braces. Beside Python's formats numbers have
        those of `_UNITS`.
    hides : tuple of str
        Kinds that it explains, which are not told beside it: of its own joint, or all of them where
        it is of none. What is a note explains only what is of its joint.
    spoils : bool
        Whether efforts say nothing of what else is wrong, unless it is a note.
    excuses : bool
        Whether nothing else is told of the effort of its joint.
    leaves_out : bool
        Whether that effort is left out of fits, unless it is accepted.
    final : bool
        Whether it cannot be accepted: it stands in the way of processing the log as well.
    """

    severity: Severity
    words: str
    remedy: str = ""
    hides: tuple[str, ...] = ()
    spoils: bool = False
    excuses: bool = False
    leaves_out: bool = False
    final: bool = False

    @property
    def accepted(self) -> bool:
        """Whether it changes what is done with a log, and may be overruled."""
        return (self.severity == "refuse" and not self.final) or self.leaves_out


def _left_out(kind: str, words: str) -> Kind:
    """Return a kind that leaves out a joint's effort."""
    remedy = (
        f"identify leaves its effort out, as without_effort does; accept=['{kind}'] (--accept "
        f"{kind}) uses it as it is"
    )
    return Kind("warning", f"effort of {{joint}} {words}", remedy, excuses=True, leaves_out=True)


KINDS = {
    # Time, and what was understood.
    "joints_unknown": Kind("refuse", "{why}", final=True),
    "joints": Kind("note", "{how}"),
    "processing": Kind("refuse", "{why}", final=True),
    "time_stamps": Kind("refuse", "{why}", final=True),
    "continued": Kind("note", "{note}"),
    "units": Kind("note", "{note}"),
    "recording": Kind("note", "{note}"),
    "time_unit": Kind("refuse", "{seen}", "{remedy}", hides=_OF_SPEED, spoils=True),
    "jitter": Kind(
        "note",
        "time stamps jitter by {jitter:.3g %} of a step of {step:.4g} s (rms), limit {limit:g %}",
        "stamp samples where they are measured",
    ),
    "lost_samples": Kind(
        "warning",
        "{lost} of {all} samples ({share:.3g %}) are missing between the others, limit {limit:g %}",
        "log with a larger buffer, or at a lower rate",
    ),
    "repeated_rows": Kind(
        "warning",
        "{rows} of {all} rows ({share:.3g %}) repeat the row before in every position and effort, "
        "limit {limit:g %}: the log is written faster than the robot measures",
        "remove the repeated rows, or log at the robot's rate",
    ),
    "time_scale": Kind(
        "refuse",
        "velocities of all joints are {scale:.3g} times the rate of their positions, limit "
        "{least:.2g} to {limit:g}: the time stamps count {scale:.3g} s for every second",
        "give the stamps in s, or the true rate (rate_hz); where they are right, leave the "
        "velocity out (velocity=none)",
        hides=_OF_SPEED,
        spoils=True,
    ),
    # Positions and velocities.
    "position_in_degrees": Kind(
        "refuse",
        "positions look like degrees, not radians{seen}{mended}",
        "convert them, or read the file with units={{'position': 'deg'}}",
        spoils=True,
    ),
    "joint_at_rest": Kind(
        "warning",
        "{joint} {moved} (limit {limit:g} rad)",
        "its inertia and friction are unknown; excite it",
    ),
    "position_jumps": Kind(
        "refuse",
        "position of {joint} changes by {size:.4g} rad in one step at row {row}, that is "
        "{speed:.4g} rad/s (limit {limit:g}): an outlier, or wrong units",
        "remove that sample, or give the unit",
        spoils=True,
    ),
    "position_lone": Kind(
        "refuse",
        "position of {joint} is {off:.3g} rad off those before and after it at row {row}, limit "
        "{limit:.2g} rad: a wrong sample",
        "remove that sample: a gap of a few samples is interpolated",
    ),
    "position_coarse": Kind(
        "warning",
        "position of {joint} has {values} different values (limit {limit}), {step:.2g} rad apart "
        "(limit {step_limit:g} rad): it is rounded",
        "log positions with all their digits",
        spoils=True,
    ),
    "position_frozen": Kind(
        "refuse",
        f"position{_STAYS}, while {{joint}} moves by {{moved:.2g}} rad, limit {{limit:.2g}}",
        _LEAVE,
    ),
    "velocity_frozen": Kind(
        "warning",
        f"velocity{_STAYS}, while {{joint}} leaves that speed by {{moved:.2g}} rad (limit "
        "{limit:.2g} rad)",
        f"{_LEAVE}, or the velocity (velocity=none)",
        hides=("velocity_clipped",),
    ),
    "one_direction": Kind(
        "warning",
        "{joints} in one direction only: {of}{share:.2g %} of the way goes back, limit {limit:g %}",
        "move both ways: friction looks like an offset else, or like gravity",
    ),
    "long_rest": Kind(
        "warning",
        "the robot stands still in {share:.2g %} of the recording (no joint faster than {speed:g} "
        "rad/s), limit {limit:g %}",
        "no need to cut it: rows at rest are left out by default; record more motion",
    ),
    "velocity_scale": Kind(
        "warning", "velocity of {joint} {what}", "correct it, or leave the velocity out"
    ),
    "velocity_late": Kind(
        "warning",
        "velocity of {joints} is {late} by up to {size:.3g ms} against the rate of the position, "
        "limit {limit:.3g ms}",
        "shift it, or leave the velocity out (velocity=none)",
    ),
    "velocity_clipped": Kind(
        "warning",
        "velocity of {joint} stays at {at} in {rows} of {all} rows ({share:.2g %}, limit "
        "{limit:g %}): it is clipped",
        "leave the velocity out (velocity=none): it is then had from the position",
    ),
    "reference_unlike": Kind(
        "note",
        "reference of {wrong}",
        "name its column, unit or joints, or leave it out (reference=none); fits that simulate the "
        "controller would be wrong",
    ),
    # Efforts alone.
    "effort_silent": _left_out(
        "effort_silent",
        "is exactly 0 in {share:.3g %} of the rows in which it moves (limit {limit:g %}): it was "
        "not measured there",
    ),
    "effort_small": _left_out(
        "effort_small",
        "is {effort:.3g} {unit} (rms), and the description's bodies need {needed:.3g} {unit}, "
        "{ratio:.3g} times as much (limit {limit:g}): another unit, a counterweight or a spring",
    ),
    "effort_spoils": _left_out(
        "effort_spoils",
        "contradicts the others, whose errors fall to {share:.2f} without it (limit {limit:g}); "
        "with it {why}",
    ),
    "effort_constant": Kind(
        "warning",
        "effort of {joint} never changes: it is {value:.4g} in every row",
        "if it was not measured, leave it out (without_effort)",
    ),
    "effort_clipped": Kind(
        "warning",
        "effort of {joint} stays at {at} in {rows} of {all} rows ({share:.2g %}, limit "
        "{limit:g %}): it is clipped",
        "leave those rows out, or move more gently: what the drive gave is unknown",
    ),
    "effort_frozen": Kind(
        "warning",
        f"effort{_STAYS}, while {{joint}} moves by {{way:.2g}} rad",
        f"{_LEAVE}, or the efforts of that joint (without_effort)",
        hides=("effort_clipped",),
    ),
    "effort_spike": Kind(
        "warning",
        "effort of {joint} is {off:.3g} off those before and after it at row {row}, limit "
        "{limit:.2g}: an outlier",
        "remove that sample",
    ),
    "effort_late": Kind("warning", "{what}", "{remedy}", excuses=True),
    # Efforts against the description. Where one change mends them, {mended} says how well.
    "forces_ignored": Kind(
        "warning",
        "the description has forces on joints that are not in the model: {what}; they are taken "
        "for gravity, offsets and friction",
        "take stiffness·(position − springref) off the recorded efforts of a joint with a spring, "
        "or leave it out (--without-effort)",
    ),
    "actuators_ignored": Kind(
        "note",
        "the description has actuators whose effort is not their control: {what}; efforts are read "
        "as the joints', whatever these are",
        "log the efforts of joints (qfrc_actuator), not controls",
    ),
    "effort_not_compared": Kind(
        "note",
        "efforts are not compared with the motion, for the robot's description {lacks}: wrong "
        "signs, units and orders of columns are not found",
        "check them by hand{give}",
    ),
    "effort_sign": Kind("refuse", "effort of {of} has the wrong sign{mended}", "flip {its}"),
    "position_sign": Kind(
        "refuse",
        "position of {of} has the wrong sign{mended}",
        "flip its sign, and that of its velocity",
        hides=_OF_FEET,
    ),
    "axis_sign": Kind(
        "refuse",
        "position and effort of {of} count the other way round than the description's axis{mended}",
        "flip the signs of both, or turn the axis in the description",
        hides=_OF_FEET,
    ),
    "position_zero": Kind(
        "refuse",
        "position of {of} has another zero than the description{mended}",
        "add {add:+.0f °} ({add:+.4f} rad)",
        hides=_OF_FEET,
    ),
    "gravity_direction": Kind(
        "refuse",
        "gravity acts along {gravity} m/s² of the base, not as described{mended}",
        "give gravity= to load_robot, or mount the description's base as the robot's",
    ),
    "joint_order": Kind(
        "refuse",
        "columns are in the order {held}{mended}",
        "name the columns so (joint_names), or put them in the robot's order",
        hides=_OF_FEET,
    ),
    "effort_order": Kind(
        "refuse",
        "columns of the efforts are in the order {held}{mended}",
        "name the effort columns one by one (columns)",
    ),
    "flags_unlike_motion": Kind(
        "warning",
        "flags of contacts are wrong: feet bear the robot while they are said to be up{mended}",
        "lower their threshold, or widen contact_margin_s; fuse forces where they are measured",
    ),
    "effort_scale": Kind(
        "refuse",
        "{whose} times {of}, limit {least:g} to {limit:g}: {unit}",
        "{remedy}",
        hides=_OF_FORCES,
    ),
    "effort_unlike_description": Kind(
        "warning",
        "effort of {joint} does not follow from the motion: the description and friction leave "
        "{unexplained:.3g %} of its variance unexplained, limit {limit:g %}",
        "check the columns, the units, the mounting and the description of this joint",
        hides=_OF_FORCES,
    ),
    "payload_differs": Kind(
        "refuse",
        "it carries another load than recording 1: {mass:+.3g} kg (standard error {error:.2g} kg) "
        "on the last link, with a first moment of {moment:.2g} kg·m, takes {takes:.2g %} of the "
        "residual of both, limit {limit:g %}",
        "fit each load by itself, or identify the load with sdpid payload --without",
    ),
    # A base that moves, and its sensors.
    "base_orientation": Kind(
        "refuse",
        "orientation of the base is no quaternion x y z w from base to world: {seen}; both agree "
        "where it is read as {right}",
        "read it in its order (base={{'quaternion': 'wxyz'}}), or give the inverse",
        hides=_OF_BASE,
        spoils=True,
    ),
    "base_velocity": Kind(
        "warning",
        "{velocity} of the base, said to be in {axes} axes, leaves {unexplained:.3g %} of the rate "
        "of its {pose} unexplained, limit {limit:g %}{better}",
        "say its axes (velocity_frame) or its unit, or leave it out",
        spoils=True,
    ),
    "imu_gyroscope": Kind("warning", "gyroscope of the base{what}", "{remedy}", spoils=True),
    "imu_accelerometer": Kind(
        "warning", "accelerometer of the base{what}", "{remedy}", spoils=True
    ),
    # Accelerations of a wrong place or axes are those of another time.
    "imu_axes": Kind("warning", f"axes of the {{what}}; {_DELAYS}", "{remedy}", hides=_LATE),
    "imu_place": Kind(
        "warning",
        "the {sensor} sits at {place} m in the base's frame, {distance:.3g} m from where it is "
        f"said to be, as the pose shows (standard error {{error:.2g}} m, limit {{limit:g}} m); "
        f"{_DELAYS}",
        "give the IMU's translation={place}",
        hides=_LATE,
    ),
    "imu_bias": Kind(
        "warning",
        "the {sensor} shows {value} {unit} too much along its axes, as the pose shows (standard "
        "error {error:.2g}, limit {limit:g}){also}",
        "take it off the {sensor}",
    ),
    "imu_scale": Kind(
        "warning",
        "the {sensor} shows {scale:.4g} times what the pose does (standard error {error:.2g}, "
        "limit {least:g} to {most:g}){also}",
        "divide the {sensor} by it",
    ),
    "imu_late": Kind("warning", "{what}", "{remedy}"),
    "base_late": Kind("warning", "{what}", "{remedy}"),
    # Feet.
    "contacts_missing": Kind(
        "refuse",
        "{said}, and the robot does not fall: its mean specific force upward is then "
        "{specific_force:.3g} m/s² (limit {limit:.3g}; gravity {gravity:.3g})",
        "give what bears it, Recording.contacts: flags, forces or wrenches; of a base that is "
        "held, log.with_held_base(link)",
        spoils=True,
    ),
    "feet_exchanged": Kind(
        "warning",
        "flags of contacts are of other feet: {feet}{mended}",
        _OF_COLUMNS,
        hides=_OF_FLAGS,
    ),
    "foot_moves": Kind(
        "warning", "{what}", "mark it as not down where it slips; check frames, offset and base"
    ),
    "foot_high": Kind(
        "warning",
        "{foot} is {height:.3g} m above the other feet while it is said to be down, limit "
        "{limit:g} m",
        "check its flags and the order of the joints, unless the ground is not level",
    ),
    "contact_frame": Kind(
        "refuse",
        "frames of contacts move while they are said to be down, and others behind them rest "
        "(limit a factor of {limit:g}): {pairs}",
        "give the contacts' frames as {frames}",
        hides=("foot_moves", "foot_high"),
        spoils=True,
    ),
    "contact_point": Kind("warning", "{feet} {where}", "{remedy}"),
    "contacts_late": Kind("warning", "{what}", "{remedy}", hides=_OF_LATE_FORCES),
    # Measured forces.
    "total_mass": Kind(
        "warning",
        "torques carry {carried:.4g} kg (standard error {kg_error:.2g} kg), {share:.3g} times the "
        "{mass:.4g} kg {said}, limit {least:g} to {most:g}: {means} scale of all torques",
        "weigh the robot, and give its mass (TotalMass); check the torque constants",
    ),
    "forces_missing": Kind(
        "refuse",
        "contact forces of {foot}{axes} never change: they are ({shown}) N in every row, while the "
        "foot is down in {down:.3g %} of them, limit {limit:g %}",
        "if they were not measured, leave all forces out, and keep the flags",
        hides=(*_OF_FORCES, "flags_unlike_forces"),
    ),
    "flags_unlike_forces": Kind(
        "warning",
        "{share:.3g %} of all measured contact force acts on feet that are said to be up, limit "
        "{limit:g %}: flags are late, have too high a threshold, or are of other feet",
        "leave the flags out, and they are made of the forces; or widen contact_margin_s",
        hides=("flags_unlike_motion",),
    ),
    "forces_unlike_motion": Kind(
        "warning",
        "contact forces are not those of this motion: {unexplained:.3g %} of what the legs' "
        "torques need beside their own links stays unexplained, limit {limit:g %}, whatever feet "
        "and axes they are of",
        "check that forces are in N and on time, and what their sensors hold",
    ),
    "forces_exchanged": Kind(
        "warning",
        "contact forces{also} are of other feet: {feet}; {better}",
        "{remedy}",
        hides=_OF_FLAGS,
    ),
    "forces_axes": Kind("warning", "contact forces{what}", "{remedy}"),
    "forces_scale": Kind("warning", "contact forces{what}", "{remedy}"),
    "forces_offset": Kind(
        "warning",
        "contact forces of {foot} are off by {offset} N in x, y, z (standard errors {errors}, "
        "limit {limit:.3g} N in {axis}), {seen}",
        "take it off, or zero the sensor while the foot is up",
        hides=("flags_unlike_forces",),
    ),
    "wrenches_moments": Kind(
        "warning",
        "moments of {foot} are {ratio:.3g} times those that the legs' torques show, forces being "
        "right, limit {least:.3g} to {most:.3g}{sign}",
        "give moments in N·m on the robot, in the world's axes",
    ),
    "wrenches_point": Kind(
        "warning",
        "moments of {foot} are about a point {point} m from its frame's origin, in the world's "
        "axes (standard errors {errors}, limits {limits})",
        "give moments about the origin of the contact's frame, or the sensor's frame",
    ),
}

# How many of a unit a number in SI is.
_UNITS = {" %": 100.0, " ms": 1e3, " °": 180.0 / pi}


class _Words(Formatter):
    """Formats that may end in a unit: ``{share:.3g %}``."""

    def format_field(self, value: Any, format_spec: str) -> Any:
        for unit, size in _UNITS.items():
            if format_spec.endswith(unit):
                number = f"{size * value:{format_spec.removesuffix(unit)}}"
                return number + unit.replace(" °", "°")
        if isinstance(value, np.ndarray):
            return vector(value)
        return super().format_field(value, format_spec)


def words(kind: str, **fields: Any) -> str:
    """Return the message of a kind of finding with its fields."""
    return _Words().vformat(KINDS[kind].words, (), fields)


def found(
    kind: str, joint: str | None = None, severity: Severity | None = None, /, **fields: Any
) -> Finding:
    """Return a finding of a kind; fields that are numbers, or vectors, are the finding's."""
    row = KINDS[kind]
    numbers: dict[str, float] = {}
    for name, value in fields.items():
        if isinstance(value, np.ndarray):
            numbers |= {
                f"{name}_{axis}": float(each) for axis, each in zip("xyz", value, strict=True)
            }
        elif isinstance(value, (int, float, np.integer, np.floating)):
            numbers[name] = float(value)
    return Finding(
        kind=kind,
        joint=joint,
        severity=severity or row.severity,
        message=words(kind, joint=joint, **fields),
        remedy=_Words().vformat(row.remedy, (), fields),
        numbers=numbers,
    )


def explained(finding: Finding, others: list[Finding]) -> bool:
    """Return whether another finding explains one, so that it is not told."""
    return any(
        finding.kind in KINDS[other.kind].hides
        and (
            finding.joint in (None, other.joint)
            if other.joint is not None
            else other.severity != "note"
        )
        for other in others
    )


def exchanged(names: Sequence[str], order: Sequence[float]) -> str:
    """Return of which other feet columns are, where `order` has the column of each foot."""
    pairs = ((int(j), i) for i, j in enumerate(order) if i != j)
    return ", ".join(f"those of {names[j]} are of {names[i]}" for j, i in pairs)


def vector(values: Array) -> str:
    """Return a vector with three digits, what is below 0.0005 as 0."""
    rounded = [float(f"{value:.3g}") if abs(value) >= 5e-4 else 0.0 for value in values]
    return f"({', '.join(f'{value:g}' for value in rounded)})"
