"""Intervals of a payload: the extremes of each quantity over all bodies that the recordings allow.

For each quantity f the interval is the range of f over the payloads pi that can exist and have
``‖matrix·pi − rhs‖² ≤ least + rise``. The rise follows the direction that pi moves in, by the
variance that the recordings show for it (see `sdpid.assurance.intervals.profile_likelihood`): for
a linear f without active constraints it is Gauss-Markov's interval.

* The mass is linear: one program each way.
* The center of mass h/m ≤ c means h − c·m ≤ 0: Dinkelbach's iteration on c finds the global
  extreme [dinkelbach1967]_.
* The inertia about the center of mass is linear to first order: it is that about the center of
  mass of the best payload (the delta method, within what bodies can have).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.payload.program import QUANTITIES, PayloadProgram
from sdpid.estimation.conic.retry import Retried
from sdpid.estimation.conic.solve import ConicFamily
from sdpid.robot.inertia import transform

# The level follows the direction in which the extreme lies; within this share it has settled.
_SETTLED, _ROUNDS = 0.05, 6

# A center of mass that changes by less than this share has settled.
_CLOSE = 1e-5

# Errors are known to this share of the efforts' squares: rounding, where the data are exact.
_EXACT = 1e-18

# Masses below, in kg, are none.
NOTHING = 1e-9


class PayloadIntervals:
    """Intervals of a payload's mass, center of mass and inertia.

    Parameters
    ----------
    program : PayloadProgram
        Of the payload.
    theta : ndarray, shape (10,)
        The payload of least cost.
    level : float
        Probability of each interval.

    Attributes
    ----------
    unsolved : list of str
        Quantities of which an end is only the best that the solver came to.
    """

    def __init__(self, program: PayloadProgram, theta: Array, level: float) -> None:
        self.program, self.best, self.level = program, theta, level
        rows = program.rows
        residual = rows.matrix @ theta - rows.rhs
        self.least = float(residual @ residual)
        conic = program.conic
        self.family = ConicFamily(replace(conic, M=conic.M[:10], m=conic.m[:10], radius=1.0))
        self.unsolved: list[str] = []

    def ends(self) -> tuple[Array, Array]:
        """Return lower and upper ends (10,) of mass, center of mass, and inertia about it."""
        lower, upper = np.full(10, -np.inf), np.full(10, np.inf)
        lower[0] = 0.0
        # Nothing has no center of mass, and no inertia about it.
        for k in range(10 if self.best[0] > NOTHING else 1):
            lower[k] = self._extreme(k, 1.0, lower[k])
            upper[k] = self._extreme(k, -1.0, upper[k])
        return lower, upper

    def gains_share(self) -> Array:
        """Return the share (10,) of the gains' errors in each variance, inequalities aside."""
        rows, found = self.program.rows, np.zeros(10)
        for k in range(10 if self.best[0] > NOTHING else 1):
            functional = self._linear(k, self.best)
            direction = np.asarray(
                np.linalg.lstsq(rows.matrix.T, functional, rcond=None)[0], dtype=np.float64
            )
            variance, _ = rows.error(direction)
            found[k] = rows.of_gains(direction)[0] / variance if variance > 0.0 else 0.0
        return found

    def _linear(self, k: int, at: Array) -> Array:
        """Return a linear function of pi whose extreme is that of quantity k.

        For the center of mass it is zero at the payload `at`; the inertia is that about the best
        payload's center of mass.
        """
        c = np.zeros(10)
        if k < 4:
            c[k] = 1.0
            c[0] -= at[k] / at[0] if k else 0.0
            return c
        return np.asarray(transform(np.eye(10), np.eye(3), -self.best[1:4] / self.best[0])[:, k])

    def _rise(self, moved: Array) -> float:
        """Return the rise of the cost for an extreme at which the residual has moved like this."""
        from scipy.stats import t

        rows = self.program.rows
        size = float(np.linalg.norm(moved))
        if not size > 0.0:
            moved, size = np.ones(10), float(np.sqrt(10.0))
        variance, freedom = rows.error(moved / size)
        quantile = float(t.ppf(0.5 * (1.0 + self.level), freedom))
        return max(quantile**2 * variance, _EXACT * float(rows.rhs @ rows.rhs))

    def _extreme(self, k: int, sign: float, otherwise: float) -> float:
        """Return the least (sign 1) or greatest (sign -1) value of quantity k.

        `otherwise` where the recordings leave it open.
        """
        matrix, of_center, value = self.program.rows.matrix, 0 < k < 4, np.inf
        c = self._linear(k, self.best)
        # The rise of a linear function, were there no constraints.
        moved = np.linalg.lstsq(matrix.T, c, rcond=None)[0]
        rise = self._rise(np.asarray(moved, dtype=np.float64))
        for _ in range(_ROUNDS):
            end = self._at(sign * c * self.program.units, rise)
            found = end.value
            if found is None or not found[0] > NOTHING:
                return otherwise
            before, value = value, sign * float(found[k] / found[0] if of_center else c @ found)
            # A rise that is nearly the same is kept, so that iterations end.
            new = self._rise(matrix @ (found - self.best))
            if abs(new - rise) > _SETTLED * rise:
                rise = new
            elif not of_center or abs(value - before) <= _CLOSE * abs(value):
                break
            c = self._linear(k, found)
        if not end.accepted:
            self.unsolved.append(QUANTITIES[k])
        return sign * value

    def _at(self, slope: Array, rise: float) -> Retried[Array]:
        """Return the payload within a level that has the least of a linear function."""
        size = float(np.linalg.norm(slope)) or 1.0
        radius = float(np.sqrt(self.least + rise)) / self.program.cost_unit
        return self.program.solved(
            lambda regularization: self.family.solve(
                slope / size, radius, regularization=regularization
            )
        )
