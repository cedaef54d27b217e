"""Friction terms that a recording cannot tell apart are named; the prior shares between them."""

from __future__ import annotations

import numpy as np

from sdpid.assurance.diagnostics.collinear_friction import collinear_friction, in_words
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.experiment.processing.samples import Samples
from tests.helpers.data import random_links
from tests.helpers.robots import small_arm
from tests.helpers.strategies import random_states

ARM = small_arm(2)
LINKS = random_links(np.random.default_rng(3), 2)


def moved(spread: float) -> Problem:
    """Return a problem whose second joint moves at speeds that differ by a share of one."""
    rng = np.random.default_rng(1)
    q, v, a = random_states(rng, 2, 300)
    v[:, 1] = np.where(v[:, 1] > 0.0, 1.0, -1.0) * (1.0 + spread * rng.uniform(-1.0, 1.0, 300))
    effort = ARM.inverse_dynamics(LINKS.ravel(), q, v, a) + 0.5 * np.sign(v) + 0.5 * v
    effort += 0.01 * rng.standard_normal(effort.shape)
    samples = Samples(position=q, velocity=v, acceleration=a, effort=effort)
    terms = ("coulomb", "viscous", "offset")
    prior = Prior(bodies=LINKS)
    return build_problem(ARM, samples, friction=terms, weighting="residual", prior=prior)


def test_speeds_that_never_vary_are_told() -> None:
    (pair,) = collinear_friction(moved(0.01))
    assert (pair.joint, pair.first, pair.second) == (ARM.joint_names[1], "Fs2", "Fv2")
    assert pair.correlation > 0.999
    note = in_words((pair,))
    assert note is not None
    assert "Fs2 and Fv2 of" in note


def test_speeds_that_vary_are_not() -> None:
    assert collinear_friction(moved(0.9)) == ()
    assert in_words(()) is None


def test_the_prior_keeps_them_from_being_torn_apart() -> None:
    """What the data leave open is shared: either term gets half of what both make."""
    theta = solve_sdp(moved(0.0)).named_theta()
    assert theta is not None
    np.testing.assert_allclose([theta["Fs2"], theta["Fv2"]], 0.5, atol=0.02)
