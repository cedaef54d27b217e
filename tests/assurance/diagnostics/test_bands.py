"""Bands hold what they say, on motion that the parameters did not see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import sdpid
from sdpid.assurance.diagnostics.bands import parameter_root, random_motion
from sdpid.assurance.diagnostics.validation import validate_robot
from tests.helpers.identified import arm_theta, identified, moved


def test_bands_hold_95_percent_of_other_motion() -> None:
    inside = []
    for seed in range(8):
        theta = arm_theta()
        estimate = identified(moved(theta, seed, seconds=10.0, block=20)).estimate
        fresh = moved(theta, 100 + seed)
        fit = sdpid.validate(estimate, fresh)
        assert fit.effort_band is not None
        assert fit.effort_band.shape == fresh.effort.shape
        inside.append(np.abs(fresh.effort - fit.effort_predicted) <= fit.effort_band)
    assert 0.93 <= np.mean(inside) <= 0.98


def test_bands_widen_where_the_motion_has_not_been() -> None:
    theta = arm_theta()
    estimate = identified(moved(theta, 1, seconds=10.0, amplitude=0.05)).estimate
    near, far = (
        sdpid.validate(estimate, moved(theta, 2, amplitude=amplitude)) for amplitude in (0.05, 1.0)
    )
    assert np.all(np.mean(far.effort_band, axis=0) > 2.0 * np.mean(near.effort_band, axis=0))
    fresh = moved(theta, 2)
    assert np.mean(np.abs(fresh.effort - far.effort_predicted) <= far.effort_band) > 0.9


def test_the_covariance_is_that_of_the_estimate() -> None:
    """Over noise alone, with a prior that says nothing, estimates scatter as told."""
    theta = arm_theta()
    drawn = [identified(moved(theta, 1, noise_seed=k)) for k in range(40)]
    bases = np.array([each.wls.base for each in drawn])
    root, _ = parameter_root(drawn[0].estimate)
    expected = np.sqrt(np.sum(root**2, axis=1))
    assert np.std(bases, axis=0) == pytest.approx(expected, rel=0.45)


def test_a_description_tells_nothing_of_its_errors() -> None:
    samples = moved(arm_theta(), 1)
    result = identified(samples)
    assert validate_robot(result.problem.robot, samples).effort_band is None
    # The same bits, whoever asks.
    first, second = (sdpid.validate(result.estimate, samples).effort_band for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_the_deviation_on_other_motion_is_what_noise_brings() -> None:
    theta = arm_theta()
    drawn = [identified(moved(theta, 1, seconds=5.0, noise_seed=k)).estimate for k in range(20)]
    truth = replace(drawn[0], base=drawn[0].problem.base_of(theta))
    told, expected = random_motion(drawn[0])[0], random_motion(truth)[1]
    errors = [random_motion(estimate)[1] - expected for estimate in drawn]
    assert told == pytest.approx(np.sqrt(np.mean(np.square(errors), axis=(0, 1))), rel=0.4)
