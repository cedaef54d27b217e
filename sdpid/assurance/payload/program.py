"""The semidefinite program of a payload: least cost over all bodies that can exist."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.payload.rows import PayloadRows
from sdpid.errors import SolverError
from sdpid.estimation.conic.retry import Retried, solve_with_retries
from sdpid.estimation.conic.solve import ConicProgram, ConicSolution, Matrix, solve_conic
from sdpid.robot.inertia import matrix_basis, physical_parameters, tensor_entries

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
        mass = float(np.clip(fit[0], 0.05, mass_max)) if np.isfinite(fit[0]) else _MASS
        self.units = mass * np.array([1.0, *(_LENGTH,) * 3, *(_LENGTH**2,) * 6])
        self.cost_unit = float(np.sqrt(max(rows.floor, 1e-7 * float(rows.rhs @ rows.rhs), 1e-300)))
        linear = rows.matrix * self.units
        # The mass, and its second moment about the origin, tr(Sigma) = tr(I) / 2.
        C = np.zeros((2, 10))
        C[0, 0] = 1.0
        C[1, 0] = -((extent / _LENGTH) ** 2)
        C[1, _DIAGONAL] = 0.5
        reference = C[0].copy()
        reference[_DIAGONAL] = 0.4
        faint = _FAINT * np.eye(10)
        self.mass = mass
        self.conic = ConicProgram(
            M=np.vstack([linear, faint]) / self.cost_unit,
            m=-np.concatenate([rows.rhs, faint @ reference]) / self.cost_unit,
            C=C,
            lower=np.array([0.0, -np.inf]),
            upper=np.array([mass_max / mass, 0.0]),
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
        found = self.solved(
            lambda regularization: solve_conic(program, regularization=regularization)
        )
        if found.value is None:
            raise SolverError(f"payload: the solver found nothing ({found.status}).")
        return found.value, found.status

    def solved(self, solve: Callable[[float], ConicSolution]) -> Retried[Array]:
        """Return the payload (10,) that a solver finds with some regularization.

        Where no point is called solved, it is the one of the least error.
        """
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
