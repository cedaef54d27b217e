"""One thread of linear algebra: matrices here are small, and threads only wait for each other.

With two cores and nothing else to do, threads cost a default identification half again as much
time, and with other work on the machine many times as much.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


@functools.cache
def _libraries() -> Any:
    # SciPy brings a library of its own, which is found only once it is there.
    import scipy.linalg.blas  # noqa: F401
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def one_thread(function: Callable[P, T]) -> Callable[P, T]:
    """Let linear algebra use one thread while a function runs, and as many as before after it."""

    @functools.wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> T:
        with _libraries().limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited
