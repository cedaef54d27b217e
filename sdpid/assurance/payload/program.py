"""The semidefinite program of a payload: the best of all bodies that can exist, and intervals.

For each quantity f the interval is the range of f over the payloads pi that can exist and have
``‖matrix·pi − rhs‖² ≤ least + rise``. The rise follows the direction that pi moves in, by the
variance that the recordings show for it (see `sdpid.assurance.intervals.level`): for
a linear f without active constraints it is Gauss-Markov's interval.

* The mass is linear: one program each way.
* The center of mass h/m ≤ c means h − c·m ≤ 0: Dinkelbach's iteration on c finds the global
  extreme [dinkelbach1967]_.
* The inertia about the center of mass is linear to first order: it is that about the center of
  mass of the best payload (the delta method, within what bodies can have).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.payload.rows import PayloadRows
from sdpid.errors import SolverError
from sdpid.estimation.conic.solve import (
    ConicFamily,
    ConicProgram,
    ConicSolution,
    Matrix,
    Retried,
    solve_conic,
    solve_with_retries,
)
from sdpid.robot.inertia import matrix_basis, physical_parameters, tensor_entries, transform

# Numbers of order one: a payload's length, m, and its mass where the data have none, kg.
_LENGTH, _MASS = 0.1, 1.0

# Pull towards a ball, in whitened units: it decides where the data say nothing, and changes what
# they do say by less than a ten-thousandth of a standard deviation.
_FAINT = 1e-4

# Clarabel's regularizations, in turn until it calls a point solved.
_REGULARIZATIONS = (1e-10, 1e-8)

# Of osmium, kg/m³: nothing is denser.
_DENSITY = 22_590.0

# Where Ixx, Iyy and Izz stand among the ten parameters.
_DIAGONAL = [4, 6, 9]

# The level follows the direction in which the extreme lies; within this share it has settled.
_SETTLED, _ROUNDS = 0.05, 6

# A center of mass that changes by less than this share has settled.
_CLOSE = 1e-5

# Errors are known to this share of the efforts' squares: rounding, where the data are exact.
_EXACT = 1e-18

# Masses below, in kg, are none.
NOTHING = 1e-9

QUANTITIES = ("mass", "com_x", "com_y", "com_z", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
QUANTITY_UNITS = ("kg", *("m",) * 3, *("kg.m2",) * 6)


def least_second_moment(mass: float) -> float:
    """Return the second moment, kg·m², that no body of a mass in kg can have less of everywhere.

    That of a ball of the densest matter: a body may be thinner in one direction and wider in
    others, as a plate is, but tools and workpieces are not.
    """
    radius = float(np.cbrt(3.0 * mass / (4.0 * np.pi * _DENSITY)))
    return mass * radius**2 / 5.0


def quantities(theta: Array) -> Array:
    """Return mass, center of mass, and inertia about it (entries in theta's order), (10,)."""
    mass, com, inertia = physical_parameters(theta)
    return np.concatenate([[float(mass)], com, tensor_entries(inertia)])


class PayloadProgram:
    """The semidefinite program of one payload.

    Parameters
    ----------
    rows : PayloadRows
        The cost.
    mass_max : float
        Largest mass, kg.
    extent : float
        Largest rms distance of the payload's mass from the frame's origin, m.
    """

    def __init__(self, rows: PayloadRows, mass_max: float, extent: float) -> None:
        self.rows = rows
        fit = np.linalg.lstsq(rows.matrix, rows.rhs, rcond=None)[0]
        self.mass = float(np.clip(fit[0], 0.05, mass_max)) if np.isfinite(fit[0]) else _MASS
        self.units = self.mass * np.array([1.0, *(_LENGTH,) * 3, *(_LENGTH**2,) * 6])
        self.cost_unit = float(np.sqrt(max(rows.floor, 1e-7 * float(rows.rhs @ rows.rhs), 1e-300)))
        # The mass, and its second moment about the origin, tr(Sigma) = tr(I) / 2.
        C = np.zeros((2, 10))
        C[0, 0] = 1.0
        C[1, 0] = -((extent / _LENGTH) ** 2)
        C[1, _DIAGONAL] = 0.5
        reference = C[0].copy()
        reference[_DIAGONAL] = 0.4
        faint = _FAINT * np.eye(10)
        self.conic = ConicProgram(
            M=np.vstack([rows.matrix * self.units, faint]) / self.cost_unit,
            m=-np.concatenate([rows.rhs, faint @ reference]) / self.cost_unit,
            C=C,
            lower=np.array([0.0, -np.inf]),
            upper=np.array([mass_max / self.mass, 0.0]),
            blocks=(self._bodies(0.0),),
        )

    def _bodies(self, least: float) -> Matrix:
        """Return the bodies whose second moments about their centers of mass are no less."""
        shift = least / (self.mass * _LENGTH**2)
        return Matrix(
            np.arange(10), matrix_basis("pseudo_inertia"), -np.diag([shift, shift, shift, 0.0])
        )

    def solve(self, least: float = 0.0) -> tuple[Array, str]:
        """Return the payload (10,) of least cost, and the status of the solver.

        Parameters
        ----------
        least : float, optional
            Least second moment about the center of mass in any direction, kg·m².

        Raises
        ------
        SolverError
            When it finds none.
        """
        program = replace(self.conic, blocks=(self._bodies(least),))
        found = self._retried(partial(solve_conic, program))
        if found.value is None:
            raise SolverError(f"payload: the solver found nothing ({found.status}).")
        return found.value, found.status

    def _retried(self, solve: Callable[[float], ConicSolution]) -> Retried[Array]:
        """Return the payload (10,) found; where none is called solved, that of the least error."""
        return solve_with_retries(
            solve,
            _REGULARIZATIONS,
            lambda x, solution: (x * self.units, 0.0 if solution.solved else solution.error),
        )

    def cost(self, theta: Array) -> float:
        """Return the cost of a payload."""
        residual = self.rows.matrix @ theta - self.rows.rhs
        return float(residual @ residual) + self.rows.floor

    def shown(self, theta: Array, level: float) -> bool:
        """Return whether the recordings distinguish the payload from none.

        No payload at all is the tip of the cone of what matter can be; the cost that it has more
        than the best one is, without any, at most distributed as chi-square of ten degrees.
        """
        from scipy.stats import chi2

        moved = self.rows.matrix @ theta
        size = float(np.linalg.norm(moved))
        if not size > 0.0:
            return False
        variance, _ = self.rows.error(moved / size)
        gain = self.cost(np.zeros(10)) - self.cost(theta)
        return bool(gain > variance * float(chi2.ppf(level, 10)))

    def intervals(self, best: Array, level: float) -> tuple[Array, list[str]]:
        """Return lower and upper ends (10, 2) of mass, center of mass, and inertia about it.

        With the names of quantities of which an end is only the best that the solver came to.

        Parameters
        ----------
        best : ndarray, shape (10,)
            The payload of least cost.
        level : float
            Probability of each interval.
        """
        ends, unsolved = np.tile([-np.inf, np.inf], (10, 1)), {}
        ends[0, 0] = 0.0
        family = ConicFamily(
            replace(self.conic, M=self.conic.M[:10], m=self.conic.m[:10], radius=1.0)
        )
        # Nothing has no center of mass, and no inertia about it.
        for k in range(10 if best[0] > NOTHING else 1):
            for side, sign in enumerate((1.0, -1.0)):
                found = self._extreme(family, k, sign, best, level)
                if found is not None:
                    ends[k, side] = found[0]
                    if not found[1]:
                        unsolved[QUANTITIES[k]] = side
        return ends, list(unsolved)

    def gains_share(self, best: Array) -> Array:
        """Return the share (10,) of the gains' errors in each variance, inequalities aside."""
        rows, found = self.rows, np.zeros(10)
        for k in range(10 if best[0] > NOTHING else 1):
            direction = self._unconstrained(_functional(k, best, best))
            variance, _ = rows.error(direction)
            own, _ = rows.error(direction, rows.gains)
            found[k] = own / variance if variance > 0.0 else 0.0
        return found

    def _unconstrained(self, functional: Array) -> Array:
        """Return how rhs moves a function of pi, were there no constraints, (10,)."""
        found = np.linalg.lstsq(self.rows.matrix.T, functional, rcond=None)[0]
        return np.asarray(found, dtype=np.float64)

    def _rise(self, moved: Array, level: float) -> float:
        """Return the rise of the cost for an extreme at which the residual has moved like this."""
        from scipy.stats import t

        size = float(np.linalg.norm(moved))
        direction = moved / size if size > 0.0 else np.full(10, np.sqrt(0.1))
        variance, freedom = self.rows.error(direction)
        quantile = float(t.ppf(0.5 * (1.0 + level), freedom))
        return max(quantile**2 * variance, _EXACT * float(self.rows.rhs @ self.rows.rhs))

    def _extreme(
        self, family: ConicFamily, k: int, sign: float, best: Array, level: float
    ) -> tuple[float, bool] | None:
        """Return the least (sign 1) or greatest (sign -1) value of quantity k, and if it is solved.

        None where the recordings leave it open.
        """
        of_center, value, least = 0 < k < 4, np.inf, self.cost(best) - self.rows.floor
        c = _functional(k, best, best)
        rise = self._rise(self._unconstrained(c), level)
        for _ in range(_ROUNDS):
            slope = sign * c * self.units
            slope /= float(np.linalg.norm(slope)) or 1.0
            radius = float(np.sqrt(least + rise)) / self.cost_unit
            end = self._retried(partial(family.solve, slope, radius))
            found = end.value
            if found is None or not found[0] > NOTHING:
                return None
            before, value = value, sign * float(found[k] / found[0] if of_center else c @ found)
            # A rise that is nearly the same is kept, so that iterations end.
            new = self._rise(self.rows.matrix @ (found - best), level)
            if abs(new - rise) > _SETTLED * rise:
                rise = new
            elif not of_center or abs(value - before) <= _CLOSE * abs(value):
                break
            c = _functional(k, found, best)
        return sign * value, end.accepted


def _functional(k: int, at: Array, best: Array) -> Array:
    """Return a linear function of pi whose extreme is that of quantity k.

    For the center of mass it is zero at the payload `at`; the inertia is that about the best
    payload's center of mass.
    """
    if k >= 4:
        return np.asarray(transform(np.eye(10), np.eye(3), -best[1:4] / best[0])[:, k])
    c: Array = np.eye(10)[k]
    c[0] -= at[k] / at[0] if k else 0.0
    return c
