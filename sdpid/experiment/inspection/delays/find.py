"""How late each channel of a recording with a base is, by motion and the equation of motion.

A channel that is late by d makes residuals of that equation that are, to first order, d times their
derivative by the delay. Parameters of links and friction that fit best are taken off both (variable
projection), and the delay is the ratio of the two residuals. Contacts are taken for closed
throughout: forces that flags deny look like delays, and rows without them need no flags.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.errors import SdpidError
from sdpid.experiment.inspection.block_fit import orthonormal, pooled
from sdpid.experiment.inspection.delays.kinematic import (
    Delay,
    delay_step,
    imu_against_pose,
    lag,
    on_legs,
    pose_against_joints,
)
from sdpid.experiment.processing.base import into_body
from sdpid.experiment.processing.choose import default_processing
from sdpid.experiment.processing.contact_samples import TRANSMITS, ContactSamples
from sdpid.experiment.processing.filters import BAND_OVER_RATE
from sdpid.experiment.processing.on_time import on_time
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.gaps import continuous
from sdpid.experiment.recording.recording import Recording, rows_of
from sdpid.robot.model.contacts.jacobians import contact_jacobians
from sdpid.robot.model.model import RobotModel

# Cut-offs (Hz). Of simulated quadrupeds efforts were found within 0.2 ms at 20 to 30 Hz with an
# IMU; at 10 Hz the signs of speeds are smeared. Accelerations from poses need 10 Hz: at 20 Hz their
# noise in the regressor made 2 ms of 0.8 to 3.4. At that of landings one is a step of 8 ms.
_CUTOFF_HZ, _POSE_CUTOFF_HZ, _LANDING_HZ = 30.0, 10.0, 120.0
# Flags may be late as well (s), where they are needed.
_MARGIN = 0.01
# Rows a sample that are left where every contact is closed. With the six of a quadruped on balls
# delays are found as well as with right flags, whatever flags say.
_LEAST_FREE = 6
# Samples that are looked at, spread evenly.
_ROWS = 600
# Half the distance of two delays whose difference is a derivative (s).
_HALF = 5e-4
_STEPS, _NEAR, _WEIGHTINGS = 4, 1e-4, 3
# Where the equation of motion leaves more than this share of the efforts' mean square, something
# else is wrong: simulated quadrupeds leave at most 0.002.
_UNLIKE = 0.05
# Widths of smooth signs (rad/s) that together imitate any dry friction.
_WIDTHS = (0.01, 0.02, 0.05, 0.2, 1.0)
# Directions of the regressor, and of forces of contacts, with less than this share of the largest
# singular value are noise.
_RANK, _FORCE_RANK = 1e-4, 1e-6
# A landing is looked for this far from its flag (s), and must not be at the edge of that.
_WINDOW, _INSIDE = 0.03, 0.9
_LEAST_LANDINGS = 6
# Times the median deviation, a normal error's standard deviation; times that, a median's error.
_NORMAL, _OF_MEDIAN = 1.4826, 1.2533
# Forces as recorded must explain those from efforts to this share.
_ALIKE = 0.5


def free_of_contacts(
    robot: RobotModel, position: Array, contacts: ContactSamples | None, scale: Array
) -> Array:
    """Return projectors of efforts over their scale onto what contacts leave free, (K, n, n)."""
    unit = np.eye(len(scale))
    if contacts is None:
        return np.broadcast_to(unit, (len(position), *unit.shape))
    J = contact_jacobians(robot, position, contacts.frames, contacts.offset)
    closed = [
        J[:, i, : TRANSMITS[kind]] * contacts.down[:, i, None, None]
        for i, kind in enumerate(contacts.kind)
    ]
    A = np.swapaxes(np.concatenate(closed, axis=1) / scale, 1, 2)
    U, s, _ = np.linalg.svd(A, full_matrices=False)
    U = U * (s > _FORCE_RANK * np.maximum(s[:, :1], 1e-300))[:, None, :]
    return np.asarray(unit - U @ np.swapaxes(U, 1, 2))


def first_scale(robot: RobotModel, effort: Array, unused: Collection[str] = ()) -> Array:
    """Return a scale of the efforts to begin with, of a robot with a floating base.

    Efforts of joints that are not used have an infinite one: their rows are zero.
    """
    joints = np.maximum(effort[:, robot.n_base :].std(axis=0), 1e-9)
    used = np.array([name not in unused for name in robot.joint_names[robot.n_base :]])
    base = np.full(robot.n_base, joints[used].mean() if used.any() else 1.0)
    base[:3] /= max(robot.reach, 1e-3)
    joints[~used] = np.inf
    return np.concatenate([base, joints])


def _rescaled(scale: Array, left: Array, free: Array) -> Array:
    """Return the scale of which residuals (K, n) are most likely, a step from the present one.

    The base's three forces share one, and so do its three torques.
    """
    top, bottom = np.sum(left**2, axis=0), np.einsum("kjj->j", free)
    for part in (slice(0, 3), slice(3, 6)):
        top[part], bottom[part] = top[part].sum(), bottom[part].sum()
    # What contacts take as a whole leaves rounding errors.
    seen = (top > 0.0) & (bottom > _FORCE_RANK * len(free))
    return np.asarray(scale * np.sqrt(np.where(seen, top, 1.0) / np.where(seen, bottom, 1.0)))


def is_held(robot: RobotModel, log: Recording) -> bool:
    """Tell whether a base is held throughout, so that it does not matter how it moves."""
    contacts = log.contacts
    if contacts is None or contacts.down is None:
        return False
    planes = np.array([kind == "plane" for kind in contacts.kind])
    holding = planes & ~on_legs(robot, log)
    return bool(holding.any()) and bool(contacts.down[:, holding].any(axis=1).all())


def _processing(log: Recording, cutoff_hz: float, **changes: Any) -> Processing:
    """Return a processing that leaves no samples out, in which delays are looked for."""
    settings: dict[str, Any] = dict.fromkeys(("decimation", "reversal_time", "impact_s"))
    settings |= {"contact_force_std": None, "contact_moment_std": None, "reasons": ()}
    settings["cutoff_hz"] = min(cutoff_hz, BAND_OVER_RATE * log.rate_hz)
    return replace(default_processing(log), **{**settings, **changes})


def _all_closed(robot: RobotModel, log: Recording) -> Recording:
    """Return a recording whose contacts are closed throughout, those that ever are.

    As it is where that leaves too few rows.
    """
    contacts = log.contacts
    if contacts is None:
        return log
    ever = np.any(contacts.closed, axis=0)
    taken = sum(TRANSMITS[kind] for kind, each in zip(contacts.kind, ever, strict=True) if each)
    if robot.n - taken < _LEAST_FREE:
        return log
    down = np.array(np.broadcast_to(ever, contacts.closed.shape))
    return replace(log, contacts=replace(contacts, down=down))


def without_delays(log: Recording, names: Collection[str], delays: Collection[float]) -> Recording:
    """Return a recording with its channels on time."""
    shifts: dict[str, Any] = {
        f"{name}_delay_s": float(each) for name, each in zip(names, delays, strict=True)
    }
    return on_time(log, replace(Processing(), **shifts))


def _friction_columns(robot: RobotModel, samples: Samples, rows: Indices) -> Array:
    """Return columns of friction, rotors and offsets of every joint at some samples, (K, n, p)."""
    first = robot.n_base

    def smooth_sign(width: float) -> Array:
        signs = samples.through_filter(lambda speed, _: np.tanh(speed / width), slice(None))
        return np.asarray(signs[rows])

    speed, rate = samples.velocity[rows], samples.acceleration[rows]
    signals = [speed, rate, np.ones_like(speed), *(smooth_sign(width) for width in _WIDTHS)]
    return np.concatenate([s[:, :, None] * np.eye(robot.n)[:, first:] for s in signals], axis=2)


class _Shifted:
    """Efforts and links' columns of samples, with efforts and the IMU read at other times.

    Filters do not depend on time: a channel that is shifted before one is the filtered one,
    shifted.
    """

    def __init__(self, robot: RobotModel, samples: Samples) -> None:
        from scipy.interpolate import CubicSpline

        self.robot, self.samples = robot, samples
        assert samples.time is not None
        self.time = samples.time - samples.time[0]
        self._gravity = into_body(samples.position[:, 3:7], robot.gravity)
        turn, force = samples.acceleration[:, 3:6], samples.acceleration[:, :3] - self._gravity
        sensed = np.hstack([samples.velocity[:, 3:6], force, turn])
        self._effort = CubicSpline(self.time, samples.effort)
        self._sensed = CubicSpline(self.time, sensed)

    def __call__(self, rows: Indices, delays: Mapping[str, float]) -> tuple[Array, Array]:
        """Return columns of links (K, n, 10·links) and efforts (K, n) at some samples."""
        at, samples = self.time[rows], self.samples
        velocity, acceleration = samples.velocity[rows], samples.acceleration[rows]
        if "imu" in delays:
            sensed = self._sensed(at + delays["imu"])
            velocity[:, 3:6], acceleration[:, 3:6] = sensed[:, :3], sensed[:, 6:]
            acceleration[:, :3] = sensed[:, 3:6] + self._gravity[rows]
        links = self.robot.regressor(samples.position[rows], velocity, acceleration)
        return links, np.asarray(self._effort(at + delays["effort"]))


def dynamic_delays(
    robot: RobotModel, log: Recording, unused: Collection[str] = ()
) -> dict[str, Delay]:
    """Return the delays of ``"effort"`` and ``"imu"`` that make the equation of motion hold best.

    Parameters
    ----------
    robot : RobotModel
        With a floating base.
    log : Recording
        Without gaps; its joints are the robot's.
    unused : collection of str, optional
        Joints whose efforts say nothing.

    Returns
    -------
    dict
        That of the IMU only where there is one on a base that moves.
    """
    base, held = log.base, is_held(robot, log)
    sensed = base is not None and base.imu is not None and base.imu.accelerometer is not None
    names = ("effort", "imu") if sensed and not held else ("effort",)
    cutoff = _CUTOFF_HZ if sensed or held else _POSE_CUTOFF_HZ
    processing = _processing(log, cutoff, contact_margin_s=_MARGIN, decimation=1)
    samples = process(_all_closed(robot, log), processing, gravity=robot.gravity.tolist())
    shifted, half = _Shifted(robot, samples), max(_HALF, 0.5 * log.step)
    delays, errors = np.zeros(len(names)), np.zeros(len(names))
    scale = first_scale(robot, samples.effort, unused)
    for _ in range(_STEPS):
        # Whatever is read at another time is inside.
        margin = np.abs(delays).max() + half
        inside = (shifted.time >= margin) & (shifted.time <= shifted.time[-1] - margin)
        rows = np.flatnonzero(inside)
        if not rows.size:
            return {}
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, _ROWS).astype(np.intp))]

        def at(values: Array, rows: Indices = rows) -> tuple[Array, Array]:
            return shifted(rows, dict(zip(names, values.tolist(), strict=True)))

        links, effort = at(delays)
        columns = np.concatenate([links, _friction_columns(robot, samples, rows)], axis=2)
        slopes = []
        for step in half * np.eye(len(names)):
            (late, late_effort), (early, early_effort) = at(delays + step), at(delays - step)
            slopes.append((late_effort - early_effort, late - early))
        contacts = None if samples.contacts is None else samples.contacts.picked(rows)
        for _ in range(_WEIGHTINGS):
            free = free_of_contacts(robot, samples.position[rows], contacts, scale)
            weighted = (free / scale) @ columns
            if np.einsum("kjj->", free) <= columns.shape[2]:
                return {}
            due = np.einsum("kij,kj->ki", free, effort / scale)
            basis, back = orthonormal(weighted.reshape(due.size, -1), _RANK)

            def beyond(values: Array, basis: Array = basis) -> Array:
                flat = values.ravel()
                return np.asarray((flat - basis @ (basis.T @ flat)).reshape(values.shape))

            theta = (back @ (basis.T @ due.ravel()))[: slopes[0][1].shape[2]]
            rates = [
                beyond(np.einsum("kij,kj->ki", free, (links @ theta - efforts) / scale))
                for efforts, links in slopes
            ]
            found = delay_step(beyond(due), np.stack(rates, axis=2) / (2.0 * half))
            if found is None:
                return {}
            change, errors, left = found
            unlike = float(np.sum(left**2) / np.sum(due**2))
            scale = _rescaled(scale, left, free)
        delays = delays + change
        if unlike > _UNLIKE:
            return {}
        if np.abs(change).max() < _NEAR:
            break
    each = zip(names, delays.tolist(), errors.tolist(), strict=True)
    return {name: Delay(value=value, error=error) for name, value, error in each}


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
    steps, measured = round(_WINDOW / step), contacts.forces is not None
    if not measured and (contacts.down is None or not _landings(contacts.down, steps)):
        return None
    std = 1.0 if measured else None
    processing = _processing(log, _LANDING_HZ, decimation=1, contact_force_std=std)
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
    force = np.stack([solved[:, row : row + 3, 0] for row in np.cumsum([0, *wide[:-1]])], axis=1)
    if samples.contacts is not None and samples.contacts.forces is not None:
        recorded, other = (
            samples.contacts.forces[..., :3].reshape(len(q), -1),
            force.reshape(len(q), -1),
        )
        moves = np.flatnonzero(np.ptp(recorded, axis=0) > 0.0)
        alike = [i for i in moves if np.corrcoef(recorded[:, i], other[:, i])[0, 1] ** 2 > _ALIKE]
        return lag(recorded[:, alike], other[:, alike], step, gain=True) if alike else None
    assert samples.time is not None
    assert contacts.down is not None
    first = round(float(samples.time[0] - log.time[0]) / step)
    return _of_flags(contacts.down[first : first + len(q)], force[:, :, 2], steps, step)


def _of_flags(down: Mask, upward: Array, steps: int, step: float) -> Delay | None:
    """Return the delay of flags against the steepest rise of upward forces (K, c)."""
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
    for foot, flags in enumerate(down.T):
        for row in (np.flatnonzero(flags[1:] & ~flags[:-1]) + 1).tolist():
            inside = steps <= row <= len(flags) - steps
            if inside and not flags[row - steps : row].any() and flags[row : row + steps].all():
                found.append((foot, row))
    return found


# Delays below these (s) are not significant: ...
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


def is_significant(channel: str, delay: Delay) -> bool:
    """Return whether a delay is long and sure enough for a finding, and to be taken off."""
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
        # The next delay is then off by less than if only the significant ones were taken off.
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
