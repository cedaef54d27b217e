"""A problem as a cone program in scaled coordinates, and what its solution says of theta."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask, frozen
from sdpid.estimation.conic.solve import ConicProgram, ConicSolution, Matrix
from sdpid.estimation.coordinates import FIXED, Coordinates
from sdpid.estimation.duality.bound import clip_psd
from sdpid.estimation.duality.multipliers import Multipliers
from sdpid.estimation.problem import Problem
from sdpid.estimation.scaling import Scaling
from sdpid.estimation.wls import solve_wls
from sdpid.robot.inertia import pseudo_inertia


def best_fit(problem: Problem, scaling: Scaling) -> Array:
    """Return standard parameters whose base parameters fit best, smallest in scaled size."""
    basis = scaling.basis()
    if problem.prior is not None:
        squared = problem.squared
        scaled = squared.matrix @ basis
        return np.asarray(basis @ np.linalg.lstsq(scaled, squared.rhs, rcond=None)[0])
    target = solve_wls(problem).base
    return np.asarray(basis @ np.linalg.lstsq(problem.base.matrix @ basis, target, rcond=None)[0])


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
    bounded : ndarray of int
        The parameters whose bounds are part of the program.
    bounds_included : ndarray of bool, shape (p,)
        Those of them whose bounds are the problem's.
    moving : ndarray of int
        The matrix inequalities that x can change.
    inverses : ndarray, shape (N, s, s)
        From matrices to scaled ones.
    conic : ConicProgram
        The program.
    """

    problem: Problem
    scaling: Scaling
    coordinates: Coordinates
    bounded: Indices
    bounds_included: Mask
    moving: Indices
    inverses: Array
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
        feasible = problem.feasible
        x, origin = coordinates.directions, coordinates.origin
        unit = np.sqrt(scaling.cost)
        M, m = problem.squared.matrix @ x / unit, problem.squared.residual(origin) / unit
        if proximal_weight > 0.0:
            M = np.vstack([M, np.sqrt(proximal_weight) * np.eye(x.shape[1])])
            m = np.concatenate([m, np.zeros(x.shape[1])])
        bounded = np.flatnonzero(bounds_included & np.any(x != 0.0, axis=1))
        size = scaling.theta[bounded]
        unequal = coordinates.limited(problem, scaling)
        rows, sizes = feasible.rows[unequal], scaling.row_sizes(feasible)[unequal]
        C = [x[bounded] / size[:, None], rows @ x / sizes[:, None]]
        lower = [
            (feasible.lower - origin)[bounded] / size,
            (feasible.row_lower[unequal] - rows @ origin) / sizes,
        ]
        upper = [
            (feasible.upper - origin)[bounded] / size,
            (feasible.row_upper[unequal] - rows @ origin) / sizes,
        ]
        inverses = np.asarray(np.linalg.inv(scaling.block_roots(feasible)))
        blocks = coordinates.inequalities(feasible, inverses)
        moving = [
            i for i, block in enumerate(blocks) if np.abs(block.linear).max(initial=0.0) > FIXED
        ]
        cost, log_dets, weight = _log_dets(problem, scaling, coordinates)
        conic = ConicProgram(
            M=M,
            m=m,
            cost=cost,
            C=np.vstack(C),
            lower=np.concatenate(lower),
            upper=np.concatenate(upper),
            blocks=tuple(blocks[i] for i in moving),
            log_dets=log_dets,
            weight=weight,
        )
        return cls(
            problem,
            scaling,
            coordinates,
            bounded,
            bounds_included,
            np.array(moving, dtype=np.intp),
            inverses,
            conic,
        )

    def theta(self, solution: ConicSolution) -> Array:
        """Return the standard parameters of a solution that has a point."""
        return self.coordinates.theta(np.asarray(solution.x))

    def multipliers(self, solution: ConicSolution, theta: Array) -> Multipliers:
        """Return the multipliers of a solution in units of the cost.

        Those of the residual are the solver's own, where it has them: what is left of the gradient
        is smaller by orders than with the residual at theta, the point moved inside.
        """
        problem, feasible, scaling = self.problem, self.problem.feasible, self.scaling
        count = len(self.bounded)
        bounds = np.zeros(problem.n_theta)
        included = np.zeros(problem.n_theta, dtype=bool)
        bounds[self.bounded] = scaling.cost * solution.rows[:count] / scaling.theta[self.bounded]
        included[self.bounded] = True
        rows = np.zeros(len(feasible.rows))
        unequal = self.coordinates.limited(problem, scaling)
        rows[unequal] = scaling.cost * solution.rows[count:] / scaling.row_sizes(feasible)[unequal]
        Z = np.zeros_like(feasible.block_constants)
        for i, dual in zip(self.moving, solution.blocks, strict=True):
            Z[i] = scaling.cost * self.inverses[i].T @ dual @ self.inverses[i]
        Z = clip_psd(Z)
        if np.any(feasible.equations):
            rows[feasible.equations] = self._of_equations(theta, Z, bounds, rows)
        y = problem.squared.residual(theta)
        if len(solution.residual) >= len(y):
            y = np.asarray(solution.residual[: len(y)] * np.sqrt(scaling.cost))
        exists = np.isfinite(problem.log_det.value(theta))
        return Multipliers(
            y=frozen(y),
            Z=frozen(Z),
            rows=frozen(rows),
            W=problem.log_det.multiplier(theta) if exists else problem.log_det.inverses,
            bounds=frozen(bounds),
            bounds_included=included,
        )

    def _of_equations(self, theta: Array, Z: Array, bounds: Array, rows: Array) -> Array:
        """Return the multipliers of the equations: what the others leave of the gradient."""
        problem, feasible = self.problem, self.problem.feasible
        left = problem.gradient(theta) - feasible.adjoint(Z)
        left = left - bounds - rows @ feasible.rows
        basis = self.scaling.basis()
        equations = feasible.rows[feasible.equations] @ basis
        return np.asarray(np.linalg.lstsq(equations.T, basis.T @ left, rcond=None)[0])


def _log_dets(
    problem: Problem, scaling: Scaling, coordinates: Coordinates
) -> tuple[Array, tuple[Matrix, ...], float]:
    """Return linear cost, matrices and weight of the log-det term."""
    term = problem.log_det
    inverses = np.linalg.inv(scaling.roots(4)[term.links])
    units = np.broadcast_to(pseudo_inertia(np.eye(10)), (len(inverses), 10, 4, 4))
    matrices = coordinates.matrices(
        np.zeros_like(inverses),
        inverses[:, None] @ units @ np.swapaxes(inverses, 1, 2)[:, None],
        term.links,
    )
    slope = term.trace_slope() / scaling.cost
    return slope @ coordinates.directions, tuple(matrices), 2.0 * term.strength / scaling.cost
