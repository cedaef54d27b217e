"""Errors of gains against finite differences, and against estimates by gains that are off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.gain_errors import GainErrors
from sdpid.estimation.posterior import Posterior
from sdpid.estimation.problem import Problem, build_problem
from sdpid.experiment.processing.samples import Samples
from tests.helpers.arm import ARM
from tests.helpers.data import make_samples, random_covariance, random_links

RNG = np.random.default_rng(7)
THETA = np.concatenate([random_links(RNG, 2).ravel(), RNG.uniform(0.5, 2.0, 4)])
# Correlated, and with a common part.
RELATIVE = np.array([[9.0, 4.0], [4.0, 25.0]]) * 1e-4
GAINS = sdpid.DriveGains(
    joint_names=ARM.joint_names,
    gains=[10.0, 4.0],
    covariance=RELATIVE * np.outer([10.0, 4.0], [10.0, 4.0]),
)


def samples_of(off: Array, *, noise: float = 0.1, seed: int = 1, count: int = 60) -> Samples:
    """Return samples whose efforts were made by gains that are off by shares."""
    samples = make_samples(ARM, THETA, np.random.default_rng(seed), count=count, noise=noise)
    return replace(samples, effort=samples.effort * (1.0 + off), gains=GAINS)


@pytest.mark.parametrize("weighting", ["gls", "gls_per_sample", "eq9", "eq18"])
def test_slopes_are_those_of_the_fit(weighting: str) -> None:
    count = 40
    covariance = random_covariance(np.random.default_rng(2), 2, count)
    mask = np.random.default_rng(3).random((count, 2)) < 0.9

    def fitted(off: Array) -> tuple[Problem, sdpid.Estimate]:
        samples = replace(samples_of(off, count=count), covariance=covariance, mask=mask)
        problem = build_problem(ARM, samples, weighting=weighting)  # type: ignore[arg-type]
        return problem, sdpid.solve_wls(problem)

    problem, estimate = fitted(np.zeros(2))
    slopes = problem.base.matrix @ Posterior.of(estimate, "blocks").from_gains
    size = np.abs(estimate.base) + 1e-3
    for j in range(2):
        moved = fitted(1e-3 * np.eye(2)[j])[1].base - estimate.base
        np.testing.assert_allclose(slopes[:, j] / size, moved / 1e-3 / size, atol=1e-7)
    # A common factor moves all parameters alike.
    np.testing.assert_allclose(slopes.sum(axis=1) / size, estimate.base / size, atol=1e-7)


def test_slopes_of_an_instrumental_estimate() -> None:
    def fitted(off: Array) -> sdpid.Estimate:
        samples = samples_of(off, count=200)
        rng = np.random.default_rng(8)
        shaken = replace(samples, position=samples.position + 0.01 * rng.standard_normal((200, 2)))
        return sdpid.solve_instrumental(
            build_problem(ARM, samples), instruments=shaken, solver=sdpid.solve_wls
        )

    estimate = fitted(np.zeros(2))
    slopes = estimate.problem.base.matrix @ Posterior.of(estimate, "blocks").from_gains
    size = np.abs(estimate.base) + 1e-3
    moved = (fitted(np.array([1e-3, 0.0])).base - estimate.base) / 1e-3
    np.testing.assert_allclose(slopes[:, 0] / size, moved / size, atol=1e-6)
    np.testing.assert_allclose(slopes.sum(axis=1) / size, estimate.base / size, atol=1e-6)


def test_a_prior_holds_against_gains() -> None:
    """With a prior the parameters follow the gains as the estimate without inequalities does."""

    def fitted(off: Array) -> sdpid.Estimate:
        prior = sdpid.Prior(bodies=THETA[:20].reshape(2, 10), strength=5.0)
        samples = samples_of(off)
        return sdpid.solve_sdp(build_problem(ARM, samples, prior=prior, consistency="none"))

    estimate = fitted(np.zeros(2))
    slopes = Posterior.of(estimate).from_gains
    moved = (fitted(np.array([1e-2, 0.0])).theta - fitted(np.array([-1e-2, 0.0])).theta) / 2e-2
    size = np.abs(estimate.theta).max()
    # What the prior says of friction follows the size of the efforts, which is not counted.
    np.testing.assert_allclose(slopes[:, 0] / size, moved / size, atol=5e-3)


def test_intervals_hold_the_truth_for_gains_drawn_from_their_covariance() -> None:
    truth = build_problem(ARM, samples_of(np.zeros(2))).base_of(THETA)
    rng = np.random.default_rng(5)
    root = np.linalg.cholesky(RELATIVE)
    held = {True: [], False: []}  # type: dict[bool, list[Array]]
    for seed in range(100):
        samples = samples_of(root @ rng.standard_normal(2), noise=0.2, seed=seed, count=150)
        for known in held:
            problem = build_problem(ARM, samples if known else replace(samples, gains=None))
            intervals = sdpid.confidence_intervals(
                sdpid.solve_wls(problem), parameters=problem.base.names, method="gauss_markov"
            )
            held[known].append(intervals.contains(truth))
    with_errors, without = (np.mean(held[known]) for known in (True, False))
    # Of some independent 800: two standard deviations are 1.5 %.
    assert 0.92 < with_errors < 0.98
    assert without < 0.8


def test_known_gains_change_nothing() -> None:
    exact = replace(GAINS, covariance=None)
    for gains in (None, exact):
        problem = build_problem(ARM, replace(samples_of(np.zeros(2)), gains=gains))
        errors = GainErrors.of(problem)
        assert not errors.any
        assert not errors.root.any()
