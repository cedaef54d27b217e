"""Work in parallel: joblib, and whatever backend its user has chosen for it."""

from __future__ import annotations

from typing import Any

from sdpid.errors import DataError


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
