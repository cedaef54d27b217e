"""Residual weighting, and covariances of masked joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given

from sdpid._common.arrays import Array
from sdpid.assurance.diagnostics.validation import validate
from sdpid.errors import DataError
from sdpid.estimation.compression.covariance import (
    integrated_time,
    masked_covariance,
    power,
    whitener,
)
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import build_problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.wls import solve_wls
from sdpid.experiment.processing.samples import Samples
from tests.helpers.data import make_samples, random_covariance, random_theta
from tests.helpers.robots import small_arm
from tests.helpers.strategies import SEEDS

ARM = small_arm(3)
COUNT = 4000
SPREAD = np.array([0.5, 2.0, 1.0])

# A share of the overall effort is added to every variance, as a floor (see
# `sdpid.estimation.compression.covariance`).
EFFORT_SHARE = 0.01


def autoregressive(rng: np.random.Generator, count: int, n: int, memory: float) -> Array:
    """Return unit-variance AR(1) noise whose neighbors correlate by `memory`."""
    noise = rng.standard_normal((count, n))
    for k in range(1, count):
        noise[k] = memory * noise[k - 1] + np.sqrt(1.0 - memory**2) * noise[k]
    return noise


def noisy(seed: int, memory: float, **fields: object) -> tuple[Samples, Array]:
    """Return samples with colored noise, and the variances that the weighting is to find."""
    rng = np.random.default_rng(seed)
    theta = random_theta(ARM, rng)
    noise = SPREAD * autoregressive(rng, COUNT, 3, memory)
    samples = make_samples(ARM, theta, rng, count=COUNT, noise=noise, **fields)  # type: ignore[arg-type]
    floor = EFFORT_SHARE**2 * float(np.mean(np.square(samples.effort)))
    return samples, SPREAD**2 + floor


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_residual_weighting_finds_variances_and_correlation_time(memory: float) -> None:
    samples, variance = noisy(0, memory)
    sigma = build_problem(ARM, samples, weighting="residual").sigma
    assert sigma.shape == (3, 3)
    np.testing.assert_array_equal(sigma, np.diag(np.diag(sigma)))
    diagonal = np.diag(sigma)
    # The variance of a sample variance: some 1 + 2·m²/(1 − m²) per sample are independent.
    np.testing.assert_allclose(diagonal / diagonal[0], variance / variance[0], rtol=0.25)
    # 1 + 2·Σ m^k of an autoregressive process; cutting the sum at the first sign change, where
    # noise takes over, leaves some tens of percent.
    time = (1.0 + memory) / (1.0 - memory)
    np.testing.assert_allclose(diagonal / variance, time, rtol=0.35)


def test_white_residuals_count_in_full() -> None:
    samples, variance = noisy(1, 0.0)
    sigma = build_problem(ARM, samples, weighting="residual").sigma
    np.testing.assert_allclose(np.diag(sigma), variance, rtol=0.15)


def test_residual_weighting_looks_at_unmasked_rows_only() -> None:
    samples, variance = noisy(2, 0.0)
    rng = np.random.default_rng(3)
    mask = rng.random((COUNT, 3)) < 0.6
    effort = np.where(mask, samples.effort, 1e3)
    spoiled = Samples(
        position=samples.position,
        velocity=samples.velocity,
        acceleration=samples.acceleration,
        effort=effort,
        mask=mask,
    )
    sigma = build_problem(ARM, spoiled, weighting="residual").sigma
    np.testing.assert_allclose(np.diag(sigma), variance, rtol=0.2)


def test_a_quiet_joint_gets_more_say_than_under_equal_weights() -> None:
    """With the right variances the spread of the estimates goes down."""
    rng = np.random.default_rng(4)
    theta = random_theta(ARM, rng)
    loud = np.array([0.05, 5.0, 0.05])
    errors: dict[str, list[float]] = {"gls": [], "residual": []}
    for _ in range(10):
        noise = loud * rng.standard_normal((300, 3))
        samples = make_samples(ARM, theta, rng, count=300, noise=noise)
        for weighting, found in errors.items():
            problem = build_problem(ARM, samples, weighting=weighting)  # type: ignore[arg-type]
            error = np.abs(solve_wls(problem).base - problem.base_of(theta))
            # The last link's own parameters, which act on its quiet joint too.
            last = [i for i, name in enumerate(problem.base.names) if name in ("zz3", "mx3", "my3")]
            assert len(last) == 3
            found.append(float(error[last].max()))
    assert np.mean(errors["residual"]) < 0.7 * np.mean(errors["gls"])


@given(SEEDS)
def test_powers(seed: int) -> None:
    covariance = random_covariance(np.random.default_rng(seed), 3, 4)
    root = power(covariance, -0.5)
    np.testing.assert_allclose(root @ covariance @ root, np.tile(np.eye(3), (4, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(power(covariance, -1.0), np.linalg.inv(covariance), atol=1e-9)


@given(SEEDS)
def test_whitening_masked_rows_is_whitening_the_rest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    covariance = random_covariance(rng, 4)
    mask = rng.random((6, 4)) < 0.6
    each = whitener(np.tile(covariance, (6, 1, 1)), mask, -1.0)
    np.testing.assert_allclose(whitener(covariance, mask, -1.0), each, atol=1e-10)
    for weight, used in zip(each, mask, strict=True):
        index = np.flatnonzero(used)
        assert not weight[~used].any()
        assert not weight[:, ~used].any()
        inverse = np.linalg.inv(covariance[np.ix_(index, index)])
        np.testing.assert_allclose(weight[np.ix_(index, index)], inverse, atol=1e-9)


@given(SEEDS)
def test_masked_covariances_are_no_worse_conditioned(seed: int) -> None:
    rng = np.random.default_rng(seed)
    covariance = 1e-13 * random_covariance(rng, 4)
    mask = rng.random((6, 4)) < 0.6
    values = np.linalg.eigvalsh(masked_covariance(covariance, mask))
    whole = np.linalg.eigvalsh(covariance)
    worst = (values[:, -1] / values[:, 0]).max()
    assert worst <= whole[-1] / whole[0] * (1.0 + 1e-9)


@pytest.mark.parametrize("exponent", [-0.5, -1.0])
def test_singular_covariances_are_refused(exponent: float) -> None:
    with pytest.raises(DataError, match="singular"):
        power(np.diag([1.0, 0.0]), exponent)
    with pytest.raises(DataError, match="singular"):
        power(np.zeros((2, 2)), exponent)
    with pytest.raises(DataError, match="1 of 3 singular"):
        power(np.stack([np.eye(2), np.diag([1.0, -1.0]), np.eye(2)]), exponent)


@pytest.mark.parametrize("believed", [False, True])
def test_a_joint_with_next_to_no_effort_is_predicted_better_than_by_a_constant(
    believed: bool,
) -> None:
    rng = np.random.default_rng(0)
    theta = random_theta(ARM, rng)
    # The last link and its joint's friction: efforts 1e4 times smaller than the others'.
    theta[20:30] *= 1e-4
    theta[[32, 35]] *= 1e-4
    samples = make_samples(ARM, theta, rng, count=1000)
    spread = samples.effort.std(axis=0)
    assert spread[2] < 1e-3 * spread[:2].min()
    # Friction that grows with the load, which the model lacks: 5 % of every joint's effort.
    more = 0.05 * np.abs(samples.effort) * np.sign(samples.velocity)
    samples = replace(samples, effort=samples.effort + more)
    prior = Prior(bodies=1.3 * theta[:30].reshape(3, 10)) if believed else None
    problem = build_problem(ARM, samples, weighting="residual", prior=prior)
    assert np.min(validate(solve_sdp(problem)).r2) > 0.9


def test_efforts_that_are_all_zero_are_refused() -> None:
    rng = np.random.default_rng(0)
    samples = make_samples(ARM, random_theta(ARM, rng), rng, count=60)
    samples = replace(samples, effort=np.zeros((60, 3)))
    with pytest.raises(DataError, match=r"efforts that count are zero.*effort was recorded"):
        build_problem(ARM, samples, weighting="residual")


def test_the_integrated_time_is_that_of_geyers_sequence() -> None:
    lags = np.arange(400.0)
    for memory in (0.0, 0.3, 0.9):
        expected = (1.0 + memory) / (1.0 - memory)
        assert integrated_time(memory**lags) == pytest.approx(expected, rel=1e-12)
    # One negative value does not end the sum, a pair does.
    found = integrated_time(np.array([1.0, -0.2, 0.5, 0.1, -0.3, 0.2, 0.9, 0.9]))
    assert found == pytest.approx(1.8)
    assert integrated_time(np.array([1.0])) == 1.0
    assert integrated_time(np.array([1.0, -0.9])) == 1.0
