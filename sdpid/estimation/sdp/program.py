"""A problem as a cone program in scaled coordinates, and what its solution says of theta."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sdpid._common.arrays import Array, Mask, frozen
from sdpid.errors import SolverError
from sdpid.estimation.conic.solve import ConicFamily, ConicProgram, ConicSolution
from sdpid.estimation.coordinates import FIXED, Coordinates, LinearLimits
from sdpid.estimation.duality.bound import Multipliers, clip_psd
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling, congruent

# Of programs that are solved for other data, in units of the cost: far below what is proven (1e-6),
# and reached without wasting iterations.
_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class SdpProgram:
    """A problem in the coordinates of one scaling.

    Attributes
    ----------
    problem : Problem
        The problem.
    scaling : Scaling
        The units.
    coordinates : Coordinates
        From x to theta.
    bounds_included : ndarray of bool, shape (p,)
        Parameters whose bounds are part of the program, where x can change them.
    limits : LinearLimits
        Of these and of the rows.
    moving : tuple of int
        The matrix inequalities that x can change.
    conic : ConicProgram
        The program.
    """

    problem: Problem
    scaling: Scaling
    coordinates: Coordinates
    bounds_included: Mask
    limits: LinearLimits
    moving: tuple[int, ...]
    conic: ConicProgram

    @classmethod
    def build(
        cls,
        problem: Problem,
        scaling: Scaling,
        coordinates: Coordinates,
        bounds_included: Mask,
        *,
        proximal_weight: float = 0.0,
    ) -> SdpProgram:
        """Build a program.

        Parameters
        ----------
        problem : Problem
            The problem.
        scaling : Scaling
            Units.
        coordinates : Coordinates
            In those units.
        bounds_included : ndarray of bool, shape (p,)
            Parameters whose bounds are part of the program.
        proximal_weight : float, optional
            Weight of ‖x‖² beside the cost.
        """
        n = coordinates.directions.shape[1]
        M, m = _squares(problem, coordinates, scaling.cost)
        if proximal_weight > 0.0:
            M = np.vstack([M, np.sqrt(proximal_weight) * np.eye(n)])
            m = np.concatenate([m, np.zeros(n)])
        limits = LinearLimits(problem, scaling, coordinates, bounds_included)
        blocks = coordinates.inequalities(problem.feasible, scaling)
        moving = [
            i for i, block in enumerate(blocks) if np.abs(block.linear).max(initial=0.0) > FIXED
        ]
        term = problem.log_det
        conic = ConicProgram(
            M=M,
            m=m,
            cost=(term.trace_slope() / scaling.cost) @ coordinates.directions,
            C=limits.C,
            lower=limits.lower,
            upper=limits.upper,
            blocks=tuple(blocks[i] for i in moving),
            log_dets=tuple(coordinates.pseudo_inertias(scaling, term.links)),
            weight=2.0 * term.strength / scaling.cost,
        )
        return cls(problem, scaling, coordinates, bounds_included, limits, tuple(moving), conic)

    def theta(self, solution: ConicSolution) -> Array:
        """Return the standard parameters of a solution that has a point."""
        return self.coordinates.theta(np.asarray(solution.x))

    def multipliers(self, solution: ConicSolution, theta: Array) -> Multipliers:
        """Return the multipliers of a solution in units of the cost.

        Those of the residual are the solver's own, where it has them: what is left of the gradient
        is smaller by orders than with the residual at theta, the point moved inside.
        """
        problem, feasible, scaling = self.problem, self.problem.feasible, self.scaling
        bounds, rows = self.limits.split(scaling.cost * solution.rows / self.limits.sizes)
        Z = np.zeros_like(feasible.block_constants)
        Z[list(self.moving)] = np.reshape(solution.blocks, (-1, *Z.shape[1:]))
        transposed = np.swapaxes(scaling.inverses(feasible), 1, 2)
        Z = clip_psd(scaling.cost * congruent(transposed, Z))
        y = problem.squared.residual(theta)
        if len(solution.residual) >= len(y):
            y = np.asarray(solution.residual[: len(y)] * np.sqrt(scaling.cost))
        exists = np.isfinite(problem.log_det.value(theta))
        if np.any(feasible.equations):
            # What the others leave of the gradient.
            left = problem.gradient(theta) - feasible.adjoint(Z) - bounds - rows @ feasible.rows
            rows[feasible.equations] = self.of_equations(left)
        return Multipliers(
            y=frozen(y),
            Z=frozen(Z),
            rows=frozen(rows),
            W=problem.log_det.multiplier(theta) if exists else problem.log_det.inverses,
            bounds=frozen(bounds),
            bounds_included=np.isin(np.arange(problem.n_theta), self.limits.chosen),
        )

    def of_equations(self, left: Array) -> Array:
        """Return the multipliers of the equations that leave least of a gradient (p,)."""
        feasible, basis = self.problem.feasible, self.scaling.basis()
        equations = feasible.rows[feasible.equations] @ basis
        return np.asarray(np.linalg.lstsq(equations.T, basis.T @ left, rcond=None)[0])


@dataclass(frozen=True, eq=False)
class ReusableProgram:
    """A program that takes other data; it holds no samples, and is small enough to be sent away.

    Attributes
    ----------
    program : SdpProgram
        The program, without the rows of its problem.
    family : ConicFamily
        Its form, of which only the numbers of the squares change.
    """

    program: SdpProgram
    family: ConicFamily

    @classmethod
    def about(
        cls, problem: Problem, theta: Array, cost: float, bounds_included: Mask
    ) -> ReusableProgram:
        """Build a program in the units of the description, about a solution.

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
        scaling, base = Scaling.of(problem), problem.base
        scaling = replace(scaling, cost=max(scaling.cost, cost))
        coordinates = Coordinates.of(problem, scaling.basis(), theta)
        if coordinates is None:
            raise SolverError(
                f"'{problem.robot.name}': the equations among the constraints contradict each "
                "other.",
                problem=problem,
            )
        program = SdpProgram.build(problem, scaling, coordinates, bounds_included)
        pattern = program.conic.M != 0.0
        # Any data mix the rows of the base parameters.
        pattern[: base.count] = np.any(base.matrix @ coordinates.directions, axis=0)
        family = ConicFamily(program.conic, pattern=pattern, tolerance=_TOLERANCE)
        return cls(replace(program, problem=problem.without_rows()), family)

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
        problem = replace(self.program.problem, A=A, rhs=rhs)
        unit = self.program.scaling.cost if cost is None else cost
        squares = _squares(problem, self.program.coordinates, unit)
        return self.family.solve(squares=squares, regularization=regularization)

    def inside(self, theta: Array) -> Mask:
        """Return which parameters (p,) are within their bounds, which the program need not have.

        Those that it has are met but for rounding.
        """
        feasible = self.program.problem.feasible
        within = (theta >= feasible.lower) & (theta <= feasible.upper)
        return np.asarray(self.program.bounds_included | within)


def _squares(problem: Problem, coordinates: Coordinates, cost: float) -> tuple[Array, Array]:
    """Return M and m of the squares of a problem, in units of a cost."""
    unit, term = np.sqrt(cost), problem.squared
    return term.matrix @ coordinates.directions / unit, term.residual(coordinates.origin) / unit
