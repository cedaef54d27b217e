"""Least squares over a cone: the one form that semidefinite programs are solved in.

    minimize ‖M·x + m‖² + cost·x − Σ_i weight·log det(E_i0 + Σ x_k·E_ik)
    subject to lower ≤ C·x ≤ upper and F_i0 + Σ x_k·F_ik ⪰ 0

With a radius the squares are no cost but a constraint, ``‖M·x + m‖ ≤ radius``.

It is handed to Clarabel directly, in its standard form (`sdpid.estimation.conic.standard_form`).
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import Any

import numpy as np

from sdpid._common.arrays import Array, Mask
from sdpid.estimation.conic.standard_form import (
    ConicProgram,
    Matrix,
    Standard,
    standard_form,
    symmetric_basis,
)

__all__ = [
    "TOLERANCE",
    "ConicFamily",
    "ConicProgram",
    "ConicSolution",
    "Matrix",
    "solve_conic",
]

# Tighter than a solver can reach: it then stops where it makes no further progress, and what it
# found is judged by what is recomputed.
TOLERANCE = 1e-11


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
        A = self._form.A
        columns = np.repeat(np.arange(A.shape[1]), np.diff(A.indptr))
        self._squares = np.flatnonzero((A.indices < self._form.zero) & (columns < program.n))
        self._entries = A.indices[self._squares], columns[self._squares]
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
        *,
        squares: tuple[Array, Array] | None = None,
        regularization: float = 1e-8,
    ) -> ConicSolution:
        """Solve one of the programs with Clarabel.

        Parameters
        ----------
        cost : ndarray, shape (n,), optional
            Another linear cost than the program's.
        radius : float, optional
            Another radius; only for programs that have one.
        squares : tuple of ndarray, optional
            Other M and m than the program's, M zero outside of the pattern.
        regularization : float, optional
            What Clarabel adds to the diagonal of its linear systems.
        """
        standard = self._form
        squares = self._own if squares is None else squares
        q, A, b = standard.q, standard.A, standard.b
        if cost is not None:
            q = q.copy()
            q[: self.program.n] = cost
        if radius is not None or squares is not None:
            b = b.copy()
        if radius is not None:
            b[standard.zero + len(standard.below) + len(standard.above)] = radius
        if squares is not None:
            A = A.copy()
            A.data[self._squares] = -squares[0][self._entries]
            b[: standard.zero] = squares[1]
        changed = replace(standard, q=q, A=A, b=b)
        solvers = vars(self._local)
        key = str(regularization)
        solver = solvers.get(key)
        again = solver is not None
        if solver is None:
            solver = _clarabel_solver(
                changed, regularization, tolerance=self._tolerance, fixed=True
            )
            # An older Clarabel takes no other numbers, or not of every program.
            if getattr(solver, "is_data_update_allowed", bool)():
                solvers[key] = solver
        else:
            # Lists are taken over faster than arrays.
            values = {"A": A.data.tolist()} if squares is not None else {}
            solver.update(q=q.tolist(), b=b.tolist(), **values)
        found = _solved(solver, self.program, changed, again=again)
        if found.status.startswith("panic"):
            solvers.pop(key, None)
        return found


def solve_conic(
    program: ConicProgram,
    *,
    regularization: float = 1e-8,
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
    cones: list[Any] = [clarabel.ZeroConeT(standard.zero)] if standard.zero else []
    if positive := len(standard.below) + len(standard.above):
        cones.append(clarabel.NonnegativeConeT(positive))
    if standard.ball:
        cones.append(clarabel.SecondOrderConeT(standard.ball))
    cones += [clarabel.PSDTriangleConeT(size) for size in standard.sizes]
    cones += [clarabel.ExponentialConeT()] * standard.exponential
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
    sizes = standard.zero, len(standard.below), len(standard.above), standard.ball
    squares, below, above, ball, rest = np.split(dual, np.cumsum(sizes))
    rows = np.zeros(len(program.lower))
    rows[standard.below] += below
    rows[standard.above] -= above
    blocks: list[Array] = []
    # Blocks of one size in turn, of which there is seldom more than one.
    for size, run in groupby(block.constant.shape[0] for block in program.blocks):
        count, basis = len(list(run)), symmetric_basis(size)
        own, rest = np.split(rest, [count * len(basis)])
        flat = own.reshape(count, len(basis)) @ basis.reshape(len(basis), -1)
        blocks += list(flat.reshape(count, size, size))
    return ConicSolution(
        status,
        v[: program.n],
        rows,
        tuple(blocks),
        iterations,
        seconds,
        ball,
        error if np.isfinite(error) else np.inf,
        # Stationary in the residual r itself: 2·r = −(multiplier of M·x + m = r).
        -0.5 * squares,
    )
