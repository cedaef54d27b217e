import itertools
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import csr_array

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.excitation.search import search as module
from sdpid.excitation.search.ipopt import INTERRUPTED, Found, minimize
from sdpid.excitation.search.search import Candidate, Search, counted_steps
from sdpid.excitation.search.space import (
    FourierSpace,
    Space,
    SplineSpace,
    largest_step,
    linear_limits,
    random_start,
)
from tests.helpers.refusals import refuses
from tests.helpers.searches import search_of

# The search: several starts, then the best of them refined; better, and within the limits.


pytest.importorskip("casadi", reason="needs the extra excite")


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
    steps: list[None] = []
    search = search_of(step=lambda: steps.append(None))
    found, stopped = search.run(starts_of(search, 3))
    assert not stopped
    assert all(holds(candidate, search) for candidate in found)
    assert [c.value for c in found] == sorted(c.value for c in found)
    assert len({c.space.size for c in found}) == 3
    assert found[0].space.size > search.space.size
    assert found[0].value < min(c.value for c in found if c.space is search.space)
    assert sum(c.steps for c in found) == len(steps) <= search.most_steps(3)


def test_the_best_goes_on_after_starts_that_are_no_better() -> None:
    search = search_of(refining_steps=5)
    start = next(starts_of(search, 1))
    values = [search.run([start] * count)[0][0].value for count in (1, 2, 3)]
    assert values[0] > values[1] > values[2]


def test_more_time_never_finds_a_worse_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for deadline in (0.0, 2.0, 30.0, 90.0, 200.0):
        # A clock that counts how often it is asked.
        clock = SimpleNamespace(monotonic=itertools.count().__next__)
        monkeypatch.setattr(module, "time", clock)
        search = search_of(deadline=deadline)
        found.append(search.run(starts_of(search, 3)))
        assert holds(found[-1][0][0], search)
    values = [candidates[0].value for candidates, _ in found]
    assert values == sorted(values, reverse=True)
    assert values[-1] < values[0]
    assert [len(candidates) for candidates, _ in found[:2]] == [1, 1]
    assert found[0][1]


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("sent", [False, True])
def test_an_interrupted_search_is_not_refined(sent: bool) -> None:
    """Raised in a step, or by a signal, it leaves the best so far."""
    calls = itertools.count(1)

    def interrupt() -> None:
        if next(calls) == 5:
            if not sent:
                raise KeyboardInterrupt
            os.kill(os.getpid(), signal.SIGINT)

    search = search_of(step=interrupt)
    found, stopped = search.run(starts_of(search, 3))
    assert stopped
    assert [c.status for c in found] == [INTERRUPTED]
    assert not sent or found[0].steps in (5, 6)
    assert holds(found[0], search)


def test_an_interruption_between_starts_leaves_what_was_found() -> None:
    search = search_of(steps=1, refining_steps=1)

    def interrupted(count: int) -> Iterator[Array]:
        yield from starts_of(search, count)
        raise KeyboardInterrupt

    found, stopped = search.run(interrupted(1))
    assert stopped
    assert holds(found[0], search)
    with pytest.raises(KeyboardInterrupt):
        search.run(interrupted(0))


def test_the_best_of_the_first_random_motions_goes_first() -> None:
    search, rng = search_of(), np.random.default_rng(1)
    found = list(search.random_starts(rng.uniform(-1.0, 0.5, (5, search.space.n)), rng))
    values = [search.value_and_gradient(x)[0] for x in found]
    assert len(values) == 5
    assert values[:4] == sorted(values[:4])


# The call of IPOPT: limits hold at every step, and the best point is kept.


TARGET = np.array([2.0, 0.5, -3.0])
BOX = (csr_array(np.eye(3)), np.full(3, -1.0), np.full(3, 1.0))


def bowl(x: np.ndarray) -> tuple[float, np.ndarray]:
    return float(np.sum((x - TARGET) ** 2)), 2.0 * (x - TARGET)


class Ball:
    """1 - x² is at least zero."""

    pattern = np.ones((1, 3), dtype=bool)

    def values(self, x: np.ndarray) -> np.ndarray:
        return np.array([1.0 - x @ x])

    def derivative(self, x: np.ndarray) -> np.ndarray:
        return -2.0 * x[None, :]


def found_in(
    function: Any = bowl, rows: Any = None, stop: Callable[..., bool] = lambda *_: False
) -> Found:
    """Return what is found in the box, in which every point has to be."""
    found = minimize(function, np.zeros(3), BOX, rows, most_steps=100, stop=stop)
    assert np.all(np.abs(found.x) <= 1.0)
    assert found.value == bowl(found.x)[0] <= bowl(np.zeros(3))[0]
    return found


@pytest.mark.parametrize(
    ("rows", "best"), [(None, [1.0, 0.5, -1.0]), (Ball(), TARGET / np.linalg.norm(TARGET))]
)
def test_the_best_point_within_the_limits_is_found(rows: Any, best: Any) -> None:
    found = found_in(rows=rows)
    assert not found.stopped
    np.testing.assert_allclose(found.x, best, atol=1e-2 if rows else 1e-3)
    assert rows is None or found.x @ found.x <= 1.0 + 1e-5


@pytest.mark.parametrize("most", [1, 2, 4])
def test_a_search_stopped_at_any_step_is_within_the_linear_limits(most: int) -> None:
    assert found_in(stop=lambda steps, _: steps >= most).stopped


def raising(error: type[BaseException], call: Any, after: int) -> Any:
    """Return a function that raises instead when it was called some times."""
    calls = itertools.count()

    def called(*arguments: Any) -> Any:
        if next(calls) >= after:
            raise error("here")
        return call(*arguments)

    return called


@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError])
@pytest.mark.parametrize("broken", ["function", "stop", "rows"])
def test_exceptions_come_through_and_interruptions_end_it(error: Any, broken: str) -> None:
    rows = Ball()
    functions = {"function": bowl, "stop": lambda *_: False, "rows": rows.values}
    # Limits at the first point, where there is no value to go on with.
    functions[broken] = raising(error, functions[broken], 0 if broken == "rows" else 3)
    rows.values = functions.pop("rows")  # type: ignore[method-assign]
    if error is ZeroDivisionError:
        refuses(error, "here", found_in, rows=rows, **functions)
    else:
        found = found_in(rows=rows, **functions)
        assert (found.stopped, found.status) == (True, INTERRUPTED)


# Motions of the search: linear in free numbers, at rest at the ends, bounded by their rows.


# Of joints that turn, and of a finger that slides by centimeters.
SIZES = np.array([1.0, 0.01, 0.3])

SPACES = {
    "spline": lambda: SplineSpace.of(3, 8.0),
    "open": lambda: SplineSpace.of(3, 8.0, closed=False),
    "postures": lambda: SplineSpace.postures(3, 20.0),
    "one_by_one": lambda: SplineSpace.one_by_one(3, 20.0),
    "fourier": lambda: FourierSpace.of(3, 8.0, 5),
    "sized": lambda: SplineSpace.of(3, 8.0).sized(SIZES),
}


def drawn(space: Space, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(space.size)


@given(st.sampled_from(tuple(SPACES)), st.integers(0, 1000))
def test_motions_are_linear_at_rest_at_their_ends_and_bounded(name: str, seed: int) -> None:
    space = SPACES[name]()
    x, time = drawn(space, seed), space.grid()
    c, curve = space.coefficients(x), space.curve(x)
    ends, dense = np.array([0.0, curve.duration]), np.linspace(0.0, space.duration, 3001)
    for order in range(4):
        expected, found = space.basis(time, order) @ c, curve.evaluate(time, derivative=order)
        inside = np.abs(expected).max()
        np.testing.assert_allclose(found, expected, atol=1e-9 * inside)
        if order in (1, 2):
            assert np.abs(curve.evaluate(ends, derivative=order)).max() <= 1e-9 * inside
        # Rows bound a derivative between the samples too.
        rows, share = space.bounds(order)
        bound = np.abs(rows @ c).max(axis=0) / share
        assert np.all(np.abs(space.basis(dense, order) @ c).max(axis=0) <= bound * (1.0 + 1e-12))
    if name != "open":
        np.testing.assert_allclose(*curve.evaluate(ends), atol=1e-9)
    by_c = np.random.default_rng(seed + 1).standard_normal(c.shape)
    assert np.sum(c * by_c) == pytest.approx(float(x @ space.pulled(by_c)))
    position = by_c[0]
    still = space.curve(space.standing(position)).evaluate(time)
    np.testing.assert_allclose(still, np.tile(position, (len(time), 1)), atol=1e-9)
    assert (space.refined(x) is None) == (name in ("postures", "one_by_one", "fourier"))


def test_one_joint_moves_at_a_time_and_postures_are_held() -> None:
    moving = {}
    for name in ("one_by_one", "postures"):
        space = SPACES[name]()
        speed = space.curve(drawn(space, 0)).evaluate(space.grid(50.0), derivative=1)
        moving[name] = np.abs(speed) > 1e-9
    assert moving["one_by_one"].any(axis=0).all()
    assert moving["one_by_one"].sum(axis=1).max() == 1
    assert np.mean(~moving["postures"].any(axis=1)) > 0.05


@given(st.sampled_from(("spline", "fourier")), st.integers(0, 200))
def test_random_starts_hold_the_limits_at_every_instant(name: str, seed: int) -> None:
    robot = sdpid.load_robot("denso_vp6242")
    limits = sdpid.Limits(acceleration=4.0, jerk=40.0).of(robot)
    made = {"spline": SplineSpace.of(6, 8.0), "fourier": FourierSpace.of(6, 8.0, 5)}[name]
    begin = limits.rest if seed % 2 else None
    linear = linear_limits(made, limits, begin)
    rng = np.random.default_rng(seed)
    x = random_start(made, linear, limits.rest, rng, lambda x: True)
    A, lower, upper = linear
    assert np.all((A @ x >= lower - 1e-9) & (A @ x <= upper + 1e-9))
    rates = (limits.velocity, limits.acceleration, limits.jerk)
    ends = [(limits.lower, limits.upper), *((-most, most) for most in rates)]
    dense = np.linspace(0.0, 8.0, 2001)
    reached = [made.curve(x).evaluate(dense, derivative=order) for order in range(4)]
    for values, (least, most) in zip(reached, ends, strict=True):
        assert np.all((values >= least) & (values <= most))
    assert np.abs(reached[1]).max() > 0.05
    if begin is not None:
        np.testing.assert_allclose(reached[0][0], begin, atol=1e-9)


@pytest.mark.parametrize(
    ("direction", "length"), [((1.0, 1.0), 1.0), ((0.0, 1.0), 3.0), ((0.0, -2.0), 0.5)]
)
def test_the_largest_step_ends_at_the_first_limit(direction: Any, length: float) -> None:
    linear = (csr_array(np.eye(2)), np.array([-1.0, -1.0]), np.array([1.0, 3.0]))
    assert largest_step(linear, np.zeros(2), np.array(direction)) == pytest.approx(length)


def test_a_single_harmonic_is_refused() -> None:
    refuses(DataError, "at least 2", FourierSpace.of, 3, 8.0, 1)


@given(st.sampled_from(["spline", "open", "sized"]), st.integers(0, 1000))
def test_refined_splines_hold_the_motion_and_its_limits(name: str, seed: int) -> None:
    space = SPACES[name]()
    x = drawn(space, seed)
    refined = space.refined(x)
    assert refined is not None
    finer, numbers = refined
    assert finer.size > 1.5 * space.size
    np.testing.assert_array_equal(finer.sizes, space.sizes)
    time = np.linspace(0.0, 8.0, 301)
    for order in range(4):
        expected = space.curve(x).evaluate(time, derivative=order)
        found = finer.curve(numbers).evaluate(time, derivative=order)
        np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())
        # Finer control points lie between those that they come from.
        bounds = [s.bounds(order)[0] @ s.coefficients(y) for s, y in ((space, x), refined)]
        size = np.abs(bounds[0]).max()
        assert np.all(bounds[1].max(axis=0) <= bounds[0].max(axis=0) + 1e-8 * size)
        assert np.all(bounds[1].min(axis=0) >= bounds[0].min(axis=0) - 1e-8 * size)


# The progress bar of a search.


@pytest.mark.parametrize(("deadline", "length"), [(np.inf, 7.0), (102.0, 2.0)])
def test_a_bar_counts_steps_or_seconds(
    deadline: float, length: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    lengths, moves = [], []

    @contextmanager
    def bar(total: float, *_: Any, **__: Any) -> Iterator[Callable[[float], None]]:
        lengths.append(total)
        yield moves.append

    clock = iter([100.5, 101.5])
    monkeypatch.setattr(module, "progress", bar)
    monkeypatch.setattr(module.time, "monotonic", lambda: next(clock))
    with counted_steps(7, 100.0, deadline, None) as step:
        step()
        step()
    assert lengths == [length]
    assert moves == ([1.0, 1.0] if np.isinf(deadline) else [0.5, 1.0])
