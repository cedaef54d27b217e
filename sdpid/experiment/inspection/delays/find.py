"""`channel_delays`: how late each channel of a recording with a base is."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from sdpid.errors import SdpidError
from sdpid.experiment.inspection.block_fit import pooled
from sdpid.experiment.inspection.delays.dynamic import (
    contacts_delay,
    dynamic_delays,
    is_held,
    without_delays,
)
from sdpid.experiment.inspection.delays.kinematic import (
    Delay,
    imu_against_pose,
    pose_against_joints,
)
from sdpid.experiment.recording.gaps import continuous
from sdpid.experiment.recording.recording import Recording, rows_of
from sdpid.robot.model.model import RobotModel

# Delays below these (s) are not told: ...
LEAST = {"effort": 5e-4, "imu": 5e-4, "base": 1e-3, "contacts": 2e-3}
# ... nor are those of fewer errors than this, to which these were added (s): what delays of
# simulated quadrupeds were off by beyond their errors (docs/evidence/legged.md). Those of the pose
# by feet, which roll and slip, are marked as "feet"; those of efforts without an IMU as "pose".
DEVIATIONS = 4.0
_BEYOND = {"effort": 1e-4, "imu": 1e-4, "base": 1e-4, "feet": 4e-4, "pose": 3e-4, "contacts": 5e-4}
# The same for long sampling steps, in steps.
_BEYOND_STEPS = 0.1
# A delay with a larger error than this (s, or sampling steps) is not known.
_UNKNOWN, _UNKNOWN_STEPS = 1e-3, 0.2
# Samples that are looked at, from the middle of longer recordings.
_READ = 20_000
_LEAST_SAMPLES = 500


def is_told(channel: str, delay: Delay) -> bool:
    """Tell whether a delay is long and sure enough to be told."""
    return delay.sure(LEAST[channel], DEVIATIONS)


def pooled_delays(found: list[dict[str, Delay]]) -> dict[str, Delay]:
    """Return delays by channel of several recordings with the same sensors."""
    result = {}
    for channel in LEAST:
        own = [(each[channel].value, each[channel].error) for each in found if channel in each]
        if own:
            value, error = pooled(*np.transpose(own))
            result[channel] = Delay(value=value, error=error)
    return result


def channel_delays(
    robot: RobotModel, log: Recording, unused: Collection[str] = ()
) -> dict[str, Delay]:
    """Return how late each channel is against the joints' positions, by its name.

    Parameters
    ----------
    robot : RobotModel
        With a floating base.
    log : Recording
        With a base; its joints are the robot's.
    unused : collection of str, optional
        Joints whose efforts say nothing.

    Returns
    -------
    dict of str to Delay
        ``"effort"``, ``"imu"``, ``"base"`` and ``"contacts"``, where they were recorded and the
        motion shows them.
    """
    piece = None if log.base is None else _piece(log)
    if piece is None:
        return {}
    found: dict[str, Delay] = {}
    beyond = {name: max(each, _BEYOND_STEPS * log.step) for name, each in _BEYOND.items()}

    def corrected(piece: Recording) -> Recording:
        # What is found next is then off by less than where only what is told were taken off.
        likely = {name: d.value for name, d in found.items() if abs(d.value) > d.error}
        return without_delays(piece, likely, likely.values())

    try:
        by_feet = pose_against_joints(robot, piece)
        if by_feet is not None:
            found["base"] = by_feet.wider(beyond["feet"])
        has_imu = piece.base is not None and piece.base.imu is not None
        if not has_imu:
            piece = corrected(piece)
        own = "effort" if has_imu or is_held(robot, piece) else "pose"
        for name, delay in dynamic_delays(robot, piece, unused).items():
            found[name] = delay.wider(beyond[own if name == "effort" else name])
        turned = imu_against_pose(piece)
        if turned is not None and "imu" in found:
            late = found["imu"].value - turned.value
            found["base"] = Delay(value=late, error=turned.error).wider(found["imu"].error)
        elif turned is not None and "base" in found:
            late = found["base"].value + turned.value
            found["imu"] = Delay(value=late, error=turned.error).wider(found["base"].error)
        landed = contacts_delay(robot, corrected(piece), unused)
        if landed is not None:
            found["contacts"] = landed.wider(beyond["contacts"])
    except SdpidError:
        # A recording that cannot be processed is refused where it is processed.
        return {}
    most = max(_UNKNOWN, _UNKNOWN_STEPS * log.step)
    return {name: each for name, each in found.items() if each.error < most}


def gyroscope_delay(log: Recording) -> dict[str, Delay]:
    """Return how late the IMU is against the pose, all that is known without a robot."""
    piece = _piece(log)
    turned = None if piece is None else imu_against_pose(piece)
    if turned is None:
        return {}
    return {"imu": turned.wider(max(_BEYOND["base"], _BEYOND_STEPS * log.step))}


def _piece(log: Recording) -> Recording | None:
    """Return the middle of the longest piece without gaps, None where it is short."""
    piece = max(continuous(log)[0], key=lambda each: each.n_samples)
    if piece.n_samples < _LEAST_SAMPLES:
        return None
    first = max(0, (piece.n_samples - _READ) // 2)
    return rows_of(piece, slice(first, first + _READ)) if first else piece
