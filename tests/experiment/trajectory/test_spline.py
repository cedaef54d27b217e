"""Splines: scipy's B-splines, with bounds that hold at every instant."""

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from sdpid.errors import DataError
from sdpid.experiment.trajectory.spline import Spline
from tests.helpers.refusals import refuses


@st.composite
def splines(draw: st.DrawFn) -> Spline:
    degree = draw(st.integers(1, 5))
    m = degree + draw(st.integers(1, 20))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    return Spline(
        duration=draw(st.floats(0.1, 100.0)),
        control_points=rng.normal(scale=draw(st.floats(0.01, 3.0)), size=(m, 2)),
        degree=degree,
    )


def of_scipy(spline: Spline, derivative: int) -> BSpline:
    curve = BSpline(spline.knots, spline.control_points, spline.degree)
    return curve.derivative(derivative) if derivative else curve


@settings(deadline=None, max_examples=50)
@given(spline=splines(), data=st.data())
def test_values_and_control_points_are_those_of_scipy(spline: Spline, data: st.DataObject) -> None:
    # The last derivative jumps at the knots, where values are those of one side.
    derivative = data.draw(st.integers(0, spline.degree - 1))
    halvings = data.draw(st.integers(0, 3))
    time = np.linspace(0.0, spline.duration, 97)
    expected = of_scipy(spline, derivative)(time)
    scale = np.abs(expected).max()
    close = {"rtol": 0.0, "atol": 1e-11 * scale}
    np.testing.assert_allclose(spline.evaluate(time, derivative=derivative), expected, **close)
    values = spline.matrix(time, derivative) @ spline.control_points
    np.testing.assert_allclose(values, expected, **close)
    # The control points after halvings are those of the same curve, as a spline of lower degree.
    points = spline.control(derivative, halvings)
    lower = spline.degree - derivative
    uniform = np.linspace(0.0, spline.duration, len(points) - lower + 1)
    halved = BSpline(np.pad(uniform, lower, mode="edge"), points, lower)
    np.testing.assert_allclose(halved(time[:-1]), expected[:-1], rtol=0.0, atol=1e-10 * scale)
    assert (points.min(axis=0) <= expected.min(axis=0) + close["atol"]).all()
    assert (points.max(axis=0) >= expected.max(axis=0) - close["atol"]).all()
    linear = Spline.control_matrix(
        len(spline.control_points), spline.duration, derivative, halvings, spline.degree
    )
    np.testing.assert_allclose(linear @ spline.control_points, points, **close)


def exactly(spline: Spline, time: float, derivative: int) -> Fraction:
    """Return a derivative of the first joint in exact arithmetic, by de Boor's algorithm."""
    degree = spline.degree
    knots = [Fraction(knot) for knot in spline.knots]
    points = [Fraction(point) for point in spline.control_points[:, 0]]
    for _ in range(derivative):
        spans = [knots[k + degree + 1] - knots[k + 1] for k in range(len(points) - 1)]
        rises = [after - before for before, after in pairwise(points)]
        points = [degree * rise / span for rise, span in zip(rises, spans, strict=True)]
        knots, degree = knots[1:-1], degree - 1
    span = max(k for k in range(degree, len(points)) if knots[k] <= time)
    local = points[span - degree : span + 1]
    for level in range(1, degree + 1):
        for k in range(degree, level - 1, -1):
            low, high = knots[span - degree + k], knots[span + 1 + k - level]
            share = (Fraction(time) - low) / (high - low)
            local[k] = (1 - share) * local[k - 1] + share * local[k]
    return local[degree]


@settings(deadline=None, max_examples=50)
@given(spline=splines(), share=st.floats(0.0, 0.999), data=st.data())
def test_bounds_hold_in_exact_arithmetic(spline: Spline, share: float, data: st.DataObject) -> None:
    derivative = data.draw(st.integers(0, spline.degree))
    time = share * spline.duration
    edges = [time, np.nextafter(time, np.inf)]
    lower, upper = spline.enclose(edges, derivative=derivative)
    assert lower[0, 0] <= exactly(spline, time, derivative) <= upper[0, 0]


@pytest.mark.parametrize("degree", [1, 2, 3, 5])
@pytest.mark.parametrize("halvings", [0, 1, 3])
def test_control_points_of_halvings_are_means(degree: int, halvings: int) -> None:
    matrix = Spline.control_matrix(17, 3.0, 0, halvings, degree)
    assert matrix.shape == ((17 - degree) * 2**halvings + degree, 17)
    assert matrix.min() >= 0.0
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0, rtol=0.0, atol=4e-16 * (1 + 3 * halvings))


@pytest.mark.parametrize("closed", [True, False])
def test_free_control_points_leave_the_ends_at_rest(closed: bool) -> None:
    free = np.random.default_rng(0).normal(size=(8, 3))
    spline = Spline.from_free(free, 4.0, closed=closed)
    ends = np.array([0.0, 4.0])
    for derivative in (1, 2):
        assert not spline.evaluate(ends, derivative=derivative).any()
    np.testing.assert_array_equal(spline.evaluate(ends), free[[0, 0 if closed else -1]])
    expansion = Spline.expansion(len(spline.control_points), closed=closed)
    np.testing.assert_array_equal(expansion @ free, spline.control_points)
    assert expansion.shape == (len(free) + 4 + closed, len(free))


def test_arguments_that_make_no_spline() -> None:
    points = np.zeros((6, 2))
    for change, message in (
        ({"duration": 0.0}, "duration"),
        ({"degree": 0}, "degree"),
        ({"degree": 6}, "at least 7"),
        ({"control_points": np.full((6, 2), np.nan)}, "control_points"),
    ):
        refuses(DataError, message, Spline, **{"duration": 1.0, "control_points": points} | change)
    spline = Spline(duration=1.0, control_points=points)
    refuses(DataError, r"1\.1 s at index 1 is not within", spline.evaluate, [0.0, 1.1])
    refuses(DataError, "increasing", spline.enclose, [0.0, 0.0])
    refuses(DataError, "derivative", Spline.control_matrix, 6, 1.0, 6)
    refuses(DataError, "at least 6", Spline.expansion, 5)
