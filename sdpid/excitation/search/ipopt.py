"""IPOPT, called through CasADi: a smooth function within linear and nonlinear limits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.extras import require
from sdpid._common.signals import Interrupts, noted_interrupts

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

_Found = TypeVar("_Found")


class Rows(Protocol):
    """Nonlinear functions g(x) that are to be at least zero."""

    @property
    def pattern(self) -> Any:
        """Where the derivative may differ from zero, as a boolean array (R, N)."""

    def values(self, x: Array) -> Array:
        """Return g(x), (R,)."""

    def derivative(self, x: Array) -> Array:
        """Return the derivative (R, N)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """The best point that held all limits.

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
        Whether `stop` ended it.
    """

    x: Array
    value: float
    steps: int
    status: str
    stopped: bool


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
    rows: Rows | None,
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
    rows : Rows, optional
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
    matrix, lower, upper = linear
    N = len(start)
    calls = _Calls(function)
    objective = _callback(
        casadi,
        N,
        casadi.Sparsity.dense(1, N),
        calls.guarded(lambda x: np.array([calls.cached(x)[0]])),
        calls.guarded(lambda x: calls.cached(x)[1]),
    )
    x = casadi.MX.sym("x", N)
    # CasADi 3.7.0 and older know sparse matrices, but no sparse arrays.
    limits = [casadi.densify(casadi.mtimes(casadi.DM(csc_matrix(matrix)), x))]
    count = 0
    if rows is not None:
        r, c = np.nonzero(rows.pattern.T)[::-1]
        count = len(rows.pattern)
        sparsity = casadi.Sparsity.triplet(count, N, r.tolist(), c.tolist())
        nonlinear = _callback(
            casadi,
            N,
            sparsity,
            # CasADi asks for both twice, and takes nonzeros from a list in half of the time.
            calls.guarded(_remembered(rows.values)),
            calls.guarded(_remembered(lambda x: rows.derivative(x)[r, c].tolist())),
            count,
        )
        limits.append(nonlinear(x))
    interrupts = Interrupts()
    watch = _Watch(
        len(lower),
        calls.guarded(lambda steps, value: stop(steps, value) or interrupts.came),
        lambda: calls.error is not None,
    )
    each_step = watch.callback(casadi, N, len(lower) + count)
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
    watch.offer(start, calls.cached(start)[0])
    status = INTERRUPTED
    try:
        # IPOPT takes an exception for a point without a value, and goes on elsewhere.
        with noted_interrupts(interrupts):
            solver(
                x0=start,
                lbg=np.concatenate([lower, np.zeros(count)]),
                ubg=np.concatenate([upper, np.full(count, np.inf)]),
            )
        status = str(solver.stats()["return_status"])
    except KeyboardInterrupt:
        watch.stopped = True
    except RuntimeError:
        # CasADi turns exceptions of ours into words.
        if calls.error is None:
            raise
    if interrupts.came or isinstance(calls.error, KeyboardInterrupt):
        status, watch.stopped = INTERRUPTED, True
    elif calls.error is not None:
        raise calls.error
    elif rows is not None:
        way = watch.last - watch.best
        for x in (watch.best + share * way for share in _SHARES):
            if np.min(rows.values(x)) >= -_HELD:
                watch.offer(x, function(x)[0])
                break
    return Found(
        x=watch.best, value=watch.value, steps=watch.steps, status=status, stopped=watch.stopped
    )


class _Calls:
    """Calls from IPOPT: the last point is remembered, and so is the first exception."""

    def __init__(self, function: Callable[[Array], tuple[float, Array]]) -> None:
        # IPOPT asks for value and gradient one after the other.
        self.cached = _remembered(function)
        self.error: BaseException | None = None

    def guarded(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function whose exceptions are kept, to be raised when IPOPT has returned.

        After one it gives what it gave last: IPOPT takes an exception for a point without a value
        and looks for others, for minutes, but a step that it can end is the last.
        """
        last: list[Any] = []

        def call(*arguments: Any) -> Any:
            if self.error is None or not last:
                try:
                    last[:] = [function(*arguments)]
                except BaseException as error:
                    self.error = self.error or error
                    if not last:
                        raise
            return last[0]

        return call


def _remembered(function: Callable[[Array], _Found]) -> Callable[[Array], _Found]:
    """Return a function that remembers its last value."""
    last: dict[bytes, _Found] = {}

    def call(x: Array) -> _Found:
        key = x.tobytes()
        if key not in last:
            found = function(x)
            last.clear()
            last[key] = found
        return last[key]

    return call


def _callback(
    casadi: Any,
    N: int,
    sparsity: Any,
    value: Callable[[Array], Array],
    derivative: Callable[[Array], Sequence[float]],
    count: int = 1,
) -> Any:
    """Return a function of CasADi with `count` values and a derivative of a given sparsity."""
    dense = casadi.Sparsity.dense
    slope = _evaluated(
        casadi,
        "derivative",
        [dense(N, 1), dense(count, 1)],
        sparsity,
        lambda x, _: casadi.DM(sparsity, derivative(np.array(x).ravel())),
    )
    arguments = [dense(N, 1)]
    return _evaluated(
        casadi, "value", arguments, dense(count, 1), lambda x: value(np.array(x).ravel()), slope
    )


def _evaluated(
    casadi: Any,
    name: str,
    arguments: Sequence[Any],
    result: Any,
    function: Callable[..., Any],
    derivative: Any = None,
) -> Any:
    """Return a function of CasADi that calls Python, from sparsities of arguments and result."""

    class Evaluated(casadi.Callback):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__()
            # CasADi keeps no reference to what Python made.
            self.kept = derivative
            self.construct(name, {})

        def get_n_in(self) -> int:
            return len(arguments)

        def get_n_out(self) -> int:
            return 1

        def get_sparsity_in(self, i: int) -> Any:
            return arguments[i]

        def get_sparsity_out(self, i: int) -> Any:
            return result

        def eval(self, values: Any) -> Any:
            return [function(*values)]

        def has_jacobian(self) -> bool:
            return self.kept is not None

        def get_jacobian(self, *_: Any) -> Any:
            return self.kept

    return Evaluated()


class _Watch:
    """Called after every step: keeps the best point, the last one, and may stop."""

    def __init__(
        self, linear: int, stop: Callable[[int, float], bool], failed: Callable[[], bool]
    ) -> None:
        self.linear, self.stop, self.failed = linear, stop, failed
        self.best, self.value, self.steps, self.stopped = np.zeros(0), np.inf, 0, False
        self.last = self.best

    def offer(self, x: Array, value: float) -> None:
        """Keep a point within all limits if it is the best so far."""
        if value < self.value:
            self.best, self.value = x.copy(), value
            self.last = self.best

    def callback(self, casadi: Any, N: int, M: int) -> Any:
        """Return what CasADi calls, with N free numbers and M limits."""
        sizes = {"x": N, "lam_x": N, "g": M, "lam_g": M, "f": 1}
        names = [casadi.nlpsol_out(i) for i in range(casadi.nlpsol_n_out())]
        arguments = [casadi.Sparsity.dense(sizes.get(n, 0), int(n in sizes)) for n in names]

        def step(*values: Any) -> int:
            if self.failed():
                return 1
            by_name = dict(zip(names, values, strict=True))
            shortfall = np.array(by_name["g"]).ravel()[self.linear :]
            x, value = np.array(by_name["x"]).ravel(), float(by_name["f"])
            if np.min(shortfall, initial=0.0) >= -_HELD:
                self.offer(x, value)
            elif value < self.value:
                self.last = x
            self.steps += 1
            self.stopped = self.stop(self.steps, self.value)
            return int(self.stopped or self.failed())

        return _evaluated(casadi, "watch", arguments, casadi.Sparsity.dense(1, 1), step)
