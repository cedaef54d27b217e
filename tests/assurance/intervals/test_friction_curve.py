"""Friction curves with intervals, against the friction that was simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import sdpid
from sdpid.assurance.intervals.friction_curve import friction_curve, joint_curve
from sdpid.errors import DataError
from sdpid.estimation.problem import Problem, build_problem
from tests.helpers.arm import ARM
from tests.helpers.data import full_regressor, random_theta

WIDTHS = (0.3, 0.6)
TRUE = (sdpid.friction.SigmoidFriction(velocity=WIDTHS), "viscous", "offset")
THETA = random_theta(ARM, np.random.default_rng(0), TRUE)


def simulated(rng: np.random.Generator, sigmoid: float | None = None) -> Problem:
    """Return a problem whose sigmoid has a given speed, or one that the data choose."""
    time = np.arange(400) / 25.0
    omega = np.array([[0.9, 1.3], [2.1, 3.1], [4.3, 3.7]])
    waves = np.exp(1j * (time[:, None, None] * omega + [0.3, 1.2]))
    q, v, a = (np.real(waves * (1j * omega) ** k / omega).sum(axis=1) for k in range(3))
    effort = full_regressor(ARM, (q, v, a), TRUE) @ THETA
    effort += 0.05 * rng.standard_normal(effort.shape)
    samples = sdpid.Samples(position=q, velocity=v, acceleration=a, effort=effort)
    terms = (sdpid.friction.SigmoidFriction(velocity=sigmoid), *TRUE[1:])
    return build_problem(ARM, samples, friction=terms)


def test_intervals_hold_the_true_curve_as_often_as_stated() -> None:
    rng = np.random.default_rng(3)
    speeds = np.array([0.1, 0.3, 1.0])
    saturated = np.tanh(speeds[:, None] / WIDTHS)
    true = THETA[20:22] * saturated + THETA[22:24] * speeds[:, None]
    signed = np.concatenate([-speeds, speeds])
    # With its offset, as a joint's own curve is.
    second = THETA[21] * np.tanh(signed / WIDTHS[1]) + THETA[23] * signed + THETA[25]
    held, with_offset = [], []
    for _ in range(20):
        estimate = sdpid.solve_sdp(simulated(rng))
        found = friction_curve(estimate, speeds)
        held.append(np.abs(found.friction - true) <= found.half_width)
        curve = joint_curve(estimate, 1, signed)
        assert curve.lower is not None
        assert curve.upper is not None
        with_offset.append((curve.lower <= second) & (second <= curve.upper))
        both = 0.5 * (curve.effort[3:] - curve.effort[:3])
        np.testing.assert_allclose(both, found.friction[:, 1], rtol=1e-9)
    assert found.friction.shape == (3, 2)
    assert found.half_width.max() < 0.3 * true.min()
    # Of 120 at 95 %, those of one record correlated.
    assert np.mean(held) > 0.87
    assert np.mean(with_offset) > 0.87
    assert (curve.level, curve.joint) == (0.95, ARM.joint_names[1])
    assert "level=0.95" in repr(curve)
    assert "upper" in curve._repr_html_()


def test_of_given_speeds_only_coefficients_are_uncertain() -> None:
    estimate = sdpid.solve_sdp(simulated(np.random.default_rng(4), 0.4))
    problem = estimate.problem
    found = friction_curve(estimate, 0.2, level=0.6826894921370859)
    at = [problem.base.names.index(name) for name in ("Fsg1", "Fv1")]
    weights = np.array([np.tanh(0.5), 0.2])
    own = estimate.covariance[np.ix_(at, at)]
    assert found.friction[0, 0] == pytest.approx(weights @ estimate.base[at])
    # One standard error, and a little more since it is uncertain itself.
    error = float(np.sqrt(weights @ own @ weights))
    assert error < found.half_width[0, 0] < 1.05 * error


def test_it_needs_standard_parameters() -> None:
    problem = simulated(np.random.default_rng(5))
    with pytest.raises(DataError, match="constrained solver"):
        friction_curve(sdpid.solve_wls(problem), 0.1)
    with pytest.raises(DataError, match="constrained solver"):
        joint_curve(sdpid.solve_wls(problem), 0)
    for level in (0.0, 1, 95, float("nan"), None):
        with pytest.raises(DataError, match="give a probability between 0 and 1"):
            joint_curve(sdpid.solve_wls(problem), 0, level=level)


def test_a_bias_of_the_fit_is_in_the_band() -> None:
    estimate = sdpid.solve_sdp(simulated(np.random.default_rng(3), 0.3))
    problem = estimate.problem
    viscous = problem.base.names.index("Fv1")
    bias = np.zeros(problem.base.count)
    bias[viscous] = 0.4
    moved = replace(estimate, problem=replace(problem, motion_bias=bias))
    speeds, quantile = np.array([0.5, 1.0]), 1.96
    plain, wider = (friction_curve(each, speeds).half_width[:, 0] for each in (estimate, moved))
    np.testing.assert_allclose(wider, np.hypot(plain, quantile * 0.4 * speeds), rtol=0.02)
