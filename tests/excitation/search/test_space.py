"""Motions of the search: linear in free numbers, at rest at the ends, bounded by their rows."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid.errors import DataError
from sdpid.excitation.search.linear import largest_step, linear_limits
from sdpid.excitation.search.space import FourierSpace, Space, SplineSpace
from sdpid.excitation.search.starts import random_start
from tests.helpers.refusals import refuses

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
NAMES = tuple(SPACES)


def drawn(space: Space, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(space.size)


@given(st.sampled_from(NAMES), st.integers(0, 1000))
def test_the_curve_is_what_the_basis_says(name: str, seed: int) -> None:
    space = SPACES[name]()
    x = drawn(space, seed)
    time = space.grid()
    for order in range(4):
        expected = space.basis(time, order) @ space.coefficients(x)
        found = space.curve(x).evaluate(time, derivative=order)
        np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


@given(st.sampled_from(NAMES), st.integers(0, 1000))
def test_every_motion_is_at_rest_at_its_ends(name: str, seed: int) -> None:
    space = SPACES[name]()
    curve = space.curve(drawn(space, seed))
    ends = np.array([0.0, curve.duration])
    for order in (1, 2):
        inside = np.abs(curve.evaluate(space.grid(), derivative=order)).max()
        assert np.abs(curve.evaluate(ends, derivative=order)).max() <= 1e-9 * inside
    if name != "open":
        np.testing.assert_allclose(*curve.evaluate(ends), atol=1e-9)


@given(st.sampled_from(NAMES), st.integers(0, 1000))
def test_rows_bound_a_derivative_between_the_samples_too(name: str, seed: int) -> None:
    space = SPACES[name]()
    x = drawn(space, seed)
    dense = np.linspace(0.0, space.duration, 3001)
    for order in range(4):
        rows, share = space.bounds(order)
        reached = np.abs(space.basis(dense, order) @ space.coefficients(x))
        bound = np.abs(rows @ space.coefficients(x)).max(axis=0) / share
        assert np.all(reached.max(axis=0) <= bound * (1.0 + 1e-12))


@given(st.sampled_from(NAMES), st.integers(0, 1000))
def test_the_pull_is_the_transpose(name: str, seed: int) -> None:
    space = SPACES[name]()
    x = drawn(space, seed)
    c = np.random.default_rng(seed + 1).standard_normal(space.coefficients(x).shape)
    assert np.sum(space.coefficients(x) * c) == pytest.approx(float(x @ space.pulled(c)))


@given(st.sampled_from(NAMES), st.integers(0, 1000))
def test_standing_still_is_standing_still(name: str, seed: int) -> None:
    space = SPACES[name]()
    position = np.random.default_rng(seed).standard_normal(3)
    curve = space.curve(space.standing(position))
    np.testing.assert_allclose(
        curve.evaluate(space.grid()), np.tile(position, (len(space.grid()), 1)), atol=1e-9
    )


def test_one_joint_moves_at_a_time() -> None:
    space = SPACES["one_by_one"]()
    speed = space.curve(drawn(space, 0)).evaluate(space.grid(20.0), derivative=1)
    moving = np.abs(speed) > 1e-9
    assert moving.any(axis=0).all()
    assert moving.sum(axis=1).max() == 1


def test_postures_are_held() -> None:
    space = SPACES["postures"]()
    speed = np.abs(space.curve(drawn(space, 0)).evaluate(space.grid(50.0), derivative=1)).max(
        axis=1
    )
    assert np.count_nonzero(speed < 1e-9) > 0.05 * len(speed)


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
    assert np.all(A @ x >= lower - 1e-9)
    assert np.all(A @ x <= upper + 1e-9)
    dense = np.linspace(0.0, 8.0, 2001)
    ranges = [limits.upper, limits.velocity, limits.acceleration, limits.jerk]
    for order, most in enumerate(ranges):
        reached = made.curve(x).evaluate(dense, derivative=order)
        assert np.all(reached <= most)
        assert np.all(reached >= (limits.lower if order == 0 else -most))
    assert np.abs(made.curve(x).evaluate(dense, derivative=1)).max() > 0.05
    if begin is not None:
        np.testing.assert_allclose(made.curve(x).evaluate(np.zeros(1))[0], begin, atol=1e-9)


def test_the_largest_step_ends_at_the_first_limit() -> None:
    from scipy.sparse import csr_array

    linear = (csr_array(np.eye(2)), np.array([-1.0, -1.0]), np.array([1.0, 3.0]))
    assert largest_step(linear, np.zeros(2), np.array([1.0, 1.0])) == pytest.approx(1.0)
    assert largest_step(linear, np.zeros(2), np.array([0.0, 1.0])) == pytest.approx(3.0)
    assert largest_step(linear, np.zeros(2), np.array([0.0, -2.0])) == pytest.approx(0.5)


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


@pytest.mark.parametrize("name", ["postures", "one_by_one", "fourier"])
def test_other_motions_are_not_refined(name: str) -> None:
    space = SPACES[name]()
    assert space.refined(drawn(space, 0)) is None
