"""Standard errors from the residuals' spectrum, against sums in time and simulated scatter."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter

import sdpid
from sdpid._common.arrays import Array
from sdpid.errors import DataError
from sdpid.estimation import noise_spectrum
from sdpid.estimation.cluster_robust import ScoreBlocks
from sdpid.estimation.compression.covariance import Weighting
from sdpid.estimation.noise_spectrum import NoiseSpectrum
from sdpid.estimation.problem import Problem, build_problem
from sdpid.robot.model.base_parameters import structural_base
from tests.helpers.arm import ARM
from tests.helpers.data import (
    FRICTION,
    friction_model,
    full_regressor,
    make_samples,
    random_theta,
    raw_rows,
)

BASE = structural_base(ARM, friction_model(ARM, FRICTION))
THETA = random_theta(ARM, np.random.default_rng(0))
DEVIATIONS = np.array([0.1, 0.3])

Noise = Callable[[np.random.Generator, int], Array]


def moving(count: int, noise: Array, **fields: object) -> sdpid.Samples:
    """Return samples of a slow motion that does not repeat itself."""
    time = np.arange(count) / 40.0
    omega = np.array([[0.9, 1.3], [2.1, 3.1], [4.3, 3.7]])
    waves = np.exp(1j * (time[:, None, None] * omega + [0.3, 1.2]))
    q, v, a = (np.real(waves * (1j * omega) ** k / omega).sum(axis=1) for k in range(3))
    effort = full_regressor(ARM, (q, v, a)) @ THETA + noise
    return sdpid.Samples(position=q, velocity=v, acceleration=a, effort=effort, **fields)  # type: ignore[arg-type]


def white(rng: np.random.Generator, count: int) -> Array:
    return DEVIATIONS * rng.standard_normal((count, 2))


def red(rng: np.random.Generator, count: int) -> Array:
    """Noise with a memory of ten samples, as long as the fastest motion."""
    long = rng.standard_normal((count + 100, 2))
    return np.asarray(DEVIATIONS * lfilter([np.sqrt(0.19)], [1.0, -0.9], long, axis=0)[100:])


@pytest.mark.parametrize("count", [60, 61])
@pytest.mark.parametrize("together", [1 << 26, 20_000])
def test_frequencies_hold_what_the_rows_hold(
    count: int, together: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(noise_spectrum, "_TOGETHER", together)
    rng = np.random.default_rng(1)
    mask = rng.uniform(size=(count, 2)) > 0.1
    samples = make_samples(ARM, THETA, rng, count=count, noise=0.1, mask=mask, starts=(0, 25))
    problem = build_problem(ARM, samples, base=BASE)
    found = NoiseSpectrum.of(problem)
    np.testing.assert_allclose(found.information(), problem.A.T @ problem.A, rtol=1e-9, atol=1e-9)
    W, effort, _ = raw_rows(problem)
    residual = (effort - W @ sdpid.solve_wls(problem).base)[mask]
    assert found.power.sum() == pytest.approx(residual @ residual)
    assert found.room.sum() == pytest.approx(mask.sum() - BASE.count, rel=0.05)


@pytest.mark.parametrize("noise", [white, red], ids=["white", "red"])
@pytest.mark.parametrize("count", [200, 1200])
def test_errors_are_as_large_as_stated(noise: Noise, count: int) -> None:
    rng = np.random.default_rng(2)
    runs, held, squares = 40, [], []
    for _ in range(runs):
        problem = build_problem(ARM, moving(count, noise(rng, count)), base=BASE)
        fit = sdpid.solve_wls(problem)
        truth = problem.base_of(THETA)
        found = sdpid.confidence_intervals(fit, method="gauss_markov", parameters=BASE.names)
        held.append(found.contains(truth).mean())
        squares.append(
            np.mean((fit.base - truth) ** 2 / np.diag(NoiseSpectrum.of(problem).covariance))
        )
    error = np.std(held) / np.sqrt(runs)
    assert 0.92 - 2.0 * error < np.mean(held) < 0.98 + 2.0 * error
    assert 0.7 < np.median(squares) < 1.5


def test_white_errors_that_are_taken_for_independent_are_too_small() -> None:
    """The red noise of these tests does harm where its spectrum is not looked at."""
    rng, runs = np.random.default_rng(3), 40
    ratios = []
    for _ in range(runs):
        problem = build_problem(ARM, moving(800, red(rng, 800)), base=BASE)
        error = sdpid.solve_wls(problem).base - problem.base_of(THETA)
        naive = np.diag(np.linalg.inv(problem.A.T @ problem.A)) * problem.floor / problem.n_rows
        ratios.append(np.mean(error**2 / naive))
    assert np.median(ratios) > 3.0


def short_problem() -> Problem:
    noise = white(np.random.default_rng(4), 60)
    return build_problem(ARM, moving(60, noise, block=20), base=BASE)


def test_records_too_short_for_blocks_have_errors() -> None:
    problem = short_problem()
    with pytest.raises(DataError, match="blocks"):
        ScoreBlocks.of(problem)
    found = NoiseSpectrum.of(problem)
    freedom = found.freedom(found.root)
    assert np.all(freedom > 2.0)
    assert np.all(freedom < problem.n_rows - BASE.count)


def test_freedom_is_satterthwaites() -> None:
    found = NoiseSpectrum.of(short_problem())
    H = found.information()
    c = np.eye(BASE.count)[3]
    moved = np.linalg.solve(H, c)
    parts = np.array([np.sum((R[:, :-1] @ moved[own]) ** 2) for own, R in found.groups])
    parts *= found.density
    assert found.covariance[3, 3] == pytest.approx(parts.sum())
    expected = parts.sum() ** 2 / np.sum(parts**2 / found.room)
    assert found.freedom(c[None] @ found.root)[0] == pytest.approx(expected)


@pytest.mark.parametrize("weighting", ["eq9", "eq18", "gls", "residual"])
def test_every_weighting_has_errors_of_its_own_fit(weighting: Weighting) -> None:
    rng = np.random.default_rng(5)
    squares = []
    for _ in range(30):
        samples = moving(300, white(rng, 300), covariance=np.diag([4.0, 0.2]))
        problem = build_problem(ARM, samples, base=BASE, weighting=weighting)
        error = sdpid.solve_wls(problem).base - problem.base_of(THETA)
        squares.append(np.mean(error**2 / np.diag(NoiseSpectrum.of(problem).covariance)))
    assert 0.7 < np.mean(squares) < 1.5


@pytest.mark.parametrize("size", [1.0, 4.0])
def test_a_believed_spectrum_takes_the_place_of_the_residuals(size: float) -> None:
    samples = moving(200, white(np.random.default_rng(1), 200))
    problem = build_problem(ARM, samples, friction=FRICTION)
    found = NoiseSpectrum.of(problem)
    believed = NoiseSpectrum.of(problem, believed=lambda at: np.full((2, len(at)), size))
    np.testing.assert_array_equal(believed.information(), found.information())
    np.testing.assert_allclose(believed.density, size)
    np.testing.assert_allclose(believed.densities, size)
    exact = size * np.linalg.inv(problem.A.T @ problem.A)
    scale = np.sqrt(np.diag(exact))
    np.testing.assert_allclose((believed.covariance - exact) / np.outer(scale, scale), 0, atol=1e-6)
