"""The bootstrap against closed forms, and its draws against the solver."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import sdpid
from sdpid.assurance.intervals import bootstrap
from sdpid.assurance.intervals.bootstrap import Refit, resample
from sdpid.errors import DataError
from sdpid.estimation.cluster_robust import ScoreBlocks
from sdpid.estimation.problem import Problem, build_problem
from tests.helpers.arm import ARM, LIGHT, arm_problem
from tests.helpers.data import make_samples, random_theta


def test_the_data_themselves_give_the_estimate() -> None:
    problem = arm_problem(LIGHT)
    blocks = ScoreBlocks.of(problem)
    information, target = blocks.information.sum(axis=0), blocks.target.sum(axis=0)
    for estimate in (sdpid.solve_wls(problem), sdpid.solve_sdp(problem)):
        found, _ = Refit.of(estimate).solve(information, target)
        assert found is not None
        np.testing.assert_allclose(found, estimate.base, atol=1e-5 * np.abs(estimate.base).max())


def test_a_draw_is_the_problem_of_the_samples_drawn() -> None:
    problem = arm_problem(LIGHT)
    blocks = ScoreBlocks.of(problem)
    rng = np.random.default_rng(4)
    drawn = rng.integers(0, blocks.count, blocks.count)
    times = np.bincount(drawn, minlength=blocks.count).astype(float)
    found, _ = Refit.of(sdpid.solve_sdp(problem)).solve(
        np.tensordot(times, blocks.information, 1), times @ blocks.target
    )
    s = problem.samples
    again = sdpid.Samples(
        position=s.position[drawn],
        velocity=s.velocity[drawn],
        acceleration=s.acceleration[drawn],
        effort=s.effort[drawn],
    )
    whole = build_problem(ARM, again, base=problem.base, constraints=problem.constraints)
    expected = sdpid.solve_sdp(whole).base
    assert found is not None
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())


def test_unconstrained_draws_scatter_as_standard_errors_say() -> None:
    rng = np.random.default_rng(6)
    theta = random_theta(ARM, rng)
    samples = make_samples(ARM, theta, rng, count=600, noise=0.2, block=4)
    fit = sdpid.solve_wls(build_problem(ARM, samples))
    drawn = resample(fit, resamples=800, seed=1)
    ratio = drawn.base.std(axis=0) / fit.standard_errors
    # 800 draws know a deviation to 2.5 %, and blocks drawn with leverage scatter a little more.
    assert np.all(np.abs(ratio - 1.0) < 0.15)


def test_periods_scatter_as_their_mean() -> None:
    rng = np.random.default_rng(7)
    theta = random_theta(ARM, rng)
    exact = make_samples(ARM, theta, rng, count=200)
    periods = exact.effort + 0.3 * rng.standard_normal((12, *exact.effort.shape))
    samples = replace(exact, effort=periods.mean(axis=0), effort_periods=periods, periods=12)
    problem = build_problem(ARM, samples)
    fit = sdpid.solve_wls(problem)
    blocks = ScoreBlocks.of(problem, "periods")
    found, _ = Refit.of(fit).solve(blocks.information.sum(axis=0), blocks.target.sum(axis=0))
    np.testing.assert_allclose(found, fit.base, rtol=1e-8, atol=1e-10)
    # The covariance is that of the periods' own fits, over their number.
    single = [sdpid.solve_wls(build_problem(ARM, replace(samples, effort=e))).base for e in periods]
    expected = np.cov(np.array(single).T) / 12
    np.testing.assert_allclose(
        blocks.covariance, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max()
    )
    drawn = resample(fit, resamples=800, groups="periods", seed=1)
    ratio = drawn.base.std(axis=0) / np.sqrt(np.diagonal(blocks.covariance))
    assert np.all(np.abs(ratio - 1.0) < 0.15)


def test_same_seed_same_intervals_and_basic_mirrors_percentile() -> None:
    estimate = sdpid.solve_sdp(arm_problem(LIGHT))
    choices = {"method": "bootstrap", "resamples": 80}
    first = sdpid.confidence_intervals(estimate, **choices)  # type: ignore[arg-type]
    second = sdpid.confidence_intervals(estimate, **choices)  # type: ignore[arg-type]
    np.testing.assert_array_equal(first.lower, second.lower)
    other = sdpid.confidence_intervals(estimate, seed=1, **choices)  # type: ignore[arg-type]
    assert not np.array_equal(first.lower, other.lower)
    basic = sdpid.confidence_intervals(estimate, kind="basic", **choices)  # type: ignore[arg-type]
    np.testing.assert_allclose(basic.upper, 2.0 * first.estimate - first.lower, atol=1e-12)


@pytest.mark.parametrize("seed", [-1, 0.5, True, None])
def test_seeds_that_are_none_are_refused(seed: Any) -> None:
    estimate = sdpid.solve_wls(arm_problem())
    with pytest.raises(DataError, match="seed"):
        sdpid.confidence_intervals(estimate, method="bootstrap", seed=seed)
    with pytest.raises(DataError, match="seed"):
        sdpid.smallest_mass_eigenvalue(estimate, seed=seed)
    with pytest.raises(DataError, match="seed"):
        sdpid.compare(estimate.problem, starts=1, seed=seed)


def test_a_generator_is_a_seed() -> None:
    estimate = sdpid.solve_wls(arm_problem())
    first, second, third = (
        resample(estimate, resamples=5, seed=np.random.default_rng(i)).base for i in (0, 0, 1)
    )
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(first, third)


def test_too_few_draws_and_unknown_kinds_are_refused() -> None:
    estimate = sdpid.solve_wls(arm_problem())
    with pytest.raises(DataError, match="at least 80"):
        sdpid.confidence_intervals(estimate, method="bootstrap", resamples=79)
    with pytest.raises(DataError, match="resamples"):
        resample(estimate, resamples=0)
    with pytest.raises(DataError, match="kind"):
        sdpid.confidence_intervals(
            estimate,
            method="bootstrap",
            resamples=80,
            kind="bca",  # type: ignore[arg-type]
        )


@pytest.mark.parametrize("accurate", [1e-8, 0.0])
def test_draws_that_the_quick_programs_leave_are_solved_from_scratch(
    accurate: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bootstrap, "_ACCURATE", accurate)
    anew: list[Problem] = []
    monkeypatch.setattr(bootstrap, "solve_sdp", lambda p: anew.append(p) or sdpid.solve_sdp(p))
    estimate = sdpid.solve_sdp(arm_problem(LIGHT))
    blocks, again = ScoreBlocks.of(estimate.problem), Refit.of(estimate)
    rng = np.random.default_rng(8)
    for _ in range(20):
        drawn = rng.integers(0, blocks.count, blocks.count)
        times = np.bincount(drawn, minlength=blocks.count).astype(float)
        H, c = np.tensordot(times, blocks.information, 1), times @ blocks.target
        root = np.linalg.cholesky(H)
        A = root.T @ estimate.problem.excitation.inverse
        problem = replace(estimate.problem, A=A, rhs=np.linalg.solve(root, c))
        expected = sdpid.solve_sdp(problem).base
        found, seconds = again.solve(H, c)
        assert found is not None
        np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())
        assert seconds > 0.0
    assert len(anew) == (20 if accurate == 0.0 else 0)
