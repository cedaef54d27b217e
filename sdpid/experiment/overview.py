"""What was understood of a recording, and what looks wrong with it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from sdpid.errors import DataError
from sdpid.experiment.choice import choose_processing
from sdpid.experiment.matching import match_joints
from sdpid.experiment.recording import Recording
from sdpid.experiment.signals import bandwidth, gaps, noise, signal_warnings
from sdpid.experiment.units import suspect_units
from sdpid.robot.model import RobotModel

__all__ = ["overview"]


def overview(recording: Recording, robot: RobotModel | None = None) -> dict[str, Any]:
    """Describe a recording, and compare it with a robot.

    Parameters
    ----------
    recording : Recording
        What was measured.
    robot : RobotModel, optional
        Whose joints these are.

    Returns
    -------
    dict
        Plain values for JSON: sizes, times (s), the processing chosen by default and why,
        ``joints`` with a range each (rad, rad/s, N.m), the standard deviation of its noise, and
        the frequencies (Hz) at which it mostly moves and below which 95 % of the motion lies; and
        ``warnings``. Missing is None.
    """
    matched, limits, warnings = _matched(recording, robot)
    suspects = suspect_units(matched, limits)
    if suspects:
        warnings.append(f"positions look like degrees, not radians: {', '.join(suspects)}")
    else:
        # Positions in degrees would raise most of the other alarms as well.
        warnings += signal_warnings(matched, None if limits is None else robot)
    processing, reasons = None, None
    try:
        choice = choose_processing(matched)
        processing = asdict(choice.processing)
        del processing["reasons"]
        reasons = "; ".join(choice.reasons)
    except DataError as cause:
        warnings.append(str(cause))
    steps = np.diff(matched.time) / matched.step
    layout = matched.period_layout
    return {
        "samples": matched.n_samples,
        "duration_s": matched.duration,
        "rate_hz": matched.rate_hz,
        "jitter_of_a_step": float(np.abs(steps - np.rint(steps)).max()),
        "lost_samples": round(matched.duration / matched.step) + 1 - matched.n_samples,
        **gaps(matched),
        "velocity": None if matched.velocity is None else "measured",
        "effort": "N.m" if matched.effort_scale is None else "turned into N.m by effort_scale",
        "period_s": matched.period,
        "periods": None if layout is None else layout[2],
        "start_s": matched.start,
        "processing": processing,
        "processing_chosen_for": reasons,
        "joints": _joints(matched),
        "warnings": warnings,
    }


def _matched(recording: Recording, robot: RobotModel | None) -> tuple[Recording, Any, list[str]]:
    """Return the recording in the robot's order, position limits, and what does not match."""
    if robot is None:
        return recording, None, []
    try:
        matched = match_joints(robot, recording)
    except DataError as cause:
        return recording, None, [str(cause)]
    warnings = []
    names = recording.joint_names
    if names is not None and not set(names) & set(robot.joint_names):
        pairs = zip(names, robot.joint_names, strict=True)
        listed = ", ".join(f"{own} is {other}" for own, other in pairs)
        warnings.append(f"joints are named differently and taken by position: {listed}")
    return matched, robot.position_limits, warnings


def _joints(recording: Recording) -> list[dict[str, Any]]:
    """Return the range of every joint."""
    position, velocity = recording.position, recording.velocity
    effort = recording.effort
    if recording.effort_scale is not None:
        effort = effort * recording.effort_scale
    motion = [bandwidth(position[:, j], recording.rate_hz) for j in range(recording.n)]
    return [
        {
            "joint": name,
            "position_min": float(position[:, j].min()),
            "position_max": float(position[:, j].max()),
            "speed_max": None if velocity is None else float(np.abs(velocity[:, j]).max()),
            "effort_rms": float(np.sqrt(np.mean(effort[:, j] ** 2))),
            "effort_max": float(np.abs(effort[:, j]).max()),
            "position_noise": noise(position[:, j]),
            "effort_noise": noise(effort[:, j]),
            "motion_hz": None if moves is None else moves[0],
            "bandwidth_hz": None if moves is None else moves[1],
        }
        for j, (name, moves) in enumerate(zip(recording.names, motion, strict=True))
    ]
