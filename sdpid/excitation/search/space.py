"""Motions that a search chooses among: positions that are linear in free numbers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.trajectory.curve import Curve, Spline
from sdpid.experiment.trajectory.fourier import FourierSeries

# Intervals of a spline a second, and at least as many: with 36 intervals in 20 s the condition
# number of a UR10e is within a tenth of what any number reaches, and more only take longer.
INTERVALS_HZ, FEWEST_INTERVALS = 1.8, 12
# Samples a second at which a motion's information is summed, and at least as many.
SAMPLES_HZ, FEWEST_SAMPLES = 5.0, 40
# Knots are halved once for the bounds: that loses 0.2 % of a limit.
_HALVINGS = 1
# Samples a period and harmonic at which a Fourier series is bounded: it exceeds the largest of
# them by at most 1 / cos(pi·harmonics/samples), two percent.
_SAMPLES_OF_HARMONIC = 16
# Intervals for which a posture is held, and for which the arm moves to the next one: six equal
# control points hold a spline of fifth degree for an interval.
_HELD, _MOVED = 1, 3


@dataclass(frozen=True, kw_only=True, eq=False)
class Space(ABC):
    """Motions of n joints with m coefficients each, of which f are free.

    Attributes
    ----------
    n : int
        Number of joints.
    duration : float
        Duration in s.
    expansions : tuple of ndarray, each of shape (m, f_j)
        The coefficients of each joint from its free numbers.
    sizes : ndarray, shape (n,), or float
        What a free number of each joint stands for, rad (m): searches that step in rad and in m
        alike hardly move a gripper whose fingers have a centimeter.
    """

    n: int
    duration: float
    expansions: tuple[Array, ...]
    sizes: Array | float = 1.0

    def sized(self, sizes: Array) -> Space:
        """Return the same motions as functions of numbers of other sizes (n,)."""
        steps = sizes / self.sizes
        expansions = tuple(E * step for E, step in zip(self.expansions, steps, strict=True))
        return replace(self, expansions=expansions, sizes=sizes)

    @abstractmethod
    def basis(self, time: Array, derivative: int) -> Array:
        """Return the matrix (K, m) from a joint's coefficients to a derivative of its position."""

    @abstractmethod
    def bounds(self, derivative: int) -> tuple[Array, float]:
        """Return rows (R, m) and a share that bound a derivative at every instant.

        It is within ``middle +- half`` where all rows are within ``middle +- share·half``.
        """

    @abstractmethod
    def curve(self, x: Array) -> Curve:
        """Return the motion of free numbers x (N,)."""

    @cached_property
    def splits(self) -> Any:
        """Where each joint's free numbers begin and end in x, shape (n + 1,)."""
        return np.cumsum([0, *(E.shape[1] for E in self.expansions)])

    @property
    def size(self) -> int:
        """Number N of free numbers of all joints."""
        return int(self.splits[-1])

    def coefficients(self, x: Array) -> Array:
        """Return the coefficients (m, n) of all joints from free numbers (N,)."""
        own = np.split(x, self.splits[1:-1])
        return np.stack([E @ xj for E, xj in zip(self.expansions, own, strict=True)], axis=1)

    def pulled(self, by_coefficients: Array) -> Array:
        """Return a derivative by the free numbers (N,) from that by the coefficients (m, n)."""
        return np.concatenate(
            [E.T @ column for E, column in zip(self.expansions, by_coefficients.T, strict=True)]
        )

    def refined(self, x: Array) -> tuple[Space, Array] | None:
        """Return a space that holds these motions and finer ones, and x in it; None for none."""
        return None

    def grid(self, rate: float = SAMPLES_HZ, fewest: int = FEWEST_SAMPLES) -> Array:
        """Return the middles of equal parts of the duration, (K,) in s."""
        count = max(fewest, round(rate * self.duration))
        return np.asarray((np.arange(count) + 0.5) * (self.duration / count), dtype=np.float64)

    @cached_property
    def first(self) -> Array:
        """What each coefficient adds to the position at which the motion begins, (m,)."""
        return np.asarray(self.basis(np.zeros(1), 0)[0])

    def standing(self, position: Array) -> Array:
        """Return the free numbers (N,) at which the arm stands still at a position (n,)."""
        return np.concatenate(
            [
                np.linalg.lstsq(E, self._constant(self.first) * value, rcond=None)[0]
                for E, value in zip(self.expansions, position, strict=True)
            ]
        )

    @abstractmethod
    def _constant(self, first: Array) -> Array:
        """Return the coefficients (m,) of a joint that stands at 1."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SplineSpace(Space):
    """Splines of fifth degree that start and end at rest.

    Attributes
    ----------
    closed : bool or None
        Whether they end where they began; None for splines with less freedom than that.
    """

    closed: bool | None = None

    @classmethod
    def of(
        cls, n: int, duration: float, *, closed: bool = True, intervals: int | None = None
    ) -> SplineSpace:
        """Build for n joints; closed motions end where they began."""
        count = intervals or max(FEWEST_INTERVALS, round(INTERVALS_HZ * duration))
        E = Spline.expansion(count + 5, closed=closed).toarray()
        return cls(n=n, duration=duration, expansions=(E,) * n, closed=closed)

    def refined(self, x: Array) -> tuple[Space, Array] | None:
        """Return the splines with twice the intervals, and the same motion among them."""
        if self.closed is None:
            return None
        m = len(self.expansions[0])
        finer = self.of(self.n, self.duration, closed=self.closed, intervals=2 * (m - 5))
        points = Spline.control_matrix(m, self.duration, 0, 1) @ self.coefficients(x)
        numbers = np.linalg.lstsq(finer.expansions[0], points, rcond=None)[0] / self.sizes
        return finer.sized(self.sizes * np.ones(self.n)), numbers.ravel(order="F")

    @classmethod
    def postures(cls, n: int, duration: float) -> SplineSpace:
        """Build for motions from posture to posture, each held for an instant or longer."""
        count = max(FEWEST_INTERVALS, round(INTERVALS_HZ * duration))
        period = 5 + _HELD + _MOVED
        # Whole rounds: the last posture is the first.
        stops = max(2, (count + 5 - 6) // period)
        m = stops * period + 6
        held = np.arange(m) % period
        E = np.zeros((m, stops))
        for i in range(m):
            here, there = (i // period) % stops, (i // period + 1) % stops
            part = max(0.0, (held[i] - 5.0) / (period - 5.0))
            E[i, here] += 1.0 - part
            E[i, there] += part
        return cls(n=n, duration=duration, expansions=(E,) * n)

    @classmethod
    def one_by_one(cls, n: int, duration: float) -> SplineSpace:
        """Build for motions in which one joint moves at a time, the others stand."""
        count = max(FEWEST_INTERVALS * n, round(INTERVALS_HZ * duration))
        whole = np.eye(count + 5)
        # A joint moves between two of n + 1 limits. Six control points act at an instant: five
        # between the last of a joint's own and the next one's first stand still.
        limits = np.linspace(0, count + 4, n + 1).astype(int)
        expansions = []
        for j in range(n):
            own = np.arange(limits[j] + 3, limits[j + 1] - 2)
            rest = 1.0 - whole[:, own].sum(axis=1)
            expansions.append(np.column_stack([rest, whole[:, own]]))
        return cls(n=n, duration=duration, expansions=tuple(expansions))

    def basis(self, time: Array, derivative: int) -> Array:
        """Return the matrix (K, m) from a joint's control points to a derivative."""
        m = len(self.expansions[0])
        return np.asarray(Spline.basis(m, self.duration, time, derivative).toarray())

    def bounds(self, derivative: int) -> tuple[Array, float]:
        """Return the control points of a derivative after a halving: they enclose it."""
        m = len(self.expansions[0])
        rows = Spline.control_matrix(m, self.duration, derivative, _HALVINGS)
        return np.asarray(rows.toarray()), 1.0

    def curve(self, x: Array) -> Curve:
        """Return the spline of free numbers x (N,)."""
        return Spline(duration=self.duration, control_points=self.coefficients(x))

    def _constant(self, first: Array) -> Array:
        return np.ones_like(first)


@dataclass(frozen=True, kw_only=True, eq=False)
class FourierSpace(Space):
    """Fourier series that pass through rest once a period, where it begins."""

    @classmethod
    def of(cls, n: int, duration: float, harmonics: int) -> FourierSpace:
        """Build for n joints: a constant, then cosine and sine of each harmonic.

        Raises
        ------
        DataError
            When there are fewer than two harmonics: one cannot be at rest without acceleration.
        """
        if harmonics < 2:
            raise DataError(f"harmonics: is {harmonics}; give at least 2.")
        order = np.arange(1, harmonics + 1.0)
        zero = np.zeros(harmonics)
        conditions = np.stack(
            [np.r_[0.0, np.ravel([zero, order], "F")], np.r_[0.0, np.ravel([order**2, zero], "F")]]
        )
        _, _, V = np.linalg.svd(conditions)
        return cls(n=n, duration=duration, expansions=(V[2:].T,) * n)

    @property
    def harmonics(self) -> int:
        """Number of harmonics."""
        return (len(self.expansions[0]) - 1) // 2

    def basis(self, time: Array, derivative: int) -> Array:
        """Return the matrix (K, m) from a joint's coefficients to a derivative."""
        rate = 2.0 * np.pi / self.duration * np.arange(1, self.harmonics + 1)
        # Every derivative turns cosines and sines by a quarter.
        angle = np.outer(time, rate) + 0.5 * np.pi * derivative
        waves = np.stack([np.cos(angle), np.sin(angle)], axis=2) * (rate**derivative)[:, None]
        constant = np.full((len(time), 1), 1.0 if derivative == 0 else 0.0)
        return np.hstack([constant, waves.reshape(len(time), -1)])

    def bounds(self, derivative: int) -> tuple[Array, float]:
        """Return samples of a derivative, and by how much less than its limit they must be."""
        count = _SAMPLES_OF_HARMONIC * self.harmonics
        time = np.asarray(np.arange(count) * (self.duration / count), dtype=np.float64)
        return self.basis(time, derivative), float(np.cos(np.pi * self.harmonics / count))

    def curve(self, x: Array) -> Curve:
        """Return the series of free numbers x (N,)."""
        c = self.coefficients(x)
        cosine, sine = c[1::2].T, c[2::2].T
        return FourierSeries(
            period=self.duration,
            center=c[0],
            harmonics=np.tile(np.arange(1, self.harmonics + 1), (self.n, 1)),
            amplitudes=np.hypot(cosine, sine),
            phases=np.arctan2(cosine, sine),
        )

    def _constant(self, first: Array) -> Array:
        return np.asarray(np.arange(len(first)) == 0, dtype=np.float64)
