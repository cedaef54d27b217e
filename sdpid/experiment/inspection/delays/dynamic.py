"""Delays that the equation of motion shows: efforts, and an IMU, against the joints.

A channel that is late by d makes residuals that are, to first order, d times their derivative by
the delay. Parameters of links and friction that fit best are taken off both (variable projection),
and what is left of one is compared with what is left of the other. Contacts are taken for closed
throughout: forces that flags deny look like delays, and rows without them need no flags.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.experiment.inspection.delays.kinematic import Delay, block_error, on_legs
from sdpid.experiment.processing.choose import default_processing
from sdpid.experiment.processing.contact_samples import TRANSMITS
from sdpid.experiment.processing.filters import BAND_OVER_RATE
from sdpid.experiment.processing.on_time import on_time
from sdpid.experiment.processing.process import process
from sdpid.experiment.processing.samples import Samples
from sdpid.experiment.processing.settings import Processing
from sdpid.experiment.recording.recording import Recording, rows_of
from sdpid.robot.model.contacts.jacobians import contact_jacobians
from sdpid.robot.model.model import RobotModel

# Cut-offs (Hz). Of simulated quadrupeds efforts were found within 0.2 ms at 20 to 30 Hz with an
# IMU; at 10 Hz the signs of speeds are smeared. Accelerations from poses need 10 Hz: at 20 Hz their
# noise in the regressor made 2 ms of 0.8 to 3.4.
_CUTOFF_HZ, _POSE_CUTOFF_HZ = 30.0, 10.0
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
# Directions of the regressor with less than this share of the largest singular value are noise.
_RANK = 1e-4


def regressor(robot: RobotModel, samples: Samples, rows: Indices) -> Array:
    """Return the columns of the links at some samples, (K, n, 10·links)."""
    return robot.regressor(
        samples.position[rows], samples.velocity[rows], samples.acceleration[rows]
    )


def free_columns(robot: RobotModel, samples: Samples, rows: Indices) -> Array:
    """Return columns of links, and of friction, rotors and offsets of every joint, (K, n, p)."""
    first, n = robot.n_base, robot.n
    speed, rate = samples.velocity[rows], samples.acceleration[rows]
    signals = [speed, rate, np.ones_like(speed)]
    for width in _WIDTHS:
        signals.append(samples.through_filter(partial(_smooth_sign, width), slice(None))[rows])
    joints = np.arange(first, n)
    friction = np.zeros((len(rows), n, len(signals), n - first))
    for i, signal in enumerate(signals):
        friction[:, joints, i, joints - first] = signal[:, first:]
    return np.concatenate(
        [regressor(robot, samples, rows), friction.reshape(len(rows), n, -1)], axis=2
    )


def _smooth_sign(width: float, speed: Array, _rate: Array) -> Array:
    return np.asarray(np.tanh(speed / width))


def orthonormal(columns: Array, rank: float = _RANK) -> tuple[Array, Array]:
    """Return an orthonormal basis of columns, and the way from it to their weights.

    Directions with less than a share `rank` of the largest singular value are noise.
    """
    size = np.linalg.norm(columns, axis=0)
    inverse = np.where(size > 0.0, 1.0 / np.where(size > 0.0, size, 1.0), 0.0)
    scaled = columns * inverse
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    kept = values > rank**2 * values[-1]
    back = vectors[:, kept] / np.sqrt(values[kept])
    return np.asarray(scaled @ back), np.asarray(inverse[:, None] * back)


@dataclass(frozen=True, kw_only=True, eq=False)
class FreeRows:
    """Orthonormal combinations of scaled efforts that contacts leave free, sample by sample.

    Attributes
    ----------
    scale : (n,) ndarray
        Size of the error of each effort.
    groups : tuple of (indices, (k, r, n) ndarray)
        Samples with the same contacts closed, and the combinations of their efforts.
    """

    scale: Array
    groups: tuple[tuple[Indices, Array], ...]

    @classmethod
    def of(
        cls,
        robot: RobotModel,
        samples: Samples,
        rows: Indices,
        scale: Array,
        unknown: Mask | None = None,
    ) -> FreeRows:
        """Return the free rows of some samples.

        `unknown` (c, 6) says which forces and moments closed contacts may have that nobody knows;
        by default all that their kinds transmit.
        """
        contacts = samples.contacts
        if contacts is None:
            every = np.broadcast_to(np.diag(1.0 / scale), (len(rows), len(scale), len(scale)))
            return cls(scale=scale, groups=((np.arange(len(rows)), every),))
        J = contact_jacobians(robot, samples.position[rows], contacts.frames, contacts.offset)
        if unknown is None:
            wide = np.array([TRANSMITS[kind] for kind in contacts.kind])
            unknown = np.arange(6) < wide[:, None]
        patterns, which = np.unique(contacts.down[rows], axis=0, return_inverse=True)
        groups = []
        for number, down in enumerate(patterns):
            chosen = np.flatnonzero(which.reshape(-1) == number)
            parts = [J[chosen, i][:, own] for i, own in enumerate(unknown) if down[i] and own.any()]
            left = np.broadcast_to(np.eye(robot.n), (len(chosen), robot.n, robot.n))
            if parts:
                closed = np.concatenate(parts, axis=1) / scale
                if closed.shape[1] >= robot.n:
                    continue
                # A contact too many costs a row, and lets no force through.
                whole = np.linalg.qr(closed.transpose(0, 2, 1), mode="complete")[0]
                left = whole[:, :, closed.shape[1] :].transpose(0, 2, 1)
            groups.append((chosen, left / scale))
        return cls(scale=scale, groups=tuple(groups))

    def apply(self, values: Array) -> Array:
        """Return values (K, n, ...) of efforts in the free rows, (R, ...)."""
        width = values.shape[2:]
        if not self.groups:
            return np.zeros((0, *width))
        parts = []
        for rows, left in self.groups:
            own = left @ values[rows].reshape(len(rows), left.shape[2], -1)
            parts.append(own.reshape(-1, *width))
        return np.concatenate(parts)

    @property
    def sample(self) -> Indices:
        """The sample of each row, (R,)."""
        parts = [np.repeat(rows, left.shape[1]) for rows, left in self.groups]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=np.intp)

    def rescaled(self, left: Array) -> Array:
        """Return the scale of which residuals (R,) are most likely, a step from the present one.

        The base's three forces share one, and so do its three torques.
        """
        top, bottom, first = np.zeros(len(self.scale)), np.zeros(len(self.scale)), 0
        for _, combined in self.groups:
            k, r, _ = combined.shape
            own = left[first : first + k * r].reshape(k, r)
            first += k * r
            top += np.sum(np.einsum("krn,kr->kn", combined, own) ** 2, axis=0)
            bottom += np.sum(combined**2, axis=(0, 1))
        for part in (slice(0, 3), slice(3, 6)):
            top[part], bottom[part] = top[part].sum(), bottom[part].sum()
        seen = (top > 0.0) & (bottom > 0.0)
        share = np.where(seen, top / np.where(seen, bottom, 1.0), 1.0)
        return np.asarray(self.scale * np.sqrt(share))


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


def is_held(robot: RobotModel, log: Recording) -> bool:
    """Tell whether a base is held throughout, so that it does not matter how it moves."""
    contacts = log.contacts
    if contacts is None or contacts.down is None:
        return False
    planes = np.array([kind == "plane" for kind in contacts.kind])
    holding = planes & ~on_legs(robot, log)
    return bool(holding.any()) and bool(contacts.down[:, holding].any(axis=1).all())


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
    processing = processing_at(log, cutoff, contact_margin_s=_MARGIN)
    log = _all_closed(robot, log)
    delays, scale, errors = np.zeros(len(names)), None, np.zeros(len(names))
    for _ in range(_STEPS):
        at = dict(zip(names, delays.tolist(), strict=True))
        samples, columns, effort, rates = _linearized(robot, log, processing, at)
        if scale is None:
            scale = first_scale(robot, samples.effort, unused)
        for _ in range(_WEIGHTINGS):
            free = FreeRows.of(robot, samples, _picked(samples), scale)
            solved = _solved(free, columns, effort, rates)
            if solved is None:
                return {}
            change, errors, left = solved
            unlike = float(np.sum(left**2) / np.sum(free.apply(effort) ** 2))
            scale = free.rescaled(left)
        delays = delays + change
        if unlike > _UNLIKE:
            return {}
        if np.abs(change).max() < _NEAR:
            break
    each = zip(names, delays.tolist(), errors.tolist(), strict=True)
    return {name: Delay(value=value, error=error) for name, value, error in each}


def _all_closed(robot: RobotModel, log: Recording) -> Recording:
    """Return a recording whose contacts are closed throughout, those that ever are.

    As it is where that leaves too few rows.
    """
    contacts = log.contacts
    if contacts is None:
        return log
    down = np.array(np.broadcast_to(contacts.closed.any(axis=0), contacts.closed.shape))
    taken = sum(TRANSMITS[kind] for kind, any_ in zip(contacts.kind, down[0], strict=True) if any_)
    if robot.n - taken < _LEAST_FREE:
        return log
    return replace(log, contacts=replace(contacts, down=down))


def processing_at(log: Recording, cutoff_hz: float, **changes: Any) -> Processing:
    """Return a processing that leaves no samples out, in which delays are looked for."""
    settings: dict[str, Any] = dict.fromkeys(("decimation", "reversal_time", "impact_s"))
    settings |= {"contact_force_std": None, "contact_moment_std": None, "reasons": ()}
    settings["cutoff_hz"] = min(cutoff_hz, BAND_OVER_RATE * log.rate_hz)
    return replace(default_processing(log), **{**settings, **changes})


def _at(log: Recording, delays: Mapping[str, float], margin: float) -> Recording:
    """Return a recording without delays, and without so many seconds at its ends."""
    fields: dict[str, Any] = {f"{name}_delay_s": float(delay) for name, delay in delays.items()}
    moved = on_time(log, replace(Processing(), **fields))
    inside = (moved.time > log.time[0] + margin) & (moved.time < log.time[-1] - margin)
    return rows_of(moved, np.asarray(inside))


def _picked(samples: Samples) -> Indices:
    """Return the samples that are looked at."""
    return np.unique(np.linspace(0, samples.n_samples - 1, _ROWS).astype(np.intp))


def _linearized(
    robot: RobotModel, log: Recording, processing: Processing, delays: Mapping[str, float]
) -> tuple[Samples, Array, Array, list[tuple[Array, Array | None]]]:
    """Process a recording at some delays and on either side of each.

    Returns
    -------
    tuple
        Samples; of those that are looked at columns of links and friction (K, n, p), and efforts
        (K, n); and for each delay derivatives of the efforts and of the columns of the links, None
        where those do not depend on it.
    """
    half = max(_HALF, 0.5 * log.step)
    # All have the same rows, whatever shifting loses at their ends.
    margin = max(abs(delay) for delay in delays.values()) + half + 1.5 * log.step

    def at(**changed: float) -> Samples:
        moved = _at(log, {**delays, **changed}, margin)
        return process(moved, processing, gravity=robot.gravity.tolist())

    samples = at()
    picked, rates = _picked(samples), []
    for name, delay in delays.items():
        ends = [at(**{name: delay + side}) for side in (half, -half)]
        late, early = (end.effort[picked] for end in ends)
        of_links = None
        if name != "effort":
            behind, before = (regressor(robot, end, picked) for end in ends)
            of_links = (behind - before) / (2.0 * half)
        rates.append(((late - early) / (2.0 * half), of_links))
    return samples, free_columns(robot, samples, picked), samples.effort[picked], rates


def _solved(
    free: FreeRows, columns: Array, effort: Array, rates: list[tuple[Array, Array | None]]
) -> tuple[Array, Array, Array] | None:
    """Return changes of the delays, their errors, and residuals; None where nothing shows."""
    columns, effort = free.apply(columns), free.apply(effort)
    if len(columns) <= columns.shape[1]:
        return None
    basis, back = orthonormal(columns)
    fitted = basis.T @ effort
    theta, left = back @ fitted, effort - basis @ fitted
    slopes = []
    for effort_rate, of_links in rates:
        rate = free.apply(effort_rate)
        if of_links is not None:
            rate = rate - free.apply(of_links @ theta[: of_links.shape[2]])
        slopes.append(rate - basis @ (basis.T @ rate))
    slope = np.column_stack(slopes)
    power = slope.T @ slope
    if not np.linalg.cond(power) < 1.0 / np.finfo(float).eps:
        return None
    change = -np.linalg.solve(power, slope.T @ left)
    left = left + slope @ change
    # By time, so that neighbors, whose errors are alike, are in one block.
    order = np.lexsort((free.sample,))
    influence = np.linalg.solve(power, (slope * left[:, None]).T)[:, order]
    errors = np.array([block_error(each, 1.0) for each in influence])
    return np.asarray(change), errors, np.asarray(left)
