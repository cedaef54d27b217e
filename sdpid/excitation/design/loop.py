"""From random motions to one that shows most, and holds its limits wherever it is checked."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import TypeAlias

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import InfeasibleError
from sdpid.excitation.limits.check import LimitCheck
from sdpid.excitation.search.search import Candidate, Search, counted_steps

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
