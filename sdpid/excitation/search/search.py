"""Search motions from several starts, refine the best, and keep what each found."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.excitation.criterion.criterion import Criterion
from sdpid.excitation.limits.joint_limits import JointLimits
from sdpid.excitation.search.inequalities import InstantRows
from sdpid.excitation.search.ipopt import Rows, minimize, require_solver
from sdpid.excitation.search.linear import linear_limits
from sdpid.excitation.search.space import Space
from sdpid.excitation.search.starts import random_start

# Random motions of which the best is the first start: condition numbers of single starts differ by
# up to a fifth (UR10e).
_FIRST = 4


def require_search(time_limit: float | None, **counts: int) -> None:
    """Refuse numbers of starts and steps, and time limits, of which there is no search.

    Raises
    ------
    DataError
        When one is out of range.
    MissingExtraError
        When CasADi is not installed (extra ``excite``).
    """
    for name, number in counts.items():
        if number < 1:
            raise DataError(f"{name}: is {number}; give at least 1.")
    if time_limit is not None and not time_limit > 0.0:
        raise DataError(f"time_limit: is {time_limit}; give a positive time in s.")
    require_solver()


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

    What is better than all starts before goes on with twice the intervals, and so on; after any
    other start the best so far goes on. Deadlines only end this: what a search finds in less time,
    it finds in more.

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
    steps, refining_steps : int
        Largest numbers of steps from one start, and of one with finer motions: what more steps
        from a start bring, finer motions bring sooner.
    levels : int
        How often the intervals are halved.
    """

    space: Space
    criterion: Criterion
    limits: JointLimits
    start: Array | None = None
    deadline: float = np.inf
    steps: int = 40
    refining_steps: int = 60
    levels: int = 2

    def most_steps(self, starts: int) -> int:
        """Return the largest number of steps of a search from a number of starts."""
        return starts * (self.steps + self.levels * self.refining_steps)

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

    def random_starts(
        self, homes: Iterable[Array], rows: InstantRows | None, rng: np.random.Generator
    ) -> Iterator[Array]:
        """Yield random motions within all limits, one from each home (n,)."""
        holds = (lambda x: True) if rows is None else rows.hold
        drawn = (random_start(self.space, self.linear, home, rng, holds) for home in homes)
        # The best goes first: a search that ends at once is no worse than any of these.
        first = itertools.islice(drawn, _FIRST)
        yield from sorted(first, key=lambda x: self.value_and_gradient(x)[0])
        yield from drawn

    def improve(
        self,
        start: Array,
        rows: Rows | None,
        *,
        number: int = 0,
        most_steps: int | None = None,
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
            Largest number of steps; by default `steps`.
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
            most_steps=most_steps or self.steps,
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
                times = self.levels
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
                        most_steps=self.refining_steps,
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
        if candidate.space.size < 2**self.levels * self.space.size:
            finer = candidate.space.refined(candidate.x)
        return finer or (candidate.space, candidate.x)


def _value(candidate: Candidate) -> float:
    return candidate.value
