"""Straight flights between events: draws from a density inside of walls, without a step size.

Many chains at once. Each point flies along a straight line and changes its direction

* at walls, where it is reflected,
* where the density falls, at random: it is reflected by the gradient, so that the point visits
  every place as often as the density says (the bouncy particle sampler [bouchard2018]_, with
  walls [bierkens2018]_),
* at the end of a trajectory of fixed length, where the point is a draw, and a new direction is
  drawn from a normal distribution.

All three leave the density as it is, whatever the covariance of the directions; one near the
density's own makes trajectories short. Where a line meets a matrix inequality is a generalized
eigenvalue, so there is no step size and nothing is rejected.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask
from sdpid.assurance.sampling.density import Density, Matrices
from sdpid.errors import SolverError

# Reflections happen this share of the flight before the wall, so that rounding leaves the point
# inside. It is far below what any number of draws can show.
_BEFORE = 1e-5

# Trajectories that rounding may take through a wall: some, and then a share of the flights.
_MOST_LOST, _LOST_SHARE = 100, 1e-3

# Flights of a trajectory, on average: thirty are usual, and some hundred in a warm-up.
_MOST_FLIGHTS = 2000

# What ends a flight.
_WALL, _LIMIT, _FALL, _END = range(4)

# Halvings of an interval, to a double's precision.
_HALVINGS = 60


@dataclass(eq=False)
class _State:
    """Where chains are: points, directions, and everything that is linear in them.

    Attributes
    ----------
    x, v : ndarray, shape (C, n)
    walls, bodies : ndarray, shape (C, N, s, s)
    values : ndarray, shape (C, m)
        Of the rows.
    gradient : ndarray, shape (C, n)
        Of the Gaussian's and the slope's part of −log density.
    left : ndarray, shape (C,)
        Length left of the trajectory.
    """

    x: Array
    v: Array
    walls: Array
    bodies: Array
    values: Array
    gradient: Array
    left: Array

    @classmethod
    def at(cls, density: Density, x: Array, v: Array, length: float) -> _State:
        """Return the state at the beginning of trajectories."""
        return cls(
            x=x,
            v=v,
            walls=density.walls.at(x),
            bodies=density.bodies.at(x),
            values=x @ density.rows.T,
            gradient=(x - density.mean) @ density.precision + density.slope,
            left=np.full(len(x), length),
        )

    def put(self, where: Indices, other: _State) -> None:
        """Overwrite chains by others."""
        for name, own in vars(self).items():
            own[where] = getattr(other, name)

    def only(self, kept: Indices) -> _State:
        """Return some of the chains."""
        return _State(**{name: own[kept] for name, own in vars(self).items()})


class Trajectories:
    """Chains in a density.

    Parameters
    ----------
    density : Density
        The density.
    x : ndarray, shape (C, n)
        Where they begin: points inside.
    rng : numpy.random.Generator
        Of directions and events.

    Attributes
    ----------
    x : ndarray, shape (C, n)
        Where they are.
    flights : int
        Straight flights so far, of all chains.
    lost : int
        Trajectories that rounding took through a wall, and that began anew.
    """

    def __init__(self, density: Density, x: Array, rng: np.random.Generator) -> None:
        self.density, self.x, self.rng = density, x, rng
        self.flights = self.lost = 0

    def run(self, count: int, length: float, covariance: Array) -> Array:
        """Return the ends (count, C, n) of trajectories of one length.

        Directions have the given covariance, so that a length of one crosses one standard
        deviation of it.
        """
        root = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
        chains = np.arange(len(self.x))
        ends = np.empty((count, *self.x.shape))
        done = np.zeros(len(chains), dtype=np.intp)
        state = self._begun(self.x, length, root)
        most = self.flights + _MOST_FLIGHTS * len(chains) * count
        while len(chains):
            try:
                kind, normal = self._fly(state)
            except np.linalg.LinAlgError:
                lost = _outside(state)
                self.lost += len(lost)
                self._require_progress(most if len(lost) else 0)
                state.put(lost, self._begun(self.x[chains[lost]], length, root))
                continue
            self.flights += len(chains)
            self._require_progress(most)
            _reflect(state.v, np.flatnonzero(kind < _END), normal, root)
            ended = np.flatnonzero(kind == _END)
            if not len(ended):
                continue
            own = chains[ended]
            ends[done[own], own] = self.x[own] = state.x[ended]
            done[own] += 1
            # Afresh, so that roundings do not add up.
            state.put(ended, self._begun(self.x[own], length, root))
            going = np.flatnonzero(done[chains] < count)
            if len(going) < len(chains):
                state, chains = state.only(going), chains[going]
        return ends

    def _require_progress(self, most: int) -> None:
        """Raise where walls are met again and again, or rounding takes points through them."""
        if self.lost > _MOST_LOST + _LOST_SHARE * self.flights or self.flights > most:
            raise SolverError(
                f"draw: after {self.flights} flights, of which rounding took {self.lost} through "
                "a wall, trajectories have not ended: the data press the estimate against the "
                "constraints by far more than their errors. Are they exact? Then the estimate is "
                "all there is; else a margin or a prior gives room.",
                problem=self.density.problem,
            )

    def _begun(self, x: Array, length: float, root: Array) -> _State:
        v = self.rng.standard_normal(x.shape) @ root.T
        return _State.at(self.density, x.copy(), v, length)

    def _fly(self, state: _State) -> tuple[Indices, Array]:
        """Move every chain to its next event; return the events and what is to be reflected by."""
        density, v = self.density, state.v
        each = np.arange(len(v))
        walls, values = density.walls.along(v), v @ density.rows.T
        gradient = v @ density.precision
        matrix, to_matrix = _first_wall(state.walls, walls)
        row, to_row = _first_limit(density, state.values, values)
        bodies = density.bodies.along(v)
        drop = self.rng.exponential(size=len(v))
        slope = np.einsum("ca,ca->c", state.gradient, v)
        curvature = np.einsum("ca,ca->c", gradient, v)
        fall = _fall(slope, curvature, drop)
        if len(density.bodies):
            rates = relative_eigenvalues(state.bodies, bodies).reshape(len(v), -1)
            fall = _fall_of_bodies(slope, curvature, density.strength, rates, drop, state.left)
        before = 1.0 - _BEFORE
        events = np.stack([before * to_matrix, before * to_row, fall, state.left])
        kind = np.argmin(events, axis=0)
        t = events[kind, each]
        state.x += t[:, None] * v
        state.walls += t[:, None, None, None] * walls
        state.bodies += t[:, None, None, None] * bodies
        state.values += t[:, None] * values
        state.gradient += t[:, None] * gradient
        state.left -= t
        normal = np.zeros_like(v)
        hit = np.flatnonzero(kind == _WALL)
        normal[hit] = _normals(density.walls, state.walls[hit, matrix[hit]], matrix[hit])
        hit = np.flatnonzero(kind == _LIMIT)
        normal[hit] = density.rows[row[hit]]
        hit = np.flatnonzero(kind == _FALL)
        normal[hit] = state.gradient[hit] - _gradient_of_bodies(density, state.bodies[hit])
        return kind, normal


def relative_eigenvalues(F: Array, D: Array) -> Array:
    """Return the eigenvalues (..., s) of ``L^(-1)·D·L^(-T)`` for matrices ``F = L·L^T``, rising.

    ``F + t·D`` is positive definite as long as ``1 + t·value`` is positive for all of them.

    Raises
    ------
    numpy.linalg.LinAlgError
        When an F is not positive definite.
    """
    L = np.asarray(np.linalg.cholesky(F), dtype=np.float64)
    half = _lower_solve(L, D)
    return np.asarray(np.linalg.eigvalsh(_lower_solve(L, np.swapaxes(half, -1, -2))))


def _lower_solve(L: Array, right: Array) -> Array:
    """Return ``L^(-1)·right``, row by row: for thousands of small matrices that is fastest."""
    out = np.empty_like(right)
    for i in range(L.shape[-1]):
        known = np.einsum("...k,...kj->...j", L[..., i, :i], out[..., :i, :])
        out[..., i, :] = (right[..., i, :] - known) / L[..., i, i, None]
    return out


def _first_wall(F: Array, D: Array) -> tuple[Indices, Array]:
    """Return which matrix (C,) is met first, and how far away it is (C,)."""
    if not F.shape[1]:
        return np.zeros(len(F), dtype=np.intp), np.full(len(F), np.inf)
    least = relative_eigenvalues(F, D)[..., 0]
    which = np.argmin(least, axis=1)
    return which, _where_singular(least[np.arange(len(F)), which])


def _where_singular(least: Array) -> Array:
    """Return how far away a matrix is singular whose least eigenvalue along the line this is."""
    with np.errstate(over="ignore"):
        found = np.divide(-1.0, least, out=np.full(len(least), np.inf), where=least < 0.0)
    return np.asarray(found)


def _first_limit(density: Density, values: Array, rates: Array) -> tuple[Indices, Array]:
    """Return which row (C,) reaches a limit first, and how far away that is (C,)."""
    room = np.where(rates > 0.0, density.upper - values, density.lower - values)
    far = np.divide(room, rates, out=np.full(rates.shape, np.inf), where=rates != 0.0)
    which = np.argmin(far, axis=1)
    return which, np.maximum(far[np.arange(len(far)), which], 0.0)


def _fall(slope: Array, curvature: Array, drop: Array) -> Array:
    """Return where ``max(0, slope + curvature·t)``, integrated from 0, has reached the drop."""
    uphill = np.maximum(slope, 0.0)
    root = np.sqrt(uphill**2 + 2.0 * curvature * drop)
    with np.errstate(divide="ignore", invalid="ignore"):
        rising = 2.0 * drop / (uphill + root)
        falling = (root - slope) / curvature
    found = np.where(slope > 0.0, rising, falling)
    return np.where(np.isfinite(found), found, np.inf)


def _fall_of_bodies(
    slope: Array, curvature: Array, strength: float, rates: Array, drop: Array, most: Array
) -> Array:
    """Return the same where ``−strength·Σ log(1 + t·rate)`` is part of −log density too.

    Infinite where that is farther away than `most`.
    """
    least = rates.min(axis=1)
    wall = _where_singular(least)
    end = np.minimum(wall, most)

    def derivative(t: Array) -> Array:
        inner = np.sum(rates / (1.0 + t[:, None] * rates), axis=1)
        return np.asarray(slope + curvature * t - strength * inner)

    def value(t: Array) -> Array:
        inner = np.sum(np.log1p(t[:, None] * rates), axis=1)
        return np.asarray(slope * t + 0.5 * curvature * t**2 - strength * inner)

    with np.errstate(divide="ignore", invalid="ignore"):
        bottom = _bisected(lambda t: derivative(t) < 0.0, np.zeros_like(end), end)
        level = value(bottom) + drop
        found = _bisected(lambda t: value(t) < level, bottom, end)
        # At a wall the density vanishes: there everything has fallen.
        reached = (wall <= most) | (value(end) >= level)
    return np.where(reached, found, np.inf)


def _bisected(before: Callable[[Array], Mask], low: Array, high: Array) -> Array:
    """Return where a condition that holds at first ceases to hold, between low and high."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        holds = before(middle)
        low, high = np.where(holds, middle, low), np.where(holds, high, middle)
    return low


def _normals(walls: Matrices, F: Array, which: Indices) -> Array:
    """Return the inward normals (k, n) of the matrices (k, s, s) that are nearly singular."""
    u = np.linalg.eigh(F)[1][:, :, 0]
    outer = u[:, :, None] * u[:, None, :]
    return np.asarray(np.einsum("nkij,kij->kn", walls.linear[:, which], outer))


def _gradient_of_bodies(density: Density, bodies: Array) -> Array:
    """Return the gradient (k, n) of ``strength·Σ log det`` of matrices (k, L, 4, 4)."""
    flat = density.bodies.flat
    inverses = np.linalg.inv(bodies).reshape(len(bodies), flat.shape[1])
    return np.asarray(density.strength * inverses @ flat.T)


def _reflect(v: Array, where: Indices, normal: Array, root: Array) -> None:
    """Reflect directions by normals, in the metric in which directions are alike."""
    own = normal[where]
    across = own @ root
    share = np.einsum("ca,ca->c", own, v[where]) / np.einsum("ca,ca->c", across, across)
    v[where] -= 2.0 * share[:, None] * (across @ root.T)


def _outside(state: _State) -> Indices:
    """Return the chains of which a matrix is not positive definite but for rounding."""

    def fails(*matrices: Array) -> bool:
        try:
            for each in matrices:
                np.linalg.cholesky(each)
        except np.linalg.LinAlgError:
            return True
        return False

    found = [fails(*each) for each in zip(state.walls, state.bodies, strict=True)]
    return np.flatnonzero(found)
