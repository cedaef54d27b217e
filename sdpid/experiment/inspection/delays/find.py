"""`channel_delays`: how late each channel of a recording with a base is."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from operator import is_not
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from sdpid.errors import SdpidError
from sdpid.experiment.inspection.delays.dynamic import dynamic_delays, is_held
from sdpid.experiment.inspection.delays.kinematic import imu_against_pose, pose_against_joints
from sdpid.experiment.inspection.delays.lag import Delay, pooled
from sdpid.experiment.inspection.delays.landings import contacts_delay
from sdpid.experiment.processing.delays.on_time import on_time
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.floating.base import BaseMotion
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

# What was found is kept as long as the recording's base: inspection and processing both ask. The
# robot and arrays that it was found with come first.
_FOUND: WeakKeyDictionary[BaseMotion, tuple[tuple[Any, ...], set[str], dict[str, Delay]]]
_FOUND = WeakKeyDictionary()


def is_told(channel: str, delay: Delay) -> bool:
    """Tell whether a delay is long and sure enough to be told."""
    return delay.sure(LEAST[channel], DEVIATIONS)


def pooled_delays(found: list[dict[str, Delay]]) -> dict[str, Delay]:
    """Return delays by channel of several recordings with the same sensors."""
    result = {}
    for channel in LEAST:
        own = [each[channel] for each in found if channel in each]
        if own:
            value, error = pooled(
                np.array([each.value for each in own]), np.array([each.error for each in own])
            )
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
    if log.base is None:
        return {}
    of = (robot, log.time, log.position, log.effort, log.contacts)
    known = _FOUND.get(log.base)
    if known is None or known[1] != {*unused} or any(map(is_not, known[0], of)):
        known = (of, {*unused}, _found(robot, log, unused))
        _FOUND[log.base] = known
    return known[2]


def gyroscope_delay(log: Recording) -> dict[str, Delay]:
    """Return how late the IMU is against the pose, all that is known without a robot."""
    piece = _piece(log)
    turned = None if piece is None else imu_against_pose(piece)
    if turned is None:
        return {}
    return {"imu": turned.wider(max(_BEYOND["base"], _BEYOND_STEPS * log.step))}


def _piece(log: Recording) -> Recording | None:
    """Return the middle of the longest piece of a recording, None where it is short."""
    piece = max(continuous(log)[0], key=lambda each: each.n_samples)
    if piece.n_samples < _LEAST_SAMPLES:
        return None
    first = max(0, (piece.n_samples - _READ) // 2)
    return rows_of(piece, slice(first, first + _READ)) if first else piece


def _found(robot: RobotModel, log: Recording, unused: Collection[str]) -> dict[str, Delay]:
    piece = _piece(log)
    if piece is None:
        return {}
    found: dict[str, Delay] = {}
    beyond = {name: max(each, _BEYOND_STEPS * log.step) for name, each in _BEYOND.items()}
    try:
        by_feet = pose_against_joints(robot, piece)
        if by_feet is not None:
            found["base"] = by_feet.wider(beyond["feet"])
        has_imu = piece.base is not None and piece.base.imu is not None
        if not has_imu:
            piece = _corrected(piece, found)
        own = "effort" if has_imu or is_held(robot, piece) else "pose"
        for name, delay in dynamic_delays(robot, piece, unused).items():
            found[name] = delay.wider(beyond[own if name == "effort" else name])
        turned = imu_against_pose(piece)
        if turned is not None and "imu" in found:
            both = float(np.hypot(turned.error, found["imu"].error))
            found["base"] = Delay(value=found["imu"].value - turned.value, error=both)
        elif turned is not None and "base" in found:
            both = float(np.hypot(turned.error, found["base"].error))
            found["imu"] = Delay(value=found["base"].value + turned.value, error=both)
        landed = contacts_delay(robot, _corrected(piece, found), unused)
        if landed is not None:
            found["contacts"] = landed.wider(beyond["contacts"])
    except SdpidError:
        # A recording that cannot be processed is refused where it is processed.
        return {}
    most = max(_UNKNOWN, _UNKNOWN_STEPS * log.step)
    return {name: each for name, each in found.items() if each.error < most}


def _corrected(piece: Recording, found: dict[str, Delay]) -> Recording:
    """Return a recording with delays taken off that are more than their error.

    What is found next is then off by less than where only what is told were taken off.
    """
    likely: dict[str, Any] = {
        f"{name}_delay_s": each.value
        for name, each in found.items()
        if abs(each.value) > each.error
    }
    return on_time(piece, replace(Processing(), **likely))
