"""Terms of a cost: convex functions of theta that solvers add up; and the squared one.

The cost of a problem is ``squared.value(theta) + log_det.value(theta)``: one `SquaredTerm` with the
rows of the data and of a quadratic prior, and one `LogDetTerm` (`sdpid.estimation.prior.log_det`),
which has no links where a prior has no log-determinants. Each term is also the largest of its
affine lower bounds, ``value(theta) = max over multipliers of constant + linear @ theta``, from
which lower bounds on the optimal cost are made.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, frozen
from sdpid.estimation.conic.solve import symmetric_basis
from sdpid.robot.inertia import matrix_basis


@dataclass(frozen=True, eq=False)
class SquaredTerm:
    """``‖matrix @ theta − rhs‖² + constant``.

    Attributes
    ----------
    matrix : ndarray, shape (k, p)
    rhs : ndarray, shape (k,)
    constant : float
    factors : (ndarray, ndarray) or None
        A (b, b) and B (b, p) with A·B the first b rows of the matrix. Where they are known,
        products go through B·theta, so that directions that B does not see vanish exactly.
    """

    matrix: Array
    rhs: Array
    constant: float = 0.0
    factors: tuple[Array, Array] | None = None

    @classmethod
    def stacked(cls, first: SquaredTerm, others: Sequence[SquaredTerm]) -> SquaredTerm:
        """Return the sum of squared terms as one; only the first may have factors."""
        if not others:
            return first
        every = (first, *others)
        return cls(
            frozen(np.vstack([term.matrix for term in every])),
            frozen(np.concatenate([term.rhs for term in every])),
            sum(term.constant for term in every),
            first.factors,
        )

    def residual(self, theta: ArrayLike) -> Array:
        """Return ``matrix @ theta − rhs``, shape (k,)."""
        values = np.asarray(theta, dtype=np.float64)
        if self.factors is None:
            return np.asarray(self.matrix @ values - self.rhs)
        A, B = self.factors
        rest = self.matrix[len(A) :] @ values
        return np.asarray(np.concatenate([A @ (B @ values), rest]) - self.rhs)

    def transposed(self, y: ArrayLike) -> Array:
        """Return ``matrix^T @ y``, shape (p,)."""
        values = np.asarray(y, dtype=np.float64)
        if self.factors is None:
            return np.asarray(self.matrix.T @ values)
        A, B = self.factors
        count = len(A)
        out = B.T @ (A.T @ values[:count])
        return np.asarray(out + self.matrix[count:].T @ values[count:])

    def value(self, theta: ArrayLike) -> float:
        """Return the term's cost."""
        residual = self.residual(theta)
        return float(residual @ residual) + self.constant

    def gradient(self, theta: ArrayLike) -> Array:
        """Return ``2·matrix^T @ residual``, shape (p,)."""
        return 2.0 * self.transposed(self.residual(theta))

    def curvature_rows(self, theta: ArrayLike) -> Array:
        """Return the matrix, whatever theta."""
        return self.matrix

    def multiplier(self, theta: ArrayLike) -> Array:
        """Return the residual y at theta, shape (k,)."""
        return self.residual(theta)

    def support(self, multiplier: ArrayLike) -> tuple[float, Array]:
        """Return the affine lower bound ``2·y·(matrix @ theta − rhs) − ‖y‖² + constant``.

        Parameters
        ----------
        multiplier : array_like, shape (k,)
            Any y.
        """
        y = np.asarray(multiplier, dtype=np.float64)
        constant = self.constant - float(y @ y) - 2.0 * float(y @ self.rhs)
        return constant, 2.0 * self.transposed(y)


def pullback_rows(P: Array) -> Array:
    """Return the rows (10, 10) whose squares are ``‖L^(-1)·X·L^(-T)‖²`` of a body X, P = L·L^T."""
    inverse = np.linalg.inv(np.linalg.cholesky(P))
    units = inverse @ matrix_basis("pseudo_inertia") @ inverse.T
    return np.asarray(np.einsum("aij,kij->ak", symmetric_basis(4), units))
