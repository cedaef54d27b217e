"""How late each channel of a recording with a base is, by motion and the equation of motion.

Every delay is found in the same way. A channel that is late by d leaves residuals that are, to
first order, d times what a longer delay takes off them (`delay_step`), until that changes nothing.

Of two signals, or of feet that stand, the residuals are their difference, or the speed of the feet.
Of efforts and the IMU they are those of the equation of motion, off which parameters of links and
friction that fit best are taken (variable projection). Contacts are taken for closed throughout:
forces that flags deny look like delays, and rows without them need no flags.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.errors import SdpidError
from sdpid.experiment.inspection.block_fit import beyond, block_error, orthonormal, pooled
from sdpid.experiment.inspection.rows import MEMORIES, Standing, on_legs, smoother, turning
from sdpid.experiment.processing.base import into_body
from sdpid.experiment.processing.choose import default_processing
from sdpid.experiment.processing.contact_samples import TRANSMITS, ContactSamples
from sdpid.experiment.processing.filters import BAND_OVER_RATE
from sdpid.experiment.processing.process import on_time, process
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.gaps import continuous
from sdpid.experiment.recording.recording import Recording
from sdpid.experiment.recording.stored import middle
from sdpid.robot.model.jacobians import contact_jacobians
from sdpid.robot.model.model import RobotModel


class Delay(NamedTuple):
    """By how much a channel is late, and its standard error, s; negative values are early."""

    value: float
    error: float

    def sure(self, least: float, deviations: float) -> bool:
        """Tell whether it is longer than a limit and so many of its errors."""
        return abs(self.value) > max(least, deviations * self.error)

    def wider(self, error: float) -> Delay:
        """Return the delay with an error that is independent of its own added."""
        return Delay(self.value, float(np.hypot(self.error, error)))


# Gauss-Newton steps of a delay end when one is this share of its error. Of motions three are enough
# from 20 ms away; of forces, which jump, ten and more.
_SETTLED, _MOST_STEPS = 0.02, 50


def delay_step(left: Array, rates: Array) -> tuple[Array, Array, Array] | None:
    """Return how much longer k delays are, (k,), their errors, and the residuals then.

    Parameters
    ----------
    left : (N, c) ndarray
        Residuals, in the order of time.
    rates : (N, c, k) ndarray
        What longer delays take off them a second.

    Returns
    -------
    tuple or None
        None where the residuals do not depend on a delay.
    """
    power = np.einsum("nci,ncj->ij", rates, rates)
    if not np.linalg.cond(power) < 1.0 / np.finfo(float).eps:
        return None
    inverse = np.linalg.inv(power)
    change = inverse @ np.einsum("nci,nc->i", rates, left)
    left = left - rates @ change
    return change, block_error(np.einsum("nci,nc->ni", rates, left) @ inverse), left


def least_delay(at: Callable[[float], tuple[Array, Array]]) -> Delay | None:
    """Return the delay at which residuals are least, None where they do not depend on it.

    `at` returns the residuals (N, c) at a delay, in the order of time, and what a longer one takes
    off them a second, (N, c).
    """
    delay = 0.0
    for _ in range(_MOST_STEPS):
        left, rate = at(delay)
        weight = 1.0 / np.sqrt(np.maximum(np.mean(left**2, axis=0), 1e-30))
        step = delay_step(left * weight, (rate * weight)[..., None])
        if step is None:
            return None
        change, error = step[0].item(), step[1].item()
        delay += change
        if abs(change) <= _SETTLED * error:
            break
    return Delay(delay, error)


def _moved(signal: Array, step: float, rows: Indices) -> Callable[[float], tuple[Array, Array]]:
    """Return a function that reads a signal at some rows, so much later, and its derivative."""
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(step * np.arange(len(signal)), signal, axis=0)

    def at(delay: float) -> tuple[Array, Array]:
        times = np.clip(step * rows + delay, 0.0, spline.x[-1])
        return np.asarray(spline(times)), np.asarray(spline(times, 1))

    return at


def lag(signal: Array, other: Array, step: float, *, gain: bool = False) -> Delay | None:
    """Return by how much a signal is later than another one of the same quantity.

    Parameters
    ----------
    signal, other : (N, c) ndarray
        Filtered alike; `signal` should be the one with less noise.
    step : float
        Sampling step, s.
    gain : bool, optional
        Whether they differ in scale, channel by channel.

    Returns
    -------
    Delay or None
        None where the signal does not change.
    """
    read, target = _moved(signal, step, np.arange(len(signal))), other - other.mean(axis=0)

    def at(delay: float) -> tuple[Array, Array]:
        values, rate = (each - each.mean(axis=0) for each in read(delay))
        if gain:
            scale = np.sum(values * target, axis=0) / np.sum(values**2, axis=0)
            values, rate = scale * values, scale * rate
        return target - values, rate

    return least_delay(at)


# Cut-off (Hz) of poses, whose differences are noisy.
_POSE_HZ = 15.0
# Least number of samples of a foot that stands.
_LEAST = 200
# A base that turns less than this (rad/s, rms) shows nothing.
LEAST_RATE = 0.05


def rms(values: Array) -> float:
    """Return the root mean square of all values."""
    return float(np.sqrt(np.mean(values**2)))


def imu_against_pose(log: Recording, *, axes: bool = True) -> Delay | None:
    """Return by how much the gyroscope is later than the orientation; None where none turns.

    Without `axes` by how fast both turn, whatever the axes of the sensor are.
    """
    base, smooth = log.base, smoother(log, _POSE_HZ, MEMORIES)
    sensed = None if base is None else base.sensed("gyroscope")
    if base is None or sensed is None or smooth is None:
        return None
    low, inner = smooth
    turned, sensed = (low(each)[inner] for each in (turning(base, log.step), sensed))
    if min(rms(turned), rms(sensed)) < LEAST_RATE:
        return None
    if not axes:
        turned, sensed = (np.linalg.norm(each, axis=1, keepdims=True) for each in (turned, sensed))
    return lag(sensed, turned, log.step)


def pose_against_joints(robot: RobotModel, log: Recording) -> Delay | None:
    """Return by how much the pose is later than the joints.

    A foot that stands does not move, so that the base's motion follows from that of its leg.

    Returns
    -------
    Delay or None
        None where no foot stands long enough, or the base does not turn.
    """
    feet = Standing.of(robot, log)
    if feet is None or np.count_nonzero(feet.stands) < _LEAST or rms(feet.base[:, 3:]) < LEAST_RATE:
        return None
    J = contact_jacobians(robot, feet.position, feet.contacts.frames, feet.contacts.offset)
    legs = np.einsum("kcij,kj->kci", J[:, :, :3, 6:], feet.speeds)
    read = _moved(feet.base, feet.step, feet.rows)

    def at(delay: float) -> tuple[Array, Array]:
        base, rate = (np.einsum("kcij,kj->kci", J[:, :, :3, :6], each) for each in read(delay))
        return (base + legs)[feet.stands], -rate[feet.stands]

    return least_delay(at)


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


def free_of_contacts(
    robot: RobotModel, position: Array, contacts: ContactSamples | None, scale: Array
) -> Array:
    """Return projectors of efforts over their scale onto what contacts leave free, (K, n, n)."""
    unit = np.eye(len(scale))
    if contacts is None:
        return np.broadcast_to(unit, (len(position), *unit.shape))
    J = contact_jacobians(robot, position, contacts.frames, contacts.offset)
    J *= contacts.down[:, :, None, None]
    A = np.swapaxes(_transmitted(J, contacts.kind) / scale, 1, 2)
    U, s, _ = np.linalg.svd(A, full_matrices=False)
    U = U * (s > _FORCE_RANK * np.maximum(s[:, :1], 1e-300))[:, None, :]
    return np.asarray(unit - U @ np.swapaxes(U, 1, 2))


def _transmitted(J: Array, kinds: Iterable[Any]) -> Array:
    """Return the rows of Jacobians (K, c, 6, n) in which contacts act, one below another."""
    each = [J[:, i, : TRANSMITS[kind]] for i, kind in enumerate(kinds)]
    return np.concatenate(each, axis=1)


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
    holding = (np.array(contacts.kind) == "plane") & ~on_legs(robot, log)
    return bool(contacts.down[:, holding].any(axis=1).all())


def _processed(robot: RobotModel, log: Recording, cutoff_hz: float, **changes: Any) -> Samples:
    """Return samples in which delays are looked for, with none left out."""
    off = ("reversal_time", "impact_s", "contact_force_std", "contact_moment_std")
    settings: dict[str, Any] = {**dict.fromkeys(off), "decimation": 1, "reasons": (), **changes}
    settings["cutoff_hz"] = min(cutoff_hz, BAND_OVER_RATE * log.rate_hz)
    processing = replace(default_processing(log), **settings)
    return process(log, processing, gravity=robot.gravity.tolist())


def _all_closed(robot: RobotModel, log: Recording) -> Recording:
    """Return a recording whose contacts are closed throughout, those that ever are.

    As it is where that leaves too few rows.
    """
    contacts = log.contacts
    if contacts is None:
        return log
    closed = contacts.closed
    ever = np.any(closed, axis=0)
    if robot.n - ever @ [TRANSMITS[kind] for kind in contacts.kind] < _LEAST_FREE:
        return log
    down = np.array(np.broadcast_to(ever, closed.shape))
    return replace(log, contacts=replace(contacts, down=down))


def without_delays(log: Recording, delays: Mapping[str, Delay]) -> Recording:
    """Return a recording with its channels on time."""
    shifts: Any = {f"{name}_delay_s": delay.value for name, delay in delays.items()}
    return on_time(log, Processing(**shifts))


def _friction_columns(robot: RobotModel, samples: Samples, rows: Indices) -> Array:
    """Return columns of friction, rotors and offsets of every joint at some samples, (K, n, p)."""

    def smooth_sign(width: float) -> Array:
        signs = samples.through_filter(lambda speed, _: np.tanh(speed / width), slice(None))
        return np.asarray(signs[rows])

    speed, rate = samples.velocity[rows], samples.acceleration[rows]
    signals = [speed, rate, np.ones_like(speed), *(smooth_sign(width) for width in _WIDTHS)]
    own = np.eye(robot.n)[:, robot.n_base :]
    return np.concatenate([signal[:, :, None] * own for signal in signals], axis=2)


def _reader(
    robot: RobotModel, samples: Samples, time: Array
) -> Callable[[Indices, Array], tuple[Array, Array]]:
    """Return a function that reads samples with efforts and, of two delays, the IMU so much later.

    It returns columns of links (K, n, 10·links) and efforts (K, n) at some rows. Filters do not
    depend on time: a channel that is shifted before one is the filtered one, shifted.
    """
    from scipy.interpolate import CubicSpline

    gravity = np.zeros((samples.n_samples, 6))
    gravity[:, :3] = into_body(samples.position[:, 3:7], robot.gravity)
    base = [samples.velocity[:, :6], samples.acceleration[:, :6] - gravity]
    effort, sensed = CubicSpline(time, samples.effort), CubicSpline(time, np.hstack(base))

    def read(rows: Indices, delays: Array) -> tuple[Array, Array]:
        velocity, acceleration = samples.velocity[rows], samples.acceleration[rows]
        if len(delays) > 1:
            velocity[:, :6], force = np.split(sensed(time[rows] + delays[1]), 2, axis=1)
            acceleration[:, :6] = force + gravity[rows]
        links = robot.regressor(samples.position[rows], velocity, acceleration)
        return links, np.asarray(effort(time[rows] + delays[0]))

    return read


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
    assert log.base is not None
    sensed, held = log.base.sensed("accelerometer") is not None, is_held(robot, log)
    names = ("effort", "imu") if sensed and not held else ("effort",)
    cutoff = _CUTOFF_HZ if sensed or held else _POSE_CUTOFF_HZ
    samples = _processed(robot, _all_closed(robot, log), cutoff, contact_margin_s=_MARGIN)
    assert samples.time is not None
    time, half = samples.time - samples.time[0], max(_HALF, 0.5 * log.step)
    read = _reader(robot, samples, time)
    delays, errors = np.zeros((2, len(names)))
    scale = first_scale(robot, samples.effort, unused)
    for _ in range(_STEPS):
        # Whatever is read at another time is inside.
        margin = np.abs(delays).max() + half
        rows = np.flatnonzero((time >= margin) & (time <= time[-1] - margin))
        if not rows.size:
            return {}
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, _ROWS).astype(np.intp))]
        links, effort = read(rows, delays)
        columns = np.concatenate([links, _friction_columns(robot, samples, rows)], axis=2)
        slopes = []
        for step in half * np.eye(len(names)):
            late, early = (read(rows, delays + each) for each in (step, -step))
            slopes.append([a - b for a, b in zip(late, early, strict=True)])
        contacts = None if samples.contacts is None else samples.contacts.rows(rows)
        for _ in range(_WEIGHTINGS):
            free = free_of_contacts(robot, samples.position[rows], contacts, scale)
            if np.einsum("kjj->", free) <= columns.shape[2]:
                return {}
            way = free / scale
            due = np.einsum("kij,kj->ki", way, effort)
            basis, back = orthonormal((way @ columns).reshape(due.size, -1), _RANK)
            theta = (back @ (basis.T @ due.ravel()))[: links.shape[2]]
            rates = [
                beyond(basis, np.einsum("kij,kj->ki", way, links @ theta - efforts))
                for links, efforts in slopes
            ]
            found = delay_step(beyond(basis, due), np.stack(rates, axis=2) / (2.0 * half))
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
    return dict(zip(names, map(Delay, delays.tolist(), errors.tolist()), strict=True))


# A landing is looked for this far from its flag (s), and must not be at the edge of that.
_WINDOW, _INSIDE = 0.03, 0.9
_LEAST_LANDINGS = 6
# Times the median deviation, a normal error's standard deviation; times that, a median's error.
_NORMAL, _OF_MEDIAN = 1.4826, 1.2533
# Forces as recorded must explain those from efforts to this share.
_ALIKE = 0.5


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
    contacts, steps = log.contacts, round(_WINDOW / log.step)
    if contacts is None or not on_legs(robot, log).all():
        return None
    wide = [TRANSMITS[kind] for kind in contacts.kind]
    if sum(wide) >= robot.n or not robot.prior[:, 0].sum() > 0.0:
        return None
    down, measured = contacts.down, contacts.forces is not None
    if not measured and (down is None or not len(_landings(down, steps))):
        return None
    samples = _processed(robot, log, _LANDING_HZ, contact_force_std=1.0 if measured else None)
    q, v, a = samples.position, samples.velocity, samples.acceleration
    need = robot.inverse_dynamics(robot.prior, q, v, a) - samples.effort
    scale = first_scale(robot, samples.effort, unused)
    J = contact_jacobians(robot, q, contacts.frames, contacts.offset)
    closed = _transmitted(J, contacts.kind) / scale
    normal = closed @ closed.transpose(0, 2, 1)
    # Legs that are stretched have forces that no effort shows.
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(normal.shape[1])
    solved = np.linalg.solve(normal, closed @ (need / scale)[:, :, None])
    forces = np.stack([solved[:, row : row + 3, 0] for row in np.cumsum([0, *wide[:-1]])], axis=1)
    felt = None if samples.contacts is None else samples.contacts.forces
    if felt is not None:
        recorded, forces = (each[..., :3].reshape(len(q), -1) for each in (felt, forces))
        moves = np.flatnonzero(np.ptp(recorded, axis=0) > 0.0)
        alike = [i for i in moves if np.corrcoef(recorded[:, i], forces[:, i])[0, 1] ** 2 > _ALIKE]
        return lag(recorded[:, alike], forces[:, alike], log.step, gain=True) if alike else None
    assert down is not None
    assert samples.time is not None
    first = round(float(samples.time[0] - log.time[0]) / log.step)
    late = []
    for row, foot in _landings(down[first : first + len(q)], steps).tolist():
        rise = np.gradient(forces[row : row + 2 * steps, foot, 2])
        peak = int(rise.argmax())
        if abs(peak - steps) > _INSIDE * steps or not 0 < peak < len(rise) - 1:
            continue
        before, top, after = rise[peak - 1 : peak + 2]
        curved = before - 2.0 * top + after
        shift = 0.5 * (before - after) / curved if curved < 0.0 else 0.0
        # A foot lands between the last sample without its flag and the first with it.
        late.append((steps - 0.5 - peak - shift) * log.step)
    if len(late) < _LEAST_LANDINGS:
        return None
    value = float(np.median(late))
    spread = _NORMAL * float(np.median(np.abs(np.array(late) - value)))
    return Delay(value, _OF_MEDIAN * spread / float(np.sqrt(len(late))))


def _landings(down: Mask, steps: int) -> Indices:
    """Return landings that are clear of others: rows, half a window before each, and feet."""
    if len(down) < 2 * steps:
        return np.zeros((0, 2), dtype=np.intp)
    windows = np.lib.stride_tricks.sliding_window_view(down, 2 * steps, axis=0)
    landed = np.arange(2 * steps) >= steps
    return np.argwhere((windows == landed).all(axis=2))


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
    channels = {name: [each[name] for each in found if name in each] for name in LEAST}
    return {name: Delay(*pooled(*np.transpose(own))) for name, own in channels.items() if own}


def channel_delays(
    robot: RobotModel | None, log: Recording, unused: Collection[str] = ()
) -> dict[str, Delay]:
    """Return how late each channel is against the joints' positions, by its name.

    Parameters
    ----------
    robot : RobotModel or None
        With a floating base. Without one the IMU is compared with the pose, and nothing else.
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
    piece = max(continuous(log)[0], key=lambda each: each.n_samples)
    if piece.base is None or piece.n_samples < _LEAST_SAMPLES:
        return {}
    has_imu, piece = piece.base.imu is not None, piece.rows(middle(piece.n_samples, _READ))
    found: dict[str, Delay] = {}
    more = {name: max(each, _BEYOND_STEPS * log.step) for name, each in _BEYOND.items()}

    def corrected(piece: Recording) -> Recording:
        # The next delay is then off by less than if only the significant ones were taken off.
        likely = {name: delay for name, delay in found.items() if abs(delay.value) > delay.error}
        return without_delays(piece, likely)

    if robot is None:
        turned = imu_against_pose(piece)
        return {} if turned is None else {"imu": turned.wider(more["base"])}
    try:
        by_feet = pose_against_joints(robot, piece)
        if by_feet is not None:
            found["base"] = by_feet.wider(more["feet"])
        if not has_imu:
            piece = corrected(piece)
        own = "effort" if has_imu or is_held(robot, piece) else "pose"
        for name, delay in dynamic_delays(robot, piece, unused).items():
            found[name] = delay.wider(more[own if name == "effort" else name])
        turned = imu_against_pose(piece)
        known = found.get("imu", found.get("base"))
        if turned is not None and known is not None:
            # The IMU against the joints is the IMU against the pose, and that against the joints.
            other, sign = ("base", -1.0) if "imu" in found else ("imu", 1.0)
            found[other] = Delay(known.value + sign * turned.value, turned.error).wider(known.error)
        landed = contacts_delay(robot, corrected(piece), unused)
        if landed is not None:
            found["contacts"] = landed.wider(more["contacts"])
    except SdpidError:
        # A recording that cannot be processed is refused where it is processed.
        return {}
    most = max(_UNKNOWN, _UNKNOWN_STEPS * log.step)
    return {name: each for name, each in found.items() if each.error < most}
