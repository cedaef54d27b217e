"""Friction in both directions is believed to be alike: one direction must not ruin the other."""

from __future__ import annotations

import numpy as np
import pytest

from sdpid.estimation.estimate import Estimate
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import build_problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.experiment.processing.samples import Samples
from tests.helpers.data import random_links
from tests.helpers.robots import small_arm
from tests.helpers.strategies import random_states

ARM = small_arm(2)
LINKS = random_links(np.random.default_rng(3), 2)


def moved(low: float, forwards: float, backwards: float) -> Estimate:
    """Return an estimate from a motion whose second joint moves at speeds of low to 2 rad/s."""
    rng = np.random.default_rng(1)
    q, v, a = random_states(rng, 2, 300)
    v[:, 1] = rng.uniform(low, 2.0, 300)
    effort = ARM.inverse_dynamics(LINKS.ravel(), q, v, a) + 0.5 * v
    effort += np.where(v > 0.0, forwards, -backwards) + 0.01 * rng.standard_normal(v.shape)
    samples = Samples(position=q, velocity=v, acceleration=a, effort=effort)
    terms = ("asymmetric_coulomb", "viscous")
    prior = Prior(bodies=LINKS)
    return solve_sdp(build_problem(ARM, samples, friction=terms, weighting="residual", prior=prior))


def test_a_side_that_never_moved_is_like_the_other() -> None:
    theta = moved(0.1, 0.6, 0.6).named_theta()
    assert theta is not None
    assert theta["Fsp2"] == pytest.approx(0.6, abs=0.03)
    # Believed to be small too, it stays a little below.
    assert 0.9 * theta["Fsp2"] < theta["Fsn2"] <= theta["Fsp2"]


def test_sides_that_moved_may_differ() -> None:
    theta = moved(-2.0, 0.6, 0.3).named_theta()
    assert theta is not None
    assert theta["Fsp2"] == pytest.approx(0.6, abs=0.03)
    assert theta["Fsn2"] == pytest.approx(0.3, abs=0.03)
