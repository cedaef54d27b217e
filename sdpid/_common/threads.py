"""Run linear algebra on one thread: matrices here are small, and threads only wait for each other.

With two cores and nothing else to do, threads cost a default identification half again as much
time, and with other work on the machine many times as much.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

from sdpid.errors import DataError

P = ParamSpec("P")
T = TypeVar("T")


@functools.cache
def _libraries() -> Any:
    """Return the controller of the linear algebra libraries that are loaded."""
    # SciPy brings a library of its own, which is found only once it is there.
    import scipy.linalg.blas  # noqa: F401
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def _take_control() -> None:
    """Let this Python thread change the number of threads.

    From threadpoolctl 3.8 on the thread that changed it first is the only one that can.
    """
    import threadpoolctl

    controller = getattr(threadpoolctl, "OpenBLASController", None)
    if controller is not None and hasattr(controller, "clear_controlling_thread"):
        controller.clear_controlling_thread(force=True)


class _OneThread:
    """A context of the process: the first of overlapping uses enters it, the last one leaves it."""

    def __init__(self) -> None:
        self._lock, self._uses = threading.Lock(), 0

    def __enter__(self) -> None:
        with self._lock:
            if not self._uses:
                libraries = _libraries()
                _take_control()
                self._limiter = libraries.limit(limits=1, user_api="blas")
            self._uses += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._uses -= 1
            if not self._uses:
                _take_control()
                self._limiter.restore_original_limits()
                _take_control()


_limited = _OneThread()


def one_thread(function: Callable[P, T]) -> Callable[P, T]:
    """Let linear algebra use one thread while a function runs, and as many as before after it.

    Calls may overlap in several threads of the process.
    """

    @functools.wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> T:
        with _limited:
            return function(*args, **kwargs)

    return limited


def parallel(n_jobs: int | None, *, threads: bool = False, **options: Any) -> Any:
    """Return a `joblib.Parallel` that leaves the backend to ``joblib.parallel_config``.

    Parameters
    ----------
    n_jobs : int or None
        Jobs at a time; None is one a core, or every worker of the backend that was chosen.
        Negative numbers count from all.
    threads : bool, optional
        Where no backend was chosen use threads, for work that leaves the interpreter to others.
    options : optional
        For `joblib.Parallel`.

    Raises
    ------
    DataError
        When there are no jobs.
    """
    if n_jobs is not None and (isinstance(n_jobs, bool) or int(n_jobs) != n_jobs or n_jobs == 0):
        raise DataError(f"n_jobs: is {n_jobs}; give a number of jobs, or None for one a core.")
    from joblib import Parallel

    jobs = -1 if n_jobs is None else int(n_jobs)
    return Parallel(n_jobs=jobs, prefer="threads" if threads else None, **options)
