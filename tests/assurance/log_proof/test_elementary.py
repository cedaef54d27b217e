"""Sine, cosine, exponential and hyperbolic tangent hold the true values."""

from __future__ import annotations

import math

import mpmath as mp
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from sdpid.assurance.log_proof.elementary import decaying, hyperbolic_tangent, sine_cosine
from sdpid.assurance.log_proof.enclosure import Enclosed, U

# What is left open of a function of size one, in units of rounding: sums and products of numbers
# up to one, some ten of them.
SHARP = 10 * U

ANGLES = st.one_of(
    st.floats(-1e6, 1e6),
    st.integers(-(10**5), 10**5).map(lambda k: k * math.pi / 4),
    st.floats(-1.0, 1.0),
)


def holds(found: Enclosed, k: int, truth: mp.mpf) -> bool:
    return bool(abs(mp.mpf(float(found.mid[k])) - truth) <= mp.mpf(float(found.rad)))


@given(st.lists(ANGLES, min_size=1, max_size=6))
@example([math.pi / 4, -math.pi / 4, 0.0, 5e-324, 1e6])
@example([math.nextafter(math.pi / 4, 1.0), 3 * math.pi / 4, 11.0])
def test_sine_and_cosine(angles: list[float]) -> None:
    sine, cosine = sine_cosine(Enclosed.exact(np.array(angles)))
    assert sine.rad < SHARP
    assert cosine.rad < SHARP
    with mp.workdps(60):
        for k, angle in enumerate(angles):
            assert holds(sine, k, mp.sin(mp.mpf(angle)))
            assert holds(cosine, k, mp.cos(mp.mpf(angle)))


@given(st.floats(-3.0, 3.0), st.floats(0.0, 0.1))
def test_an_angle_that_is_only_enclosed(angle: float, error: float) -> None:
    sine, cosine = sine_cosine(Enclosed.exact(np.array([angle])).off(error))
    with mp.workdps(60):
        for end in (mp.mpf(angle) - mp.mpf(error), mp.mpf(angle) + mp.mpf(error)):
            assert holds(sine, 0, mp.sin(end))
            assert holds(cosine, 0, mp.cos(end))


@pytest.mark.parametrize("angle", [2e6, -1e22, 1e300])
def test_huge_angles_are_anywhere(angle: float) -> None:
    sine, cosine = sine_cosine(Enclosed.exact(np.array([0.5, angle])))
    for found in (sine, cosine):
        assert np.all(found.mid - found.rad <= -1.0)
        assert np.all(found.mid + found.rad >= 1.0)


@given(st.lists(st.floats(0.0, 800.0), min_size=1, max_size=6))
@example([0.0, 5e-324, 745.2, 800.0, math.log(2.0) / 2])
def test_decaying_exponential(values: list[float]) -> None:
    found = decaying(Enclosed.exact(np.array(values)))
    assert found.rad < SHARP
    with mp.workdps(60):
        for k, x in enumerate(values):
            assert holds(found, k, mp.exp(-mp.mpf(x)))


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=6))
@example([0.0, -0.0, 1e-300, -25.0, 1e308])
def test_hyperbolic_tangent(values: list[float]) -> None:
    found = hyperbolic_tangent(Enclosed.exact(np.array(values)))
    assert found.rad < 2 * SHARP
    with mp.workdps(60):
        for k, x in enumerate(values):
            # Beyond, its distance from one is far below what is left open.
            assert holds(found, k, mp.tanh(max(min(mp.mpf(x), 1000), -1000)))
