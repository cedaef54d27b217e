"""Search motions from several starts, refine the best, and keep what each found."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.progress import progress
from sdpid.errors import DataError
from sdpid.excitation.criterion.criterion import Criterion
from sdpid.excitation.limits.check import LimitCheck
from sdpid.excitation.limits.joint_limits import JointLimits
from sdpid.excitation.search.inequalities import InstantRows
from sdpid.excitation.search.ipopt import minimize, require_solver
from sdpid.excitation.search.space import Space
from sdpid.excitation.search.starts import Linear, linear_limits, random_start
from sdpid.experiment.trajectory.curve import Curve

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


class Inequalities(Protocol):
    """Limits that are no linear functions of a motion, as a search holds them on a grid."""

    def rows(self, space: Space) -> InstantRows | None:
        """Return the rows that a search among motions holds; None where there are none."""

    def learn(self, check: LimitCheck) -> None:
        """Hold what a check found broken with more room."""

    def check(self, curve: Curve) -> LimitCheck:
        """Return what a motion comes to beside all limits."""


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
    stopped : bool
        Whether that was before its end.
    seconds : float
        Time that it took.
    """

    space: Space
    x: Array
    value: float
    start: int
    steps: int
    status: str
    stopped: bool
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
    inequalities : Inequalities
        All other limits.
    name : str
        The robot.
    start : ndarray, shape (n,), optional
        Where the motions begin.
    deadline : float
        Time of `time.monotonic` at which the search ends, infinite for none.
    steps, refining_steps : int
        Largest numbers of steps from one start, and of one with finer motions: what more steps
        from a start bring, finer motions bring sooner.
    levels : int
        How often the intervals are halved.
    step : callable
        Called after every step.
    """

    space: Space
    criterion: Criterion
    limits: JointLimits
    inequalities: Inequalities
    name: str
    start: Array | None = None
    deadline: float = np.inf
    steps: int = 40
    refining_steps: int = 60
    levels: int = 2
    step: Callable[[], None] = lambda: None

    def most_steps(self, starts: int) -> int:
        """Return the largest number of steps of a search from a number of starts."""
        return starts * (self.steps + self.levels * self.refining_steps)

    def on(self, space: Space) -> Search:
        """Return the same search among other motions."""
        return replace(self, space=space)

    @cached_property
    def linear(self) -> Linear:
        """Matrix, lower and upper limits of rows that hold at every instant."""
        return linear_limits(self.space, self.limits, self.start)

    @cached_property
    def rows(self) -> InstantRows | None:
        """All other limits, on a grid."""
        return self.inequalities.rows(self.space)

    def holds(self, x: Array) -> bool:
        """Return whether a motion (N,) is within the limits on the grid."""
        return self.rows is None or self.rows.hold(x)

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

    def random_starts(self, homes: Iterable[Array], rng: np.random.Generator) -> Iterator[Array]:
        """Yield random motions within all limits, one from each home (n,)."""
        drawn = (random_start(self.space, self.linear, home, rng, self.holds) for home in homes)
        # The best goes first: a search that ends at once is no worse than any of these.
        first = itertools.islice(drawn, _FIRST)
        yield from sorted(first, key=lambda x: self.value_and_gradient(x)[0])
        yield from drawn

    def improve(
        self, start: Array, *, number: int = 0, most_steps: int | None = None, near: bool = False
    ) -> Candidate:
        """Search from one start.

        Parameters
        ----------
        start : ndarray, shape (N,)
            A motion within all limits.
        number : int, optional
            Number of the start.
        most_steps : int, optional
            Largest number of steps; by default `steps`.
        near : bool, optional
            Whether the start is nearly the best.
        """
        began = time.monotonic()

        def stop(steps: int, value: float) -> bool:
            self.step()
            return time.monotonic() > self.deadline

        found = minimize(
            self.value_and_gradient,
            start,
            self.linear,
            self.rows,
            most_steps=most_steps or self.steps,
            stop=stop,
            near=near,
        )
        return Candidate(
            space=self.space,
            x=found.x,
            value=found.value,
            start=number,
            steps=found.steps,
            status=found.status,
            stopped=found.stopped,
            seconds=time.monotonic() - began,
        )

    def run(self, starts: Iterable[Array]) -> tuple[list[Candidate], bool]:
        """Search from every start (N,), go on from the best, while there is time.

        Returns
        -------
        list of Candidate
            The best first.
        bool
            Whether the search was stopped before its end.
        """
        found: list[Candidate] = []
        coarse, gone, stopped = np.inf, None, False
        try:
            for number, start in enumerate(starts):
                candidate, times = self.improve(start, number=number), self.levels
                found.append(candidate)
                if candidate.value < coarse:
                    coarse = candidate.value
                else:
                    candidate = min(found, key=_value)
                    # What went on in vain would do so again.
                    gone, times = candidate, int(candidate is not gone)
                for _ in range(times):
                    if found[-1].stopped:
                        break
                    candidate = self._onward(candidate)
                    found.append(candidate)
                stopped = found[-1].stopped
                if stopped:
                    break
        except KeyboardInterrupt:
            if not found:
                raise
            stopped = True
        return sorted(found, key=_value), stopped

    def _onward(self, candidate: Candidate) -> Candidate:
        """Return what a search finds from a candidate, among finer motions where there are any."""
        space, x = candidate.space, candidate.x
        if space.size < 2**self.levels * self.space.size:
            space, x = space.refined(x) or (space, x)
        most = self.refining_steps
        return self.on(space).improve(x, number=candidate.start, most_steps=most, near=True)


def _value(candidate: Candidate) -> float:
    return candidate.value


@contextmanager
def counted_steps(
    total: int, began: float, deadline: float, shown: bool | None
) -> Iterator[Callable[[], None]]:
    """Yield what to call after every step of a search, which moves a progress bar.

    Parameters
    ----------
    total : int
        Largest number of steps.
    began, deadline : float
        Times of `time.monotonic` between which the search runs; an infinite deadline for none.
        With one the bar shows the share of the time.
    shown : bool, optional
        Whether there is a bar; by default on a terminal.
    """
    timed = bool(np.isfinite(deadline))
    last = began
    length = deadline - began if timed else total
    with progress(length, "searching a motion", enabled=shown) as advance:

        def step() -> None:
            nonlocal last
            now = time.monotonic()
            advance(now - last if timed else 1.0)
            last = now

        yield step
