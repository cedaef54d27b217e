"""Filter the efforts period by period, and return their mean and covariance."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from sdpid._common.arrays import Array
from sdpid.experiment.processing.period_mean import Chain
from sdpid.experiment.recording.recording import Recording

T = TypeVar("T")

# Decoding and filtering let other threads run, but each holds some copies of a period.
_MOST_THREADS = 4
# The efforts of all periods are kept up to this many bytes, for a bootstrap over periods; more
# would make the memory grow with the length of the record.
_MOST_KEPT = 1 << 27


@contextlib.contextmanager
def workers(count: int) -> Iterator[Callable[[Callable[[int], T], Iterable[int]], list[T]]]:
    """Yield a ``map`` that returns a list and runs on up to four cores, at most `count`."""
    count = min(_MOST_THREADS, count, _cores())
    if count <= 1:
        yield lambda action, items: [action(item) for item in items]
        return
    with ThreadPoolExecutor(count) as pool:
        yield lambda action, items: list(pool.map(action, items))


def in_threads(action: Callable[[int], T], items: Sequence[int]) -> list[T]:
    """Return ``[action(i) for i in items]``, computed on up to four cores."""
    with workers(len(items)) as each:
        return each(action, items)


def _cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Moments:
    """Mean and covariance of vectors that are added one by one, by Welford's recurrence.

    Parameters
    ----------
    K, n : int
        Vectors of size n, at each of K samples.
    covariance : bool
        Whether the covariance is wanted as well.
    """

    def __init__(self, K: int, n: int, *, covariance: bool) -> None:
        self._pairs = [(i, j) for i in range(n) for j in range(i, n)] if covariance else []
        self._sums = np.zeros((len(self._pairs), K))
        self._mean = np.zeros((n, K))
        self._count = 0

    def add(self, values: Array) -> None:
        """Add the values (n, K) of one period."""
        self._count += 1
        change = values - self._mean
        self._mean += change / self._count
        if self._count > 1:
            share = (self._count - 1) / self._count
            for (i, j), total in zip(self._pairs, self._sums, strict=True):
                total += change[i] * change[j] * share

    @property
    def mean(self) -> Array:
        """The mean (K, n)."""
        return np.ascontiguousarray(self._mean.T)

    @property
    def covariance(self) -> Array:
        """Sigma_k (K, n, n) of the paper's (11) [denso]_, of a rank of at most count - 1."""
        n, K = self._mean.shape
        covariance = np.empty((K, n, n))
        for (i, j), total in zip(self._pairs, self._sums, strict=True):
            covariance[:, i, j] = covariance[:, j, i] = total / (self._count - 1)
        return covariance


@dataclass(frozen=True, kw_only=True, eq=False)
class Efforts:
    """Filtered efforts: their mean over the periods, and their covariance.

    Attributes
    ----------
    mean : (K, n) ndarray
        Over the periods, in N·m.
    covariance : (K, n, n) ndarray or None
        In (N·m)².
    periods : (P, K, n) ndarray or None
        All of them, where there are several and they take no more than 128 MiB.
    note : str or None
        Why they are not kept.
    """

    mean: Array
    covariance: Array | None = None
    periods: Array | None = None
    note: str | None = None

    @staticmethod
    def of(log: Recording, chain: Chain, *, covariance: bool, chunk: int) -> Efforts:
        """Filter the efforts of a recording and add up mean and covariance.

        Parameters
        ----------
        log : Recording
            The record.
        chain : Chain
            Window, filter and decimation.
        covariance : bool
            Whether the covariance is wanted.
        chunk : int
            Pieces in which a record without periods is filtered, in samples.
        """
        window, n = chain.window, log.n
        columns = [log.effort[:, j] for j in range(n)]
        K, P = len(range(0, window.length, chain.decimation)), window.periods
        if not window.circular:
            mean = np.empty((K, n))

            def whole(j: int) -> None:
                first = 0
                for part in chain.parts(chunk):
                    kept = part.kept(part.period(columns[j], 0))
                    mean[first : first + kept.size, j] = kept
                    first += kept.size

            in_threads(whole, range(n))
            return Efforts(mean=mean)
        size = 8 * P * K * n
        periods = np.empty((P, K, n)) if P > 1 and size <= _MOST_KEPT else None
        moments = Moments(K, n, covariance=covariance)
        values = np.empty((n, K))
        # One set of threads for all periods: each finds the memory of the period before.
        with workers(n) as each:
            for p in range(P):

                def one(j: int, p: int = p) -> None:
                    values[j] = chain.kept(chain.period(columns[j], p))

                each(one, range(n))
                moments.add(values)
                if periods is not None:
                    periods[p] = values.T
        note = None
        if P > 1 and periods is None:
            note = (
                f"efforts of the single periods not kept: they take {size / 1e6:.4g} MB, more than "
                f"{_MOST_KEPT / 1e6:.4g} MB"
            )
        return Efforts(
            mean=moments.mean,
            covariance=moments.covariance if covariance else None,
            periods=periods,
            note=note,
        )
