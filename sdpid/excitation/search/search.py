"""Search motions from several starts, refine the best, and mend it until it holds its limits."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from types import SimpleNamespace
from typing import Protocol, TypeAlias

import numpy as np

from sdpid._common.arrays import Array
from sdpid._common.progress import progress
from sdpid.errors import DataError, InfeasibleError
from sdpid.excitation.criterion.criterion import Criterion
from sdpid.excitation.limits.check import LimitCheck
from sdpid.excitation.limits.joint_limits import JointLimits
from sdpid.excitation.search.ipopt import minimize, require_solver
from sdpid.excitation.search.space import InstantRows, Linear, Space, linear_limits, random_start
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


# Rounds of search, check, and a wider margin; of steps of a search in one.
_ROUNDS, _STEPS = 6, 60
# A robot that moves by less than this stands still, rad (m).
_STILL = 1e-6
# Shares of a motion's way from standing still that are tried: nearly all of it first, which costs
# little of what it shows, and less where no search mends it.
_NEARLY = (1.0, 0.998, 0.99, 0.98, 0.95, 0.9)
# A sound motion whose objective exceeds what the search found by more than this is searched again.
_WORSE = 0.1
_SHRINKS = (0.98, 0.95, 0.9, 0.8, 0.65, 0.5, 0.3, 0.1)

# A motion and what it comes to beside its limits.
Checked: TypeAlias = tuple[Candidate, LimitCheck]


def designed(
    search: Search,
    homes: Iterable[Array],
    rng: np.random.Generator,
    asked: SimpleNamespace,
    began: float,
    kept: tuple[float, float],
) -> tuple[Checked, list[Candidate], bool]:
    """Return the best motion that holds all limits, what was found, and whether it was stopped.

    Parameters
    ----------
    search : Search
        What is looked for, without an end.
    homes : iterable of ndarray (n,)
        Where motions begin.
    rng : numpy.random.Generator
        The only source of randomness.
    asked : SimpleNamespace
        Arguments of the design: the number of ``starts``, without a ``time_limit`` (s) no more
        homes are searched from, and ``progress``, by default a bar on a terminal.
    began : float
        Time of `time.monotonic` at which the design began.
    kept : tuple of float
        Seconds of a time limit, and its share at most, that are kept for the check: half of them
        may be taken to mend what was found.
    """
    seconds = 0.0
    if (limit := asked.time_limit) is not None:
        seconds = min(kept[0], kept[1] * limit)
        search = replace(search, deadline=began + limit - seconds)
    most, total = asked.starts if limit is None else None, search.most_steps(asked.starts)
    with counted_steps(total, began, search.deadline, asked.progress) as step:
        begun = search.random_starts(homes, rng)
        found, stopped = replace(search, step=step).run(itertools.islice(begun, most))
    search = replace(search, deadline=search.deadline + seconds / 2.0)
    return mend(search, found), found, stopped


def mend(search: Search, found: Sequence[Candidate]) -> Checked:
    """Return the best motion that holds all limits where it is checked, and the check.

    The motions found, the best first, are taken as they are or a little smaller; where that costs
    too much, the search goes on from the best of them with wider margins.

    Raises
    ------
    InfeasibleError
        When none is found: it names the limits in the way.
    """
    _require_motion(search, found[0])
    sound: list[Checked] = []
    for candidate in found:
        late = time.monotonic() > search.deadline
        if sound and (_objective(sound[0]) <= candidate.value or late):
            break
        sound = sorted([*sound, *_smaller(search, candidate, _NEARLY)], key=_objective)
    if not sound or _objective(sound[0]) > found[0].value + _WORSE:
        again = _searched_again(search, found[0])
        # What a search could not mend is only made much smaller where nothing else is sound.
        shares = (1.0,) if sound else (1.0, *_SHRINKS)
        sound = sorted([*sound, *_smaller(search, again, shares)], key=_objective)
    if sound:
        return sound[0]
    _, check = checked(search, again, _SHRINKS[-1])
    broken = "; ".join(
        f"{row.kind} of {row.subject} by {-row.slack:.3g} {row.unit} at {row.time:.2f} s"
        for row in check.rows
        if row.verdict != "held"
    )
    raise InfeasibleError(
        f"excitation of '{search.name}': no motion was found that holds every limit. Even one "
        f"of a tenth of the size breaks: {broken}. Widen these limits, or give another start."
    )


def _objective(sound: Checked) -> float:
    return sound[0].value


def checked(search: Search, candidate: Candidate, share: float = 1.0) -> tuple[Array, LimitCheck]:
    """Return a share of a motion's way from standing still (N,), and its check."""
    x = _part(candidate, share)
    return x, search.inequalities.check(candidate.space.curve(x))


def _smaller(search: Search, candidate: Candidate, shares: Iterable[float]) -> Iterator[Checked]:
    """Yield the largest of some shares of a motion that holds all limits, with its check."""
    for share in shares:
        x, check = checked(search, candidate, share)
        if check.ok:
            if share < 1.0:
                value, _ = search.on(candidate.space).value_and_gradient(x)
                candidate = replace(candidate, x=x, value=value)
            yield candidate, check
            return


def _searched_again(search: Search, candidate: Candidate) -> Candidate:
    """Return what a search finds from a motion with margins as wide as its checks ask for."""
    for _ in range(_ROUNDS):
        _, check = checked(search, candidate)
        if check.ok:
            break
        search.inequalities.learn(check)
        again = search.on(candidate.space)
        # As large as may be, on the way to standing still.
        parts = (_part(candidate, share) for share in (*0.85 ** np.arange(30), 0.0))
        start = next((x for x in parts if again.holds(x)), _part(candidate, 0.0))
        candidate = again.improve(start, number=candidate.start, most_steps=_STEPS, near=True)
        if candidate.stopped:
            break
    return candidate


def _require_motion(search: Search, candidate: Candidate) -> None:
    """Refuse a candidate that stands still: no start moved, or none was searched in time."""
    space = candidate.space
    if np.ptp(space.curve(candidate.x).evaluate(space.grid()), axis=0).max() > _STILL:
        return
    _, check = checked(search, candidate)
    nearest = min(check.rows, key=lambda row: row.slack / (abs(row.limit) or 1.0))
    raise InfeasibleError(
        f"excitation of '{search.name}': no motion was found, the robot stands still. Nearest "
        f"to its limit is {nearest.kind} of {nearest.subject} ({nearest.slack:.3g} {nearest.unit} "
        "left). Give the search more time, another start, or wider limits."
    )


def _part(candidate: Candidate, share: float) -> Array:
    """Return a share of a motion's way (N,) from standing still where it begins."""
    space, x = candidate.space, candidate.x
    still = space.standing(space.first @ space.coefficients(x))
    return np.asarray(still + share * (x - still))
