"""How the fitted rows of a program move with its data, and the degrees of freedom they spend.

The least-squares problem ``minimize ‖M·x − h‖²`` over a convex set projects h onto what the set's
points can make, and a projection has a derivative almost everywhere: the matrix R by which the
fitted rows M·x move with h. It is symmetric, between 0 and E. Its trace is the number of degrees of
freedom that the fit spends [kato2009]_: one for each direction that moves freely, none for one that
is pinned, and something between along a curved boundary.

R is ``M·(M^T·M + K)^(-1)·M^T`` with K half the second derivative that the constraints add. A matrix
F ⪰ 0 and its multiplier Z have common eigenvectors, with eigenvalues f and z of which one is zero:
K is infinite between two eigenvectors with z > 0, which pins F to its face, and z_i/f_j between one
with z and one with f, which is the curvature of the boundary along that face.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.conic.solve import ConicProgram

# A pinned direction is this many times as stiff as the stiffest of the data: a hundred-millionth
# of its movement is left, and directions that are not pinned keep their digits.
_STIFF = 1e4

# What is this much less stiff than the stiffest of the data is no active constraint: an interior
# point's solver leaves a multiplier of about its tolerance on every other.
_SLACK = 1e-5

# A solver's point is at least this far inside of its matrices and limits, of order one.
_INSIDE = 1e-12

# Directions that neither data nor constraints hold, in shares of the stiffest: rounding.
_OPEN = 1e-12


class FitResponse:
    """The derivative of the fitted rows of one program.

    Parameters
    ----------
    program : ConicProgram
        Its squares, matrices and limits are used, in units of order one.

    Attributes
    ----------
    stiff : float
        Stiffness of a pinned direction, of size one.
    """

    def __init__(self, program: ConicProgram) -> None:
        self.program = program
        U, singular, _ = np.linalg.svd(program.M, full_matrices=False)
        self._size = float(singular[0])
        self.stiff = _STIFF * self._size
        U = U[:, singular > _OPEN * singular[0]]
        # Where no constraint is active.
        self._unconstrained: Array = np.asarray(U @ U.T)

    def at(
        self,
        x: Array,
        rows: Array,
        blocks: tuple[Array, ...],
        *,
        weight: float = 1.0,
        held: Array | None = None,
    ) -> Array:
        """Return the derivative R of the fitted rows with respect to the data.

        Parameters
        ----------
        x : ndarray, shape (n,)
            An interior-point solver's optimum.
        rows, blocks : ndarray, tuple of ndarray
            Its multipliers, as in `ConicSolution`.
        weight : float, optional
            By which the multipliers are to be multiplied to be those of the squares.
        held : ndarray, shape (n,), optional
            A linear function of x that is held at its value.

        Returns
        -------
        ndarray, shape (r, r)
        """
        stiff = [*self._limits(x, weight * rows), *self._matrices(x, weight, blocks)]
        if held is not None:
            stiff.append(held[None] * (self.stiff / np.linalg.norm(held)))
        if not stiff:
            return self._unconstrained
        M = self.program.M
        U, singular, _ = np.linalg.svd(np.vstack([M, *stiff]), full_matrices=False)
        U = U[: len(M), singular > _OPEN * singular[0]]
        return np.asarray(U @ U.T)

    def _limits(self, x: Array, pull: Array) -> Iterator[Array]:
        """Yield the rows of K's root of the limits."""
        C, at = self.program.C, self.program.C @ x
        room = np.where(pull > 0.0, at - self.program.lower, self.program.upper - at)
        size = np.linalg.norm(C, axis=1)
        root = np.sqrt(0.5 * np.abs(pull) / np.maximum(room, _INSIDE))
        active = root * size > _SLACK * self._size
        if np.any(active):
            most = self.stiff / size[active]
            yield np.minimum(root[active], most)[:, None] * C[active]

    def _matrices(self, x: Array, weight: float, blocks: tuple[Array, ...]) -> Iterator[Array]:
        """Yield the rows of K's root of each matrix inequality that is active."""
        least = _SLACK * self._size
        for matrix, Z in zip(self.program.blocks, blocks, strict=True):
            stiffness, vectors = _stiffness(matrix.at(x), weight * Z)
            root = np.sqrt(stiffness)
            if root.max() > least:
                i, j = np.triu_indices(len(Z))
                # An entry off the diagonal stands for two.
                weights = np.where(i == j, np.sqrt(0.5), 1.0) * np.minimum(root, self.stiff)[i, j]
                entries = (vectors.T @ matrix.linear @ vectors)[:, i, j] * weights
                rows = np.zeros((len(i), len(x)))
                rows[:, matrix.index] = entries.T
                yield rows[weights > least]


def _stiffness(F: Array, Z: Array) -> tuple[Array, Array]:
    """Return z_i/f_j between common eigenvectors of F and Z, and the eigenvectors.

    Of a pair of eigenvectors that with the larger share of z comes first: the other quotient is
    one of two roundings.
    """
    size = max(float(np.linalg.norm(Z)), np.finfo(float).tiny)
    _, vectors = np.linalg.eigh(F / np.linalg.norm(F) - Z / size)
    f, z = (np.einsum("ia,ij,ja->a", vectors, each, vectors) for each in (F, Z))
    f, z = np.maximum(f, _INSIDE), np.maximum(z, 0.0)
    quotients, share = np.divide.outer(z, f), z / f
    return np.where(np.greater_equal.outer(share, share), quotients, quotients.T), vectors
