"""`inspect_recording`: run every check on a recording."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from math import inf
from typing import Any, ClassVar

from sdpid._common.arrays import is_number
from sdpid._common.tables import Shown, Table
from sdpid.errors import DataError
from sdpid.experiment.inspection import (
    base_checks,
    channel_checks,
    delay_checks,
    dynamics_checks,
    feet_checks,
    motion_checks,
)
from sdpid.experiment.inspection.kinds import KINDS, Finding, explained, found, note, refuse
from sdpid.experiment.inspection.subject import CHECKS, OF_EFFORTS, Subject
from sdpid.experiment.readers.read import is_frame, read_recording
from sdpid.experiment.recording.joints import joint_columns, lacking, robot_of
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.model import RobotModel

# Importing a file of checks adds them to the lists. A new check is a function in one of these.
_ = (
    *(motion_checks, channel_checks, delay_checks, dynamics_checks),
    *(base_checks, feet_checks),
)
KINDS.update(
    joints_unknown=refuse("{why}", final=True, about="log"),
    joints=note("{how}", about="log"),
    processing=refuse("{why}", final=True),
)


@dataclass(frozen=True, kw_only=True)
class Inspection(Shown):
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
    _facts: ClassVar[tuple[str, ...]] = ("ok",)

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

    def _tables(self) -> tuple[Table, ...]:
        columns = ("severity", "kind", "joint", "message", "remedy")
        return (
            Table(columns, tuple(tuple(vars(f)[name] for name in columns) for f in self.findings)),
        )

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
    if total_mass is not None and not (is_number(total_mass) and 0.0 < total_mass < inf):
        raise DataError(
            f"total_mass: is {total_mass!r:.80}; give what the robot weighs, a positive number, kg."
        )
    if not isinstance(log, Recording):
        log = read_recording(log)
    if robot is not None:
        robot = robot_of(robot, [log])
    return Inspection(findings=inspect_recordings([log], robot, total_mass=total_mass))


def inspect_recordings(
    logs: Sequence[Recording | Subject],
    robot: RobotModel | None = None,
    *,
    name: str = "",
    without_effort: Iterable[str] = (),
    total_mass: float | None = None,
) -> tuple[Finding, ...]:
    """Return the findings of recordings, and of what does not fit between them.

    Parameters
    ----------
    logs : sequence of Recording or Subject
        What is to be used together.
    robot : RobotModel, optional
        Whose joints these are; a Subject knows its robot.
    name : str, optional
        Messages begin with it and, of several recordings, a number.
    without_effort : iterable of str, optional
        Joints whose effort is not used: there are no findings about it.
    total_mass : float, optional
        What a robot with a floating base weighs, kg.
    """
    unused = frozenset(without_effort)
    subjects = [
        replace(Subject.of(log, robot), without=unused, total_mass=total_mass) for log in logs
    ]
    looked_at = [_looked_at(subject) for subject in subjects]
    if len(looked_at) == 1 and not name:
        return looked_at[0][1]
    between = dict(dynamics_checks.other_loads([subject for subject, _ in looked_at]))
    resting = [{f.joint for f in told if f.kind == "joint_at_rest"} for _, told in looked_at]
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


def _looked_at(subject: Subject) -> tuple[Subject, tuple[Finding, ...]]:
    """Return one recording as checks see it, and its findings, what is to be refused first."""
    asked = subject.without
    findings = [*_about_names(subject), *subject.continued[1], *channel_checks.silent(subject)]
    subject = _less(subject, findings)
    # Rows in which a channel is wrong are left out: other channels and joints would be blamed.
    wrong, subject = channel_checks.wrong_channels(subject)
    findings += wrong
    for each in CHECKS:
        findings += each(subject)
    if not any(KINDS[f.kind].spoils for f in findings if f.severity != "note"):
        for each in OF_EFFORTS:
            more = [*each(subject)]
            findings, subject = findings + more, _less(subject, more)
    told, kinds = [], [finding.kind for finding in findings]
    for place, finding in enumerate(findings):
        kind = finding.kind
        # What stands still and efforts both tell it.
        again = kind == "feet_exchanged" and kind in kinds[:place]
        # The finding by which an effort is left out is kept; others about that effort are not.
        unused = asked if KINDS[kind].excuses else subject.without
        of_unused = kind.startswith("effort") and finding.joint in unused
        if not (again or of_unused or explained(finding, findings)):
            told.append(finding)
    ranks = ("refuse", "warning", "note")
    return subject, tuple(sorted(told, key=lambda each: ranks.index(each.severity)))


def _less(subject: Subject, findings: list[Finding]) -> Subject:
    """Return a subject without the efforts that findings exclude from all further checks."""
    joints = {f.joint for f in findings if f.joint and KINDS[f.kind].excuses} - subject.without
    return replace(subject, without=subject.without | joints) if joints else subject


def _about_names(subject: Subject) -> Iterator[Finding]:
    """Yield what to say of the names of joints."""
    if subject.mismatch is not None:
        yield found("joints_unknown", why=str(subject.mismatch))
        return
    robot, names = subject.robot, subject.given.joint_names
    if robot is None or names is None:
        return
    missing = lacking(robot, subject.given)
    own = tuple(name for name in robot.joint_names[robot.n_base :] if name not in missing)
    if not set(own) <= set(names):
        columns = [names[column] for column in joint_columns(robot, names, own)]
        pairs = [f"{a} is {b}" for a, b in zip(columns, own, strict=True)]
        how = f"joints have another prefix or suffix than the robot's: {', '.join(pairs)}"
    elif left_out := sorted(set(names) - set(own)):
        how = f"columns of joints that the robot lacks are left out: {', '.join(left_out)}"
    elif names != own:
        how = f"joints are taken in the robot's order, the columns are of {', '.join(names)}"
    else:
        return
    yield found("joints", how=how)


# Kinds of findings that one may overrule. Any other that is refused stands in the way of processing
# the log as well, whatever is accepted.
REFUSED = tuple(sorted(name for name, kind in KINDS.items() if kind.accepted))


def kinds_accepted(accept: str | Iterable[str]) -> tuple[str, ...]:
    """Return the kinds of findings that are accepted, checked.

    Raises
    ------
    DataError
        When one is no kind that is ever refused.
    """
    if not isinstance(accept, Iterable):
        raise DataError(
            f"accept: is {accept!r:.80}; give kinds of findings, such as 'effort_sign', or () for "
            "none."
        )
    kinds = (accept,) if isinstance(accept, str) else tuple(accept)
    for kind in kinds:
        if kind not in REFUSED:
            near = get_close_matches(str(kind), REFUSED, n=1)
            meant = f"did you mean {near[0]}? " if near else ""
            raise DataError(
                f"accept: {kind!r} is no kind of finding that is refused; {meant}There are "
                f"{', '.join(REFUSED)}."
            )
    return kinds


def joints_left_out(findings: Iterable[Finding], accept: Iterable[str] = ()) -> tuple[str, ...]:
    """Return the joints whose effort is left out, for findings that are not accepted."""
    left_out = [f for f in findings if KINDS[f.kind].leaves_out and f.kind not in set(accept)]
    return tuple(dict.fromkeys(f.joint for f in left_out if f.joint))


def require_accepted(findings: Sequence[Finding], accept: str | Iterable[str] = ()) -> None:
    """Raise when a finding of severity ``"refuse"`` is not accepted.

    Parameters
    ----------
    findings : sequence of Finding
        Of the inspection.
    accept : str or iterable of str, optional
        Kinds of findings that are overruled.

    Raises
    ------
    DataError
        With the findings, their remedies, and the kinds that would have to be accepted.
    """
    kinds = kinds_accepted(accept)
    refused = [each for each in findings if each.severity == "refuse" and each.kind not in kinds]
    if not refused:
        return
    listed = ". ".join(f"{each.kind}: {each}".rstrip(".") for each in refused)
    names = dict.fromkeys(each.kind for each in refused)
    overruled = [name for name in names if name in REFUSED]
    asked = ", ".join(repr(name) for name in overruled)
    options = " ".join(f"--accept {name}" for name in overruled)
    rest = (
        f" If that is as it should be, accept=[{asked}] ({options}) overrules it."
        if overruled
        else ""
    )
    raise DataError(
        f"the log is refused, for no result from it would mean anything. {listed}.{rest}"
    )
