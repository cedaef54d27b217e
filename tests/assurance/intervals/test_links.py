"""Mass, center of mass and principal inertias of links, and their intervals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sdpid
from sdpid.assurance.intervals.links import link_properties, properties, slopes
from sdpid.estimation.posterior import Posterior
from sdpid.robot.inertia import theta_from_physical, transform
from tests.helpers.data import random_theta
from tests.helpers.identified import ARM, FRICTION, arm_theta, moved

SEEDS = st.integers(0, 2**32 - 1)


def body(seed: int) -> np.ndarray:
    theta = random_theta(ARM, np.random.default_rng(seed), FRICTION)[:10]
    # Axes that are apart: of those that coincide the order is arbitrary.
    mass, com = theta[0], theta[1:4] / theta[0]
    return theta_from_physical(mass, com, np.diag([0.02, 0.03, 0.042]) * mass)


@given(SEEDS)
def test_slopes_are_those_of_the_properties(seed: int) -> None:
    theta, step = body(seed), 1e-6
    scale = step * np.maximum(np.abs(theta), np.abs(theta).max() * 1e-2)
    ahead, back = (properties(theta + sign * np.diag(scale)) for sign in (1.0, -1.0))
    found = ((ahead - back) / (2.0 * scale[:, None])).T
    assert slopes(theta) == pytest.approx(found, rel=1e-4, abs=1e-5 * np.abs(found).max())


@given(SEEDS)
def test_turning_the_frame_keeps_mass_and_principal_inertias(seed: int) -> None:
    theta = body(seed)
    rotation = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    turned = properties(transform(theta, rotation, [0.3, -0.2, 0.1])[None])[0]
    own = properties(theta[None])[0]
    assert turned[[0, 4, 5, 6]] == pytest.approx(own[[0, 4, 5, 6]], rel=1e-9)
    assert turned[1:4] == pytest.approx(rotation @ own[1:4] + [0.3, -0.2, 0.1], rel=1e-9)


def test_intervals_are_those_of_small_errors_drawn_as_data_and_prior_leave_them() -> None:
    prior = sdpid.Prior(bodies=arm_theta()[:20].reshape(2, 10))
    problem = sdpid.build_problem(ARM, moved(arm_theta(), 1), friction=FRICTION, prior=prior)
    estimate = sdpid.solve_sdp(problem)
    found = link_properties(estimate)
    covariance = Posterior.of(estimate).covariance(np.eye(problem.n_theta))
    scale = 1e-4
    draws = np.random.default_rng(0).multivariate_normal(
        estimate.theta, scale**2 * covariance, 4000, check_valid="ignore"
    )
    each = np.array([properties(draw[:20].reshape(2, 10)) for draw in draws])
    deviation = each.std(axis=0) / scale
    # Student's t has at least the normal's quantile; 4000 draws tell a deviation to 1 %.
    ratio = (found.upper - found.value) / deviation
    assert np.all(ratio >= 0.95 * 1.96)
    assert np.all(ratio[found.prior_share > 0.99] <= 1.05 * 1.96)
    assert np.all(found.lower[:, [0, 4, 5, 6]] >= 0.0)
    assert np.all((found.lower <= found.value) & (found.value <= found.upper))


def test_what_nothing_tells_has_no_end() -> None:
    """The first link turns about one axis: its mass is not to be seen."""
    problem = sdpid.build_problem(ARM, moved(arm_theta(), 1), friction=FRICTION)
    found = link_properties(sdpid.solve_sdp(problem))
    assert found.upper[0, 0] == np.inf
    assert found.lower[0, 0] == 0.0


def test_without_standard_parameters_there_are_none() -> None:
    problem = sdpid.build_problem(ARM, moved(arm_theta(), 1), friction=FRICTION)
    with pytest.raises(sdpid.errors.DataError, match="no standard parameters"):
        link_properties(sdpid.solve_wls(problem))
