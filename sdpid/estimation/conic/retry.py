"""Solve a cone program again, with other settings, until what is found is good enough."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from sdpid._common.arrays import Array
from sdpid.estimation.conic.solve import ConicSolution

A = TypeVar("A")
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Retried(Generic[T]):
    """What several attempts found.

    Attributes
    ----------
    value : T or None
        What was made of the best solution; None where there is none to use.
    accepted : bool
        Whether it is good enough. Where not, `value` is only the best there was.
    status : str
        What the solver said of that solution, or without one, of the last attempt.
    seconds : float
        In the solver, over all attempts.
    solves : int
        Attempts made.
    """

    value: T | None
    accepted: bool
    status: str
    seconds: float
    solves: int


def solve_with_retries(
    solve: Callable[[A], ConicSolution],
    attempts: Iterable[A],
    judge: Callable[[Array, ConicSolution], tuple[T, float] | None],
    *,
    enough: float = 0.0,
) -> Retried[T]:
    """Solve with each setting in turn until a solution is good enough, and return the best.

    Parameters
    ----------
    solve : callable
        Solves with one setting, such as Clarabel's regularization.
    attempts : iterable
        The settings, in the order in which they are tried.
    judge : callable
        Takes the point and its solution; returns what the caller makes of them, and by how much
        that falls short (the less the better), or None where it is of no use. Solutions without a
        point are not judged.
    enough : float, optional
        The attempts end with the first that falls short by no more than this; ``-inf`` makes all.

    Returns
    -------
    Retried
        The first of those that fall short least. Callers decide what one that is not accepted is
        worth to them.
    """
    value: T | None = None
    least, status, seconds, solves = np.inf, "not attempted", 0.0, 0
    for attempt in attempts:
        solution = solve(attempt)
        seconds, solves = seconds + solution.seconds, solves + 1
        if value is None:
            status = solution.status
        judged = None if solution.x is None else judge(solution.x, solution)
        if judged is not None:
            made, short = judged[0], np.inf if np.isnan(judged[1]) else judged[1]
            if value is None or short < least:
                value, least, status = made, short, solution.status
        if least <= enough:
            break
    return Retried(value, bool(least <= enough), status, seconds, solves)
