"""How far payloads go that the recordings do not rule out: extremes over all that matter can be.

For each quantity f the interval is the range of f over the payloads pi that can exist and have
``‖matrix·pi − rhs‖² ≤ least + rise``. The rise follows the direction that pi moves in, by the
variance that the recordings show for it (see `sdpid.assurance.intervals.profile_likelihood`): for a
linear f without active constraints it is Gauss-Markov's interval.

* The mass is linear, one program each way.
* The center of mass h/m ≤ c means h − c·m ≤ 0; Dinkelbach's iteration on c finds the global
  extreme [dinkelbach1967]_.
* A moment of inertia about the center of mass is concave in pi: its largest value is one program,
  with ``[[I − z, h^T], [h, m·E]]`` ⪰ 0 for a moment of at least z.
* Its smallest value, and products of inertia, are local extremes, from several starts: moments
  about the center of mass are those about a fixed point, to first order.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.payload.program import PayloadProgram, quantities
from sdpid.estimation.conic.solve import ConicFamily, Matrix
from sdpid.robot.inertia import transform

# The level follows the direction in which the extreme lies; within this share it has settled.
_SETTLED, _ROUNDS = 0.05, 6

# A value that changes by less than this share has settled.
_CLOSE = 1e-5

# Errors are known to this share of the efforts' squares: rounding, where the data are exact.
_EXACT = 1e-18

# Centers of mass farther than this from the best one, m, are starts for local extremes.
_FAR = 0.03

# Masses below, in kg, are none.
NOTHING = 1e-9

# The first moments that a moment of inertia about the center of mass takes away.
_ACROSS = {4: (2, 3), 6: (1, 3), 9: (1, 2)}


class PayloadIntervals:
    """The programs of the extremes.

    Parameters
    ----------
    program : PayloadProgram
        Of the payload.
    theta : ndarray, shape (10,)
        The payload of least cost.
    level : float
        Probability of each interval.
    """

    def __init__(self, program: PayloadProgram, theta: Array, level: float) -> None:
        self.program, self.best, self.level = program, theta, level
        rows = program.rows
        residual = rows.matrix @ theta - rows.rhs
        self.least = float(residual @ residual)
        conic = program.conic
        self.within = replace(conic, M=conic.M[:10], m=conic.m[:10], radius=1.0)
        self.family = ConicFamily(self.within)
        self.starts: list[Array] = [theta]

    def ends(self) -> tuple[Array, Array]:
        """Return lower and upper ends (10,) of mass, center of mass, and inertia about it."""
        lower, upper = np.full(10, -np.inf), np.full(10, np.inf)
        lower[0] = 0.0
        for k in range(4):
            lower[k], upper[k] = self._extreme(k, 1.0, lower[k]), self._extreme(k, -1.0, upper[k])
        for k in range(4, 10):
            lower[k] = self._local(k, 1.0)
            upper[k] = self._largest(k) if k in _ACROSS else self._local(k, -1.0)
        return lower, upper

    def _linear(self, k: int, at: Array) -> Array:
        """Return a linear function of pi that is least or greatest where quantity k is, near `at`.

        Of the center of mass it is zero at `at`; moments are those about its center of mass.
        """
        c = np.zeros(10)
        if k == 0:
            c[0] = 1.0
            return c
        if k < 4:
            c[k], c[0] = 1.0, -at[k] / at[0]
            return c
        return np.asarray(transform(np.eye(10), np.eye(3), -at[1:4] / at[0])[:, k])

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

    def _first_rise(self, c: Array) -> float:
        """Return the rise for a linear function, were there no constraints."""
        moved = np.linalg.lstsq(self.program.rows.matrix.T, c, rcond=None)[0]
        return self._rise(np.asarray(moved, dtype=np.float64))

    def _extreme(self, k: int, sign: float, otherwise: float) -> float:
        """Return the least (sign 1) or greatest (sign -1) mass or coordinate of the center."""
        at = self.best
        if k > 0 and not at[0] > NOTHING:
            return otherwise  # nothing has no center of mass
        rise = self._first_rise(self._linear(k, at))
        value = sign * float(quantities(at)[k])
        for _ in range(_ROUNDS):
            found = self._at(sign * self._linear(k, at) * self.program.units, rise)
            if found is None or not found[0] > NOTHING:
                return otherwise
            rise, kept = self._updated(rise, found)
            new = sign * float(quantities(found)[k])
            settled = kept and abs(new - value) <= _CLOSE * abs(value)
            value, at = new, found
            if settled:
                break
        if k > 0 and abs(value - sign * float(quantities(self.best)[k])) > _FAR:
            self.starts.append(at)
        return sign * value

    def _local(self, k: int, sign: float) -> float:
        """Return the least or greatest moment or product of inertia found from all starts."""
        if not self.best[0] > NOTHING:
            return -sign * np.inf
        value = np.inf
        for start in self.starts:
            at, last = start, np.inf
            rise = self._first_rise(self._linear(k, at))
            for _ in range(_ROUNDS):
                found = self._at(sign * self._linear(k, at) * self.program.units, rise)
                if found is None or not found[0] > NOTHING:
                    break
                rise, kept = self._updated(rise, found)
                new = sign * float(quantities(found)[k])
                value = min(value, new)
                if kept and abs(new - last) <= 1e-3 * abs(new):
                    break
                at, last = found, new
        return sign * value

    def _largest(self, k: int) -> float:
        """Return the largest moment of inertia about the center of mass."""
        if not self.best[0] > NOTHING:
            return np.inf
        first, second = _ACROSS[k]
        linear = np.zeros((5, 3, 3))
        linear[0, 0, 0] = 1.0
        linear[1, 0, 1] = linear[1, 1, 0] = 1.0
        linear[2, 0, 2] = linear[2, 2, 0] = 1.0
        linear[3, 1, 1] = linear[3, 2, 2] = 1.0
        linear[4, 0, 0] = -1.0
        index = np.array([k, first, second, 0, 10])
        conic = self.within

        def wider(matrix: Array) -> Array:
            return np.hstack([matrix, np.zeros((len(matrix), 1))])

        family = ConicFamily(
            replace(
                conic,
                M=wider(conic.M),
                C=wider(conic.C),
                blocks=(*conic.blocks, Matrix(index, linear, np.zeros((3, 3)))),
            )
        )
        cost = np.zeros(11)
        cost[10] = -1.0
        rise = self._first_rise(self._linear(k, self.best))
        value = np.inf
        for _ in range(_ROUNDS):
            found = self._at(cost, rise, family)
            if found is None:
                break
            value = float(quantities(found)[k]) if found[0] > NOTHING else value
            rise, kept = self._updated(rise, found)
            if kept:
                break
        return value

    def _updated(self, rise: float, found: Array) -> tuple[float, bool]:
        """Return the rise for the direction in which an extreme was found, and if it is the same.

        One that is nearly the same is kept, so that iterations end.
        """
        new = self._rise(self.program.rows.matrix @ (found - self.best))
        kept = abs(new - rise) <= _SETTLED * rise
        return (rise if kept else new), kept

    def _at(self, slope: Array, rise: float, family: ConicFamily | None = None) -> Array | None:
        """Return the payload with the least of a linear function, in scaled units, in a level."""
        size = float(np.linalg.norm(slope)) or 1.0
        radius = float(np.sqrt(self.least + rise)) / self.program.cost_unit
        best: Any = None
        for regularization in (1e-10, 1e-8):
            solution = (family or self.family).solve(
                slope / size, radius, regularization=regularization
            )
            self.program.seconds += solution.seconds
            self.program.solves += 1
            if solution.x is not None:
                best = solution.x[:10] * self.program.units
            if "Solved" in solution.status:
                break
        return None if best is None else np.asarray(best)
