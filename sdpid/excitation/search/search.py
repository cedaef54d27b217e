"""Search motions from several starts, refine the best, and keep what each found."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.criterion.criterion import Criterion
from sdpid.excitation.limits.joint_limits import JointLimits
from sdpid.excitation.search.ipopt import Rows, minimize
from sdpid.excitation.search.linear import linear_limits
from sdpid.excitation.search.space import Space

# Steps of one start: what more of them bring, finer motions bring sooner.
MOST_STEPS = 40
# What is better than all starts before goes on with twice and four times the intervals; after any
# other start the best so far goes on. Deadlines only end this: what a search finds in less time,
# it finds in more.
_LEVELS, _REFINING_STEPS = 2, 60


def most_steps(starts: int) -> int:
    """Return the largest number of steps of a search from a number of starts."""
    return starts * (MOST_STEPS + _LEVELS * _REFINING_STEPS)


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """The best motion from one start.

    Attributes
    ----------
    space : Space
        The motions that it was searched among.
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

    space: Space
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
    limits : JointLimits
        Of positions, speeds, accelerations and jerks.
    start : ndarray, shape (n,), optional
        Where the motions begin.
    deadline : float
        Time of `time.monotonic` at which the search ends, infinite for none.
    """

    space: Space
    criterion: Criterion
    limits: JointLimits
    start: Array | None = None
    deadline: float = np.inf

    def on(self, space: Space) -> Search:
        """Return the same search among other motions."""
        return replace(self, space=space)

    @cached_property
    def linear(self) -> tuple[Any, Array, Array]:
        """Matrix, lower and upper limits of rows that hold at every instant."""
        return linear_limits(self.space, self.limits, self.start)

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
        near: bool = False,
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
        near : bool, optional
            Whether the start is nearly the best.
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
            near=near,
        )
        candidate = Candidate(
            space=self.space,
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
        rows_of: Callable[[Space], Rows | None] = lambda space: None,
        *,
        step: Callable[[], None] = lambda: None,
    ) -> tuple[list[Candidate], bool]:
        """Search from every start, go on from the best, while there is time.

        Parameters
        ----------
        starts : iterable of ndarray (N,)
            Motions within all limits.
        rows_of : callable, optional
            Further limits of motions of a space.
        step : callable, optional
            Called after every step.

        Returns
        -------
        list of Candidate
            The best first.
        bool
            Whether the search was stopped before its end.
        """
        found: list[Candidate] = []
        rows, coarse, gone, stopped = rows_of(self.space), np.inf, None, False
        try:
            for number, start in enumerate(starts):
                candidate, stopped = self.improve(start, rows, number=number, step=step)
                found.append(candidate)
                times = _LEVELS
                if candidate.value < coarse:
                    coarse = candidate.value
                else:
                    candidate = min(found, key=_value)
                    # What went on in vain would do so again.
                    gone, times = candidate, int(candidate is not gone)
                for _ in range(times):
                    if stopped:
                        break
                    space, x = self._onward(candidate)
                    candidate, stopped = self.on(space).improve(
                        x,
                        rows_of(space),
                        number=candidate.start,
                        most_steps=_REFINING_STEPS,
                        step=step,
                        near=True,
                    )
                    found.append(candidate)
                if stopped:
                    break
        except KeyboardInterrupt:
            if not found:
                raise
            stopped = True
        return sorted(found, key=_value), stopped

    def _onward(self, candidate: Candidate) -> tuple[Space, Array]:
        """Return the motions among which a candidate goes on, and its numbers there."""
        finer = None
        if candidate.space.size < 2**_LEVELS * self.space.size:
            finer = candidate.space.refined(candidate.x)
        return finer or (candidate.space, candidate.x)


def _value(candidate: Candidate) -> float:
    return candidate.value
