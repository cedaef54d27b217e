"""Terms of a cost: convex functions of theta that solvers add up, the squared and the log-det one.

The cost of a problem is ``squared.value(theta) + log_det.value(theta)``: one `SquaredTerm` with the
rows of the data and of a quadratic prior, and one `LogDetTerm`, which has no links where a prior
has no log-determinants. Each term is also the largest of its affine lower bounds, ``value(theta) =
max over multipliers of constant + linear @ theta``, from which lower bounds on the optimal cost are
made.

The log-det (entropic) divergence of pseudo-inertias P and P0 is ``D(P‖P0) = −log det(P·P0^(-1)) +
tr(P0^(-1)·P) − 4``: twice the Kullback-Leibler divergence of the zero-mean normal distributions
with these covariances, the Bregman divergence of −log det, not negative, zero at P0 alone, infinite
at the boundary of what can exist, and the same in every frame [lee2020]_. Costs are twice nats, as
everywhere here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from sdpid._common.arrays import Array, Indices, frozen
from sdpid.errors import DataError
from sdpid.estimation.conic.solve import symmetric_basis
from sdpid.robot.inertia import from_pseudo_inertia, matrix_basis, pseudo_inertia

# The pseudo-inertia's coordinates: E_k with P(theta) = Σ theta_k·E_k.
_UNITS = matrix_basis("pseudo_inertia")


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

    def support(self, multiplier: ArrayLike) -> tuple[float, Array]:
        """Return the affine lower bound ``2·y·(matrix @ theta − rhs) − ‖y‖² + constant``.

        Parameters
        ----------
        multiplier : array_like, shape (k,)
            Any y; the residual at theta makes it tight there.
        """
        y = np.asarray(multiplier, dtype=np.float64)
        constant = self.constant - float(y @ y) - 2.0 * float(y @ self.rhs)
        return constant, 2.0 * self.transposed(y)


def pullback_rows(P: Array) -> Array:
    """Return the rows (10, 10) whose squares are ``‖L^(-1)·X·L^(-T)‖²`` of a body X, P = L·L^T."""
    inverse = np.linalg.inv(np.linalg.cholesky(P))
    units = inverse @ _UNITS @ inverse.T
    return np.asarray(np.einsum("aij,kij->ak", symmetric_basis(4), units))


@dataclass(frozen=True, eq=False)
class LogDetTerm:
    """``2·strength·Σ D(P_i‖P0_i)`` over some links, as a function of theta; zero over no links.

    Attributes
    ----------
    links : ndarray of int, shape (L,)
        The links that are believed to be near a body; link i is ``theta[10·i : 10·i + 10]``.
    inverses : ndarray, shape (L, 4, 4)
        P0^(-1) of each, positive definite.
    strength : float
        Factor on the divergence, nats.
    n_theta : int
        Size p of theta.

    Raises
    ------
    DataError
        When an inverse is not positive definite, or shapes do not fit.
    """

    links: Indices
    inverses: Array
    strength: float
    n_theta: int

    def __post_init__(self) -> None:
        links, inverses = np.array(self.links, dtype=np.intp), frozen(self.inverses)
        links.setflags(write=False)
        if inverses.shape != (len(links), 4, 4):
            raise DataError(
                f"log-det term: inverses have shape {inverses.shape}, expected "
                f"{(len(links), 4, 4)}."
            )
        if not self.strength > 0.0:
            raise DataError(f"log-det term: strength is {self.strength}; give a positive number.")
        object.__setattr__(self, "links", links)
        object.__setattr__(self, "inverses", inverses)
        _cholesky(inverses, "P0^(-1)")

    @classmethod
    def around(
        cls, links: ArrayLike, bodies: ArrayLike, strength: float, n_theta: int
    ) -> LogDetTerm:
        """Build from the believed bodies (L, 10), each of which must be able to exist."""
        roots = _cholesky(pseudo_inertia(bodies), "the pseudo-inertia of a believed body")
        inverses = np.linalg.inv(roots)
        inverses = np.swapaxes(inverses, 1, 2) @ inverses
        return cls(np.asarray(links, dtype=np.intp), inverses, strength, n_theta)

    @classmethod
    def none(cls, n_theta: int) -> LogDetTerm:
        """Return the term over no links, which is zero."""
        return cls(np.zeros(0, dtype=np.intp), np.zeros((0, 4, 4)), 1.0, n_theta)

    @cached_property
    def roots(self) -> Array:
        """C of each link with P0^(-1) = C·C^T, shape (L, 4, 4)."""
        return frozen(_cholesky(self.inverses, "P0^(-1)"))

    @cached_property
    def log_det(self) -> Array:
        """Logarithm of det P0^(-1) of each link, shape (L,)."""
        return frozen(2.0 * np.log(np.diagonal(self.roots, axis1=1, axis2=2)).sum(axis=1))

    def matrices(self, theta: ArrayLike) -> Array:
        """Return the pseudo-inertias of the believed links, shape (L, 4, 4)."""
        values = np.asarray(theta, dtype=np.float64).reshape(-1)
        return pseudo_inertia(values[self._entries])

    @property
    def _entries(self) -> Indices:
        return np.asarray(10 * self.links[:, None] + np.arange(10))

    def divergences(self, theta: ArrayLike) -> Array:
        """Return D of each link, nats, shape (L,); infinite where the body cannot exist."""
        ratios = np.swapaxes(self.roots, 1, 2) @ self.matrices(theta) @ self.roots
        values = np.linalg.eigvalsh(ratios)
        inside = values[:, 0] > 0.0
        # Term by term each is not negative, and exact to rounding near P0 as well.
        values = np.where(inside[:, None], values, 1.0)
        return np.where(inside, (values - 1.0 - np.log(values)).sum(axis=1), np.inf)

    def value(self, theta: ArrayLike) -> float:
        """Return the cost of theta (p,) or of bodies (links, 10); infinite outside the cone."""
        if not len(self.links):
            return 0.0
        return 2.0 * self.strength * float(self.divergences(theta).sum())

    def center(self) -> Array:
        """Return theta (p,) with the believed bodies P0, all else zero."""
        out = np.zeros(self.n_theta)
        out[self._entries] = from_pseudo_inertia(np.linalg.inv(self.inverses))
        return out

    def multiplier(self, theta: ArrayLike) -> Array:
        """Return P^(-1) of the believed links, shape (L, 4, 4): where `support` is tight.

        Raises
        ------
        DataError
            When one of the bodies cannot exist.
        """
        roots = np.linalg.inv(_cholesky(self.matrices(theta), "the pseudo-inertia of a body"))
        return np.asarray(np.swapaxes(roots, 1, 2) @ roots)

    def gradient(self, theta: ArrayLike) -> Array:
        """Return the derivative of `value`, ``2·strength·⟨P0^(-1) − P^(-1), E_k⟩``, shape (p,).

        Raises
        ------
        DataError
            When one of the bodies cannot exist.
        """
        return self._linear(self.multiplier(theta))

    def curvature_rows(self, theta: ArrayLike) -> Array:
        """Return R, shape (10·L, p), with R^T·R half the second derivative of `value` at theta.

        As rows of a quadratic cost they are its second-order expansion: ``value(theta + d) ≈
        value(theta) + gradient·d + ‖R·d‖²``. At P0 they are those of the constant pullback.

        Raises
        ------
        DataError
            When one of the bodies cannot exist.
        """
        matrices = self.matrices(theta)
        _cholesky(matrices, "the pseudo-inertia of a body")
        out = np.zeros((len(self.links), 10, self.n_theta))
        for rows, own, P in zip(out, self._entries, matrices, strict=True):
            rows[:, own] = pullback_rows(P)
        return np.asarray(np.sqrt(self.strength) * out.reshape(-1, self.n_theta))

    def support(self, multiplier: ArrayLike) -> tuple[float, Array]:
        """Return an affine function that `value` is nowhere below.

        From ``−log det P ≥ log det W + 4 − tr(W·P)`` for any positive definite W and every P in
        the cone, with equality at W = P^(-1) (the conjugate of −log det [boyd2004]_):
        ``value(theta) ≥ constant + linear @ theta`` with constant ``2·strength·Σ (log det W_i −
        log det P0_i^(-1))`` and linear ``2·strength·⟨P0_i^(-1) − W_i, E_k⟩``.

        Parameters
        ----------
        multiplier : array_like, shape (L, 4, 4)
            W, positive definite.

        Returns
        -------
        constant : float
        linear : ndarray, shape (p,)

        Raises
        ------
        DataError
            When a W is not positive definite.
        """
        matrices = np.asarray(multiplier, dtype=np.float64)
        if matrices.shape != self.inverses.shape:
            raise DataError(
                f"log-det term: W has shape {matrices.shape}, expected {self.inverses.shape}."
            )
        diagonal = np.diagonal(_cholesky(matrices, "W"), axis1=1, axis2=2)
        gained = 2.0 * np.log(diagonal).sum(axis=1) - self.log_det
        return 2.0 * self.strength * float(gained.sum()), self._linear(matrices)

    def trace_slope(self) -> Array:
        """Return the slope of the linear part, ``2·strength·Σ tr(P0_i^(-1)·P_i)``, shape (p,)."""
        return self._linear(np.zeros_like(self.inverses))

    def _linear(self, W: Array) -> Array:
        """Return ``2·strength·⟨P0_i^(-1) − W_i, E_k⟩`` as a vector over theta."""
        out = np.zeros(self.n_theta)
        products = np.einsum("lij,kij->lk", self.inverses - W, _UNITS)
        out[self._entries] = 2.0 * self.strength * products
        return out


def _cholesky(matrices: Array, name: str) -> Array:
    """Return lower triangular roots of matrices (L, 4, 4), or say which has none."""
    try:
        return np.asarray(np.linalg.cholesky(matrices))
    except np.linalg.LinAlgError:
        values = np.linalg.eigvalsh(matrices)[:, 0]
        worst = int(np.argmin(values))
        raise DataError(
            f"log-det term: {name} number {worst} is not positive definite (smallest eigenvalue "
            f"{values[worst]:.2e}); the divergence is only defined for bodies that can exist."
        ) from None
