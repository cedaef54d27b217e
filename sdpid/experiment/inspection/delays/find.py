"""`channel_delays`: how late each channel of a recording with a base is."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.errors import SdpidError
from sdpid.experiment.inspection.delays.dynamic import (
    dynamic_delays,
    first_scale,
    is_held,
    processing_at,
)
from sdpid.experiment.inspection.delays.kinematic import (
    Delay,
    imu_against_pose,
    lag,
    on_legs,
    pooled,
    pose_against_joints,
)
from sdpid.experiment.processing.contact_samples import TRANSMITS
from sdpid.experiment.processing.on_time import on_time
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.gaps import continuous
from sdpid.experiment.recording.recording import Recording, rows_of
from sdpid.robot.model.contacts.jacobians import contact_jacobians
from sdpid.robot.model.model import RobotModel

# Cut-off (Hz) at which a landing is a step of 8 ms.
_CUTOFF_HZ = 120.0
# A landing is looked for this far from its flag (s), and must not be at the edge of that.
_WINDOW, _INSIDE = 0.03, 0.9
_LEAST_LANDINGS = 6
# Times the median deviation, a normal error's standard deviation; times that, a median's error.
_NORMAL, _OF_MEDIAN = 1.4826, 1.2533
# Forces as recorded must explain those from efforts to this share.
_UNLIKE = 0.5


def contacts_delay(robot: RobotModel, log: Recording, unused: Collection[str] = ()) -> Delay | None:
    """Return by how much contacts are late against efforts and joints that are on time.

    The forces that the description's bodies need, less the efforts, jump where a foot lands. Flags
    are compared with the steepest rise, the median of all landings; recorded forces with the
    forces themselves. Bodies that are 15 % off move neither.

    Returns
    -------
    Delay or None
        None where no foot lands often enough, or forces do not follow from efforts.
    """
    contacts, step = log.contacts, log.step
    if contacts is None or not on_legs(robot, log).all():
        return None
    wide = [TRANSMITS[kind] for kind in contacts.kind]
    if sum(wide) >= robot.n or not robot.prior[:, 0].sum() > 0.0:
        return None
    down = contacts.down
    steps = round(_WINDOW / step)
    if contacts.forces is None and (down is None or not _landings(down, steps)):
        return None
    std = None if contacts.forces is None else 1.0
    processing = processing_at(log, _CUTOFF_HZ, decimation=1, contact_force_std=std)
    samples = process(log, processing, gravity=robot.gravity.tolist())
    q, v, a = samples.position, samples.velocity, samples.acceleration
    need = robot.inverse_dynamics(robot.prior, q, v, a) - samples.effort
    scale = first_scale(robot, samples.effort, unused)
    J = contact_jacobians(robot, q, contacts.frames, contacts.offset)
    closed = np.concatenate([J[:, i, :rows] for i, rows in enumerate(wide)], axis=1) / scale
    normal = closed @ closed.transpose(0, 2, 1)
    # Legs that are stretched have forces that no effort shows.
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(normal.shape[1])
    solved = np.linalg.solve(normal, closed @ (need / scale)[:, :, None])
    first_rows = np.cumsum([0, *wide[:-1]])
    force: Array = np.stack([solved[:, row : row + 3, 0] for row in first_rows], axis=1)
    assert samples.time is not None
    first = round(float(samples.time[0] - log.time[0]) / step)
    if samples.contacts is not None and samples.contacts.forces is not None:
        return _of_forces(samples.contacts.forces[:, :, :3], force, step)
    assert down is not None
    return _of_flags(down[first : first + len(q)], force[:, :, 2], step)


def _of_forces(recorded: Array, force: Array, step: float) -> Delay | None:
    """Return the delay of recorded forces against others, up to their scales."""
    mine, other = (each.reshape(len(each), -1) for each in (recorded, force))
    moves = np.ptp(mine, axis=0) > 0.0
    alike = [
        bool(moves[i]) and np.corrcoef(mine[:, i], other[:, i])[0, 1] ** 2 > _UNLIKE
        for i in range(mine.shape[1])
    ]
    if not any(alike):
        return None
    return lag(mine[:, alike], other[:, alike], step, gain=True)


def _of_flags(down: Mask, upward: Array, step: float) -> Delay | None:
    """Return the delay of flags against the steepest rise of upward forces (K, c)."""
    steps = round(_WINDOW / step)
    found = []
    for foot, row in _landings(down, steps):
        rise = np.gradient(upward[row - steps : row + steps, foot])
        peak = int(rise.argmax())
        if abs(peak - steps) > _INSIDE * steps or not 0 < peak < len(rise) - 1:
            continue
        before, top, after = rise[peak - 1 : peak + 2]
        curved = before - 2.0 * top + after
        shift = 0.5 * (before - after) / curved if curved < 0.0 else 0.0
        # A foot lands between the last sample without its flag and the first with it.
        found.append((steps - 0.5 - peak - shift) * step)
    if len(found) < _LEAST_LANDINGS:
        return None
    value = float(np.median(found))
    spread = _NORMAL * float(np.median(np.abs(np.array(found) - value)))
    return Delay(value=value, error=_OF_MEDIAN * spread / float(np.sqrt(len(found))))


def _landings(down: Mask, steps: int) -> list[tuple[int, int]]:
    """Return feet and rows of landings that are clear of others, (foot, first row down)."""
    found = []
    for foot in range(down.shape[1]):
        flags = down[:, foot]
        for row in (np.flatnonzero(flags[1:] & ~flags[:-1]) + 1).tolist():
            inside = steps <= row <= len(flags) - steps
            if inside and not flags[row - steps : row].any() and flags[row : row + steps].all():
                found.append((foot, row))
    return found


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
    piece = None if log.base is None else _piece(log)
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
