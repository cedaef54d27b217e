"""Signals of a controller, from a log: errors, rates and efforts, filtered alike."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.processing.filters import low_pass, stencil
from sdpid.experiment.processing.motion import motion_frequency, white_noise
from sdpid.experiment.recording.gaps import continuous
from sdpid.experiment.recording.recording import Recording, channels
from sdpid.experiment.recording.uniform_grid import make_grid

# The law is linear, so every signal may pass one filter; it lets pass what moves the robot, and
# its friction, and not the noise of encoders. In Hz, and as a part of the sample rate at most.
_PASS, _LEAST_PASS, _LARGEST_PART = 10.0, 2.0, 0.1
_ORDER = 2
# Ends are left out where the filter's guess of what came before still shows to 1e-4.
_FORGOTTEN = 9.0
# Rows for each period of the cut-off.
_ROWS = 4.0
_LEAST_ROWS = 200


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracking:
    """Signals of a controller at K times, all passed through one filter.

    Attributes
    ----------
    position, velocity : ndarray, shape (K, n)
    reference, reference_velocity, reference_acceleration : ndarray, shape (K, n)
    integral : ndarray, shape (K, n)
        Integral of the position error from the first sample of each piece on.
    effort, effort_rate : ndarray, shape (K, n)
    piece : ndarray of int, shape (K,)
        Which piece between gaps a row is of.
    position_noise, velocity_noise : ndarray, shape (n,)
        Variances that white noise of the positions leaves in position and velocity.
    cutoff_hz : float
        Of the filter.
    step : float
        Sampling step of the recording, s.
    """

    position: Array
    velocity: Array
    reference: Array
    reference_velocity: Array
    reference_acceleration: Array
    integral: Array
    effort: Array
    effort_rate: Array
    piece: Array
    position_noise: Array
    velocity_noise: Array
    cutoff_hz: float
    step: float


def tracking(log: Recording, cutoff_hz: float | None = None) -> Tracking:
    """Return the signals of a controller.

    Raises
    ------
    DataError
        When nothing moves, or no piece is long enough.
    """
    pieces, _ = continuous(log)
    if cutoff_hz is None:
        motion = motion_frequency(max(pieces, key=lambda piece: piece.n_samples))
        cutoff_hz = min(max(_PASS * motion, _LEAST_PASS), _LARGEST_PART * log.rate_hz)
    elif not 0.0 < cutoff_hz <= _LARGEST_PART * log.rate_hz:
        raise DataError(
            f"cutoff_hz: is {cutoff_hz:g}, expected at most {_LARGEST_PART * log.rate_hz:.4g} Hz, "
            f"{_LARGEST_PART:g} of the sample rate."
        )
    found = [rows for piece in pieces if (rows := _filtered(piece, cutoff_hz)) is not None]
    count = sum(len(rows["position"]) for rows in found)
    if count < _LEAST_ROWS:
        raise DataError(
            f"fit_controller: {count} rows are left at a cut-off of {cutoff_hz:.3g} Hz, at least "
            f"{_LEAST_ROWS} are needed; give a longer recording."
        )
    signals = {name: np.concatenate([rows[name] for rows in found]) for name in found[0]}
    part = np.concatenate([np.full(len(rows["position"]), k) for k, rows in enumerate(found)])
    longest = max(pieces, key=lambda piece: piece.n_samples)
    variance = np.array([white_noise(longest.position[:, j]) ** 2 for j in range(log.n)])
    shares = _passed(cutoff_hz, log.rate_hz)
    return Tracking(
        **signals,
        piece=part,
        position_noise=variance * shares[0],
        velocity_noise=variance * shares[1],
        cutoff_hz=cutoff_hz,
        step=log.step,
    )


def _passed(cutoff_hz: float, rate_hz: float) -> tuple[float, float]:
    """Return the variances of filtered white noise of variance 1, and of its rate."""
    f = np.linspace(0.0, rate_hz / 2.0, 20_001)
    power = low_pass("butterworth", cutoff_hz, _ORDER, rate_hz).gain(f, rate_hz) ** 2
    return float(np.mean(power)), float(np.mean(power * (2.0 * np.pi * f) ** 2))


def _filtered(log: Recording, cutoff_hz: float) -> dict[str, Array] | None:
    """Return the signals of a piece without gaps; None if it is too short."""
    grid = make_grid(log)
    rate = 1.0 / grid.step
    low = low_pass("butterworth", cutoff_hz, _ORDER, rate)
    edge = int(_FORGOTTEN * low.time_constant) + 3
    stride = max(1, int(rate / (_ROWS * cutoff_hz)))
    if grid.count < 3 * edge:
        return None
    tables = {
        name: np.column_stack([grid.read(table[:, j], 0, grid.count) for j in range(log.n)])
        for name, table in channels(log).items()
        if name != "velocity"
    }
    scheme = stencil("central4")
    smooth = {name: low.apply(table) for name, table in tables.items()}

    def rows(signal: Array) -> Array:
        """Return every so many rows, without the ends."""
        margin = edge - (grid.count - len(signal)) // 2
        return np.ascontiguousarray(signal[margin : len(signal) - margin : stride])

    def each(function: Callable[[Array, float], Array], signal: Array) -> Array:
        return rows(np.column_stack([function(column, grid.step) for column in signal.T]))

    def rate_of(signal: Array) -> Array:
        return each(scheme.velocity, signal)

    off = smooth["reference"] - smooth["position"]
    sums = np.cumsum(off, axis=0) * grid.step - off * (grid.step / 2.0)
    return {
        "position": rows(smooth["position"]),
        "velocity": rate_of(smooth["position"]),
        "reference": rows(smooth["reference"]),
        "reference_velocity": rate_of(smooth["reference"]),
        "reference_acceleration": each(scheme.acceleration, smooth["reference"]),
        "integral": rows(sums),
        "effort": rows(smooth["effort"]),
        "effort_rate": rate_of(smooth["effort"]),
    }
