"""The motion of a log, low-passed: rows to compare efforts in, and legs that stand."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.errors import DataError
from sdpid.experiment.processing.base import angle_noise, body_rate, into_body, unit
from sdpid.experiment.processing.filters import BAND_OVER_RATE, low_pass, stencil
from sdpid.experiment.processing.motion import motion_frequency, white_noise
from sdpid.experiment.processing.pipeline import near
from sdpid.experiment.recording.floating import BaseMotion, Contacts
from sdpid.experiment.recording.gaps import Grid, make_grid
from sdpid.experiment.recording.plausible import moving
from sdpid.experiment.recording.recording import Recording
from sdpid.robot.model.jacobians import contact_jacobians
from sdpid.robot.model.model import RobotModel

# Rows that are compared: 300 tell every kind of wrong log that 600 do, on 17 real recordings.
_ROWS = 300
# Samples that are read, from the middle of longer recordings.
_READ = 1 << 19
# The low-pass filter lets pass this many times the frequency of the motion, and at least 1 Hz.
_PASS, _LEAST_PASS = 10.0, 1.0
# Samples for each period of the cut-off.
_SAMPLES = 16.0
# Standard deviation of a Gaussian in time, times the frequency at which it loses 3 dB.
_GAUSSIAN = 0.1325
# The Gaussian is cut off, and ends of a piece are left out, at this many standard deviations.
_REACH = 4.0
# Width of the smooth sign of the velocity, rad/s.
_WIDTH = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class FilteredRows:
    """Signals of a recording at some times, all passed through one filter.

    Attributes
    ----------
    position, velocity, acceleration : ndarray, shape (K, n)
    sign : ndarray, shape (K, n)
        Smooth sign of the velocity, filtered like the effort.
    effort, effort_rate : ndarray, shape (K, n)
        The effort and its derivative.
    recorded_velocity, recorded_reference : ndarray, shape (K, n), or None
        Those that were recorded, where there are any.
    usable : ndarray of bool, shape (n,)
        Which joints move on their own and have an effort.
    step : float
        Sampling step of the recording, s.
    """

    position: Array
    velocity: Array
    acceleration: Array
    sign: Array
    effort: Array
    effort_rate: Array
    usable: Mask
    step: float
    recorded_velocity: Array | None = None
    recorded_reference: Array | None = None

    @cached_property
    def velocity_fits(self) -> list[dict[str, float]]:
        """How each joint's recorded velocity follows the rate of its position; [] without one."""
        if self.recorded_velocity is None:
            return []
        signals = (self.recorded_velocity.T, self.velocity.T, self.acceleration.T)
        return list(map(follows, *signals))


def friction(rows: FilteredRows, j: int) -> tuple[Array, Array, Array]:
    """Return the columns of Coulomb and viscous friction and of a rotor's inertia of a joint."""
    return rows.sign[:, j], rows.velocity[:, j], rows.acceleration[:, j]


def smooth_sign(velocity: Array) -> Array:
    """Return the smooth sign of a velocity, as dry friction has it."""
    return np.asarray(np.tanh(velocity / _WIDTH))


def low_passed(pieces: Sequence[Recording], without: Collection[str] = ()) -> FilteredRows | None:
    """Return rows of the pieces of a recording; None where none is long enough or nothing moves.

    Parameters
    ----------
    pieces : sequence of Recording
        Of one recording, without gaps and wrapped angles.
    without : collection of str
        Joints whose effort says nothing.
    """
    longest = max(pieces, key=lambda piece: piece.n_samples)
    try:
        grids = [make_grid(piece) for piece in pieces]
        cutoff = max(_PASS * motion_frequency(longest), _LEAST_PASS)
    except DataError:
        return None
    filtered = [_filtered(piece, grid, cutoff) for piece, grid in zip(pieces, grids, strict=True)]
    parts = [part for part in filtered if part]
    if not parts:
        return None
    stride = -(-sum(len(part["effort"]) for part in parts) // _ROWS)
    signals = {name: np.concatenate([part[name][::stride] for part in parts]) for name in parts[0]}
    low = np.min([piece.position.min(axis=0) for piece in pieces], axis=0)
    high = np.max([piece.position.max(axis=0) for piece in pieces], axis=0)
    known = np.array([name not in without for name in longest.names])
    usable = moving(low, high) & known & (np.ptp(signals["effort"], axis=0) > 0.0)
    return FilteredRows(**signals, usable=usable, step=longest.step)


def _filtered(log: Recording, grid: Grid, cutoff: float) -> dict[str, Array]:
    """Return signals of `FilteredRows` of a piece, (samples, n) each; none if it is too short."""
    from scipy.ndimage import gaussian_filter1d

    # Means of so many samples each, of the middle of a long piece.
    count = max(1, int(1.0 / (grid.step * _SAMPLES * cutoff)))
    length = min(grid.count, _READ) // count * count
    begin, step = (grid.count - length) // 2, count * grid.step
    width = max(_GAUSSIAN / (cutoff * step), 1.0)
    edge = int(_REACH * width) + 1
    if length // count < 3 * edge:
        return {}

    def averaged(table: Array) -> Array:
        columns = [grid.read(table[:, j], begin, begin + length) for j in range(log.n)]
        return np.asarray(np.stack(columns, axis=1).reshape(-1, count, log.n).mean(axis=1))

    def smooth(values: Array, order: int, share: float = 1.0) -> Array:
        passed = gaussian_filter1d(values, max(share * width, 1.0), 0, order, truncate=_REACH)
        return np.asarray(passed / step**order)

    position, effort = averaged(log.position), averaged(log.effort)
    # The sign changes fast: it is taken of a velocity that is filtered less, and then filtered.
    signals = {
        "position": smooth(position, 0),
        "velocity": smooth(position, 1),
        "acceleration": smooth(position, 2),
        "sign": smooth(smooth_sign(smooth(position, 1, 0.25)), 0),
        "effort": smooth(effort, 0),
        "effort_rate": smooth(effort, 1),
    }
    for name in ("velocity", "reference"):
        if (recorded := getattr(log, name)) is not None:
            signals[f"recorded_{name}"] = smooth(averaged(recorded), 0)
    return {name: each[edge:-edge] for name, each in signals.items()}


def follows(signal: Array, value: Array, rate: Array, *others: Array) -> dict[str, float]:
    """Fit a signal as scale × a value some time later, plus an offset; others are accounted for."""
    mean = float(value.mean())
    columns = np.column_stack([value - mean, rate, *others, np.ones_like(rate)])
    weights = np.linalg.lstsq(columns, signal)[0]
    scale, slope, level = weights[[0, 1, -1]].tolist()
    a, b = (each - each.mean() for each in (columns @ weights, signal))
    size = float(np.sqrt((a @ a) * (b @ b)))
    return {
        "scale": scale,
        "offset": level - mean,
        "lag": slope / scale if scale != 0.0 else 0.0,
        "correlation": float(a @ b) / size if size > 0.0 else 0.0,
    }


# A filter for signals (N, ...), and samples.
Smoother: TypeAlias = tuple[Callable[[Array], Array], slice]

# Weights of derivatives of what has passed a filter.
SLOPES = stencil("central4")
# Cut-off (Hz) of the motion of feet that stand for some 0.2 s, and least number of memories of the
# filter.
_STANCE_HZ, MEMORIES = 20.0, 8.0
# Feet that have just landed, or are about to lift, roll and slip (s).
_AT_REST = 0.05
# Samples at which feet are looked at.
_STANCE_ROWS = 1500


def smoother(log: Recording, cutoff_hz: float, least: float) -> Smoother | None:
    """Return a low-pass filter for a recording without gaps, and what its ends do not reach.

    None of a recording that is shorter than `least` times the memory of the filter. Ends reach two
    memories far.
    """
    found = low_pass("finite", min(cutoff_hz, BAND_OVER_RATE / log.step), 2, 1.0 / log.step)
    if log.n_samples < least * found.reach:
        return None
    return found.whole, slice(2 * found.reach, log.n_samples - 2 * found.reach)


def turning(base: BaseMotion, step: float) -> Array:
    """Return the angular velocity of a base by its orientation, in its axes, (N, 3)."""
    return body_rate(base.orientation, SLOPES.first, step)


@dataclass(frozen=True, kw_only=True, eq=False)
class Standing:
    """A robot on legs at some samples, its motion filtered.

    Attributes
    ----------
    robot : RobotModel
    contacts : Contacts
        c in all.
    rows : ndarray of int, shape (K,)
    position : ndarray, shape (K, nq)
    base : ndarray, shape (N, 6)
        Velocity of the base at all samples, in its axes.
    speeds : ndarray, shape (K, joints)
    stands : ndarray of bool, shape (K, c)
        Feet that are down as far as the filter sees, and settled; never what holds a base.
    step : float
        Of the recording, s.
    noise : float
        What noise of pose and joints makes of the speed of a foot that stands, along an axis, m/s
        rms.
    """

    robot: RobotModel
    contacts: Contacts
    rows: Indices
    position: Array
    base: Array
    speeds: Array
    stands: Mask
    step: float
    noise: float

    @classmethod
    def of(cls, robot: RobotModel, log: Recording) -> Standing | None:
        """Return the motion of a recording without gaps; None without pose, flags, or time."""
        base, contacts, step = log.base, log.contacts, log.step
        if base is None or base.position is None or contacts is None or contacts.down is None:
            return None
        smooth = smoother(log, _STANCE_HZ, MEMORIES)
        if smooth is None:
            return None
        (low, inner), joints = smooth, np.asarray(log.position)
        reach = inner.start // 2
        moving = into_body(base.orientation, np.gradient(base.position, step, axis=0))
        rows = np.unique(np.linspace(inner.start, inner.stop - 1, _STANCE_ROWS).astype(np.intp))
        stands = ~near(~contacts.down, reach + round(_AT_REST / step))[rows]
        impulse = np.eye(8 * reach + 1)[:, [4 * reach]]
        gain = np.linalg.norm(low(np.gradient(impulse, step, axis=0)))
        angles = np.hypot(angle_noise(base.orientation), white_noise(joints))
        pose = [low(base.position), unit(low(base.orientation)), low(joints)]
        return cls(
            robot=robot,
            contacts=contacts,
            rows=rows,
            position=np.hstack(pose)[rows],
            base=low(np.hstack([moving, turning(base, step)])),
            speeds=low(np.gradient(joints, step, axis=0))[rows],
            # What holds a base stands still, whatever joints do.
            stands=stands & on_legs(robot, log),
            step=step,
            noise=float(gain * np.hypot(white_noise(base.position), robot.reach * angles)),
        )


def on_legs(robot: RobotModel, log: Recording) -> Mask:
    """Return which contacts joints move, (c,)."""
    contacts = log.contacts
    assert contacts is not None
    middle = robot.at_rest(log.position[[log.n_samples // 2]])
    J = contact_jacobians(robot, middle, contacts.frames, contacts.offset)
    return np.asarray(J[0, :, :, robot.n_base :].any(axis=(1, 2)))
