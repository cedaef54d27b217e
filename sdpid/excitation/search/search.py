"""Search motions from several starts, and keep the best that each found."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.criterion.criterion import Criterion
from sdpid.excitation.search.ipopt import Rows, minimize
from sdpid.excitation.search.space import Space

# Steps of one start: nine tenths of what more would bring.
MOST_STEPS = 250


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """The best motion from one start.

    Attributes
    ----------
    x : ndarray, shape (N,)
        Its free numbers.
    value : float
        The objective.
    start : int
        Number of the start, from 0.
    steps : int
        Steps of the search.
    status : str
        How it ended, in the solver's words.
    seconds : float
        Time that it took.
    """

    x: Array
    value: float
    start: int
    steps: int
    status: str
    seconds: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Search:
    """A search of motions.

    Attributes
    ----------
    space : Space
        The motions.
    criterion : Criterion
        What is made small.
    linear : tuple
        Limits that hold at every instant, from `linear_limits`.
    deadline : float
        Time of `time.monotonic` at which the search ends, infinite for none.
    """

    space: Space
    criterion: Criterion
    linear: tuple[Any, Array, Array]
    deadline: float = np.inf

    def value_and_gradient(self, x: Array) -> tuple[float, Array]:
        """Return the objective of a motion (N,) and its gradient (N,)."""
        c = self.space.coefficients(x)
        q, v, a = (matrix @ c for matrix in self._matrices)
        value, slopes = self.criterion.gradient(q, v, a, self.space.duration)
        by_c = sum(m.T @ slope for m, slope in zip(self._matrices, slopes, strict=True))
        return value, self.space.pulled(np.asarray(by_c))

    @cached_property
    def _matrices(self) -> list[Array]:
        grid = self.space.grid()
        return [self.space.basis(grid, order) for order in range(3)]

    def improve(
        self,
        start: Array,
        rows: Rows | None,
        *,
        number: int = 0,
        most_steps: int = MOST_STEPS,
        step: Callable[[], None] = lambda: None,
    ) -> tuple[Candidate, bool]:
        """Search from one start, and say whether the search was stopped.

        Parameters
        ----------
        start : ndarray, shape (N,)
            A motion within all limits.
        rows : Rows, optional
            Further limits.
        number : int, optional
            Number of the start.
        most_steps : int, optional
            Largest number of steps.
        step : callable, optional
            Called after every step.
        """
        began = time.monotonic()

        def stop(steps: int, value: float) -> bool:
            step()
            return time.monotonic() > self.deadline

        found = minimize(
            self.value_and_gradient,
            start,
            self.linear,
            rows,
            most_steps=most_steps,
            stop=stop,
        )
        candidate = Candidate(
            x=found.x,
            value=found.value,
            start=number,
            steps=found.steps,
            status=found.status,
            seconds=time.monotonic() - began,
        )
        return candidate, found.stopped

    def run(
        self,
        starts: Iterable[Array],
        rows: Rows | None,
        *,
        step: Callable[[], None] = lambda: None,
    ) -> tuple[list[Candidate], bool]:
        """Search from every start until the deadline or an interruption.

        Returns
        -------
        list of Candidate
            The best first.
        bool
            Whether the search was stopped before the last start.
        """
        found: list[Candidate] = []
        stopped = False
        for number, start in enumerate(starts):
            candidate, stopped = self.improve(start, rows, number=number, step=step)
            found.append(candidate)
            if stopped:
                break
        return sorted(found, key=lambda each: each.value), stopped
