"""Laws of every curve: bounds hold at every instant, and time and sign scale as they should."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.experiment.trajectory.curve import Curve
from sdpid.experiment.trajectory.fourier import FourierSeries
from sdpid.experiment.trajectory.sampled import SampledCurve
from sdpid.experiment.trajectory.spline import Spline
from tests.helpers.refusals import refuses

KINDS = ["spline", "fourier", "positions", "velocities", "accelerations"]
HIGHEST = 4


def curve_of(kind: str, seed: int, scale: float = 1.0, slower: float = 1.0) -> Curve:
    """Return a random curve; the same one with amplitudes scaled and time stretched."""
    rng = np.random.default_rng(seed)
    duration = slower * rng.uniform(0.2, 30.0)
    if kind == "spline":
        degree = int(rng.integers(1, 6))
        points = rng.normal(size=(degree + rng.integers(1, 20), 2))
        return Spline(duration=duration, control_points=scale * points, degree=degree)
    if kind == "fourier":
        shape = (2, int(rng.integers(1, 7)))
        return FourierSeries(
            period=duration,
            center=scale * rng.normal(size=2),
            harmonics=rng.integers(1, 15, size=shape),
            amplitudes=scale * rng.normal(size=shape),
            phases=rng.uniform(-7.0, 7.0, size=shape),
        )
    samples = int(rng.integers(4, 30))
    steps = rng.uniform(0.2, 1.0, samples - 1)
    time = np.concatenate([[0.0], np.cumsum(steps)]) * duration / steps.sum()
    values = scale * rng.normal(size=(3, samples, 2))
    given = 1 + KINDS.index(kind) - KINDS.index("positions")
    names = ("position", "velocity", "acceleration")[:given]
    scaled = {name: values[k] / slower**k for k, name in enumerate(names)}
    return SampledCurve(time=time + rng.uniform(0.0, 9.0), **scaled)


def inside(edges: Array, cells: int = 30) -> tuple[Array, Array]:
    """Return times within each cell, ends left out, and the number of each one's cell."""
    share = np.linspace(0.0, 1.0, cells + 2)[1:-1]
    time = edges[:-1, None] + share * np.diff(edges)[:, None]
    return time.ravel(), np.repeat(np.arange(len(edges) - 1), cells)


@settings(deadline=None, max_examples=100)
@given(
    kind=st.sampled_from(KINDS),
    seed=st.integers(0, 2**32 - 1),
    derivative=st.integers(0, HIGHEST),
    inner=st.lists(st.floats(0.0, 1.0), max_size=12),
)
def test_bounds_hold_at_every_instant(
    kind: str, seed: int, derivative: int, inner: list[float]
) -> None:
    curve = curve_of(kind, seed)
    edges = np.unique(np.concatenate([[0.0, 1.0], inner])) * curve.duration
    edges = edges[np.concatenate([[True], np.diff(edges) > 1e-9])]
    lower, upper = curve.enclose(edges, derivative=derivative)
    assert lower.shape == upper.shape == (len(edges) - 1, curve.n)
    time, cell = inside(edges)
    values = curve.evaluate(time, derivative=derivative)
    assert (lower[cell] <= values).all()
    assert (values <= upper[cell]).all()


@settings(deadline=None, max_examples=40)
@given(
    kind=st.sampled_from(KINDS),
    seed=st.integers(0, 2**32 - 1),
    derivative=st.integers(0, HIGHEST),
)
def test_finer_cells_give_closer_bounds(kind: str, seed: int, derivative: int) -> None:
    curve = curve_of(kind, seed)
    excess = []
    for halvings in (0, 1, 3, 5):
        # Cells whose edges are not the breaks' own: pieces are cut, and joined.
        cells = 3 * 2**halvings
        edges = np.linspace(0.0, curve.duration, cells + 1)
        lower, upper = curve.enclose(edges, derivative=derivative)
        time, _ = inside(edges, 64)
        values = curve.evaluate(time, derivative=derivative).reshape(cells, 64, curve.n)
        excess.append((upper - lower - np.ptp(values, axis=1)).max(axis=0))
        if halvings == 0:
            coarse = lower.min(axis=0), upper.max(axis=0)
    size = np.abs(coarse).max() + 1e-300
    # A finer cell's bounds stay within the coarse ones', up to rounding; those of a Fourier series
    # are cut into cells of their own, which exceed the curve by about 1e-3.
    slack = (5e-3 if kind == "fourier" else 1e-9) * size
    assert (lower.min(axis=0) >= coarse[0] - slack).all()
    assert (upper.max(axis=0) <= coarse[1] + slack).all()
    # The samples stop short of the ends of the cells by 1/65 of them on either side.
    if derivative <= getattr(curve, "smooth", HIGHEST):
        assert (excess[-1] <= 0.5 * excess[0] + 0.05 * size).all()


@settings(deadline=None, max_examples=40)
@given(
    kind=st.sampled_from(KINDS),
    seed=st.integers(0, 2**32 - 1),
    derivative=st.integers(0, 3),
    slower=st.floats(0.1, 10.0),
    scale=st.sampled_from([-1.0, 2.0, 0.3]),
)
def test_slower_and_mirrored_motions(
    kind: str, seed: int, derivative: int, slower: float, scale: float
) -> None:
    curve, other = curve_of(kind, seed), curve_of(kind, seed, scale, slower)
    edges = np.linspace(0.0, 1.0, 14)
    time, _ = inside(edges, 5)
    factor = scale / slower**derivative
    one = curve.evaluate(time * curve.duration, derivative=derivative)
    size = np.abs(one).max() + 1e-300
    another = other.evaluate(time * other.duration, derivative=derivative) / factor
    # A derivative that jumps has either value at the jump, and in the cell that ends there.
    if derivative <= getattr(curve, "smooth", HIGHEST):
        np.testing.assert_allclose(another, one, rtol=0.0, atol=1e-8 * size)
    bounds = [part.enclose(edges * part.duration, derivative=derivative) for part in (curve, other)]
    scaled = [values / factor for values in bounds[1]]
    if factor < 0.0:
        scaled.reverse()
    if derivative <= getattr(curve, "smooth", HIGHEST):
        np.testing.assert_allclose(scaled, bounds[0], rtol=0.0, atol=1e-8 * size)


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_are_those_of_the_curve(kind: str) -> None:
    curve = curve_of(kind, 5)
    h = 1e-6 * curve.duration
    time = np.linspace(0.01, 0.985, 11) * curve.duration
    for derivative in range(2):
        ahead, behind = (curve.evaluate(time + s, derivative=derivative) for s in (h, -h))
        rate = curve.evaluate(time, derivative=derivative + 1)
        np.testing.assert_allclose((ahead - behind) / (2 * h), rate, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("kind", KINDS[2:])
def test_samples_are_met(kind: str) -> None:
    curve = curve_of(kind, 7)
    assert isinstance(curve, SampledCurve)
    for derivative, values in enumerate((curve.position, curve.velocity, curve.acceleration)):
        if values is not None:
            met = curve.evaluate(curve.breaks, derivative=derivative)
            np.testing.assert_allclose(met, values, atol=1e-9)
    # Up to the order that it says the curve does not jump at its samples.
    for derivative in range(curve.smooth + 2):
        times = curve.breaks[1:-1]
        after = curve.evaluate(times, derivative=derivative)
        before = curve.evaluate(times * (1 - 1e-12), derivative=derivative)
        jump = np.abs(after - before).max()
        assert (jump < 1e-6) == (derivative <= curve.smooth)


def test_quintic_and_cubic_motions_are_met_exactly() -> None:
    time = np.array([0.0, 0.3, 1.1, 2.0])
    for degree, orders in ((5, 3), (3, 2)):
        polynomials = np.random.default_rng(0).normal(size=(degree + 1, 2))
        derivatives = [
            np.polynomial.polynomial.polyval(
                time, np.polynomial.polynomial.polyder(polynomials, k, axis=0)
            ).T
            for k in range(orders)
        ]
        names = ("position", "velocity", "acceleration")
        curve = SampledCurve(time=time, **dict(zip(names, derivatives, strict=False)))
        dense = np.linspace(0.0, 2.0, 101)
        expected = np.polynomial.polynomial.polyval(dense, polynomials).T
        np.testing.assert_allclose(curve.evaluate(dense), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time": [0.0, 1.0, 1.0]}, "does not increase at sample 2"),
        ({"time": [0.0]}, "at least two"),
        ({"velocity": np.zeros((3, 1))}, r"velocity has shape \(3, 1\)"),
        ({"position": [[0.0, 0.0], [0.0, np.nan], [0.0, 0.0]]}, "not finite"),
        ({"acceleration": np.zeros((3, 2))}, "without velocities"),
    ],
)
def test_samples_that_make_no_curve(change: dict[str, object], message: str) -> None:
    good = {"time": [0.0, 1.0, 2.0], "position": np.zeros((3, 2))}
    refuses(DataError, message, SampledCurve, **good | change)
