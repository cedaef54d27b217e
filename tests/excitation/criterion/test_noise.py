"""Expected noise: densities, what is assumed, and what earlier residuals say."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.estimation.problem import build_problem
from sdpid.excitation.criterion.noise import ExpectedNoise, usual_effort
from tests.helpers.arm import ARM
from tests.helpers.data import FRICTION, make_samples, random_theta

NAMES = ("joint_1", "joint_2", "joint_3")
RMS = np.array([3.0, 48.0, 0.0])


def test_white_noise_has_a_density() -> None:
    noise = ExpectedNoise.of(NAMES, [1.0, 2.0, 3.0], RMS, 250.0)
    np.testing.assert_allclose(noise.density, np.array([1.0, 4.0, 9.0]) / 250.0)
    np.testing.assert_allclose(noise.filtered_variance(25.0), np.array([1.0, 4.0, 9.0]) / 10.0)
    # A filter takes nothing away beyond the noise itself.
    np.testing.assert_allclose(noise.filtered_variance(1e6), [1.0, 4.0, 9.0])


def test_one_number_serves_all_joints_and_names_serve_each() -> None:
    one = ExpectedNoise.of(NAMES, 0.5, RMS, 100.0)
    np.testing.assert_allclose(one.deviation, 0.5)
    named = ExpectedNoise.of(NAMES, dict(zip(NAMES, (3.0, 2.0, 1.0), strict=True)), RMS, 100.0)
    np.testing.assert_allclose(named.deviation, [3.0, 2.0, 1.0])
    assert ExpectedNoise.of(NAMES, named, RMS, 1.0) is named


def test_without_numbers_it_is_assumed_and_said() -> None:
    noise = ExpectedNoise.of(NAMES, None, RMS, 100.0)
    assert noise.deviation[0] < noise.deviation[1]
    assert np.all(noise.deviation > 0.0)
    assert "assumed" in noise.notes[0]


@pytest.mark.parametrize(
    ("noise", "says"),
    [
        ([1.0, 2.0], "give one number or 3"),
        ({"joint_1": 1.0, "elbow": 2.0}, "elbow"),
        ([1.0, -1.0, 1.0], "positive"),
        ([1.0, np.nan, 1.0], "not finite"),
    ],
)
def test_wrong_numbers_are_refused(noise: object, says: str) -> None:
    with pytest.raises(DataError, match=says):
        ExpectedNoise.of(NAMES, noise, RMS, 100.0)  # type: ignore[arg-type]


@given(st.lists(st.floats(0.0, 1e4), min_size=1, max_size=7), st.floats(1e-3, 1e3))
def test_usual_efforts_scale_and_are_never_zero(rms: list[float], factor: float) -> None:
    usual = usual_effort(np.array(rms))
    assert np.all(usual > 0.0)
    if max(rms) > 1e-3:
        np.testing.assert_allclose(usual_effort(factor * np.array(rms)), factor * usual)


@pytest.mark.parametrize("weighting", ["gls", "residual"])
def test_residuals_of_white_noise_give_its_density(weighting: str) -> None:
    deviations = np.array([0.1, 0.3])
    theta = random_theta(ARM, np.random.default_rng(0))
    found = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        samples = make_samples(ARM, theta, rng, count=400, noise=0.0)
        effort = samples.effort + deviations * rng.standard_normal(samples.effort.shape)
        samples = replace(samples, effort=effort, time=np.arange(400) / 50.0)
        problem = build_problem(ARM, samples, friction=FRICTION, weighting=weighting)  # type: ignore[arg-type]
        found.append(ExpectedNoise.of_residuals(problem, theta))
    density: Array = np.mean([each.density for each in found], axis=0)
    np.testing.assert_allclose(density, deviations**2 / 50.0, rtol=0.15)
    deviation = np.mean([each.deviation for each in found], axis=0)
    np.testing.assert_allclose(deviation, deviations, rtol=0.1)
