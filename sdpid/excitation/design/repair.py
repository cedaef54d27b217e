"""From a motion that holds its limits on a grid to one that holds them wherever it is checked."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from sdpid._common.arrays import Array
from sdpid.errors import InfeasibleError
from sdpid.excitation.limits.check import LimitCheck
from sdpid.excitation.search.inequalities import InstantRows
from sdpid.excitation.search.search import Candidate, Search
from sdpid.excitation.search.space import Space
from sdpid.experiment.trajectory.curve import Curve
from sdpid.robot.model.model import RobotModel

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


class Design(Protocol):
    """What a motion is designed for."""

    @property
    def robot(self) -> RobotModel:
        """The robot."""

    def check(self, curve: Curve) -> LimitCheck:
        """Return what a motion comes to beside its limits."""


class Inequalities(Protocol):
    """Limits that are no linear functions of a motion, as a search holds them on a grid."""

    def rows(self, space: Space) -> InstantRows | None:
        """Return the rows that a search among motions holds; None where there are none."""

    def learn(self, check: LimitCheck) -> None:
        """Hold what a check found broken with more room."""


def checked(task: Design, candidate: Candidate, share: float = 1.0) -> tuple[Array, LimitCheck]:
    """Return a share of a motion's way from standing still (N,), and its check."""
    x = _part(candidate, share)
    return x, task.check(candidate.space.curve(x))


def mend(
    task: Design, search: Search, found: Sequence[Candidate], inequalities: Inequalities
) -> tuple[Candidate, LimitCheck]:
    """Return the best motion that holds all limits where it is checked, and the check.

    The motions found, the best first, are taken as they are or a little smaller; where that costs
    too much, the search goes on from the best of them with wider margins.

    Raises
    ------
    InfeasibleError
        When none is found: it names the limits in the way.
    """
    _require_motion(task, found[0])
    sound: list[tuple[Candidate, LimitCheck]] = []
    for candidate in found:
        if sound and (
            _objective(sound[0]) <= candidate.value or time.monotonic() > search.deadline
        ):
            break
        sound = sorted([*sound, *_smaller(task, search, candidate, _NEARLY)], key=_objective)
    if not sound or _objective(sound[0]) > found[0].value + _WORSE:
        again = _searched_again(task, search, found[0], inequalities)
        # What a search could not mend is only made much smaller where nothing else is sound.
        shares = (1.0,) if sound else (1.0, *_SHRINKS)
        sound = sorted([*sound, *_smaller(task, search, again, shares)], key=_objective)
    if sound:
        return sound[0]
    check = checked(task, again, _SHRINKS[-1])[1]
    broken = "; ".join(
        f"{row.kind} of {row.subject} by {-row.slack:.3g} {row.unit} at {row.time:.2f} s"
        for row in check.rows
        if row.verdict != "held"
    )
    raise InfeasibleError(
        f"excitation of '{task.robot.name}': no motion was found that holds every limit. Even one "
        f"of a tenth of the size breaks: {broken}. Widen these limits, or give another start."
    )


def _objective(sound: tuple[Candidate, LimitCheck]) -> float:
    return sound[0].value


def _smaller(
    task: Design, search: Search, candidate: Candidate, shares: Iterable[float]
) -> Iterator[tuple[Candidate, LimitCheck]]:
    """Yield the largest of some shares of a motion that holds all limits, with its check."""
    for share in shares:
        x, check = checked(task, candidate, share)
        if check.ok:
            if share < 1.0:
                value = search.on(candidate.space).value_and_gradient(x)[0]
                status = f"shrunk to {100.0 * share:g} %"
                candidate = replace(candidate, x=x, value=value, status=status)
            yield candidate, check
            return


def _searched_again(
    task: Design, search: Search, candidate: Candidate, inequalities: Inequalities
) -> Candidate:
    """Return what a search finds from a motion with margins as wide as its checks ask for."""
    for _ in range(_ROUNDS):
        check = checked(task, candidate)[1]
        if check.ok:
            break
        inequalities.learn(check)
        rows = inequalities.rows(candidate.space)
        start = shrunk(candidate, rows)
        candidate, stopped = search.on(candidate.space).improve(
            start, rows, number=candidate.start, most_steps=_STEPS, near=True
        )
        if stopped:
            break
    return candidate


def _require_motion(task: Design, candidate: Candidate) -> None:
    """Refuse a candidate that stands still: no start moved, or none was searched in time."""
    space = candidate.space
    if np.ptp(space.curve(candidate.x).evaluate(space.grid()), axis=0).max() > _STILL:
        return
    check = checked(task, candidate)[1]
    nearest = min(check.rows, key=lambda row: row.slack / (abs(row.limit) or 1.0))
    raise InfeasibleError(
        f"excitation of '{task.robot.name}': no motion was found, the robot stands still. Nearest "
        f"to its limit is {nearest.kind} of {nearest.subject} ({nearest.slack:.3g} {nearest.unit} "
        "left). Give the search more time, another start, or wider limits."
    )


def shrunk(candidate: Candidate, rows: InstantRows | None) -> Array:
    """Return a motion (N,) as large as may be, on the way to standing still, that holds rows."""
    for share in 0.85 ** np.arange(30):
        moved = _part(candidate, share)
        if rows is None or rows.hold(moved):
            return moved
    return _part(candidate, 0.0)


def _part(candidate: Candidate, share: float) -> Array:
    """Return a share of a motion's way (N,) from standing still where it begins."""
    space, x = candidate.space, candidate.x
    still = space.standing(space.first @ space.coefficients(x))
    return np.asarray(still + share * (x - still))
