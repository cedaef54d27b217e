"""A semidefinite program that is solved for other data: only the numbers of its squares change."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.errors import SolverError
from sdpid.estimation.conic.solve import ConicFamily, ConicSolution
from sdpid.estimation.coordinates import Coordinates
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.estimation.sdp.program import SdpProgram

# In units of the cost: far below what is proven (1e-6), and reached without wasting iterations.
_TOLERANCE = 1e-9


def program_about(problem: Problem, theta: Array, cost: float, bounds_included: Mask) -> SdpProgram:
    """Return a problem's program in the units of its description, about a solution.

    Parameters
    ----------
    problem : Problem
        The problem.
    theta : ndarray, shape (p,)
        A solution.
    cost : float
        What it costs: the unit of the cost, where it is not smaller than the scaling's own.
    bounds_included : ndarray of bool, shape (p,)
        Parameters whose bounds are part of the program: at least `FeasibleSet.bounded`.

    Raises
    ------
    SolverError
        When the equations among the constraints contradict each other.
    """
    scaling = Scaling.of(problem)
    scaling = replace(scaling, cost=max(scaling.cost, cost))
    coordinates = Coordinates.of(problem, scaling.basis(), np.array(theta))
    if coordinates is None:
        raise SolverError(
            f"'{problem.robot.name}': the equations among the constraints contradict each other.",
            problem=problem,
        )
    return SdpProgram.build(problem, scaling, coordinates, bounds_included)


@dataclass(frozen=True, eq=False)
class ReusableProgram:
    """A program that takes other data; it holds no samples, and is small enough to be sent away.

    Attributes
    ----------
    family : ConicFamily
        The program.
    coordinates : Coordinates
        From the program's x to theta.
    base : ndarray, shape (b, n)
        From x to base parameters.
    origin : ndarray, shape (b,)
        The base parameters at x = 0.
    prior_matrix, prior_rhs : ndarray, shapes (r, n) and (r,)
        Squares of a prior, in units of the cost's root.
    lower, upper : ndarray, shape (p,)
        Bounds of theta.
    bounds_included : ndarray of bool, shape (p,)
        Parameters whose bounds the program has.
    cost : float
        The unit of the cost.
    """

    family: ConicFamily
    coordinates: Coordinates
    base: Array
    origin: Array
    prior_matrix: Array
    prior_rhs: Array
    lower: Array
    upper: Array
    bounds_included: Mask
    cost: float

    @classmethod
    def of(cls, program: SdpProgram) -> ReusableProgram:
        """Keep what a program needs to be solved for other data."""
        problem, unit = program.problem, float(np.sqrt(program.scaling.cost))
        matrix, count = problem.base.matrix, problem.base.count
        base = np.asarray(matrix @ program.coordinates.directions)
        conic = program.conic
        pattern = conic.M != 0.0
        # Any data mix the rows of `base`.
        pattern[:count] = np.any(base != 0.0, axis=0)
        return cls(
            ConicFamily(conic, pattern=pattern, tolerance=_TOLERANCE),
            program.coordinates,
            base,
            np.asarray(matrix @ program.coordinates.origin),
            conic.M[count:] * unit,
            conic.m[count:] * unit,
            problem.feasible.lower,
            problem.feasible.upper,
            program.bounds_included,
            program.scaling.cost,
        )

    def solve(
        self, A: Array, rhs: Array, *, cost: float | None = None, regularization: float
    ) -> ConicSolution:
        """Solve with the cost ``‖A @ base − rhs‖²`` of other data.

        Parameters
        ----------
        A, rhs : ndarray, shapes (b, b) and (b,)
            Compressed data.
        cost : float, optional
            Another unit of the cost; not with a log-det prior.
        regularization : float
            Of Clarabel.
        """
        unit = float(np.sqrt(self.cost if cost is None else cost))
        squares = (
            np.vstack([A @ self.base, self.prior_matrix]) / unit,
            np.concatenate([A @ self.origin - rhs, self.prior_rhs]) / unit,
        )
        return self.family.solve(squares=squares, regularization=regularization)

    def inside(self, theta: Array) -> Mask:
        """Return which parameters (p,) are within their bounds, which the program need not have.

        Those that it has are met but for rounding.
        """
        return np.asarray(self.bounds_included | ((theta >= self.lower) & (theta <= self.upper)))
