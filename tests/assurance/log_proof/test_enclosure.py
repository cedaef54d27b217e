"""Operations on midpoints and radii hold those on all numbers within them."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from sdpid._common.arrays import Array
from sdpid.assurance.log_proof.enclosure import Enclosed, largest
from tests.helpers.strategies import SEEDS

SAMPLES = 3


def exact(values: Any) -> Any:
    return np.vectorize(Fraction, otypes=[object])(np.asarray(values, dtype=float))


def spread(rng: np.random.Generator, *shape: int) -> Array:
    """Return numbers of very different size."""
    return np.asarray(rng.standard_normal(shape) * 10.0 ** rng.integers(-8, 8, shape))


class Ball:
    """An enclosure of vectors, numbers or a matrix, and exact samples within it."""

    def __init__(self, rng: np.random.Generator, *shape: int) -> None:
        mid = spread(rng, *shape, SAMPLES)
        rad = float(np.abs(spread(rng))) * 1e-9
        error = spread(rng, *shape, SAMPLES)
        # Smaller than the radius by its Frobenius norm, which is no smaller than any other.
        error *= 0.999 * rad / np.sqrt(np.sum(error**2, axis=tuple(range(len(shape)))))
        self.inside = exact(mid) + exact(error)
        norm = np.sqrt(np.sum(mid**2, axis=tuple(range(len(shape))))).max()
        self.ball = Enclosed(mid, np.asarray(rad), np.asarray(norm * (1.0 + 1e-14)))


def holds(found: Enclosed, truth: Any) -> bool:
    """Return whether an error is below the radius in the Frobenius norm, or may be."""
    error = exact(found.mid) - truth
    squares = (error * error).reshape(-1, SAMPLES).sum(axis=0)
    # A matrix's spectral norm is at least its Frobenius norm over √3.
    share = 3 if error.ndim == 3 else 1
    bound = Fraction(float(found.rad)) ** 2 * share
    size = (exact(found.mid) ** 2).reshape(-1, SAMPLES).sum(axis=0)
    within = size <= Fraction(float(found.size)) ** 2 * share
    return bool(np.all(squares <= bound) and np.all(within))


def cross(a: Any, b: Any) -> Any:
    return np.array([a[i] * b[j] - a[j] * b[i] for i, j in ((1, 2), (2, 0), (0, 1))])


@given(SEEDS)
def test_numbers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = Ball(rng), Ball(rng)
    assert holds(x.ball + y.ball, x.inside + y.inside)
    assert holds(x.ball - y.ball, x.inside - y.inside)
    assert holds(x.ball * y.ball, x.inside * y.inside)
    v = Ball(rng, 3)
    assert holds(x.ball.times(v.ball), x.inside * v.inside)


@given(SEEDS)
def test_vectors(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = Ball(rng, 3), Ball(rng, 3)
    assert holds(x.ball + y.ball, x.inside + y.inside)
    assert holds(x.ball.dot(y.ball), (x.inside * y.inside).sum(axis=0))
    assert holds(x.ball.cross(y.ball), cross(x.inside, y.inside))
    assert holds(x.ball.measured(), x.inside)


@given(SEEDS)
def test_matrices(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R, S, x = Ball(rng, 3, 3), Ball(rng, 3, 3), Ball(rng, 3)
    applied = sum(R.inside[:, j] * x.inside[j] for j in range(3))
    back = sum(R.inside[j] * x.inside[j] for j in range(3))
    composed = sum(R.inside[:, j, None] * S.inside[None, j] for j in range(3))
    assert holds(R.ball.apply(x.ball), applied)
    assert holds(R.ball.back(x.ball), back)
    assert holds(R.ball.compose(S.ball), composed)


@given(SEEDS, st.integers(1, 3))
def test_stacked_vectors_have_radii_of_their_own(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    balls = [Ball(rng, 3) for _ in range(count)]
    stacked = Enclosed(
        np.stack([b.ball.mid for b in balls]),
        np.array([b.ball.rad for b in balls]),
        np.array([b.ball.size for b in balls]),
    )
    y, R = Ball(rng, 3), Ball(rng, 3, 3)
    for found, single in (
        (stacked.cross(y.ball), [b.ball.cross(y.ball) for b in balls]),
        (stacked.dot(y.ball), [b.ball.dot(y.ball) for b in balls]),
        (R.ball.back(stacked), [R.ball.back(b.ball) for b in balls]),
        (y.ball.dot(y.ball).times(stacked), [y.ball.dot(y.ball).times(b.ball) for b in balls]),
    ):
        for k, one in enumerate(single):
            np.testing.assert_array_equal(found.mid[k], one.mid)
            assert found.rad[k] == one.rad
            assert found.size[k] == one.size


def test_the_largest_is_exact() -> None:
    np.testing.assert_array_equal(largest(np.array([[1.0, -3.0], [-0.0, 0.0]])), [3.0, 0.0])
