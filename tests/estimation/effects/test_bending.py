"""Derivatives of friction by the speeds that the data chose, against the shapes themselves."""

from __future__ import annotations

import numpy as np
import pytest

import sdpid
from sdpid.estimation.effects.bending import Bending
from sdpid.estimation.noise_spectrum import NoiseSpectrum
from sdpid.estimation.problem import Problem, build_problem
from sdpid.robot.friction.motion import Motion
from tests.helpers.arm import ARM
from tests.helpers.data import full_regressor, random_theta

TERMS = (sdpid.friction.SigmoidFriction(), "viscous", "offset")
SPEEDS = np.array([0.3, 0.6])


def simulated(rng: np.random.Generator, count: int = 400) -> tuple[Problem, np.ndarray]:
    """Return a problem whose friction saturates at some speeds, and the truth."""
    terms = (sdpid.friction.SigmoidFriction(velocity=tuple(SPEEDS)), *TERMS[1:])
    theta = random_theta(ARM, np.random.default_rng(0), terms)
    time = np.arange(count) / 25.0
    omega = np.array([[0.9, 1.3], [2.1, 3.1], [4.3, 3.7]])
    waves = np.exp(1j * (time[:, None, None] * omega + [0.3, 1.2]))
    q, v, a = (np.real(waves * (1j * omega) ** k / omega).sum(axis=1) for k in range(3))
    effort = full_regressor(ARM, (q, v, a), terms) @ theta
    effort += 0.05 * rng.standard_normal(effort.shape)
    samples = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=effort)
    return build_problem(ARM, samples, friction=TERMS), theta


def test_derivatives_are_those_of_the_shape() -> None:
    problem, theta = simulated(np.random.default_rng(1))
    values = theta[20:]
    found = Bending.of(problem.friction, problem.profiled, values)
    v = np.linspace(-2.0, 2.0, 30)[:, None] * np.ones(2)
    motion = Motion(position=v, velocity=v, acceleration=v, robot=ARM)
    speeds = np.array([each.value for each in problem.profiled])
    # d(tanh(v/w))/d(log w) = -(v/w)·sech²(v/w)
    ratio = v / speeds
    expected = -values[:2] * ratio / np.cosh(ratio) ** 2
    columns = found.columns(motion)
    assert columns.shape == (30, 2, 2)
    np.testing.assert_allclose(np.einsum("kjj->kj", columns), expected, atol=2e-3)
    assert not columns[:, [0, 1], [1, 0]].any()
    limits = [np.log(each.upper / each.lower) / np.sqrt(12.0) for each in problem.profiled]
    np.testing.assert_allclose(found.deviations, limits)


def test_without_chosen_speeds_there_are_none() -> None:
    problem, theta = simulated(np.random.default_rng(1))
    found = Bending.of(problem.friction, (), theta[20:])
    assert found.deviations.size == 0
    assert NoiseSpectrum.of(problem).covariance.shape == (problem.base.count,) * 2


def test_errors_count_the_speeds_that_the_data_chose() -> None:
    """Friction scatters more for them, and the truth is within as often as stated."""
    rng = np.random.default_rng(2)
    alone, beside = [], []
    for _ in range(15):
        problem, theta = simulated(rng)
        estimate = sdpid.solve_sdp(problem)
        error = estimate.base - problem.base_of(theta)
        at = [problem.base.names.index(name) for name in ("Fsg1", "Fsg2", "Fv1", "Fv2")]
        for given, ratios in ((None, alone), (estimate.theta, beside)):
            variance = np.diag(NoiseSpectrum.of(problem, given).covariance)
            ratios.append(np.mean((error**2 / variance)[at]))
    # Of 60 squares the mean scatters by a fifth; those of one joint are correlated.
    assert np.mean(alone) > 1.8 * np.mean(beside)
    assert np.mean(beside) == pytest.approx(1.0, abs=0.5)
