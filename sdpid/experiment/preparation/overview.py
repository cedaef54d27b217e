"""Describe a recording: sizes, times, ranges, noise, and findings."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import asdict
from typing import Any

import numpy as np

from sdpid.errors import DataError
from sdpid.experiment.inspection.inspect import inspect_recordings
from sdpid.experiment.inspection.kinds import found
from sdpid.experiment.inspection.subject import Subject
from sdpid.experiment.processing.choose import default_processing
from sdpid.experiment.processing.motion import joint_frequencies, white_noise
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.model import RobotModel

# A step longer than this many nominal ones is a gap; less is jitter.
_GAP = 1.5


def overview(
    recording: Recording, robot: RobotModel | None = None, *, without_effort: Collection[str] = ()
) -> dict[str, Any]:
    """Describe a recording, and compare it with a robot.

    Parameters
    ----------
    recording : Recording
        What was measured.
    robot : RobotModel, optional
        Whose joints these are.
    without_effort : collection of str, optional
        Joints whose effort is not looked at.

    Returns
    -------
    dict
        Plain values for JSON: sizes, times (s), the processing chosen by default and why,
        ``joints`` with a range each (rad, rad/s, N.m), the standard deviation of its noise, and
        the frequencies (Hz) at which it mostly moves and below which 95 % of the motion lies; and
        ``findings`` (see `inspect_recordings`). Missing is None.
    """
    matched = Subject.of(recording, robot).log
    findings = list(inspect_recordings([recording], robot, without_effort=without_effort))
    processing, reasons = None, None
    try:
        chosen = default_processing(matched)
        processing = asdict(chosen)
        del processing["reasons"]
        reasons = "; ".join(chosen.why)
    except DataError as cause:
        findings.append(found("processing", why=str(cause)))
    steps = np.diff(matched.time) / matched.step
    layout = matched.period_layout
    return {
        "samples": matched.n_samples,
        "duration_s": matched.duration,
        "rate_hz": matched.rate_hz,
        "jitter_of_a_step": float(np.abs(steps - np.rint(steps)).max()),
        "lost_samples": round(matched.duration / matched.step) + 1 - matched.n_samples,
        "gaps": int(np.count_nonzero(steps > _GAP)),
        "longest_step_s": matched.stamps.most,
        "longest_step_row": matched.stamps.row,
        "velocity": None if matched.velocity is None else "measured",
        "reference": None if matched.reference is None else "commanded positions",
        "period_s": matched.period,
        "periods": None if layout is None else layout[2],
        "start_s": matched.start,
        "processing": processing,
        "processing_chosen_for": reasons,
        "joints": _joints(matched, without_effort),
        "findings": [finding.to_dict() for finding in findings],
    }


def _joints(recording: Recording, without_effort: Collection[str]) -> list[dict[str, Any]]:
    """Return the range of every joint."""
    position, velocity = recording.position, recording.velocity
    effort = recording.effort
    known = [name not in without_effort for name in recording.names]
    motion = joint_frequencies(recording)
    return [
        {
            "joint": name,
            "position_min": float(position[:, j].min()),
            "position_max": float(position[:, j].max()),
            "speed_max": None if velocity is None else float(np.abs(velocity[:, j]).max()),
            "effort_rms": float(np.sqrt(np.mean(effort[:, j] ** 2))) if known[j] else None,
            "effort_max": float(np.abs(effort[:, j]).max()) if known[j] else None,
            "position_noise": white_noise(position[:, j]),
            "effort_noise": white_noise(effort[:, j]) if known[j] else None,
            "motion_hz": None if moves is None else moves[0],
            "bandwidth_hz": None if moves is None else moves[1],
        }
        for j, (name, moves) in enumerate(zip(recording.names, motion, strict=True))
    ]
