"""Cone programs that look for weights of base parameters which contradict a table.

Everything here is in floating point and only proposes; `Refutation` decides in exact arithmetic.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.assurance.tables.facial_reduction import Face
from sdpid.assurance.tables.witness_search import Search
from sdpid.verifier.realizable import coefficient_matrices

# Gap and residuals at which the solver stops.
_TOLERANCE = 1e-10

# C and Q of each of a link's ten coefficients, (10, 3, 3) and (10, 4, 4).
_UNIT_MATRICES = tuple(
    np.array([coefficient_matrices(row)[i] for row in np.eye(10, dtype=int).tolist()], dtype=float)
    for i in (0, 1)
)


@dataclass(frozen=True, eq=False)
class Weights:
    """Weights that a program found.

    Attributes
    ----------
    face : Face
        Where they lie.
    free : ndarray
        The free weights.
    masses : ndarray, shape (links,) or (0,)
        Multipliers of the bound on masses.
    violation : float
        By how much the table contradicts the inequality that they make.
    """

    face: Face
    free: Array
    masses: Array
    violation: float

    def support(self) -> Array:
        """Return the weights over the support."""
        return np.asarray(self.face.matrix() @ self.free)


class WeightProgram:
    """The weights of a face whose inequality all links obey that can exist, as a cone.

    Parameters
    ----------
    search : Search
        The question.
    face : Face
        Which weights there may be.
    mass_bound : bool
        Whether the bound on masses may be used.
    norm : ndarray, optional
        Scale of the weights over the support, ``Σ norm·|weight| ≤ 1``. Without it they are scaled
        such that their inequality bounds the margin.
    """

    def __init__(
        self, search: Search, face: Face, *, mass_bound: bool, norm: Array | None = None
    ) -> None:
        import cvxpy as cp

        q, M, L = search.question, search.scaling.mass, search.scaling.length
        support, links = list(face.support), q.n_links
        self.face, self._cp = face, cp
        # Free weights in units of their own row's size, multipliers of masses in those of one over
        # the mass of a scale.
        self._unit = M * search.unit[list(face.free)]
        self._mass, self._free = M, cp.Variable(len(face.free))
        self._masses = cp.Variable(links, nonneg=True) if mass_bound else None
        self._interior = cp.Variable(nonneg=True)
        N = face.matrix() / self._unit
        coefficients = search.R[support].T @ N
        self._weights = N @ self._free
        traces = coefficients[: 10 * links].reshape(links, 10, -1)[:, [4, 6, 9]].sum(axis=(0, 1))
        spread = (2.0 if q.consistency == "pseudo_inertia" else 1.0) * (traces @ self._free)
        self._violation = (
            float(q.margin) * spread
            - search.value[support] @ self._weights
            - search.half[support] @ cp.abs(self._weights)
        )
        if self._masses is not None:
            self._violation -= float(q.mass_max) / M * cp.sum(self._masses)
        signed = [j for j in sorted(q.nonnegative) if np.any(coefficients[j] != 0.0)]
        self._cone = [self._interior <= 1.0]
        if signed:
            scaled = search.scaling.theta[signed][:, None] * coefficients[signed]
            self._cone.append(scaled @ self._free >= self._interior)
        scale = np.sqrt(M) * np.array([L, L, L, 1.0])
        for link, both in enumerate(face.alive):
            for unit, rows in zip(_UNIT_MATRICES, both, strict=True):
                if rows:
                    own = coefficients[10 * link : 10 * link + 10]
                    part = unit[:, rows][:, :, rows] * np.outer(scale[rows], scale[rows])
                    self._cone.append(self._definite(part, own, link if len(unit[0]) == 4 else -1))
        if norm is None:
            self._scale = M * L**2 * spread == 1.0
        else:
            self._scale = norm @ cp.abs(self._weights) <= 1.0

    def _definite(self, part: Array, coefficients: Array, link: int) -> Any:
        """Return the constraint on a matrix of a link, with its mass's multiplier if one is due."""
        cp, size = self._cp, part.shape[1]
        flat = part.reshape(10, -1).T @ coefficients
        matrix = cp.reshape(flat @ self._free, (size, size), order="C")
        if self._masses is not None and link >= 0:
            corner = np.zeros((size, size))
            corner[-1, -1] = 1.0
            matrix = matrix + self._masses[link] * corner
        return matrix - self._interior * np.eye(size) >> 0

    def most_contradicting(self) -> Weights | None:
        """Return the weights that the table contradicts most."""
        cp = self._cp
        return self._solved(cp.Maximize(self._violation), self._scale, self._interior == 0.0)

    def most_interior(self, least: float) -> Weights | None:
        """Return the weights farthest inside the cone that the table contradicts by `least`."""
        cp = self._cp
        return self._solved(cp.Maximize(self._interior), self._scale, self._violation >= least)

    def cheapest(self, cost: Array, least: float) -> Weights | None:
        """Return the weights of least ``Σ cost·|weight|`` that the table contradicts by `least`."""
        objective = self._cp.Minimize(cost @ self._cp.abs(self._weights))
        return self._solved(objective, self._violation >= least, self._interior == 0.0)

    def _solved(self, objective: Any, *constraints: Any) -> Weights | None:
        if not _solves(objective, [*self._cone, *constraints]):
            return None
        masses = np.zeros(0) if self._masses is None else self._masses.value / self._mass
        return Weights(
            self.face,
            np.asarray(self._free.value / self._unit),
            np.maximum(masses, 0.0),
            float(self._violation.value),
        )


def _solves(objective: Any, constraints: list[Any]) -> bool:
    """Solve a CVXPY problem; return whether its variables have values, accurate or not."""
    import cvxpy as cp

    program = cp.Problem(objective, constraints)
    limits = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), _TOLERANCE)
    with warnings.catch_warnings():
        # What is found is checked in exact arithmetic: it need not be accurate.
        warnings.simplefilter("ignore")
        try:
            # Numbers are of order one as they are: scaled again they lose digits.
            program.solve(solver=cp.CLARABEL, equilibrate_enable=False, **limits)
        except cp.error.SolverError:
            return False
    return all(variable.value is not None for variable in program.variables())
