"""`inspect_recording`: run every check on a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from sdpid.errors import DataError
from sdpid.experiment.inspection import effort_checks, motion_checks, time_checks
from sdpid.experiment.inspection.finding import CHECKS, Finding, Subject
from sdpid.experiment.recording.joints import joint_columns, match_joints
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.model import RobotModel

__all__ = ["Inspection", "inspect_recording", "inspect_recordings"]

# Importing a file of checks adds them to the list. A new check is a function in one of these.
_FILES = (time_checks, motion_checks, effort_checks)


@dataclass(frozen=True, kw_only=True)
class Inspection:
    """The findings of all checks on a recording.

    Attributes
    ----------
    findings : tuple of Finding
        Errors first, then warnings, then notes.
    """

    findings: tuple[Finding, ...]

    @property
    def ok(self) -> bool:
        """Whether there is no error and no warning."""
        return all(finding.severity == "note" for finding in self.findings)

    def __str__(self) -> str:
        lines = [f"{finding.severity}: {finding}" for finding in self.findings]
        return "\n".join(lines) or "nothing wrong was found"

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {"ok": self.ok, "findings": [finding.to_dict() for finding in self.findings]}


def inspect_recording(log: Recording, robot: RobotModel | None = None) -> Inspection:
    """Check a recording for defects that make parameters from it wrong.

    Parameters
    ----------
    log : Recording
        What was measured.
    robot : RobotModel, optional
        Whose joints these are: its names, its limits and the gravity of its masses are then
        compared with the recording.

    Returns
    -------
    Inspection
    """
    findings: list[Finding] = []
    if robot is not None:
        log, robot, matching = _matched(log, robot)
        findings += matching
    subject = Subject(log=log, robot=robot)
    findings += [finding for each in CHECKS for finding in each(subject)]
    if any(finding.kind == "position_in_degrees" for finding in findings):
        # Positions in degrees raise most of the other alarms as well.
        alone = ("position_in_degrees", "joints", "joints_unknown")
        findings = [finding for finding in findings if finding.kind in alone]
    ranks = ("error", "warning", "note")
    return Inspection(findings=tuple(sorted(findings, key=lambda f: ranks.index(f.severity))))


def inspect_recordings(
    logs: Sequence[Recording], robot: RobotModel | None = None, *, name: str = ""
) -> tuple[Finding, ...]:
    """Return the findings of recordings; messages begin with `name` and, of several, a number."""
    if len(logs) == 1 and not name:
        return inspect_recording(logs[0], robot).findings
    name = name or "recording"
    return tuple(
        replace(finding, message=f"{name} {number}: {finding.message}")
        for number, log in enumerate(logs, 1)
        for finding in inspect_recording(log, robot).findings
    )


def _matched(
    log: Recording, robot: RobotModel
) -> tuple[Recording, RobotModel | None, list[Finding]]:
    """Return the recording in the robot's order, the robot, and findings about joint names."""
    try:
        matched = match_joints(robot, log)
    except DataError as cause:
        return log, None, [Finding(severity="error", kind="joints_unknown", message=str(cause))]
    names = log.joint_names
    if names is None or set(robot.joint_names) <= set(names):
        left_out = () if names is None else sorted(set(names) - set(robot.joint_names))
        if not left_out:
            return matched, robot, []
        message = f"columns of joints that the robot lacks are left out: {', '.join(left_out)}"
    else:
        found = [names[column] for column in joint_columns(robot, names)]
        pairs = [f"{a} is {b}" for a, b in zip(found, robot.joint_names, strict=True)]
        message = f"joints have another prefix or suffix than the robot's: {', '.join(pairs)}"
    return matched, robot, [Finding(severity="note", kind="joints", message=message)]
