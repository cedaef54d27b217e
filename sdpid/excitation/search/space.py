"""Motions that a search chooses among: linear in free numbers, with limits as functions of these.

Limits that are no linear functions are held on a grid. Between its instants they may be broken by a
little: the check that follows the search is exact, and says where; then the search goes on with
those instants too, or with a wider margin.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol, TypeAlias

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.kept import last_kept
from sdpid.errors import DataError
from sdpid.excitation.geometry.collision import CollisionModel
from sdpid.excitation.limits.joint_limits import JointLimits
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


# What a search keeps of a limit: the rest is for rounding in the check that follows.
_KEPT = 1.0 - 1e-7
# A row with entries below this is of a derivative that vanishes at an end.
_EMPTY = 1e-9
# A start uses this share of the way to the first limit: searches that begin at a limit are slow.
_SHARE = 0.6
# Shares of it that are tried until the other limits hold too.
_SHRINKS = 0.7 ** np.arange(40)
# Neighboring coefficients are averaged this often: accelerations would leave little room else.
_SMOOTHED = 2

# A sparse matrix A (R, N) and limits (R,) of the products ``A @ x`` with free numbers x.
Linear: TypeAlias = "tuple[Any, Array, Array]"


def linear_limits(space: Space, limits: JointLimits, start: Array | None = None) -> Linear:
    """Return rows A (R, N) and limits with which ``lower <= A @ x <= upper`` is sufficient.

    Positions, speeds, accelerations and jerks of the motion are then within their limits at every
    instant, and the motion begins at `start` (n,), where that is given.

    Returns
    -------
    scipy.sparse.csr_array, shape (R, N)
    lower, upper : ndarray, shape (R,)
    """
    from scipy.sparse import block_diag, csr_array

    symmetric = [limits.velocity, limits.acceleration, limits.jerk]
    ranges = [np.stack([limits.lower, limits.upper])] + [np.stack([-r, r]) for r in symmetric]
    bounds = [space.bounds(order) for order in range(len(ranges))]
    blocks, lower, upper = [], [], []
    for j, E in enumerate(space.expansions):
        own = []
        for (rows, share), (low, high) in zip(bounds, ranges, strict=True):
            if not (np.isfinite(low[j]) or np.isfinite(high[j])):
                continue
            matrix = rows @ E
            matrix = matrix[np.abs(matrix).max(axis=1) > _EMPTY]
            own.append(np.where(np.abs(matrix) > _EMPTY * np.abs(matrix).max(), matrix, 0.0))
            mean, half = _middle(low[j], high[j])
            lower.append(np.full(len(matrix), mean - _KEPT * share * half))
            upper.append(np.full(len(matrix), mean + _KEPT * share * half))
        if start is not None:
            own.append(space.basis(np.zeros(1), 0) @ E)
            lower.append(start[j : j + 1])
            upper.append(start[j : j + 1])
        blocks.append(csr_array(np.vstack([np.zeros((0, E.shape[1])), *own])))
    return csr_array(block_diag(blocks)), np.concatenate(lower), np.concatenate(upper)


def _middle(low: float, high: float) -> tuple[float, float]:
    """Return the middle of a range and half its width, about the finite end of a half-open one."""
    if np.isfinite(low) and np.isfinite(high):
        return 0.5 * (low + high), 0.5 * (high - low)
    return (float(low), np.inf) if np.isfinite(low) else (float(high), np.inf)


def largest_step(linear: Linear, x: Array, direction: Array) -> float:
    """Return the longest way along a direction that keeps the limits, from x within them."""
    A, lower, upper = linear
    at, along = A @ x, A @ direction
    moved = np.abs(along) > _EMPTY * np.abs(along).max(initial=0.0)
    at, along, lower, upper = at[moved], along[moved], lower[moved], upper[moved]
    room = np.where(along > 0.0, upper - at, lower - at) / along
    return float(np.min(room, initial=np.inf))


def random_start(
    space: Space,
    linear: Linear,
    home: Array,
    rng: np.random.Generator,
    holds: Callable[[Array], bool],
) -> Array:
    """Return a random motion (N,) about a position at which the arm may stand still.

    Parameters
    ----------
    space : Space
        The motions.
    linear : tuple
        Matrix, lower and upper limits, as `linear_limits` returns them.
    home : ndarray, shape (n,)
        A position within all limits, at which the motion begins.
    rng : numpy.random.Generator
        The only source of randomness.
    holds : callable
        Whether a motion keeps all other limits.

    Returns
    -------
    ndarray, shape (N,)
        Standing still at home where nothing else holds.
    """
    still = space.standing(home)
    x = still.copy()
    for j in range(space.n):
        own = slice(space.splits[j], space.splits[j + 1])
        direction = np.zeros(space.size)
        drawn = rng.standard_normal(space.splits[j + 1] - space.splits[j])
        for _ in range(_SMOOTHED):
            drawn = 0.5 * (drawn + np.roll(drawn, 1))
        direction[own] = drawn
        # The start stays where it is: positions at the ends are those of home.
        ends = space.first @ space.expansions[j]
        direction[own] -= ends * (ends @ drawn) / (ends @ ends)
        x += _SHARE * min(largest_step(linear, still, direction), 1e3) * direction
    for shrink in _SHRINKS:
        candidate = still + shrink * (x - still)
        if holds(candidate):
            return np.asarray(candidate)
    return still


def usual_states(
    space: Space,
    limits: JointLimits,
    homes: Iterable[Array],
    rng: np.random.Generator,
    holds: Callable[[Array], bool] = lambda x: True,
    start: Array | None = None,
) -> tuple[Array, Array, Array]:
    """Return positions, rates and accelerations (K, n) of random motions within the limits."""
    linear = linear_limits(space, limits, start)
    drawn = [space.coefficients(random_start(space, linear, home, rng, holds)) for home in homes]
    bases = (space.basis(space.grid(), order) for order in range(3))
    q, v, a = (np.concatenate([basis @ c for c in drawn]) for basis in bases)
    return q, v, a


# Entries of the matrices of a motion below this share of the largest are zero.
_ZERO = 1e-12


class StateInequality(Protocol):
    """Functions of a state that are to be at least zero."""

    def evaluate(self, q: Array, v: Array, a: Array) -> Array:
        """Return their values (K, r) at states (K, n), in shares of their limits."""

    def derivatives(self, q: Array, v: Array, a: Array) -> tuple[Array | None, ...]:
        """Return derivatives (K, r, n) by position, velocity and acceleration; None for zero."""


@dataclass(frozen=True, kw_only=True, eq=False)
class InstantRows:
    """Inequalities at the instants at which each is to hold, as functions of free numbers.

    Attributes
    ----------
    space : Space
        The motions.
    parts : sequence of (StateInequality, ndarray (K,))
        Each inequality and its instants in s.
    """

    space: Space
    parts: Sequence[tuple[StateInequality, Array]]

    @cached_property
    def _matrices(self) -> list[list[Array]]:
        return [[self.space.basis(time, order) for order in range(3)] for _, time in self.parts]

    @cached_property
    def _by_free(self) -> list[list[list[Array]]]:
        """Matrices from the free numbers of each joint, part by part and order by order."""
        return [
            [[matrix @ E for E in self.space.expansions] for matrix in matrices]
            for matrices in self._matrices
        ]

    def _states(self, part: int, x: Array) -> list[Array]:
        c = self.space.coefficients(x)
        return [matrix @ c for matrix in self._matrices[part]]

    @cached_property
    def pattern(self) -> Any:
        """Where the derivative may differ from zero, a boolean array (R, N)."""
        blocks = []
        for i, (inequality, _) in enumerate(self.parts):
            one = (state[:1] for state in self._states(i, np.zeros(self.space.size)))
            count = inequality.evaluate(*one).shape[1]
            used = sum(np.abs(m) > _ZERO * np.abs(m).max() for m in self._matrices[i])
            own = np.hstack([used @ (E != 0.0) > 0 for E in self.space.expansions])
            blocks.append(np.repeat(own, count, axis=0))
        return np.vstack(blocks)

    def values(self, x: Array) -> Array:
        """Return all functions (R,), instant by instant."""
        found = (each.evaluate(*self._states(i, x)) for i, (each, _) in enumerate(self.parts))
        return np.concatenate([values.ravel() for values in found])

    def hold(self, x: Array) -> bool:
        """Return whether a motion (N,) is within all of them."""
        return bool(np.min(self.values(x)) > 0.0)

    def derivative(self, x: Array) -> Array:
        """Return the derivative (R, N)."""
        blocks = []
        for i, (inequality, _) in enumerate(self.parts):
            by_state = inequality.derivatives(*self._states(i, x))
            parts = [
                (m, s) for m, s in zip(self._by_free[i], by_state, strict=True) if s is not None
            ]
            out = np.zeros((*parts[0][1].shape[:2], self.space.size))
            for matrices, slopes in parts:
                for j, matrix in enumerate(matrices):
                    own = slice(self.space.splits[j], self.space.splits[j + 1])
                    out[:, :, own] += slopes[:, :, j, None] * matrix[:, None, :]
            blocks.append(out.reshape(-1, self.space.size))
        return np.vstack(blocks)


# Slacks of distances are counted in this length, m, and the soft minimum over pairs is below the
# least one by at most log(P) over this, 1/m: a centimeter for twenty pairs that are alike near.
_LENGTH = 0.1
_SHARPNESS = 300.0


@dataclass(frozen=True, kw_only=True, eq=False)
class KeptDistance:
    """Distances of all pairs are at least their clearance.

    Attributes
    ----------
    collision : CollisionModel
        The pairs.
    clearance : float
        The wanted clearance, m.
    margin : float
        What is kept beyond it, m, for what happens between the instants.
    """

    collision: CollisionModel
    clearance: float
    margin: float = 0.0

    def evaluate(self, q: Array, v: Array, a: Array) -> Array:
        """Return the soft least slack (K, 1), in shares of 0.1 m."""
        return self._least(q)[0]

    def derivatives(self, q: Array, v: Array, a: Array) -> tuple[Array | None, ...]:
        """Return its derivative by position (K, 1, n)."""
        return self._least(q)[1], None, None

    @last_kept
    def _least(self, q: Array) -> tuple[Array, Array]:
        slack, slope = self.collision.soft_minimum(
            q, _SHARPNESS, clearance=self.clearance, beyond=self.margin
        )
        return slack[:, None] / _LENGTH, slope[:, None, :] / _LENGTH
