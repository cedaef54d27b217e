"""Multipliers of the constraints and of the residual: what a lower bound is proven with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.estimation.problem import Problem


@dataclass(frozen=True, kw_only=True, eq=False)
class Multipliers:
    """Multipliers of one problem, in units of the cost.

    Attributes
    ----------
    y : ndarray, shape (rows of `Problem.squared`,)
        Multiplier of `Problem.squared`; at an optimum its residual.
    Z : ndarray, shape (N, s, s)
        Multipliers of the matrix inequalities of `FeasibleSet`, positive semidefinite.
    rows : ndarray, shape (r,)
        Multipliers of the linear rows: positive at the lower limit, negative at the upper one.
    W : ndarray, shape (L, 4, 4)
        Multiplier of `Problem.log_det`, the inverses of pseudo-inertias; L may be zero.
    bounds : ndarray, shape (p,)
        Multipliers of the bounds on theta, signed likewise; zero where they are not included.
    bounds_included : ndarray of bool, shape (p,)
        Whose bounds the solver was given.
    """

    y: Array
    Z: Array
    rows: Array
    W: Array
    bounds: Array
    bounds_included: Mask

    def __repr__(self) -> str:
        bounds = int(np.count_nonzero(self.bounds_included))
        return (
            f"Multipliers({len(self.y)} of the cost, {len(self.Z)} matrices, {len(self.rows)} "
            f"rows, {bounds} of {len(self.bounds)} bounds, {len(self.W)} log-det)"
        )

    @classmethod
    def of_cost(cls, problem: Problem, y: Array, W: Array | None = None) -> Multipliers:
        """Return multipliers of the cost's terms alone; those of the constraints are zero.

        Without W the log-det term's are those of the believed bodies.
        """
        feasible = problem.feasible
        return cls(
            y=y,
            Z=np.zeros_like(feasible.block_constants),
            rows=np.zeros(len(feasible.rows)),
            bounds=np.zeros(problem.n_theta),
            bounds_included=np.zeros(problem.n_theta, dtype=bool),
            W=problem.log_det.inverses if W is None else W,
        )

    @classmethod
    def at(cls, problem: Problem, theta: Array) -> Multipliers:
        """Return the multipliers of the cost's terms at theta, where it is finite."""
        y, W = problem.squared.multiplier(theta), problem.log_det.multiplier(theta)
        return cls.of_cost(problem, y, W)

    @property
    def constrained(self) -> bool:
        """Whether any constraint has a multiplier."""
        return bool(np.any(self.Z) or np.any(self.rows) or np.any(self.bounds))
