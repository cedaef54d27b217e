"""Standard errors that hold what they promise, on white and on filtered noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t

from sdpid._common.arrays import Array
from sdpid.assurance.intervals.intervals import confidence_intervals
from sdpid.errors import DataError
from sdpid.estimation.cluster_robust import ScoreBlocks
from sdpid.estimation.compression.covariance import WEIGHTINGS, Weighting
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.noise_spectrum import NoiseSpectrum
from sdpid.estimation.problem import build_problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.wls import solve_wls
from sdpid.robot.model.base_parameters import structural_base
from tests.helpers.data import FRICTION, friction_model, make_samples, random_theta
from tests.helpers.robots import small_arm

ARM = small_arm(2)
BASE = structural_base(ARM, friction_model(ARM, FRICTION))
RUNS = 60

# Of RUNS × 12 parameters at 95 %, correlated within a run: the share that is covered spreads by
# some 0.02, and small-sample errors are a little short.
COVERED = (0.89, 0.99)


def coverage(
    noise_of: object, *, count: int, block: int = 1, weighting: Weighting = "gls"
) -> float:
    """Return how often the truth lies within 1.96 standard errors."""
    rng = np.random.default_rng(0)
    inside = []
    for _ in range(RUNS):
        theta = random_theta(ARM, rng)
        noise: Array = noise_of(rng, count)  # type: ignore[operator]
        samples = make_samples(
            ARM,
            theta,
            rng,
            count=count,
            noise=noise,
            block=block,
            covariance=np.diag([1.0, 4.0]),
        )
        problem = build_problem(ARM, samples, weighting=weighting, base=BASE)
        estimate = solve_wls(problem)
        error = np.abs(estimate.base - problem.base_of(theta))
        inside.append(error <= 1.96 * estimate.standard_errors)
    return float(np.mean(inside))


def white(rng: np.random.Generator, count: int) -> Array:
    return np.array([1.0, 2.0]) * rng.standard_normal((count, 2))


def filtered(rng: np.random.Generator, count: int) -> Array:
    """Moving averages over ten samples: strongly correlated, zero beyond."""
    long = rng.standard_normal((count + 9, 2))
    sums = np.cumsum(np.vstack([np.zeros((1, 2)), long]), axis=0)
    return np.asarray((sums[10:] - sums[:-10]) / np.sqrt(10.0))


@pytest.mark.parametrize("weighting", ["gls", "eq9", "eq18", "residual"])
def test_white_noise_is_covered(weighting: Weighting) -> None:
    assert COVERED[0] <= coverage(white, count=300, weighting=weighting) <= COVERED[1]


def test_a_wrong_weight_is_covered_too() -> None:
    """The sandwich needs no true covariance, only independent blocks."""

    def loud(rng: np.random.Generator, count: int) -> Array:
        return np.array([5.0, 0.1]) * rng.standard_normal((count, 2))

    assert COVERED[0] <= coverage(loud, count=300) <= COVERED[1]


def slow_motion_coverage(block: int) -> float:
    """Return the coverage where motion and noise both last: correlation counts then."""
    rng = np.random.default_rng(1)
    count = 2000
    inside = []
    for _ in range(RUNS):
        theta = random_theta(ARM, rng)
        samples = make_samples(ARM, theta, rng, count=count, block=block)
        smooth = {
            name: 2.0 * filtered(rng, count) for name in ("position", "velocity", "acceleration")
        }
        from tests.helpers.data import full_regressor

        states = smooth["position"], smooth["velocity"], smooth["acceleration"]
        effort = full_regressor(ARM, states) @ theta + filtered(rng, count)
        problem = build_problem(ARM, replace(samples, effort=effort, **smooth), base=BASE)
        error = np.abs(solve_wls(problem).base - problem.base_of(theta))
        inside.append(error <= 1.96 * np.sqrt(np.diag(ScoreBlocks.of(problem).covariance)))
    return float(np.mean(inside))


def test_filtered_noise_needs_blocks() -> None:
    assert COVERED[0] <= slow_motion_coverage(25) <= COVERED[1]
    # Counting correlated samples as independent ones promises too much.
    assert slow_motion_coverage(1) < 0.8


def test_errors_shrink_with_the_root_of_the_samples() -> None:
    rng = np.random.default_rng(2)
    theta = random_theta(ARM, rng)
    errors = [
        solve_wls(
            build_problem(ARM, make_samples(ARM, theta, rng, count=count, noise=1.0), base=BASE)
        ).standard_errors
        for count in (400, 6400)
    ]
    np.testing.assert_allclose(errors[0] / errors[1], 4.0, rtol=0.4)


def test_the_covariance_is_one() -> None:
    rng = np.random.default_rng(3)
    samples = make_samples(ARM, random_theta(ARM, rng), rng, count=200, noise=1.0)
    estimate = solve_wls(build_problem(ARM, samples, base=BASE))
    covariance = np.asarray(estimate.covariance)
    np.testing.assert_allclose(covariance, covariance.T, rtol=1e-10)
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    np.testing.assert_allclose(estimate.standard_errors**2, np.diag(covariance))
    # White noise of unit variance: nearly the textbook's (W^T W)^(-1).
    A = estimate.problem.A
    textbook = np.sqrt(np.diag(np.linalg.inv(A.T @ A)))
    np.testing.assert_allclose(estimate.standard_errors, textbook, rtol=0.5)


def test_too_few_blocks() -> None:
    rng = np.random.default_rng(4)
    samples = make_samples(ARM, random_theta(ARM, rng), rng, count=60, noise=1.0, block=30)
    with pytest.raises(DataError, match="2 blocks of 30 samples, at least 8"):
        ScoreBlocks.of(build_problem(ARM, samples, base=BASE))


def test_what_holds_an_estimate_back_is_not_noise() -> None:
    """Errors are those of the fit: pulling the estimate away from it adds none."""
    rng = np.random.default_rng(5)
    theta = random_theta(ARM, rng)
    samples = make_samples(ARM, theta, rng, count=400, noise=0.1)
    held = Constraints(mass_max=0.1 * float(theta[:20:10].min()))
    problem = build_problem(ARM, samples, weighting="residual", base=BASE, constraints=held)
    free, estimate = solve_wls(problem), solve_sdp(problem)
    # It is held back by many times what noise moves it.
    assert np.max(np.abs(estimate.base - free.base) / free.standard_errors) > 30.0
    np.testing.assert_allclose(estimate.standard_errors, free.standard_errors, rtol=1e-6)
    error = np.abs(free.base - problem.base_of(theta))
    assert np.mean(error <= 1.96 * estimate.standard_errors) > 0.8


@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize("block", [10, 150], ids=["blocks", "too short for blocks"])
def test_there_is_one_covariance(weighting: Weighting, block: int) -> None:
    rng = np.random.default_rng(6)
    sigma = np.diag([1.0, 4.0])
    samples = make_samples(
        ARM, random_theta(ARM, rng), rng, count=200, noise=1.0, covariance=sigma, block=block
    )
    estimate = solve_wls(build_problem(ARM, samples, weighting=weighting, base=BASE))
    found = confidence_intervals(estimate, method="gauss_markov", parameters=BASE.names)
    errors = NoiseSpectrum.of(estimate.problem)
    quantiles = t.ppf(0.975, errors.freedom(errors.root))
    half = 0.5 * (found.upper - found.lower)
    np.testing.assert_allclose(half, quantiles * estimate.standard_errors, rtol=1e-9)
