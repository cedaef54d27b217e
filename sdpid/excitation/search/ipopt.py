"""IPOPT, called through CasADi: a smooth function within linear and nonlinear limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid._common.signals import Interrupts, noted_interrupts
from sdpid.excitation.search.space import InstantRows

# A step that no longer changes value or limits by this share ends the search; a hundred times that
# does so after some steps in a row. What is found is checked anew and exactly, elsewhere.
_TOLERANCE, _ACCEPTABLE = 1e-4, 1e-3
# Steps whose curvature is kept: more take longer, and help little.
_MEMORY = 20
# The start is within the limits, and is not moved away from them by more than this.
_PUSH = 1e-6
# Rows that stand for nonlinear limits count as held when they are short by no more than this share
# of a limit: the grid on which they are held is coarse, and another margin stands for that.
_HELD = 1e-3
# Where the barrier begins when the start is nearly the best: from its usual place a search first
# leaves the limits at which the start lies, and takes dozens of steps to come back.
_NEAR = {"ipopt.mu_strategy": "monotone", "ipopt.mu_init": 1e-4}
# Shares of the way from the best point to the last one that are tried, where only the last steps
# were beyond a nonlinear limit.
_SHARES = (1.0, 0.75, 0.5, 0.25)
# How a search ended that its user interrupted.
INTERRUPTED = "Interrupted"


@dataclass(kw_only=True, eq=False)
class Found:
    """The best point that held all limits, kept while IPOPT calls.

    Attributes
    ----------
    x : ndarray, shape (N,)
        The point; the start where nothing better was found.
    value : float
        Its value.
    steps : int
        Steps taken.
    status : str
        How the search ended, in IPOPT's words.
    stopped : bool
        Whether it was asked to end.
    last : ndarray, shape (N,)
        The last better point, where it was beyond a nonlinear limit; else `x`.
    error : BaseException or None
        The first exception of a call, to be raised when IPOPT has returned.
    """

    x: Array
    last: Array
    value: float = np.inf
    steps: int = 0
    status: str = INTERRUPTED
    stopped: bool = False
    error: BaseException | None = None

    def offer(self, x: Array, value: float) -> None:
        """Keep a point within all limits if it is the best so far."""
        if value < self.value:
            self.x = self.last = x
            self.value = value

    def kept(self, function: Callable[[Array], Any]) -> Callable[..., Any]:
        """Return a function of a point that remembers its last value: IPOPT asks for it twice.

        After an exception of any it gives that value: IPOPT takes an exception for a point without
        a value and looks for others, for minutes, but a step that it can end is the last.
        """
        last: list[Any] = []

        def call(x: Array, *_: Array) -> Any:
            key = x.tobytes()
            if not last or (last[0] != key and self.error is None):
                try:
                    last[:] = key, function(x)
                except BaseException as error:
                    self.error = self.error or error
                    if not last:
                        raise
            return last[1]

        return call

    def step(self, x: Array, value: float, held: bool, stop: Callable[[int, float], bool]) -> bool:
        """Keep the point of a step, and return whether it is to be the last."""
        if self.error is None:
            if held:
                self.offer(x, value)
            elif value < self.value:
                self.last = x
            self.steps += 1
            try:
                self.stopped = stop(self.steps, self.value)
            except BaseException as error:
                self.error = error
        return self.stopped or self.error is not None


def require_solver() -> Any:
    """Import CasADi, which brings IPOPT.

    Raises
    ------
    MissingExtraError
        When it is not installed (extra ``excite``).
    """
    return require("casadi", extra="excite")


def minimize(
    function: Callable[[Array], tuple[float, Array]],
    start: Array,
    linear: tuple[Any, Array, Array],
    rows: InstantRows | None,
    *,
    most_steps: int,
    stop: Callable[[int, float], bool],
    near: bool = False,
) -> Found:
    """Minimize a smooth function from a point that is within its limits.

    Linear limits hold at every step, so that the search may be stopped at any time.

    Parameters
    ----------
    function : callable
        From x (N,) to its value and gradient (N,).
    start : ndarray, shape (N,)
        A point within all limits.
    linear : tuple of (sparse array (R, N), ndarray (R,), ndarray (R,))
        Matrix, lower and upper limits of its rows.
    rows : InstantRows, optional
        Nonlinear functions to be kept at or above zero.
    most_steps : int
        Largest number of steps.
    stop : callable
        Called after every step with its number and the best value; whether to stop.
    near : bool, optional
        Whether the start is nearly the best, such as one that another search found.

    Raises
    ------
    MissingExtraError
        When CasADi is not installed (extra ``excite``).
    """
    from scipy.sparse import csc_matrix

    casadi = require_solver()
    callback, dense = _callback(casadi), casadi.Sparsity.dense
    matrix, lower, upper = linear
    N, R = len(start), len(lower)
    found, interrupts = Found(x=start, last=start), Interrupts()
    called = found.kept(function)
    slope = callback([(N, 1), (1, 1)], dense(1, N), lambda x, _: called(x)[1])
    objective = callback([(N, 1)], dense(1, 1), lambda x: [called(x)[0]], slope)
    x = casadi.MX.sym("x", N)
    # CasADi 3.7.0 and older know sparse matrices, but no sparse arrays.
    limits = [casadi.densify(casadi.mtimes(casadi.DM(csc_matrix(matrix)), x))]
    count = 0
    if rows is not None:
        r, c = np.nonzero(rows.pattern.T)[::-1]
        count, derivative = len(rows.pattern), rows.derivative
        # CasADi takes nonzeros from a list in half of the time.
        nonzeros = found.kept(lambda x: derivative(x)[r, c].tolist())
        sparsity = casadi.Sparsity.triplet(count, N, r.tolist(), c.tolist())
        slopes = callback([(N, 1), (count, 1)], sparsity, nonzeros)
        nonlinear = callback([(N, 1)], dense(count, 1), found.kept(rows.values), slopes)
        limits.append(nonlinear(x))

    def step(x: Array, f: Array, g: Array, *_: Array) -> list[int]:
        held = np.min(g[R:], initial=0.0) >= -_HELD
        last = found.step(x, float(f[0]), bool(held), lambda *at: stop(*at) or interrupts.came)
        return [int(last)]

    # x, f, g, their multipliers, and those of no parameters.
    sizes = [(N, 1), (1, 1), (R + count, 1), (N, 1), (R + count, 1), (0, 0)]
    each_step = callback(sizes, dense(1, 1), step)
    solver = casadi.nlpsol(
        "search",
        "ipopt",
        {"x": x, "f": objective(x), "g": casadi.vertcat(*limits)},
        {
            "iteration_callback": each_step,
            "print_time": False,
            "calc_lam_p": False,
            "error_on_fail": False,
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
            "ipopt.hessian_approximation": "limited-memory",
            "ipopt.limited_memory_max_history": _MEMORY,
            # Steps take half of the time, with many rows an eighth: no scaling of the equations,
            # minimum degree, and the memory as rows of its own.
            "ipopt.limited_memory_aug_solver": "extended",
            "ipopt.mumps_permuting_scaling": 0,
            "ipopt.mumps_scaling": 0,
            "ipopt.mumps_pivot_order": 0,
            # Else limits are widened by 1e-8 of their size before the search begins.
            "ipopt.bound_relax_factor": 0.0,
            "ipopt.bound_push": _PUSH,
            "ipopt.bound_frac": _PUSH,
            "ipopt.tol": _TOLERANCE,
            "ipopt.acceptable_tol": _ACCEPTABLE,
            "ipopt.max_iter": most_steps,
            **(_NEAR if near else {}),
        },
    )
    found.offer(start, called(start)[0])
    try:
        # IPOPT takes an exception for a point without a value, and goes on elsewhere.
        with noted_interrupts(interrupts):
            solver(
                x0=start,
                lbg=np.concatenate([lower, np.zeros(count)]),
                ubg=np.concatenate([upper, np.full(count, np.inf)]),
            )
        found.status = str(solver.stats()["return_status"])
    except KeyboardInterrupt:
        found.stopped = True
    except RuntimeError:
        # CasADi turns exceptions of ours into words.
        if found.error is None:
            raise
    if interrupts.came or isinstance(found.error, KeyboardInterrupt):
        found.status, found.stopped = INTERRUPTED, True
    elif found.error is not None:
        raise found.error
    elif rows is not None:
        way = found.last - found.x
        for moved in (found.x + share * way for share in _SHARES):
            if np.min(rows.values(moved)) >= -_HELD:
                found.offer(moved, function(moved)[0])
                break
    return found


@cache
def _callback(casadi: Any) -> Any:
    """Return the class of CasADi's functions that call Python."""

    class Evaluated(casadi.Callback):  # type: ignore[misc]
        """From arrays of given shapes to the nonzeros of a sparsity, with its derivative."""

        def __init__(
            self,
            shapes: list[tuple[int, int]],
            result: Any,
            function: Callable[..., Any],
            derivative: Any = None,
        ) -> None:
            super().__init__()
            self.shapes, self.result, self.function = shapes, result, function
            # CasADi keeps no reference to what Python made.
            self.derivative = derivative
            self.construct("evaluated", {})

        def get_n_in(self) -> int:
            return len(self.shapes)

        def get_n_out(self) -> int:
            return 1

        def get_sparsity_in(self, i: int) -> Any:
            return casadi.Sparsity.dense(*self.shapes[i])

        def get_sparsity_out(self, i: int) -> Any:
            return self.result

        def eval(self, values: Any) -> Any:
            arrays = (np.array(value).ravel() for value in values)
            return [casadi.DM(self.result, self.function(*arrays))]

        def has_jacobian(self) -> bool:
            return self.derivative is not None

        def get_jacobian(self, *_: Any) -> Any:
            return self.derivative

    return Evaluated
