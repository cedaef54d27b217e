"""`SampledCurve`: a joint motion through the samples of any tool."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, frozen, real_array, shaped
from sdpid.errors import DataError
from sdpid.experiment.trajectory.curve import ROUNDING, Pieces


@dataclass(frozen=True, kw_only=True, eq=False)
class SampledCurve(Pieces):
    """A piecewise polynomial through samples of a motion.

    With velocities and accelerations the pieces are of fifth degree and meet both; with velocities
    only they are cubic and meet those; positions alone are joined by the cubic spline whose
    accelerations are continuous.

    Attributes
    ----------
    time : ndarray, shape (K,)
        Increasing times in s; the curve starts at the first, which need not be zero.
    position : ndarray, shape (K, n)
        Positions in rad (m for prismatic joints).
    velocity, acceleration : ndarray, shape (K, n), optional
        In rad/s and rad/s² (m/s, m/s²).

    Raises
    ------
    DataError
        When shapes differ, there are fewer than two samples, a value is not finite, time does not
        increase, or there are accelerations without velocities.
    """

    time: Array
    position: Array
    velocity: Array | None = None
    acceleration: Array | None = None

    def __post_init__(self) -> None:
        time = real_array(self.time, "time", ndim=1)
        if len(time) < 2:
            raise DataError(f"sampled motion: {len(time)} samples; at least two are needed.")
        short = np.flatnonzero(np.diff(time) <= 0.0)
        if short.size:
            k = int(short[0])
            raise DataError(
                f"sampled motion: time does not increase at sample {k + 1}: {time[k + 1]} s after "
                f"{time[k]} s."
            )
        object.__setattr__(self, "time", frozen(time))
        n = real_array(self.position, "position", ndim=2).shape[1]
        for name in ("position", "velocity", "acceleration"):
            if (values := getattr(self, name)) is not None:
                what = ": one row a sample, one column a joint"
                values = shaped(values, f"sampled motion: {name}", (len(time), n), what)
                object.__setattr__(self, name, values)
        if self.acceleration is not None and self.velocity is None:
            raise DataError("sampled motion: accelerations without velocities; give both.")

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.position.shape[1])

    @property
    def duration(self) -> float:  # type: ignore[override]
        """Duration in s."""
        return float(self.time[-1] - self.time[0])

    @cached_property
    def breaks(self) -> Array:
        """Times of the samples from the first on, (K,), in s."""
        return frozen(self.time - self.time[0])

    @property
    def smooth(self) -> int:
        """The highest derivative that is continuous: 1 where only velocities are given, else 2."""
        return 1 if self.velocity is not None and self.acceleration is None else 2

    @cached_property
    def _offsets(self) -> Array:
        """Bernstein coefficients of each piece, less its first position, (q + 1, K - 1, n)."""
        h, moved = np.diff(self.breaks)[:, None], np.diff(self.position, axis=0)
        velocity = self.velocity
        if velocity is None:
            from scipy.interpolate import CubicSpline

            velocity = CubicSpline(self.breaks, self.position)(self.breaks, 1)
        inner = [velocity[:-1] * h / 3.0, moved - velocity[1:] * h / 3.0]
        if self.acceleration is not None:
            leave, arrive = velocity[:-1] * h / 5.0, velocity[1:] * h / 5.0
            first, last = (a * h**2 / 20.0 for a in (self.acceleration[:-1], self.acceleration[1:]))
            inner = [leave, 2.0 * leave + first, moved - 2.0 * arrive + last, moved - arrive]
        return np.stack([np.zeros_like(moved), *inner, moved])

    @property
    def control_points(self) -> Array:
        """Bernstein coefficients of each piece, (q + 1, K - 1, n), in rad."""
        return np.asarray(self._offsets + self.position[:-1])

    def _polynomials(self, derivative: int, piece: Any) -> tuple[Array, Array, Array]:
        """Return control points (q+1, S, n), knots (2q, S) and rounding (S, n) of S pieces."""
        from scipy.interpolate import BPoly

        h, degree = np.diff(self.breaks)[piece, None], len(self._offsets) - 1
        if derivative == 0:
            points = self._offsets[:, piece] + self.position[piece]
            scale = np.abs(points).max(axis=0)
        else:
            points = BPoly(self._offsets, self.breaks).derivative(derivative).c[:, piece]
            scale = np.abs(self._offsets[:, piece]).max(axis=0)
        for order in range(derivative):
            scale = scale * 2.0 * max(degree - order, 0) / h
        ends = self.breaks[np.stack([piece, piece + 1])]
        return points, np.repeat(ends, len(points) - 1, axis=0), ROUNDING * scale
