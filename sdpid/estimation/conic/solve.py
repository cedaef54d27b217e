"""Least squares over a cone: the one form that semidefinite programs are solved in.

    minimize ‖M·x + m‖² + cost·x − Σ_i weight·log det(E_i0 + Σ x_k·E_ik)
    subject to lower ≤ C·x ≤ upper and F_i0 + Σ x_k·F_ik ⪰ 0

With a radius the squares are no cost but a constraint, ``‖M·x + m‖ ≤ radius``.

It is handed to Clarabel directly, in its standard form

    minimize ½·v·P·v + q·v   subject to   A·v + s = b,   s in a cone

over v = (x, residual, …): nothing is compiled, and the residual is a variable of its own, so that
M is never squared.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Generic, TypeVar

import numpy as np

from sdpid._common.arrays import Array, Indices, Mask, frozen

T = TypeVar("T")
Attempt = TypeVar("Attempt")

# Tighter than a solver can reach: it then stops where it makes no further progress, and what it
# found is judged by what is recomputed.
TOLERANCE = 1e-11


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


class _ConeRows:
    """Rows of A and b, gathered cone by cone."""

    def __init__(self) -> None:
        self.count = 0
        self.entries: list[tuple[Array, Indices, Indices]] = []
        self.b: list[Array] = []
        self.cones: list[tuple[str, int]] = []

    def add(
        self, cone: str, dense: Array, columns: Indices, b: Array, size: int | None = None
    ) -> None:
        """Add rows that are dense in some columns; zeros are left out."""
        i, j = np.nonzero(dense)
        self.entries.append((dense[i, j], i + self.count, columns[j]))
        self.b.append(b)
        self.count += len(b)
        self.cones.append((cone, len(b) if size is None else size))


@dataclass(frozen=True, eq=False)
class Standard:
    """``minimize ½·v·P·v + q·v, A·v + s = b``; the cones in turn, by Clarabel's names and sizes.

    The first three are equations, limits, and the ball, each of which may have no rows. Limits are
    known by their places among all lower ones and then all upper ones.
    """

    P: Any
    q: Array
    A: Any
    b: Array
    cones: tuple[tuple[str, int], ...]
    limits: Indices

    @property
    def sizes(self) -> list[int]:
        """Rows of equations, limits and ball."""
        return [size for _, size in self.cones[:3]]


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
    count, ball = len(program.m), 0
    if program.radius is not None:
        count, ball = 0, 1 + count
    # Variables: x, the residual, and for each log-determinant a triangle and its logarithms.
    width, blocks, logs = n + count, list(program.blocks), []
    for matrix in program.log_dets:
        size = len(matrix.constant)
        triangle = width + np.arange(size * (size + 1) // 2)
        blocks.append(_with_triangle(matrix, triangle))
        width += len(triangle) + size
        logs += [(width - size + j, triangle[j * (j + 3) // 2]) for j in range(size)]
    rows, own = _ConeRows(), np.arange(n)
    residual = np.hstack([-program.M[:count], np.eye(count)])
    rows.add("ZeroConeT", residual, np.arange(n + count), program.m[:count])
    ends = np.concatenate([program.lower, program.upper])
    limits = np.flatnonzero(np.isfinite(ends))
    sign = np.where(limits < len(program.lower), -1.0, 1.0)
    functions = sign[:, None] * np.vstack([program.C, program.C])[limits]
    rows.add("NonnegativeConeT", functions, own, sign * ends[limits])
    inside = np.vstack([np.zeros((1, n)), -program.M])[:ball]
    rows.add("SecondOrderConeT", inside, own, np.append(program.radius or 0.0, program.m)[:ball])
    for block in blocks:
        basis = symmetric_basis(len(block.constant))
        flat = basis.reshape(len(basis), -1)
        linear = -flat @ block.linear.reshape(len(block.linear), -1).T
        constant = flat @ block.constant.ravel()
        rows.add("PSDTriangleConeT", linear, block.index, constant, len(block.constant))
    # (t_j, 1, z_jj) in the exponential cone: t_j ≤ log z_jj.
    for pair in logs:
        dense, b = np.array([[-1.0, 0.0], [0.0, 0.0], [0.0, -1.0]]), np.array([0.0, 1.0, 0.0])
        rows.add("ExponentialConeT", dense, np.array(pair), b)
    q = np.zeros(width)
    if program.cost is not None:
        q[:n] = program.cost
    q[[log for log, _ in logs]] = -program.weight
    where = n + np.arange(count)
    P = csc_matrix((np.full(count, 2.0), (where, where)), shape=(width, width))
    b = np.concatenate(rows.b)
    values, *places = (np.concatenate(each) for each in zip(*rows.entries, strict=True))
    A = csc_matrix((values, places), shape=(len(b), width))
    return Standard(P, q, A, b, tuple(rows.cones), limits)


def _with_triangle(matrix: Matrix, triangle: Indices) -> Matrix:
    """Return ``[[X, Z], [Z^T, diag(Z)]]``, Z lower triangular: where it is ⪰ 0, det X ≥ Π z_jj."""
    size, given = len(matrix.constant), len(matrix.index)
    linear = np.zeros((given + len(triangle), 2 * size, 2 * size))
    linear[:given, :size, :size] = matrix.linear
    i, j = np.tril_indices(size)
    k = given + np.arange(len(triangle))
    linear[k, i, size + j] = linear[k, size + j, i] = 1.0
    linear[k, size + i, size + i] = i == j
    index = np.concatenate([matrix.index, triangle])
    return Matrix(index, linear, np.pad(matrix.constant, (0, size)))


@dataclass(frozen=True, eq=False)
class ConicSolution:
    """The point where a solver stopped, with its multipliers; callers recompute what they use.

    Attributes
    ----------
    status : str
        What the solver said, such as ``"Solved"``.
    x : ndarray, shape (n,), or None
        None where the solver has none.
    rows : ndarray, shape (c,)
        Multipliers of the linear inequalities, lower less upper.
    blocks : tuple of ndarray
        Multipliers of the matrix inequalities.
    iterations : int
    seconds : float
        In the solver, by its own clock.
    ball : ndarray, shape (1 + r,)
        Multipliers of ‖M·x + m‖ ≤ radius: of the radius, then of the residual; empty without one.
    residual : ndarray, shape (r,)
        M·x + m as the multipliers have it; empty with a radius.
    error : float
        The largest of gap, primal and dual residual, relative, by the solver's own account;
        infinite where it gives none.
    """

    status: str
    x: Array | None
    rows: Array = field(default_factory=lambda: np.zeros(0))
    blocks: tuple[Array, ...] = ()
    iterations: int = 0
    seconds: float = 0.0
    ball: Array = field(default_factory=lambda: np.zeros(0))
    error: float = np.inf
    residual: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def solved(self) -> bool:
        """Whether the solver calls the point a solution, if only to a looser tolerance."""
        return self.status.startswith(("Solved", "AlmostSolved", "solved"))


class ConicFamily:
    """Programs of one shape, put into form once: cost, squares and radius may differ.

    Clarabel keeps its own form of them as well, one in each thread: only numbers are exchanged
    between two solves, and each starts afresh, so that what is found does not depend on what was
    solved before. Nothing is equilibrated: numbers are expected to be of order one.

    Parameters
    ----------
    program : ConicProgram
        One of them.
    pattern : ndarray of bool, shape (r, n), optional
        Which entries of M may differ from zero in any of them; by default all have the same
        squares. Only programs without a radius can have others.
    tolerance : float, optional
        Relative gap and residuals at which Clarabel stops.
    """

    def __init__(
        self,
        program: ConicProgram,
        *,
        pattern: Mask | None = None,
        tolerance: float = TOLERANCE,
    ) -> None:
        self._tolerance = tolerance
        self._own = None if pattern is None else (program.M, program.m)
        if pattern is not None:
            # Zeros of one program must keep their place.
            program = replace(program, M=np.where(pattern, 1.0, 0.0))
        self.program = program
        self._form = standard_form(program)
        entries = self._form.A.tocoo()
        self._squares = np.flatnonzero(
            (entries.row < self._form.sizes[0]) & (entries.col < program.n)
        )
        self._entries = entries.row[self._squares], entries.col[self._squares]
        self._local = threading.local()

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_local"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._local = threading.local()

    def solve(
        self,
        cost: Array | None = None,
        radius: float | None = None,
        regularization: float = 1e-8,
        *,
        squares: tuple[Array, Array] | None = None,
    ) -> ConicSolution:
        """Solve one of the programs with Clarabel.

        Parameters
        ----------
        cost : ndarray, shape (n,), optional
            Another linear cost than the program's.
        radius : float, optional
            Another radius; only for programs that have one.
        regularization : float, optional
            What Clarabel adds to the diagonal of its linear systems.
        squares : tuple of ndarray, optional
            Other M and m than the program's, M zero outside of the pattern.
        """
        form = self._form
        squares = self._own if squares is None else squares
        q, A, b = form.q.copy(), form.A, form.b.copy()
        count, limits, _ = form.sizes
        if cost is not None:
            q[: self.program.n] = cost
        if radius is not None:
            b[count + limits] = radius
        if squares is not None:
            A = A.copy()
            A.data[self._squares] = -squares[0][self._entries]
            b[:count] = squares[1]
        form = replace(form, q=q, A=A, b=b)
        solvers = vars(self._local)
        key = str(regularization)
        solver = solvers.get(key)
        again = solver is not None
        if solver is None:
            solver = _clarabel_solver(form, regularization, tolerance=self._tolerance, fixed=True)
            # An older Clarabel takes no other numbers, or not of every program.
            if getattr(solver, "is_data_update_allowed", bool)():
                solvers[key] = solver
        else:
            # Lists are taken over faster than arrays.
            values = {"A": A.data.tolist()} if squares is not None else {}
            solver.update(q=q.tolist(), b=b.tolist(), **values)
        found = _solved(solver, self.program, form, again=again)
        if found.status.startswith("panic"):
            solvers.pop(key, None)
        return found


def solve_conic(
    program: ConicProgram,
    regularization: float = 1e-8,
    *,
    tolerance: float = TOLERANCE,
    verbose: bool = False,
) -> ConicSolution:
    """Solve a program.

    Parameters
    ----------
    program : ConicProgram
        The program.
    regularization : float, optional
        What Clarabel adds to the diagonal of its linear systems.
    tolerance : float, optional
        Relative gap and residuals at which Clarabel stops.
    verbose : bool, optional
        Let the solver print.

    Returns
    -------
    ConicSolution
        With the point where the solver stopped, whatever it calls it.
    """
    standard = standard_form(program)
    made = _clarabel_solver(standard, regularization, tolerance=tolerance, verbose=verbose)
    return _solved(made, program, standard)


def _clarabel_solver(
    standard: Standard,
    regularization: float,
    *,
    tolerance: float = TOLERANCE,
    verbose: bool = False,
    fixed: bool = False,
) -> Any:
    """Return Clarabel with a program; fixed, it keeps what others may need."""
    import clarabel

    settings = clarabel.DefaultSettings()
    settings.verbose = verbose
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    settings.static_regularization_constant = regularization
    if fixed:
        settings.presolve_enable = settings.chordal_decomposition_enable = False
        settings.equilibrate_enable = False
    cones = [
        getattr(clarabel, name)(*(() if name == "ExponentialConeT" else (size,)))
        for name, size in standard.cones
        if size
    ]
    return clarabel.DefaultSolver(standard.P, standard.q, standard.A, standard.b, cones, settings)


def _solved(
    solver: Any, program: ConicProgram, standard: Standard, *, again: bool = False
) -> ConicSolution:
    """Let Clarabel solve, and sort what it found: its point, and the multipliers.

    Its own clock counts the setup, but only where that is new.
    """
    begin = time.perf_counter()
    try:
        found = solver.solve()
    except BaseException as cause:
        # Where numbers overflow, the solver panics, which is no `Exception`: no point was found.
        if type(cause).__name__ != "PanicException":
            raise
        return ConicSolution(f"panic: {cause}", None)
    status, iterations, seconds = str(found.status), int(found.iterations), float(found.solve_time)
    if again:
        # The one setup is in every solve's time: what the call took is less.
        seconds = min(seconds, time.perf_counter() - begin)
    value, bound = float(found.obj_val), float(found.obj_val_dual)
    gap = abs(value - bound) / max(1.0, abs(value))
    error = max(gap, float(found.r_prim), float(found.r_dual))
    v, dual = np.array(found.x), np.array(found.z)
    if not (np.all(np.isfinite(v)) and np.all(np.isfinite(dual))):
        return ConicSolution(status, None, iterations=iterations, seconds=seconds)
    squares, limits, ball, rest = np.split(dual, np.cumsum(standard.sizes))
    pulls = np.zeros((2, len(program.lower)))
    pulls.flat[standard.limits] = limits
    blocks = []
    for block in program.blocks:
        basis = symmetric_basis(len(block.constant))
        own, rest = np.split(rest, [len(basis)])
        blocks.append(np.einsum("a,aij->ij", own, basis))
    return ConicSolution(
        status,
        v[: program.n],
        pulls[0] - pulls[1],
        tuple(blocks),
        iterations,
        seconds,
        ball,
        error if np.isfinite(error) else np.inf,
        # Stationary in the residual r itself: 2·r = −(multiplier of M·x + m = r).
        -0.5 * squares,
    )


@dataclass(frozen=True, eq=False)
class Retried(Generic[T]):
    """What several attempts found.

    Attributes
    ----------
    value : T or None
        What was made of the best solution; None where there is none to use.
    accepted : bool
        Whether it is good enough. Where not, `value` is only the best there was.
    status : str
        What the solver said of that solution, or without one, of the last attempt.
    seconds : float
        In the solver, over all attempts.
    solves : int
        Attempts made.
    """

    value: T | None
    accepted: bool
    status: str
    seconds: float
    solves: int


def solve_with_retries(
    solve: Callable[[Attempt], ConicSolution],
    attempts: Iterable[Attempt],
    judge: Callable[[Array, ConicSolution], tuple[T, float] | None],
    *,
    enough: float = 0.0,
) -> Retried[T]:
    """Solve with each setting in turn until a solution is good enough, and return the best.

    Parameters
    ----------
    solve : callable
        Solves with one setting, such as Clarabel's regularization.
    attempts : iterable
        The settings, in the order in which they are tried.
    judge : callable
        Takes the point and its solution; returns what the caller makes of them, and by how much
        that falls short (the less the better), or None where it is of no use. Solutions without a
        point are not judged.
    enough : float, optional
        The attempts end with the first that falls short by no more than this; ``-inf`` makes all.

    Returns
    -------
    Retried
        The first of those that fall short least. Callers decide what one that is not accepted is
        worth to them.
    """
    value: T | None = None
    least, status, seconds, solves = np.inf, "not attempted", 0.0, 0
    for attempt in attempts:
        solution = solve(attempt)
        seconds, solves = seconds + solution.seconds, solves + 1
        if value is None:
            status = solution.status
        judged = None if solution.x is None else judge(solution.x, solution)
        if judged is not None:
            made, short = judged[0], np.inf if np.isnan(judged[1]) else judged[1]
            if value is None or short < least:
                value, least, status = made, short, solution.status
        if least <= enough:
            break
    return Retried(value, bool(least <= enough), status, seconds, solves)
