"""Low-pass a recording to a few rows in which efforts can be compared with dynamics."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.errors import DataError
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
