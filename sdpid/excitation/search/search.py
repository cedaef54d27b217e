"""Search motions from several starts, refine the best, and keep what each found."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.excitation.criterion.criterion import Criterion
from sdpid.excitation.limits.joint_limits import JointLimits
from sdpid.excitation.search.ipopt import INTERRUPTED, Rows, minimize
from sdpid.excitation.search.linear import linear_limits
from sdpid.excitation.search.space import Space

# Steps of one start: most end by themselves after 100 to 250 (UR10e, LWR 4+).
MOST_STEPS = 250
# The best motions go on with twice and four times the intervals: from 36 of them in 20 s, the
# condition number of a UR10e falls by another tenth, in a third of the time of one start.
_REFINED, _LEVELS, _REFINING_STEPS = 2, 2, 150
# Share of the time after which starts end and the best are refined.
_COARSE = 0.6


def most_steps(starts: int) -> int:
    """Return the largest number of steps of a search from a number of starts."""
    return starts * MOST_STEPS + min(starts, _REFINED) * _LEVELS * _REFINING_STEPS


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
        """Search from every start, refine the best, until the deadline or an interruption.

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
        stopped = False
        try:
            for candidate, ended in self._candidates(starts, rows_of, step):
                found.append(candidate)
                stopped = ended
                if candidate.status == INTERRUPTED:
                    break
        except KeyboardInterrupt:
            if not found:
                raise
            stopped = True
        return sorted(found, key=_value), stopped

    def _candidates(
        self,
        starts: Iterable[Array],
        rows_of: Callable[[Space], Rows | None],
        step: Callable[[], None],
    ) -> Iterator[tuple[Candidate, bool]]:
        """Yield the best from every start, then refined; and whether each was stopped."""
        now = time.monotonic()
        coarse = replace(self, deadline=now + _COARSE * (self.deadline - now))
        rows = rows_of(self.space)
        found: list[Candidate] = []
        for number, start in enumerate(starts):
            candidate, stopped = coarse.improve(start, rows, number=number, step=step)
            found.append(candidate)
            yield candidate, stopped
            if stopped:
                break
        for candidate in sorted(found, key=_value)[:_REFINED]:
            for _ in range(_LEVELS):
                refined = candidate.space.refined(candidate.x)
                if refined is None or time.monotonic() > self.deadline:
                    break
                candidate, stopped = self.on(refined[0]).improve(
                    refined[1],
                    rows_of(refined[0]),
                    number=candidate.start,
                    most_steps=_REFINING_STEPS,
                    step=step,
                )
                yield candidate, stopped


def _value(candidate: Candidate) -> float:
    return candidate.value
