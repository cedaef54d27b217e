"""Periodic joint motion as a Fourier series."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, frozen, frozen_view, real_array
from sdpid.errors import DataError
from sdpid.experiment.trajectory.curve import ROUNDING, cells_within

# Cells are enclosed in parts over which the fastest sinusoid turns by this (rad) at most. Its
# bound is then 1e-3 of its amplitude too wide; others' are closer.
_TURN = 0.1

# No joint moves as far (rad, or m).
_LARGEST = 1e9


@dataclass(frozen=True, kw_only=True, eq=False)
class FourierSeries:
    """``q_j(t) = center_j + Σ_h amplitudes_jh · sin(2π·harmonics_jh·t/period + phases_jh)``.

    Joints with fewer sinusoids than others are padded with harmonic 0 and amplitude 0.

    Attributes
    ----------
    period : float
        Period in s.
    center : ndarray, shape (n,)
        Mean positions in rad.
    harmonics : ndarray of int, shape (n, H)
        Multiples of the fundamental frequency 1/period.
    amplitudes : ndarray, shape (n, H)
        Amplitudes in rad.
    phases : ndarray, shape (n, H)
        Phases in rad.

    Raises
    ------
    DataError
        When shapes differ, a value is not finite, a harmonic is negative or no whole number, or
        a harmonic 0 has an amplitude.
    """

    period: float
    center: Array
    harmonics: Any
    amplitudes: Array
    phases: Array

    def __post_init__(self) -> None:
        if not (np.isfinite(self.period) and self.period > 0.0):
            raise DataError(f"Fourier series: period is {self.period}; give a positive time in s.")
        axes = {"center": 1, "harmonics": 2, "amplitudes": 2, "phases": 2}
        given = {name: real_array(getattr(self, name), name, ndim=d) for name, d in axes.items()}
        shapes = [given[name].shape for name in axes]
        if len({(*shapes[0], *shapes[1][1:]), *shapes[1:]}) > 1:
            listed = ", ".join(f"{name} {array.shape}" for name, array in given.items())
            raise DataError(
                f"Fourier series: {listed} do not fit; give (n,) and three times (n, H)."
            )
        if any((np.abs(given[name]) > _LARGEST).any() for name in ("center", "amplitudes")):
            raise DataError(
                f"Fourier series: center and amplitudes pass {_LARGEST:g} rad, which no joint does."
            )
        harmonics = given["harmonics"]
        # A double beyond that is whole, and no harmonic of anything.
        if np.any((np.rint(harmonics) != harmonics) | (harmonics < 0) | (harmonics > 2**53)):
            raise DataError("Fourier series: harmonics must be whole numbers of at least 0.")
        if np.any((harmonics == 0) & (given["amplitudes"] != 0.0)):
            raise DataError(
                "Fourier series: harmonic 0 with an amplitude; put a constant into the center."
            )
        object.__setattr__(self, "period", float(self.period))
        for name, array in given.items():
            object.__setattr__(self, name, frozen(array))
        object.__setattr__(self, "harmonics", frozen_view(harmonics.astype(np.int64)))

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.center)

    @property
    def duration(self) -> float:
        """Duration of the curve in s: one period."""
        return self.period

    @property
    def breaks(self) -> Array:
        """The ends of the period: all derivatives are smooth between them."""
        return np.array([0.0, self.period])

    def evaluate(self, time: Any, *, derivative: int = 0) -> Array:
        """Return a derivative of the positions at any times, (K,) to (K, n)."""
        time = np.asarray(time, dtype=np.float64)
        rate = 2.0 * np.pi * self.harmonics / self.period
        out = np.zeros((len(time), self.n))
        # sin differentiates into itself a quarter turn further on.
        quarter = 0.5 * np.pi * derivative
        for h in range(self.harmonics.shape[1]):
            angle = time[:, None] * rate[:, h] + self.phases[:, h] + quarter
            out += self.amplitudes[:, h] * rate[:, h] ** derivative * np.sin(angle)
        return out + self.center if derivative == 0 else out

    def enclose(self, edges: Any, *, derivative: int = 0) -> tuple[Array, Array]:
        """Return bounds of a derivative that hold at every instant of each cell.

        Between two instants a function f leaves its chord by at most h²/8 times the largest
        ``|f''|``, h apart. That is bounded by Taylor's theorem about the middle.

        Parameters
        ----------
        edges : array_like, shape (C + 1,)
            Increasing times within one period.
        derivative : int, optional
            0 for positions, 1 for velocities and so on.

        Returns
        -------
        lower, upper : ndarray, shape (C, n)

        Raises
        ------
        DataError
            When the edges do not increase or leave the period.
        """
        edges = cells_within(edges, self.period)
        rate = 2.0 * np.pi * self.harmonics / self.period
        turns = np.ceil(np.diff(edges) * rate.max(initial=0.0) / _TURN)
        parts = np.maximum(turns, 1.0).astype(np.intp)
        first = np.cumsum(parts) - parts
        own = np.repeat(np.arange(len(parts)), parts)
        within = (np.arange(len(own)) - first[own]) / parts[own]
        points = np.append(edges[own] + within * np.diff(edges)[own], edges[-1])
        step = np.diff(points)[:, None]
        middle = points[:-1] + 0.5 * step[:, 0]

        def total(order: int) -> Array:
            return np.asarray((np.abs(self.amplitudes) * rate**order).sum(axis=1))

        values = self.evaluate(points, derivative=derivative)
        bend = self.evaluate(middle, derivative=derivative + 2)
        change = np.abs(self.evaluate(middle, derivative=derivative + 3))
        change = 0.5 * step * change + 0.125 * step**2 * total(derivative + 4)
        above = 0.125 * step**2 * np.maximum(change - bend, 0.0)
        below = 0.125 * step**2 * np.maximum(change + bend, 0.0)
        center = self.center if derivative == 0 else np.zeros(self.n)
        lower = np.maximum(np.minimum(values[:-1], values[1:]) - below, center - total(derivative))
        upper = np.minimum(np.maximum(values[:-1], values[1:]) + above, center + total(derivative))
        # A sine is as wrong as its angle, which grows to that at the end of the period.
        angle = 1.0 + rate.max(initial=0.0) * self.period + np.abs(self.phases).max(initial=0.0)
        rounding = ROUNDING * (np.abs(center) + angle * total(derivative))
        return (
            np.minimum.reduceat(lower - rounding, first, axis=0),
            np.maximum.reduceat(upper + rounding, first, axis=0),
        )

    def one_period(self, samples: int, *, derivative: int = 0) -> Array:
        """Return a derivative at equally spaced samples of one period, shape (samples, n).

        By an inverse FFT, which costs far less than the sum of sinusoids.

        Raises
        ------
        DataError
            When the samples are too few for the highest harmonic.
        """
        highest = int(self.harmonics.max(initial=0))
        if 2 * highest >= samples:
            raise DataError(
                f"Fourier series: {samples} samples a period are too few for harmonic {highest}; "
                f"at least {2 * highest + 1} are needed."
            )
        rate = 2.0 * np.pi * self.harmonics / self.period
        quarter = 0.5 * np.pi * (derivative - 1)
        lines = 0.5 * samples * self.amplitudes * rate**derivative
        spectrum = np.zeros((self.n, samples // 2 + 1), dtype=np.complex128)
        joints = np.arange(self.n)[:, None]
        np.add.at(spectrum, (joints, self.harmonics), lines * np.exp(1j * (self.phases + quarter)))
        values = np.fft.irfft(spectrum, n=samples, axis=1)
        if derivative == 0:
            values += self.center[:, None]
        return np.ascontiguousarray(values.T)

    def delayed(self, shift: Array) -> FourierSeries:
        """Return the series that starts `shift_j` seconds (n,) into joint j's period."""
        turn = 2.0 * np.pi * self.harmonics * np.asarray(shift)[:, None] / self.period
        return replace(self, phases=np.mod(self.phases + turn, 2.0 * np.pi))
