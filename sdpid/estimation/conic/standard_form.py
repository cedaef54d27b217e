"""Least squares over a cone, and the standard form of the solver.

    minimize ½·v·P·v + q·v   subject to   A·v + s = b,   s in a cone

over v = (x, residual, …): nothing is compiled, and the residual is a variable of its own, so that
M is never squared.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Indices, frozen


@dataclass(frozen=True, eq=False)
class Matrix:
    """One symmetric matrix ``constant + Σ x[index_k]·linear_k``.

    Attributes
    ----------
    index : ndarray of int, shape (k,)
        The entries of x that it depends on.
    linear : ndarray, shape (k, s, s)
    constant : ndarray, shape (s, s)
    """

    index: Indices
    linear: Array
    constant: Array

    def at(self, x: Array) -> Array:
        """Return the matrix (s, s) at a point (n,)."""
        return np.asarray(self.constant + np.einsum("k,kij->ij", x[self.index], self.linear))


@dataclass(frozen=True, kw_only=True, eq=False)
class ConicProgram:
    """The program above.

    Attributes
    ----------
    M, m : ndarray, shapes (r, n) and (r,)
        Of the squares.
    cost : ndarray, shape (n,), or None
        Linear part of the cost.
    C, lower, upper : ndarray, shapes (c, n), (c,), (c,)
        Linear inequalities; infinite limits are left out.
    blocks : tuple of Matrix
        To be positive semidefinite.
    log_dets : tuple of Matrix
        Whose log-determinants count in the cost.
    weight : float
        Weight of the log-determinants.
    radius : float or None
        Limit of ‖M·x + m‖, which then is no cost.
    """

    M: Array
    m: Array
    C: Array
    lower: Array
    upper: Array
    blocks: tuple[Matrix, ...] = ()
    cost: Array | None = None
    log_dets: tuple[Matrix, ...] = ()
    weight: float = 0.0
    radius: float | None = None

    @property
    def n(self) -> int:
        """Size of x."""
        return int(self.M.shape[1])


class _Rows:
    """Entries of A, gathered cone by cone."""

    def __init__(self) -> None:
        self.count = 0
        self.entries: list[tuple[Array, Indices, Indices]] = []
        self.b: list[Array] = []

    def add(self, dense: Array, columns: Indices, b: Array) -> None:
        """Add rows that are dense in some columns; zeros are left out."""
        i, j = np.nonzero(dense)
        self.entries.append((dense[i, j], i + self.count, columns[j]))
        self.b.append(b)
        self.count += len(b)

    def matrix(self, width: int) -> Any:
        from scipy.sparse import csc_matrix

        values, *where = (np.concatenate(each) for each in zip(*self.entries, strict=True))
        return csc_matrix((values, where), shape=(self.count, width))


@dataclass(frozen=True, eq=False)
class Standard:
    """``minimize ½·v·P·v + q·v, A·v + s = b``; the sizes of the cones in turn.

    First equations, then limits below and above, by their places in the program.
    """

    P: Any
    q: Array
    A: Any
    b: Array
    zero: int
    below: Indices
    above: Indices
    sizes: tuple[int, ...]
    exponential: int
    ball: int = 0


@cache
def symmetric_basis(size: int) -> Array:
    """Return an orthonormal basis of the symmetric matrices, (size·(size+1)/2, size, size).

    Clarabel's vector of a matrix, the columns of the upper triangle in turn, is its coordinates.
    """
    pairs = [(i, j) for i in range(size) for j in range(i + 1)]
    basis = np.zeros((len(pairs), size, size))
    for k, (i, j) in enumerate(pairs):
        basis[k, i, j] = basis[k, j, i] = 1.0 if i == j else np.sqrt(0.5)
    return frozen(basis)


def standard_form(program: ConicProgram) -> Standard:
    """Bring a program into the solver's form."""
    from scipy.sparse import csc_matrix

    n = program.n
    # Within a radius there is no cost of the residual, which then needs no variable.
    count = len(program.m) if program.radius is None else 0
    own = np.arange(n)
    # Variables: x, the residual, and for each log-determinant a triangle and its logarithms.
    width = n + count
    extra = []
    for matrix in program.log_dets:
        size = int(matrix.constant.shape[0])
        triangle = width + np.arange(size * (size + 1) // 2)
        logs = triangle[-1] + 1 + np.arange(size)
        extra.append((triangle, logs))
        width = int(logs[-1]) + 1
    rows = _Rows()
    residual = np.hstack([-program.M[:count], np.eye(count)])
    rows.add(residual, np.arange(n + count), program.m[:count])
    below = np.flatnonzero(np.isfinite(program.lower))
    above = np.flatnonzero(np.isfinite(program.upper))
    rows.add(-program.C[below], own, -program.lower[below])
    rows.add(program.C[above], own, program.upper[above])
    ball = 0
    if program.radius is not None:
        ball = 1 + len(program.m)
        rows.add(np.zeros((1, n)), own, np.array([program.radius]))
        rows.add(-program.M, own, program.m)
    sizes = []
    for block in program.blocks:
        size = block.constant.shape[0]
        basis = symmetric_basis(size)
        flat = basis.reshape(len(basis), -1)
        rows.add(
            -flat @ block.linear.reshape(len(block.linear), -1).T,
            block.index,
            flat @ block.constant.ravel(),
        )
        sizes.append(size)
    for matrix, (triangle, _) in zip(program.log_dets, extra, strict=True):
        sizes.append(_add_log_det(rows, matrix, triangle))
    # (t_j, 1, z_jj) in the exponential cone: t_j ≤ log z_jj.
    for triangle, logs in extra:
        for j in range(len(logs)):
            rows.add(
                np.array([[-1.0, 0.0], [0.0, 0.0], [0.0, -1.0]]),
                np.array([logs[j], triangle[j * (j + 3) // 2]]),
                np.array([0.0, 1.0, 0.0]),
            )
    q = np.zeros(width)
    if program.cost is not None:
        q[:n] = program.cost
    for _, logs in extra:
        q[logs] = -program.weight
    where = n + np.arange(count)
    P = csc_matrix((np.full(count, 2.0), (where, where)), shape=(width, width))
    return Standard(
        P=P,
        q=q,
        A=rows.matrix(width),
        b=np.concatenate(rows.b),
        zero=count,
        below=below,
        above=above,
        sizes=tuple(sizes),
        exponential=sum(len(logs) for _, logs in extra),
        ball=ball,
    )


def _add_log_det(rows: _Rows, matrix: Matrix, triangle: Indices) -> int:
    """Add ``[[X, Z], [Z^T, diag(Z)]]`` ⪰ 0 with Z lower triangular: then det X ≥ Π z_jj."""
    size = int(matrix.constant.shape[0])
    basis = symmetric_basis(2 * size)
    flat = basis.reshape(len(basis), -1)
    linear = np.zeros((len(matrix.index) + len(triangle), 2 * size, 2 * size))
    linear[: len(matrix.index), :size, :size] = matrix.linear
    at = len(matrix.index)
    for i in range(size):
        for j in range(i + 1):
            linear[at, i, size + j] = linear[at, size + j, i] = 1.0
            if i == j:
                linear[at, size + i, size + i] = 1.0
            at += 1
    constant = np.zeros((2 * size, 2 * size))
    constant[:size, :size] = matrix.constant
    columns = np.concatenate([matrix.index, triangle])
    rows.add(-flat @ linear.reshape(len(linear), -1).T, columns, flat @ constant.ravel())
    return 2 * size
