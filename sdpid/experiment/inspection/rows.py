"""Low-pass a recording to a few rows in which efforts can be compared with dynamics."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.errors import DataError
from sdpid.experiment.processing.filters import correlated
from sdpid.experiment.processing.motion import motion_frequency
from sdpid.experiment.recording.gaps import Grid, make_grid
from sdpid.experiment.recording.plausible import moving
from sdpid.experiment.recording.recording import Recording

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
    recorded_velocity : ndarray, shape (K, n), or None
        The recorded velocity, where there is one.
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
    low = np.min([piece.position.min(axis=0) for piece in pieces], axis=0)
    high = np.max([piece.position.max(axis=0) for piece in pieces], axis=0)
    moves = moving(low, high)
    filtered = [_filtered(piece, grid, cutoff) for piece, grid in zip(pieces, grids, strict=True)]
    parts = [part for part in filtered if part]
    if not parts:
        return None
    stride = -(-sum(len(part["effort"]) for part in parts) // _ROWS)
    signals = {name: np.concatenate([part[name][::stride] for part in parts]) for name in parts[0]}
    known = np.array([name not in without for name in longest.names])
    usable = moves & known & (np.ptp(signals["effort"], axis=0) > 0.0)
    return FilteredRows(**signals, usable=usable, step=longest.step)


def _filtered(log: Recording, grid: Grid, cutoff: float) -> dict[str, Array]:
    """Return signals of `FilteredRows` of a piece, (samples, n) each; none if it is too short."""
    count = max(1, int(1.0 / (grid.step * _SAMPLES * cutoff)))
    step = count * grid.step
    width = max(_GAUSSIAN / (cutoff * step), 1.0)
    edge = int(_REACH * width) + 1
    if min(grid.count, _READ) // count < 3 * edge:
        return {}

    def channels(table: Array) -> Array:
        return np.column_stack([_averaged(table[:, j], grid, count) for j in range(log.n)])

    def smooth(values: Array, order: int, share: float = 1.0) -> Array:
        return correlated(values, _gaussian(max(share * width, 1.0), order)) / step**order

    position, effort = channels(log.position), channels(log.effort)
    # The sign changes fast: it is taken of a velocity that is filtered less, and then filtered.
    signals = {
        "position": smooth(position, 0),
        "velocity": smooth(position, 1),
        "acceleration": smooth(position, 2),
        "sign": smooth(smooth_sign(smooth(position, 1, 0.25)), 0),
        "effort": smooth(effort, 0),
        "effort_rate": smooth(effort, 1),
    }
    if log.velocity is not None:
        signals["recorded_velocity"] = smooth(channels(log.velocity), 0)
    return {name: each[edge:-edge] for name, each in signals.items()}


def _gaussian(width: float, order: int) -> Array:
    """Return weights of a sample's neighbors for its mean, or a derivative, under a Gaussian."""
    reach = int(_REACH * width + 0.5)
    place = np.arange(-reach, reach + 1) / width
    window = np.exp(-0.5 * place**2)
    shape = (np.ones_like(place), place / width, (place**2 - 1.0) / width**2)[order]
    return np.asarray(shape * window / window.sum())


def _averaged(column: Array, grid: Grid, count: int) -> Array:
    """Return means of `count` successive grid points each, of the middle of one channel."""
    length = min(grid.count, _READ) // count * count
    begin = (grid.count - length) // 2
    values = grid.read(column, begin, begin + length)
    return np.asarray(values.reshape(-1, count).mean(axis=1))
