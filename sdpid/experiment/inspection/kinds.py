"""Findings, and their kinds: how serious each is, in what words, and what else it explains.

A file of checks adds its kinds to `KINDS`, beside the functions that find them, which yield
``found("foot_high", foot=..., height=..., limit=...)``: the kind has the words.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import pi
from string import Formatter
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from sdpid._common.arrays import Array

Severity = Literal["refuse", "warning", "note"]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One defect of a recording, or a remark about it.

    Attributes
    ----------
    kind : str
        Name of the kind of defect, such as ``"effort_sign"``.
    message : str
        The defect, its place, and its number against a limit.
    severity : {"refuse", "warning", "note"}
        What is to be refused makes a result meaningless; a warning may make it wrong; a note does
        not.
    remedy : str
        What to do next; may be empty.
    joint : str or None
        The joint; None where it is the whole recording.
    numbers : mapping of str to float
        The numbers of the message.

    Examples
    --------
    >>> still = sdpid.Recording(time=log.time, position=0.0 * log.position, effort=log.effort)
    >>> finding = sdpid.inspect_recording(still, robot).findings[0]
    >>> finding.severity, finding.kind, finding.joint
    ('warning', 'joint_at_rest', 'joint_1')
    >>> dict(finding.numbers)
    {'range': 0.0, 'limit': 0.001}
    """

    kind: str
    message: str
    severity: Severity = "warning"
    remedy: str = ""
    joint: str | None = None
    numbers: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        numbers = {name: float(value) for name, value in self.numbers.items()}
        object.__setattr__(self, "numbers", MappingProxyType(numbers))

    def __str__(self) -> str:
        return f"{self.message}; {self.remedy}" if self.remedy else self.message

    def line(self, *, used: bool = True) -> str:
        """Return the finding in a line, headed by its severity and its kind.

        What is to be refused is headed ``accepted`` where its recording is used all the same.
        """
        head = "accepted" if used and self.severity == "refuse" else self.severity
        return f"{head} {self.kind}: {self}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {**vars(self), "numbers": dict(self.numbers), "text": str(self)}


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
    about : str
        What it is about, together with other kinds: ``"speed"``, ``"base"``, ``"feet"``,
        ``"late"``, ``"forces"`` or ``"flags"``.
    hides : tuple of str
        Kinds, and what kinds are about, that it explains and that are not told beside it: of its
        own joint, or all of them where it is of none. What is a note explains only what is of its
        joint.
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
    about: str = ""
    hides: tuple[str, ...] = ()
    spoils: bool = False
    excuses: bool = False
    leaves_out: bool = False
    final: bool = False

    @property
    def accepted(self) -> bool:
        """Whether it changes what is done with a log, and may be overruled."""
        return (self.severity == "refuse" and not self.final) or self.leaves_out


refuse, warning, note = (partial(Kind, each) for each in ("refuse", "warning", "note"))

# A kind of finding that leaves out a joint's effort.
left_out = partial(
    warning,
    remedy="identify leaves its effort out, as without_effort does; accept=['{kind}'] (--accept "
    "{kind}) uses it as it is",
    excuses=True,
    leaves_out=True,
)

# Every kind by its name, once the files of checks are imported.
KINDS: dict[str, Kind] = {}

# Forces that are late differ from those of their time.
_OF_LATE_FORCES = (
    *("forces_unlike_motion", "forces_scale", "forces_offset"),
    *("wrenches_moments", "wrenches_point"),
)
_DELAYS = "delays are told once this is mended"
KINDS.update(
    velocity_late=warning(
        "velocity of {joints} is {late} by up to {size:.3g ms} against the rate of the position, "
        "limit {limit:.3g ms}",
        "shift it, or leave the velocity out (velocity=none)",
        about="speed",
    ),
    effort_late=warning("{what}", "{remedy}", excuses=True, about="late"),
    base_orientation=refuse(
        "orientation of the base is no quaternion x y z w from base to world: {seen}; both agree "
        "where it is read as {right}",
        "read it in its order (base={{'quaternion': 'wxyz'}}), or give the inverse",
        hides=("base", "feet", "late"),
        spoils=True,
    ),
    base_velocity=warning(
        "{velocity} of the base, said to be in {axes} axes, leaves {unexplained:.3g %} of the rate "
        "of its {pose} unexplained, limit {limit:g %}{better}",
        "say its axes (velocity_frame) or its unit, or leave it out",
        spoils=True,
        about="base",
    ),
    imu_gyroscope=warning("gyroscope of the base{what}", "{remedy}", spoils=True, about="base"),
    imu_accelerometer=warning(
        "accelerometer of the base{what}", "{remedy}", spoils=True, about="base"
    ),
    imu_axes=warning(f"axes of the {{what}}; {_DELAYS}", "{remedy}", hides=("late",), about="base"),
    imu_place=warning(
        "the {sensor} sits at {place} m in the base's frame, {distance:.3g} m from where it is "
        f"said to be, as the pose shows (standard error {{error:.2g}} m, limit {{limit:g}} m); "
        f"{_DELAYS}",
        "give the IMU's translation={place}",
        hides=("late",),
        about="base",
    ),
    imu_bias=warning(
        "the {sensor} shows {value} {unit} too much along its axes, as the pose shows (standard "
        "error {error:.2g}, limit {limit:g}){also}",
        "take it off the {sensor}",
        about="base",
    ),
    imu_scale=warning(
        "the {sensor} shows {scale:.4g} times what the pose does (standard error {error:.2g}, "
        "limit {least:g} to {most:g}){also}",
        "divide the {sensor} by it",
        about="base",
    ),
    imu_late=warning("{what}", "{remedy}", about="late"),
    base_late=warning("{what}", "{remedy}", about="late"),
    contacts_missing=refuse(
        "{said}, and the robot does not fall: its mean specific force upward is then "
        "{specific_force:.3g} m/s² (limit {limit:.3g}; gravity {gravity:.3g})",
        "give what bears it, Recording.contacts: flags, forces or wrenches; of a base that is "
        "held, log.with_held_base(link)",
        spoils=True,
    ),
    foot_moves=warning(
        "{what}", "mark it as not down where it slips; check frames, offset and base", about="feet"
    ),
    foot_high=warning(
        "{foot} is {height:.3g} m above the other feet while it is said to be down, limit "
        "{limit:g} m",
        "check its flags and the order of the joints, unless the ground is not level",
        about="feet",
    ),
    contact_frame=refuse(
        "frames of contacts move while they are said to be down, and others behind them rest "
        "(limit a factor of {limit:g}): {pairs}",
        "give the contacts' frames as {frames}",
        hides=("foot_moves", "foot_high"),
        spoils=True,
        about="feet",
    ),
    contact_point=warning("{feet} {where}", "{remedy}", about="feet"),
    contacts_late=warning("{what}", "{remedy}", hides=_OF_LATE_FORCES, about="late"),
    total_mass=warning(
        "torques carry {carried:.4g} kg (standard error {kg_error:.2g} kg), {share:.3g} times the "
        "{mass:.4g} kg {said}, limit {least:g} to {most:g}: {means} scale of all torques",
        "weigh the robot, and give its mass (TotalMass); check the torque constants",
    ),
    forces_missing=refuse(
        "contact forces of {foot}{axes} never change: they are ({shown}) N in every row, while the "
        "foot is down in {down:.3g %} of them, limit {limit:g %}",
        "if they were not measured, leave all forces out, and keep the flags",
        hides=("forces", "flags_unlike_forces"),
    ),
    flags_unlike_forces=warning(
        "{share:.3g %} of all measured contact force acts on feet that are said to be up, limit "
        "{limit:g %}: flags are late, have too high a threshold, or are of other feet",
        "leave the flags out, and they are made of the forces; or widen contact_margin_s",
        hides=("flags_unlike_motion",),
        about="flags",
    ),
    forces_unlike_motion=warning(
        "contact forces are not those of this motion: {unexplained:.3g %} of what the legs' "
        "torques need beside their own links stays unexplained, limit {limit:g %}, whatever feet "
        "and axes they are of",
        "check that forces are in N and on time, and what their sensors hold",
        about="forces",
    ),
    forces_exchanged=warning(
        "contact forces{also} are of other feet: {feet}; {better}",
        "{remedy}",
        hides=("flags",),
        about="forces",
    ),
    forces_axes=warning("contact forces{what}", "{remedy}", about="forces"),
    forces_scale=warning("contact forces{what}", "{remedy}", about="forces"),
    forces_offset=warning(
        "contact forces of {foot} are off by {offset} N in x, y, z (standard errors {errors}, "
        "limit {limit:.3g} N in {axis}), {seen}",
        "take it off, or zero the sensor while the foot is up",
        hides=("flags_unlike_forces",),
        about="forces",
    ),
    wrenches_moments=warning(
        "moments of {foot} are {ratio:.3g} times those that the legs' torques show, forces being "
        "right, limit {least:.3g} to {most:.3g}{sign}",
        "give moments in N·m on the robot, in the world's axes",
        about="forces",
    ),
    wrenches_point=warning(
        "moments of {foot} are about a point {point} m from its frame's origin, in the world's "
        "axes (standard errors {errors}, limits {limits})",
        "give moments about the origin of the contact's frame, or the sensor's frame",
        about="forces",
    ),
)

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
        remedy=_Words().vformat(row.remedy, (), {"kind": kind, **fields}),
        numbers=numbers,
    )


def explained(finding: Finding, others: list[Finding]) -> bool:
    """Return whether another finding explains one, so that it is not told."""
    return any(
        {finding.kind, KINDS[finding.kind].about} & {*KINDS[other.kind].hides}
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
