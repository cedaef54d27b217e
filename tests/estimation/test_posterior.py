"""The errors of estimates against dense formulas and against what simulated estimates scatter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import sdpid
from sdpid._common.arrays import Array
from sdpid.estimation.noise_spectrum import NoiseSpectrum
from sdpid.estimation.posterior import Posterior
from sdpid.estimation.problem import build_problem
from tests.helpers.arm import ARM, CONDITIONS, arm_problem
from tests.helpers.data import make_samples, random_links, random_theta

RNG = np.random.default_rng(4)
BODIES = random_links(RNG, 2)
THETA = np.concatenate([BODIES.ravel(), RNG.uniform(0.5, 2.0, 4)])


def estimated(noise: float, prior: sdpid.Prior | None, *, count: int = 40) -> sdpid.Estimate:
    samples = make_samples(ARM, THETA, np.random.default_rng(1), count=count, noise=noise)
    return sdpid.solve_sdp(build_problem(ARM, samples, prior=prior))


def test_without_a_prior_it_is_the_fit() -> None:
    estimate = estimated(0.1, None)
    expected = NoiseSpectrum.of(estimate.problem).covariance
    size = np.sqrt(np.diag(expected))
    found = estimate.covariance / np.outer(size, size)
    np.testing.assert_allclose(found, expected / np.outer(size, size), atol=1e-6)


class Known:
    """Errors of unit variance: the weights are right."""

    def __init__(self, root: Array) -> None:
        self.root, self.scores = root, np.eye(root.shape[1])

    def freedom(self, directions: Array) -> Array:
        return np.full(len(directions), 10.0)


@pytest.mark.parametrize("kind", ["pullback", "entropic"])
def test_with_right_weights_it_is_bayes(kind: str) -> None:
    estimate = estimated(0.1, sdpid.Prior(bodies=BODIES, kind=kind))  # type: ignore[arg-type]
    problem = estimate.problem
    assert problem.prior is not None
    rows = [term.curvature_rows(estimate.theta) for term in problem.prior.terms]
    G = problem.A @ problem.base.matrix
    expected = np.linalg.inv(G.T @ G + sum(R.T @ R for R in rows))
    right = Posterior.about(estimate, Known(np.linalg.inv(problem.A)))
    B = problem.base.matrix
    size = np.sqrt(np.diag(B @ expected @ B.T))
    np.testing.assert_allclose(
        right.covariance(B) / np.outer(size, size), B @ expected @ B.T / np.outer(size, size),
        atol=1e-6,
    )  # fmt: skip
    variance, share, freedom = right.spread(B)
    np.testing.assert_allclose(np.sqrt(variance), size, rtol=1e-6)
    # The prior's part of the variance is known, so that a function has the more freedom.
    np.testing.assert_allclose(freedom, 10.0 / (1.0 - share) ** 2)


def test_what_equations_fix_has_no_error() -> None:
    estimate = sdpid.solve_sdp(arm_problem(*CONDITIONS["fixed"]))
    names = estimate.problem.base.theta_names
    unit = np.eye(len(names))
    fixed, free = (Posterior.of(estimate).spread(unit[[names.index(n)]])[0] for n in ("Fv1", "Fv2"))
    assert fixed[0] <= 1e-12 * free[0]


def test_errors_of_estimates_with_a_prior_are_as_large_as_stated() -> None:
    """Drawn are efforts' noise and, for what the prior says, the friction's truth."""
    rng = np.random.default_rng(2)
    belief = sdpid.Prior(bodies=BODIES, strength=1e6)
    samples = make_samples(ARM, THETA, rng, count=30)
    ratios = []
    base = None
    for _ in range(40):
        theta = THETA.copy()
        effort = samples.effort + 0.3 * rng.standard_normal(samples.effort.shape)
        drawn = sdpid.Samples(
            position=samples.position,
            velocity=samples.velocity,
            acceleration=samples.acceleration,
            effort=effort,
        )
        problem = build_problem(ARM, drawn, prior=belief, weighting="residual", base=base)
        base = problem.base
        estimate = sdpid.solve_sdp(problem)
        viscous = [base.names.index(name) for name in ("Fv1", "Fv2")]
        errors = (estimate.base - problem.base_of(theta))[viscous]
        stated = np.diag(estimate.covariance)[viscous]
        ratios.append(errors**2 / stated)
    # A chi² of 80 degrees of freedom over its mean scatters by 16 %.
    assert 0.5 < np.mean(ratios) < 1.5


def test_unseen_directions_are_open_up_to_limits() -> None:
    """Friction of a joint without effort: neither data nor prior say a thing."""
    rng = np.random.default_rng(3)
    samples = make_samples(ARM, random_theta(ARM, rng), rng, count=30, noise=0.1)
    mask = np.tile([True, False], (30, 1))
    problem = build_problem(
        ARM,
        replace(samples, mask=mask),
        prior=sdpid.Prior(bodies=BODIES, friction=False),
        weighting="residual",
    )
    found = sdpid.confidence_intervals(
        sdpid.solve_sdp(problem), method="gauss_markov", parameters=("Fv1", "Fv2", "xxr2", "zz2")
    )
    assert found.label[0] == "from data"
    assert found.label[1] == "from the prior"
    assert (found.lower[1], found.upper[1]) == (0.0, problem.constraints.friction_max)
    assert np.isfinite(found.upper).all()
