"""Draws have the posterior's distribution: against rejection, and the closed form inside."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import ks_2samp

import sdpid
from sdpid._common.arrays import Array
from sdpid.assurance.sampling.density import Density
from sdpid.assurance.sampling.draw import draw
from sdpid.errors import SolverError
from sdpid.estimation.estimate import Estimate
from sdpid.estimation.posterior import Posterior
from sdpid.robot.inertia import Consistency, margin
from tests.assurance.intervals.test_boundary import BODY, ON_THE_AXIS, arm
from tests.assurance.intervals.test_boundary import estimate as of_arm
from tests.helpers.arm import BODIES, BOTH, arm_problem

# Of some thousand draws quantiles are uncertain by two percent. A test of Kolmogorov and Smirnov of
# any of 24 parameters fails this often where the law is right.
FALSE_ALARM = 1e-4


def pressed(consistency: Consistency) -> Estimate:
    """Return an estimate whose last link lies on the boundary, with a prior that says so too."""
    prior = sdpid.Prior(bodies=BODIES, strength=10.0)
    return sdpid.solve_sdp(arm_problem(consistency=consistency, prior=prior, margin=0.0))


def rejected(estimate: Estimate, count: int) -> Array:
    """Return draws of the Gaussian that obey the constraints, by rejection."""
    density, feasible = Density.of(estimate), estimate.problem.feasible
    root = np.linalg.cholesky(np.linalg.inv(density.precision))
    x = np.random.default_rng(0).standard_normal((count, density.n)) @ root.T
    theta = density.theta(density.mean + x)
    theta = theta[np.all((theta >= feasible.lower) & (theta <= feasible.upper), axis=1)]
    margins = margin(theta[:, :20].reshape(-1, 2, 10), feasible.consistency)
    return np.asarray(theta[margins.min(axis=1) > 0.0])


@pytest.mark.parametrize("consistency", BOTH)
def test_draws_are_those_that_rejection_keeps(consistency: Consistency) -> None:
    estimate = pressed(consistency)
    assert estimate.worst_margin is not None
    assert estimate.worst_margin < 1e-9
    kept = rejected(estimate, 200_000)
    assert len(kept) > 1000
    found = draw(estimate, 3000, seed=3)
    for k, name in enumerate(found.names):
        level = FALSE_ALARM / len(found.names)
        assert ks_2samp(found.theta[:, k], kept[:, k]).pvalue > level, name
    # Together, too: the largest and the smallest second moments are functions of ten parameters.
    both = (margin(each[:, 10:20], consistency) for each in (found.theta, kept))
    assert ks_2samp(*both).pvalue > FALSE_ALARM


def test_inside_draws_are_those_of_gauss_and_markov() -> None:
    estimate = of_arm(BODY, 1, noise=0.003, mass_max=3.0)
    found = draw(estimate, 3000, seed=4)
    covariance = Posterior.of(estimate).covariance(estimate.problem.base.matrix)
    error = np.sqrt(np.diag(covariance))
    size = found.effective_sizes.min()
    away = (found.base.mean(axis=0) - estimate.base) / error
    assert np.abs(away).max() < 5.0 / np.sqrt(size)
    # Standardized by what is stated, draws are uncorrelated and of variance one.
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    values = np.linalg.eigvalsh(root @ np.cov(found.base.T) @ root.T)
    edge = np.sqrt(len(error) / size)
    assert (1.0 - edge) ** 2 - 5.0 / np.sqrt(size) < values[0]
    assert values[-1] < (1.0 + edge) ** 2 + 5.0 / np.sqrt(size)


@pytest.mark.parametrize("noise", [1e-6, 0.0])
def test_data_as_good_as_exact(noise: float) -> None:
    """Inside of the constraints they are drawn from; against them nothing is left to draw."""
    found = draw(of_arm(BODY, 1, noise=noise, mass_max=3.0), 16)
    assert found.r_hat.max() < 1.1
    if noise == 0.0:
        with pytest.raises(SolverError, match="draw: "):
            draw(of_arm(ON_THE_AXIS, 1, noise=noise), 16)


def test_frames_do_not_matter() -> None:
    """Turn the last link's frame about its joint: what the turn leaves has the same draws."""
    names = ("zz2", "zzr1", "Fv2")
    found = []
    for turn in (0.0, 0.7):
        estimate = of_arm(ON_THE_AXIS, 3, robot=arm(turn), turn=turn)
        draws = draw(estimate, 1000, seed=5)
        found.append(draws.base[:, [draws.base_names.index(each) for each in names]])
    for k, name in enumerate(names):
        assert ks_2samp(found[0][:, k], found[1][:, k]).pvalue > FALSE_ALARM, name
