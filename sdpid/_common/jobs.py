"""Work in parallel: joblib, and whatever backend its user has chosen for it."""

from __future__ import annotations

import os
import threading
from typing import Any

from sdpid.errors import DataError


class _SafePath:
    """Lets Python start without the current folder on its import path (from 3.11 on).

    Overlapping uses restore the environment once, when the last one ends.
    """

    _NAME = "PYTHONSAFEPATH"

    def __init__(self) -> None:
        self._lock, self._uses = threading.Lock(), 0
        self._before: str | None = None

    def __enter__(self) -> None:
        with self._lock:
            if not self._uses:
                self._before = os.environ.get(self._NAME)
                os.environ[self._NAME] = "1"
            self._uses += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._uses -= 1
            if not self._uses and self._before is None:
                del os.environ[self._NAME]
            elif not self._uses and self._before is not None:
                os.environ[self._NAME] = self._before


_safe_path = _SafePath()


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

    class SafeParallel(Parallel):  # type: ignore[misc]
        """Starts workers that do not import modules of the current folder."""

        def __call__(self, tasks: Any) -> Any:
            with _safe_path:
                return super().__call__(tasks)

    return SafeParallel(
        n_jobs=-1 if n_jobs is None else int(n_jobs),
        prefer="threads" if threads else None,
        **options,
    )
