"""The arithmetic of the stand-alone checker, against floating point and exact identities."""

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from sdpid.robot.inertia import CONSISTENCIES, margin, matrix_of
from sdpid.verifier import bodies, exact

SMALL = st.integers(-9, 9)
SHARES = st.fractions(0, 1, max_denominator=10**6).filter(bool)
POSITIVE = st.fractions(min_value=Fraction(1, 10**40), max_value=10**40)


def determinant(matrix: list[list[Fraction]]) -> Fraction:
    """Return the determinant by its definition."""
    size = len(matrix)
    total = Fraction(0)
    for order in itertools.permutations(range(size)):
        swaps = sum(order[i] > order[j] for j in range(size) for i in range(j))
        terms = (matrix[i][order[i]] for i in range(size))
        total += (-1) ** swaps * math.prod(terms, start=Fraction(1))
    return total


@st.composite
def grams(draw: st.DrawFn) -> list[list[Fraction]]:
    """Draw V·V^T of any rank, with zero rows now and then."""
    size, rank = draw(st.integers(1, 5)), draw(st.integers(0, 5))
    unit = draw(SHARES)
    V = draw(st.lists(st.lists(SMALL, min_size=rank, max_size=rank), min_size=size, max_size=size))
    return [[unit * sum(map(int.__mul__, a, b)) for b in V] for a in V]


@given(grams())
def test_squares_are_positive_semidefinite(matrix: list[list[Fraction]]) -> None:
    found, det = exact.factorize(matrix)
    assert found
    assert det == determinant(matrix)


@given(grams(), st.data())
def test_the_slightest_negative_direction_is_found(
    matrix: list[list[Fraction]], data: st.DataObject
) -> None:
    """With x^T·M·x = 0 for some x, M less any multiple of the identity is not ⪰ 0."""
    assume(determinant(matrix) == 0)
    share = data.draw(SHARES) / 10**30
    less = [[x - share * (i == j) for j, x in enumerate(row)] for i, row in enumerate(matrix)]
    assert not exact.positive_semidefinite(less)
    more = [[x + share * (i == j) for j, x in enumerate(row)] for i, row in enumerate(matrix)]
    assert exact.positive_semidefinite(more)


def test_other_matrices() -> None:
    assert exact.positive_semidefinite([])
    assert exact.positive_semidefinite([[0, 0], [0, 0.5]])
    assert not exact.positive_semidefinite([[0, 1], [1, 1]])
    assert not exact.positive_semidefinite([[1, 0], [1, 1]])
    assert not exact.positive_semidefinite([[1, 0]])
    # A tenth is not what the double of that name is.
    tenth = Fraction(1, 10)
    assert exact.positive_semidefinite([[tenth, 1], [1, 10]])
    assert exact.positive_semidefinite([[0.1, 1], [1, 10]]) == (Fraction(0.1) >= tenth)
    assert not exact.positive_semidefinite([[math.nextafter(0.1, 0.0), 1], [1, 10]])


@given(POSITIVE, POSITIVE)
def test_logarithms_are_enclosed(a: Fraction, b: Fraction) -> None:
    (low_a, high_a), (low_b, high_b), (low, high) = map(exact.log_bounds, (a, b, a * b))
    for value, ends in ((a, (low_a, high_a)), (b, (low_b, high_b))):
        assert ends[0] < ends[1] < ends[0] + Fraction(1, 2**52)
        nearest = math.log(value.numerator) - math.log(value.denominator)
        slack = 1e-13
        assert ends[0] - slack <= nearest <= ends[1] + slack
    # ln(a·b) = ln a + ln b lies in both intervals.
    assert low <= high_a + high_b
    assert high >= low_a + low_b


def test_logarithms_known_otherwise() -> None:
    """The digits of ln 2 and ln 10 are known from tables."""
    for value, digits in (
        (2, "0.69314718055994530941723212"),
        (10, "2.30258509299404568401799145"),
    ):
        low, high = exact.log_bounds(Fraction(value))
        assert low < Fraction(digits) + Fraction(1, 10**26)
        assert high > Fraction(digits)
        assert high - low < Fraction(1, 10**17)
    low, high = exact.log_bounds(Fraction(1))
    assert low <= 0 <= high


@given(st.fractions(0, 10**6))
def test_roots_are_from_above(value: Fraction) -> None:
    root = exact.root_above(value)
    assert value < root * root
    assert (root - Fraction(1, 2**78)) ** 2 <= value or root < Fraction(1, 2**77)


@given(st.lists(st.lists(st.floats(-1e9, 1e9), min_size=3, max_size=3), min_size=1, max_size=4))
def test_products(matrix: list[list[float]]) -> None:
    x = [1.5, -1e-200, 1e5]
    for row, found in zip(matrix, exact.product(matrix, x), strict=True):
        assert found == sum(Fraction(a) * Fraction(b) for a, b in zip(row, x, strict=True))


@pytest.mark.parametrize("consistency", CONSISTENCIES[:2])
def test_bodies(consistency: str) -> None:
    rng = np.random.default_rng(0)
    body = rng.standard_normal(10)
    body[0] = 1.0
    matrix = matrix_of(body, consistency)  # type: ignore[arg-type]
    found = bodies.link_matrix(body.tolist(), consistency)
    np.testing.assert_allclose(np.array(found, dtype=float), matrix, rtol=1e-15)
    Z = rng.standard_normal(matrix.shape)
    slopes = bodies.adjoint(Z.tolist(), consistency)
    assert float(exact.dot(slopes, body.tolist())) == pytest.approx(float(np.sum(Z * matrix)))
    largest = float(margin(body, consistency))  # type: ignore[arg-type]
    assert bodies.has_margin(body.tolist(), largest - 1e-9, consistency)
    assert not bodies.has_margin(body.tolist(), largest + 1e-9, consistency)
