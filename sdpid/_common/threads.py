"""Run linear algebra on one thread: matrices here are small, and threads only wait for each other.

With two cores and nothing else to do, threads cost a default identification half again as much
time, and with other work on the machine many times as much.
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

# The number of threads belongs to the process: the first of overlapping calls sets it to one, and
# the last one to end puts it back.
_lock = threading.Lock()
_running = 0
_limiter: Any = None


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


@contextmanager
def _limited() -> Iterator[None]:
    """Keep linear algebra at one thread until every overlapping call has ended."""
    global _running, _limiter
    with _lock:
        if _running == 0:
            libraries = _libraries()
            _take_control()
            _limiter = libraries.limit(limits=1, user_api="blas")
        _running += 1
    try:
        yield
    finally:
        with _lock:
            _running -= 1
            if _running == 0:
                _take_control()
                _limiter.restore_original_limits()
                _take_control()


def one_thread(function: Callable[P, T]) -> Callable[P, T]:
    """Let linear algebra use one thread while a function runs, and as many as before after it.

    Calls may overlap in several threads of the process.
    """

    @functools.wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> T:
        with _limited():
            return function(*args, **kwargs)

    return limited
