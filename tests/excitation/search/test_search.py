"""The search: several starts, then the best of them refined; better, and within the limits."""

import itertools
import os
import signal
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid.excitation.criterion.criterion import Criterion
from sdpid.excitation.criterion.objectives import Objective
from sdpid.excitation.criterion.rows import BaseRows
from sdpid.excitation.search import search as module
from sdpid.excitation.search.ipopt import INTERRUPTED
from sdpid.excitation.search.search import Candidate, Search, most_steps
from sdpid.excitation.search.space import SplineSpace
from sdpid.excitation.search.starts import random_start
from tests.helpers.robots import planar_arm

pytest.importorskip("casadi", reason="needs the extra excite")

LIMITS = sdpid.Limits(lower=-1.5, upper=1.0, velocity=2.0, acceleration=4.0, jerk=40.0, share=1.0)


def search_of(limits: sdpid.Limits = LIMITS, **settings: Any) -> Search:
    robot = planar_arm()
    rows = BaseRows.of(robot, ("viscous",))
    criterion = Criterion(
        rows=rows,
        objective=Objective(kind="mixed"),
        rates=np.ones(robot.n),
        known=np.zeros((rows.count, rows.count)),
    )
    space = SplineSpace.of(robot.n, 4.0, intervals=8)
    return Search(space=space, criterion=criterion, limits=limits.of(robot), **settings)


def starts_of(search: Search, count: int) -> Iterator[Array]:
    rng = np.random.default_rng(0)
    for _ in range(count):
        home = rng.uniform(-1.0, 0.5, search.space.n)
        yield random_start(search.space, search.linear, home, rng, lambda x: True)


def holds(candidate: Candidate, search: Search) -> bool:
    A, lower, upper = search.on(candidate.space).linear
    at = A @ candidate.x
    return bool(np.all((at >= lower) & (at <= upper)))


def test_the_best_are_refined_within_the_limits() -> None:
    search = search_of()
    steps = 0

    def step() -> None:
        nonlocal steps
        steps += 1

    found, stopped = search.run(starts_of(search, 3), step=step)
    assert not stopped
    assert all(holds(candidate, search) for candidate in found)
    assert [c.value for c in found] == sorted(c.value for c in found)
    sizes = {c.space.size for c in found}
    assert len(sizes) == 3
    assert found[0].space.size > search.space.size
    coarse = min(c.value for c in found if c.space is search.space)
    assert found[0].value < coarse
    assert sum(c.steps for c in found) == steps <= most_steps(3)


def test_the_best_goes_on_after_starts_that_are_no_better(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "_REFINING_STEPS", 5)
    search = search_of()
    start = next(starts_of(search, 1))
    values = [search.run([start] * count)[0][0].value for count in (1, 2, 3)]
    assert values[0] > values[1] > values[2]


def test_more_time_never_finds_a_worse_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    values = []
    for deadline in (2.0, 10.0, 30.0, 50.0, 90.0, 140.0, 200.0):
        # A clock that counts how often it is asked.
        clock = SimpleNamespace(monotonic=itertools.count().__next__)
        monkeypatch.setattr(module, "time", clock)
        search = search_of(deadline=deadline)
        found, _ = search.run(starts_of(search, 3))
        values.append(found[0].value)
    assert values == sorted(values, reverse=True)
    assert values[-1] < values[0]


def test_after_the_deadline_there_is_still_a_motion() -> None:
    search = search_of(deadline=0.0)
    found, stopped = search.run(starts_of(search, 3))
    assert stopped
    assert len(found) == 1
    assert holds(found[0], search)


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("sent", [False, True])
def test_an_interrupted_search_is_not_refined(sent: bool) -> None:
    """Raised in a step, or by a signal, it leaves the best so far."""
    search = search_of()
    calls = 0

    def interrupt() -> None:
        nonlocal calls
        calls += 1
        if calls == 5:
            if not sent:
                raise KeyboardInterrupt
            os.kill(os.getpid(), signal.SIGINT)

    found, stopped = search.run(starts_of(search, 3), step=interrupt)
    assert stopped
    assert [c.status for c in found] == [INTERRUPTED]
    assert not sent or found[0].steps in (5, 6)
    assert holds(found[0], search)
