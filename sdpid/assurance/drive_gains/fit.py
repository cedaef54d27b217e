"""Gains that fit currents best, by variable projection.

For any gains the bodies' parameters and the drives' friction are a linear least-squares problem
[golub2003]_. Friction does not depend on the gains and is projected away once; what is left is a
function of the n logarithms of the gains alone.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sdpid._common.arrays import Array, Indices
from sdpid.assurance.drive_gains.model import GainModel
from sdpid.estimation.conic.solve import ConicProgram, Matrix, solve_conic, solve_with_retries
from sdpid.estimation.information import information_root, least_squares
from sdpid.robot.inertia import matrix_basis

# How far from its start a search may go: factors of 1e4, for currents that no arm explains.
_FAR = np.log(1e4)
# Steps that end a search: relative, of logarithms, and of the cost, which is flat there.
_STEP, _FALL = 1e-10, 1e-14
# A column of which friction leaves less than this share is explained by friction: a link's inertia
# about the axis of a drive that has an inertia of its own.
_EXPLAINED = 1e-9
# A least standard deviation of a current's errors, as a share of the currents: rounding.
_LEAST_SIGMA = 1e-6

# What the currents do not show of the bodies: this pull, beside rows of variance one, chooses it.
_FAINT = 0.03
# Lengths in which bodies are measured, m, and the mass of one of which nothing is known, kg.
_LENGTH, _MASS = 0.1, 1.0
# A radius of gyration of links that are described without mass, m.
_GYRATION = 0.1
_REGULARIZATIONS = (1e-10, 1e-8)
# Steps among bodies that can exist, and the step of a logarithm that is none: a thousandth of what
# intervals are wide.
_STEPS, _STILL = 20, 1e-5


class FoundGains(NamedTuple):
    """Where a search for gains ended.

    Logarithms of the gains (n,), the bodies' unknown parameters, the weighted sum of squared
    errors of the currents, and whether the last step was none.
    """

    logs: Array
    unknown: Array
    cost: float
    settled: bool


@dataclass(frozen=True, eq=False)
class GainFit:
    """The least-squares problem of gains, for one choice of weights.

    Attributes
    ----------
    model : GainModel
        What currents are explained by.
    links : sequence of ndarray
        The links (links, 10) that load the gears in each recording.
    rows : tuple of ndarray
        Of each joint the triangles (., c + Y + 1) of all recordings' columns.
    alone : ndarray, shape (n,)
        Mean squared errors of the currents, each recording explained alone, A². Such a fit knows no
        gains: the links at each joint are its own.
    errors : ndarray, shape (n,)
        Mean squares of the currents' errors, A²: the weights.
    """

    model: GainModel
    links: Sequence[Array]
    rows: tuple[Array, ...]
    alone: Array
    errors: Array

    @classmethod
    def of(cls, model: GainModel, links: Sequence[Array]) -> GainFit:
        """Compress all rows; the weights are those of each recording explained alone."""
        runs = [
            [np.asarray(np.linalg.qr(columns, mode="r")) for columns in model.columns(number, own)]
            for number, own in enumerate(links)
        ]
        left = [
            [R[:, -1] - R[:, :-1] @ least_squares(R[:, :-1], R[:, -1]) for R in run] for run in runs
        ]
        alone = np.sum([[own @ own for own in run] for run in left], axis=0) / model.used
        rows = tuple(np.vstack(joint) for joint in zip(*runs, strict=True))
        return cls(model, links, rows, alone, alone)

    @property
    def sigma(self) -> Array:
        """Standard deviations of the currents' errors, (n,)."""
        least = np.maximum(_LEAST_SIGMA * self.model.spread, 1e-300)
        return np.maximum(np.sqrt(self.errors), least)

    @cached_property
    def _system(self) -> tuple[Indices, Array, Array]:
        """Joint of each row (R,), what multiplies the bodies (R, Y), and the current (R,), in A.

        Friction is projected away. The last rows are what is believed of the links, as of one joint
        more whose gain and weight are one.
        """
        found, size = [], len(self.model.known) + 1
        for rows in self.rows:
            basis = rows[:, :-size] @ information_root(rows[:, :-size])
            left = rows[:, -size:] - basis @ (basis.T @ rows[:, -size:])
            # What is nothing but rounding must not be scaled up later.
            whole = np.linalg.norm(rows[:, -size:], axis=0)
            left[:, np.linalg.norm(left, axis=0) < _EXPLAINED * whole] = 0.0
            found.append(np.asarray(np.linalg.qr(left, mode="r")))
        found.append(np.column_stack(self.model.believed))
        stacked = np.vstack(found)
        joints = np.repeat(np.arange(len(found)), [len(each) for each in found])
        return joints, stacked[:, :-1], stacked[:, -1]

    def weighted(self, logs: Array) -> tuple[Array, Array]:
        """Return what multiplies the bodies (R, Y) and the current (R,), in standard deviations."""
        joints, Z, current = self._system
        sigma = np.append(self.sigma, 1.0)[joints]
        gains = np.exp(np.append(logs, 0.0))[joints]
        return Z / (sigma * gains)[:, None], current / sigma

    def linear(self, logs: Array) -> tuple[Array, Array]:
        """Return matrix and right-hand side of the least-squares problem in what is unknown."""
        matrix, current = self.weighted(logs)
        return matrix[:, self.model.unknown], current - matrix @ self.model.known

    def slopes(self, logs: Array, bodies: Array) -> Array:
        """Return the derivative (R, n) by the logarithms of what bodies (Y,) leave of currents."""
        own = self._system[0][:, None] == np.arange(len(logs))
        return np.asarray((self.weighted(logs)[0] @ bodies)[:, None] * own)

    def at(self, logs: Array) -> tuple[Array, Array, Array]:
        """Return the best unknowns, residual, and its derivative by logs, unknowns following."""
        matrix, rhs = self.linear(logs)
        root = information_root(matrix)
        basis = matrix @ root
        unknown = root @ (basis.T @ rhs)
        slopes = self.slopes(logs, self.model.bodies(unknown))
        return unknown, rhs - matrix @ unknown, slopes - basis @ (basis.T @ slopes)

    def mean_squares(self, found: FoundGains) -> Array:
        """Return the mean squared errors of each joint's current, (n,), A²."""
        matrix, rhs = self.linear(found.logs)
        squares = np.bincount(self._system[0], (rhs - matrix @ found.unknown) ** 2)
        return np.asarray(squares[: len(found.logs)] * self.sigma**2 / self.model.used)

    def search(self, start: Array) -> FoundGains:
        """Return where a search from logarithms of gains (n,) ends; known ones stay."""
        from scipy.optimize import least_squares as minimize

        free = self.model.free

        @functools.lru_cache(maxsize=1)
        def at(*moved: float) -> tuple[Array, Array, Array, Array]:
            logs = start.copy()
            logs[free] = moved
            return (logs, *self.at(logs))

        moved, settled = start[free], True
        if free.any():
            ended = minimize(
                lambda x: at(*x)[2],
                moved,
                lambda x: at(*x)[3][:, free],
                bounds=(moved - _FAR, moved + _FAR),
                xtol=_STEP,
                ftol=_FALL,
            )
            moved, settled = ended.x, bool(ended.success)
        logs, unknown, *_ = at(*moved)
        return self._found(logs, unknown, settled)

    def consistent(self, near: FoundGains, *, hold: bool = False) -> FoundGains:
        """Return the best gains near others of links and loads that can exist.

        Steps of Gauss and Newton, with the semidefinite program inside each: about the present
        gains and bodies their product is linear, and each body is one that matter can have. With
        `hold` the gains stay.
        """
        model, logs, unknown = self.model, near.logs.copy(), near.unknown
        moving = np.flatnonzero(model.free & (not hold))
        units, reference, blocks = self._existing
        count, settled = len(unknown), False
        pull = _FAINT * np.eye(count, count + len(moving))
        for _ in range(_STEPS):
            matrix, rhs = self.linear(logs)
            slopes = self.slopes(logs, model.bodies(unknown))[:, moving]
            whole = np.column_stack([matrix * units, -slopes, rhs])
            R = np.asarray(np.linalg.qr(whole, mode="r"))
            program = ConicProgram(
                M=np.vstack([R[:, :-1], pull]),
                m=-np.concatenate([R[:, -1], _FAINT * reference]),
                C=np.zeros((0, count + len(moving))),
                lower=np.zeros(0),
                upper=np.zeros(0),
                blocks=blocks,
            )
            # The point of least cost, or the nearest to it that the solver came to.
            best = solve_with_retries(
                functools.partial(solve_conic, program),
                _REGULARIZATIONS,
                lambda point, solution: (point, 0.0 if solution.solved else solution.error),
            ).value
            if best is None:
                break
            unknown, step = best[:count] * units, best[count:]
            logs[moving] += np.clip(step, -0.5, 0.5)
            settled = float(np.abs(step).max(initial=0.0)) < _STILL
            if settled:
                break
        return self._found(logs, unknown, settled)

    def _found(self, logs: Array, unknown: Array, settled: bool) -> FoundGains:
        """Return where a search ended, with the cost there."""
        matrix, rhs = self.linear(logs)
        return FoundGains(logs, unknown, float(np.sum((rhs - matrix @ unknown) ** 2)), settled)

    @cached_property
    def _existing(self) -> tuple[Array, Array, tuple[Matrix, ...]]:
        """Units of what is unknown, where it is pulled to in them, and the bodies in them."""
        model, robot = self.model, self.model.robot
        body = _LENGTH ** np.array([0, 1, 1, 1, *[2] * 6])
        thin = _MASS * np.array([1.0, 0, 0, 0, *(_GYRATION**2 * np.array([1, 0, 1, 0, 0, 1]))])
        described = np.where(robot.prior[:, :1] > 0.0, robot.prior, thin)
        shared = np.arange(len(model.placed), model.n_arm)
        units = np.concatenate(
            [
                (described[:, :1] * body).ravel(),
                np.ones(len(shared)),
                *(load.mass * body for load in model.loads),
            ]
        )
        reference = np.zeros(len(units))
        reference[: described.size] = described.ravel()
        basis, blocks = matrix_basis("pseudo_inertia"), []
        place = np.cumsum(model.unknown) - 1
        for own in np.delete(np.arange(len(units)), shared).reshape(-1, 10):
            loose = model.unknown[own]
            if loose.any():
                constant = np.einsum("k,kij->ij", model.known[own] / units[own], basis)
                blocks.append(Matrix(place[own[loose]], basis[loose], constant))
        scaled = (reference / units)[model.unknown]
        return units[model.unknown], scaled, tuple(blocks)
