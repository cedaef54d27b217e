"""Derivatives: exact where they must be, and what they let pass of the noise."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import savgol_coeffs

from sdpid.errors import DataError
from sdpid.experiment.processing.filters import Spectral, Stencil, stencil
from sdpid.experiment.processing.settings import Processing
from tests.helpers.refusals import refuses

# A velocity is exact up to the first degree, an acceleration up to the second.
DEGREES = {
    "central": (2, 3),
    "central4": (4, 5),
    "central6": (6, 7),
    "savitzky_golay": (4, 5),
}


@settings(max_examples=60, deadline=None)
@given(
    name=st.sampled_from(sorted(DEGREES)),
    coefficients=st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=8),
    cutoff=st.floats(0.01, 0.49),
    step=st.sampled_from([1e-3, 0.02, 1.0]),
)
def test_polynomials_are_differentiated_exactly(
    name: str, coefficients: list[float], cutoff: float, step: float
) -> None:
    weights = stencil(name, cutoff_over_rate=cutoff)
    margin = weights.margin
    time = step * np.arange(-margin, margin + 1)
    scale = max(1.0, time[-1])
    for order, degree in zip((1, 2), DEGREES[name], strict=True):
        p = np.polynomial.Polynomial(coefficients[: degree + 1])
        signal = p(time / scale)
        expected = p.deriv(order)(0.0) / scale**order
        act = weights.velocity if order == 1 else weights.acceleration
        found = act(signal, step)
        assert found.shape == (1,)
        # Rounding of values up to 8 over a power of the step.
        assert abs(found[0] - expected) <= 1e-14 * 8 / step**order + 1e-9 * abs(expected)


@settings(max_examples=40, deadline=None)
@given(
    count=st.integers(5, 64),
    step=st.sampled_from([1e-3, 0.02, 1.0]),
    seed=st.integers(0, 99),
)
def test_the_fourier_series_is_differentiated_exactly(count: int, step: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    highest = (count - 1) // 2
    harmonics = np.arange(highest + 1)
    omega = 2.0 * np.pi * harmonics / (count * step)
    amplitude, phase = rng.uniform(-1, 1, (2, highest + 1))
    angle = step * np.arange(count)[:, None] * omega + 3.0 * phase
    spectral = Spectral()
    assert spectral.margin == 0
    signal = np.sin(angle) @ amplitude
    first = np.cos(angle) @ (amplitude * omega)
    second = -np.sin(angle) @ (amplitude * omega**2)
    np.testing.assert_allclose(
        spectral.velocity(signal, step), first, rtol=0, atol=1e-13 * count / step
    )
    np.testing.assert_allclose(
        spectral.acceleration(signal, step), second, rtol=0, atol=1e-12 * count / step**2
    )


def test_half_the_rate_has_no_slope_but_a_curvature() -> None:
    signal = np.array([1.0, -1.0] * 4)
    np.testing.assert_allclose(Spectral().velocity(signal, 0.1), 0.0, atol=1e-13)
    np.testing.assert_allclose(
        Spectral().acceleration(signal, 0.1), -((np.pi / 0.1) ** 2) * signal, rtol=1e-12
    )


@settings(max_examples=30, deadline=None)
@given(
    name=st.sampled_from([*sorted(DEGREES), "spectral"]),
    factors=st.tuples(st.floats(-5, 5), st.floats(-5, 5)),
    seed=st.integers(0, 99),
)
def test_derivatives_are_linear(name: str, factors: tuple[float, float], seed: int) -> None:
    how: Stencil = Spectral() if name == "spectral" else stencil(name, cutoff_over_rate=0.1)
    one, other = np.random.default_rng(seed).standard_normal((2, 60))
    for act in (how.velocity, how.acceleration):
        together = act(factors[0] * one + factors[1] * other, 0.1)
        apart = factors[0] * act(one, 0.1) + factors[1] * act(other, 0.1)
        np.testing.assert_allclose(together, apart, rtol=0, atol=1e-9)


@settings(max_examples=40, deadline=None)
@given(cutoff=st.floats(0.001, 0.499))
def test_a_window_lets_as_much_noise_pass_as_the_cut_off(cutoff: float) -> None:
    half = stencil("savitzky_golay", cutoff_over_rate=cutoff).margin
    # Of smoothing weights, the sum of squares is the share of the variance that passes.
    passed = [np.sum(savgol_coeffs(2 * h + 1, 4) ** 2) for h in (half, half + 1)]
    assert passed[0] >= 2.0 * cutoff * (1.0 - 1e-3)
    assert passed[1] < 2.0 * cutoff * (1.0 + 1e-3)


@pytest.mark.parametrize("half", [2, 3, 10, 40])
def test_local_polynomials_are_scipys(half: int) -> None:
    cutoffs = np.geomspace(1e-3, 0.49, 400)
    cutoff = next(c for c in cutoffs[::-1] if _half(c) == half)
    weights = stencil("savitzky_golay", cutoff_over_rate=cutoff)
    for order, ours in ((1, weights.first), (2, weights.second)):
        theirs = savgol_coeffs(2 * half + 1, 4, deriv=order, use="dot")
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9 * np.abs(theirs).max())


def _half(cutoff: float) -> int:
    return stencil("savitzky_golay", cutoff_over_rate=cutoff).margin


def test_long_windows_keep_their_digits() -> None:
    weights = stencil("savitzky_golay", cutoff_over_rate=1e-4)
    assert weights.margin > 8000
    place = np.arange(-weights.margin, weights.margin + 1) / 1e3
    # SciPy's weights lose 63 % here.
    assert weights.velocity(place, 1e-3)[0] == pytest.approx(1.0, rel=1e-12)
    assert weights.acceleration(place**2, 1e-3)[0] == pytest.approx(2.0, rel=1e-9)
    assert weights.second.sum() == pytest.approx(0.0, abs=1e-20)


def test_the_shortest_window_is_central() -> None:
    shortest = stencil("savitzky_golay", cutoff_over_rate=0.4999)
    central = stencil("central4")
    np.testing.assert_allclose(shortest.first, central.first, atol=1e-14)
    np.testing.assert_allclose(shortest.second, central.second, atol=1e-14)


def test_what_is_asked_for_must_exist() -> None:
    refuses(DataError, "'central8' is unknown", stencil, "central8")
    for cutoff in (None, 0.0, 0.5):
        with pytest.raises(DataError, match="needs the cut-off over the sample rate"):
            stencil("savitzky_golay", cutoff_over_rate=cutoff)
    assert isinstance(Processing(derivative="spectral").stencil(100.0), Spectral)
    assert Processing(derivative="savitzky_golay").stencil(1000.0).margin == _half(0.015)
