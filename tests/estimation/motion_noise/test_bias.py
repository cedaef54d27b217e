"""Noise in the measured motion: how far it moves a fit, and that intervals count it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

import sdpid
from sdpid.assurance.intervals.noise_in_motion import noise_in_words
from sdpid.errors import DataError
from sdpid.estimation.motion_noise.bias import with_motion_bias
from sdpid.estimation.motion_noise.twins import twins
from sdpid.experiment.preparation.for_robot import prepare
from tests.helpers.arm import ARM
from tests.helpers.data import random_links

BODIES = random_links(np.random.default_rng(4), 2)
PROCESSING = sdpid.Processing(
    cutoff_hz=25.0, filter="finite", decimation=None, reversal_time=None, derivative="central4"
)
NOISE = 3e-4


def recorded(noise: float, seed: int = 0) -> sdpid.Recording:
    """Return 20 s at 500 Hz of a motion below 2 Hz, its efforts exact but for white noise."""
    time = np.arange(10_000) / 500.0
    rng = np.random.default_rng(7)
    omega = 2.0 * np.pi * rng.uniform(0.3, 2.0, (5, ARM.n))
    angle = time[:, None, None] * omega + rng.uniform(0.0, 2.0 * np.pi, omega.shape)
    q, v, a = (
        np.sum(each, axis=1)
        for each in (np.sin(angle) / omega, np.cos(angle), -omega * np.sin(angle))
    )
    effort = ARM.inverse_dynamics(BODIES, q, v, a)
    rng = np.random.default_rng(seed)
    effort += 0.01 * np.std(effort, axis=0) * rng.standard_normal(effort.shape)
    return sdpid.Recording(
        time=time, position=q + noise * rng.standard_normal(q.shape), effort=effort
    )


def problem_of(log: sdpid.Recording) -> sdpid.Problem:
    samples = prepare(ARM, log, PROCESSING)
    return sdpid.build_problem(ARM, samples, friction=(), weighting="residual")


def test_the_bias_is_what_noise_does_and_intervals_count_it() -> None:
    log = recorded(NOISE)
    problem = with_motion_bias(problem_of(log), [log], PROCESSING)
    bias, truth = problem.motion_bias, problem.base_of(BODIES.ravel())
    assert bias is not None
    # Three seeds of noise, against the fit of the same motion without.
    fits = [sdpid.solve_wls(problem_of(recorded(NOISE, seed))).base for seed in range(3)]
    moved = np.mean(fits, axis=0) - sdpid.solve_wls(problem_of(recorded(0.0))).base
    size = np.abs(moved) > 0.2 * np.abs(moved).max()
    np.testing.assert_allclose(bias[size], moved[size], rtol=0.4)
    wls = sdpid.solve_wls(problem)
    without = replace(wls, problem=replace(problem, motion_bias=None))
    short, honest = (
        sdpid.confidence_intervals(each, method="gauss_markov", parameters=problem.base.names)
        for each in (without, wls)
    )
    assert not short.contains(truth).all()
    assert honest.contains(truth).all()
    assert honest.motion_share is not None
    assert short.motion_share is None
    # The bootstrap draws the bias too.
    drawn, shorter = (
        sdpid.confidence_intervals(
            each, method="bootstrap", parameters=problem.base.names, resamples=200, n_jobs=1
        )
        for each in (wls, without)
    )
    assert drawn.motion_share is not None
    most_moved = honest.motion_share > 0.8
    assert most_moved.any()
    np.testing.assert_allclose(drawn.width[most_moved], honest.width[most_moved], rtol=0.3)
    assert np.all(shorter.width[most_moved] < 0.7 * drawn.width[most_moved])
    most = problem.base.names[int(np.argmax(honest.motion_share))]
    words = noise_in_words(honest)
    assert words is not None
    assert most in words
    assert noise_in_words(short) is None
    with pytest.raises(DataError, match="not those of the"):
        with_motion_bias(problem, [recorded(NOISE, 1)], PROCESSING)


def test_a_bias_as_one_more_error_is_held_at_least_as_often_as_stated() -> None:
    bias = np.linspace(0.0, 30.0, 3001)
    for level in (0.9, 0.95, 0.99):
        half = norm.ppf(0.5 * (1.0 + level)) * np.sqrt(1.0 + bias**2)
        assert np.all(norm.cdf(half - bias) - norm.cdf(-half - bias) >= level - 1e-4)


def test_twins_have_the_noise_of_the_recording_once_more() -> None:
    log = recorded(NOISE)
    turn = np.tile([0.0, 0.0, 0.0, 1.0], (log.n_samples, 1))
    rng = np.random.default_rng(1)
    imu = sdpid.Imu(
        gyroscope=2e-3 * rng.standard_normal((log.n_samples, 3)),
        # Landings: strong, and short.
        accelerometer=0.03 * rng.standard_normal((log.n_samples, 3))
        + 30.0 * (rng.random((log.n_samples, 1)) < 0.01),
    )
    base = sdpid.BaseMotion(orientation=turn, position=np.zeros((log.n_samples, 3)), imu=imu)
    log = replace(log, base=base)
    first, second = twins(log, np.random.default_rng(0))
    np.testing.assert_allclose(first.position + second.position, 2.0 * log.position, atol=1e-12)
    assert np.std(first.position - log.position) == pytest.approx(NOISE, rel=0.1)
    assert first.base is not None
    assert first.base.imu is not None
    assert first.base.imu.gyroscope is not None
    assert first.base.imu.accelerometer is not None
    added = first.base.imu.accelerometer - imu.accelerometer
    assert np.std(added) == pytest.approx(0.03, rel=0.15)
    assert np.std(first.base.imu.gyroscope - imu.gyroscope) == pytest.approx(2e-3, rel=0.1)
    np.testing.assert_array_equal(first.base.orientation, turn)
    np.testing.assert_array_equal(first.effort, log.effort)
