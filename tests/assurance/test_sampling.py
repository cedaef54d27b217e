"""Draws obey every constraint, and have the distribution that they should."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.stats import chi2, ks_2samp, kstest

import sdpid
from sdpid._common.arrays import Array
from sdpid.assurance.sampling.density import Density, Matrices
from sdpid.assurance.sampling.draw import Draws, draw
from sdpid.assurance.sampling.mixing import effective_sizes, split_r_hat
from sdpid.assurance.sampling.walk import drawn_on_lines, hit_and_run, relative_eigenvalues
from sdpid.errors import DataError, SolverError
from sdpid.estimation.conic.solve import symmetric_basis
from sdpid.estimation.estimate import FEASIBLE, Estimate
from sdpid.estimation.posterior import Posterior
from sdpid.robot.inertia import Consistency, margin
from tests.assurance.test_intervals import BODY, ON_THE_AXIS
from tests.assurance.test_intervals import estimate as of_arm
from tests.helpers.arm import BODIES, BOTH, CONDITIONS, arm_problem
from tests.helpers.refusals import refuses


@cache
def estimate(condition: str = "total", consistency: Consistency = "pseudo_inertia") -> Estimate:
    """Return an estimate on the boundary, under one of the conditions."""
    return sdpid.solve_sdp(arm_problem(*CONDITIONS[condition], consistency=consistency))


@cache
def drawn(condition: str = "total", consistency: Consistency = "pseudo_inertia") -> Draws:
    """Return draws of it."""
    return draw(estimate(condition, consistency), 200, seed=1)


@pytest.mark.parametrize(
    ("condition", "consistency"),
    [(each, BOTH[k % 2]) for k, each in enumerate(("box", "all mass", "symmetric", "fixed link"))],
)
def test_every_draw_obeys_every_constraint(condition: str, consistency: Consistency) -> None:
    found = drawn(condition, consistency)
    feasible = estimate(condition, consistency).problem.feasible
    assert found.theta.shape == (200, len(found.names))
    assert max(feasible.violation(theta) for theta in found.theta) <= FEASIBLE
    moving = [k for k in range(2) if condition != "fixed link" or k == 0]
    margins = margin(found.theta[:, :20].reshape(200, 2, 10)[:, moving], consistency)
    assert np.all(margins > feasible.constraints.margin)
    assert len(np.unique(found.theta, axis=0)) == 200
    assert np.allclose(found.base, found.theta @ estimate(condition).problem.base.matrix.T)


def test_the_same_seed_gives_the_same_draws_and_fewer_are_the_first() -> None:
    few = draw(estimate(), 8, seed=1)
    assert np.array_equal(few.theta, drawn().theta[:8])
    assert not np.array_equal(draw(estimate(), 8, seed=2).theta, few.theta)
    assert len(set(few.chain.tolist())) == 8
    assert np.all(few.effective_sizes <= 8)


def test_masses_of_one_value_have_that_value() -> None:
    problem = arm_problem()
    limits = problem.constraints.replace(mass_min=1.0, mass_max=1.0)
    found = draw(sdpid.solve_sdp(problem.constrained(constraints=limits)), 8)
    np.testing.assert_allclose(found.theta[:, [0, 10]], 1.0, rtol=1e-12)


def test_what_nothing_sees_is_told() -> None:
    (note,) = (each for each in drawn().notes if "neither data nor prior" in each)
    assert "xx_1 in " in note
    prior = sdpid.Prior(bodies=BODIES)
    seen = draw(sdpid.solve_sdp(arm_problem(prior=prior)), 8)
    assert not any("neither data nor prior" in each for each in seen.notes)


def test_what_has_no_posterior_is_refused() -> None:
    problem = estimate().problem
    bare, free = problem.without_rows(), problem.constrained(consistency="none")
    refuses(DataError, "no standard parameters", draw, sdpid.solve_wls(problem), 10)
    refuses(DataError, "were not kept with this problem", draw, sdpid.solve_sdp(bare), 10)
    refuses(DataError, "nothing but theta_max bounds", draw, sdpid.solve_sdp(free), 10)
    for count in (0, 2.5, True):
        refuses(DataError, "count is", draw, estimate(), count)


# ---- Draws have the posterior's distribution: against rejection, and the closed form inside.


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
        refuses(SolverError, "draw: ", draw, of_arm(ON_THE_AXIS, 1, noise=noise), 16)


# ---- Effective sample size and R-hat of chains whose answers are known.


COUNT, CHAINS = 2000, 20

# Of 40 000 draws the effective sample size is uncertain by a few percent.
COUNTED = 0.1


def chains(correlation: float, seed: int = 0) -> Array:
    """Return stationary AR(1) chains (count, chains, 1) of variance one."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((COUNT, CHAINS, 1))
    noise[1:] *= np.sqrt(1.0 - correlation**2)
    return np.asarray(lfilter([1.0], [1.0, -correlation], noise, axis=0))


@pytest.mark.parametrize("correlation", [0.0, 0.3, 0.8])
def test_effective_size_of_autoregressive_chains(correlation: float) -> None:
    expected = COUNT * CHAINS * (1.0 - correlation) / (1.0 + correlation)
    (found,) = effective_sizes(chains(correlation))
    assert found == pytest.approx(expected, rel=COUNTED)


def test_chains_that_agree_and_that_do_not() -> None:
    values = chains(0.3)
    assert split_r_hat(values)[0] < 1.005
    apart, wider = values.copy(), values.copy()
    apart[:, 0] += 3.0
    still = np.broadcast_to(values[:1], values.shape)
    assert split_r_hat(still)[0] == np.inf
    # The same mean and another spread: only the distances from the median tell.
    wider[:, :5] *= 4.0
    assert split_r_hat(apart)[0] > 1.05
    assert split_r_hat(wider)[0] > 1.05


def test_ranks_alone_count() -> None:
    values = chains(0.5)
    assert effective_sizes(np.exp(3.0 * values)) == pytest.approx(effective_sizes(values))


def test_a_parameter_that_is_fixed_is_known_as_well_as_can_be() -> None:
    values = np.full((16, 4, 1), 2.0)
    assert effective_sizes(values) == 64.0
    assert split_r_hat(values) == 1.0


# ---- Chains have the laws that random matrices are known to have.


WALKS, EACH = 50, 40


def cone(scale: Array, power: float = 0.0) -> Density:
    """Return Wishart's density of positive definite matrices."""
    size, units = len(scale), symmetric_basis(len(scale))
    n = len(units)
    return replace(
        Density.of(sdpid.solve_sdp(arm_problem(*CONDITIONS["pair"]))),
        mean=np.zeros(n),
        slope=0.5 * np.einsum("ij,kij->k", np.linalg.inv(scale), units),
        precision=np.zeros((n, n)),
        walls=Matrices(np.zeros((0, size, size)), np.zeros((n, 0, size, size))),
        bodies=Matrices(np.zeros((1, size, size)), units[:, None]),
        limits=-np.einsum("kii->k", units)[None],
        room_at_zero=np.full(1, 1e3),
        strength=power,
    )


def matrices_of(density: Density, start: Array, covariance: Array) -> Array:
    """Return matrices (k, s, s) drawn from a density."""
    x = np.einsum("kij,ij->k", symmetric_basis(len(start)), start)
    begin = np.tile(x, (WALKS, 1))
    rng = np.random.default_rng(5)
    points = hit_and_run(density, begin, covariance=covariance, rng=rng, count=EACH + 5, sweeps=4)
    found = points[5:].reshape(-1, density.n)
    return np.einsum("ck,kij->cij", found, symmetric_basis(len(start)))


def test_a_chain_that_rounding_would_take_out_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    steps = "sdpid.assurance.sampling.walk.drawn_on_lines"
    monkeypatch.setattr(steps, lambda *_: np.array([1e3, 1e-3]))
    begin = np.tile(np.einsum("kii->k", symmetric_basis(4)) / 5.0, (2, 1))
    rng, covariance = np.random.default_rng(0), np.eye(begin.shape[1])
    (ends,) = hit_and_run(cone(np.eye(4)), begin, covariance=covariance, rng=rng, count=1)
    assert np.array_equal(ends[0], begin[0])
    assert not np.any(ends[1] == begin[1])


@pytest.mark.parametrize("power", [0.5, 3.0])
def test_wishart_with_a_power_of_the_determinant(power: float) -> None:
    scale = np.diag([0.1, 0.2, 0.5, 1.0]) + 0.05
    nu = 5.0 + 2.0 * power
    density = cone(scale, power)
    root = np.linalg.cholesky(scale)
    units = np.linalg.inv(root) @ symmetric_basis(4) @ np.linalg.inv(root).T
    flat = units.reshape(10, 16)
    found = matrices_of(density, nu * scale, 2.0 * nu * np.linalg.inv(flat @ flat.T))
    ratios = np.linalg.inv(root) @ found @ np.linalg.inv(root).T
    # The trace, and by Bartlett's decomposition every pivot, is that of chi-square variables.
    assert kstest(np.einsum("cii->c", ratios), chi2(4.0 * nu).cdf).pvalue > FALSE_ALARM
    pivots = np.einsum("cii->ci", np.linalg.cholesky(ratios)) ** 2
    for i in range(4):
        assert kstest(pivots[:, i], chi2(nu - i).cdf).pvalue > FALSE_ALARM


@pytest.mark.parametrize("strength", [0.0, 1.5])
@pytest.mark.parametrize(
    ("slope", "curvature"), [(0.0, 0.0), (0.7, 0.0), (-3.0, 0.0), (2.0, 5.0), (-40.0, 9.0)]
)
def test_points_on_a_line_have_its_density(slope: float, curvature: float, strength: float) -> None:
    """From any point of the density a step leads to a point of the density."""
    rates, count = np.array([-0.5, 0.2, 1.0]), 4000
    bodies = rates if strength else rates[:0]
    t = np.linspace(-1.0, 2.0, 100_001)[1:-1]
    log = -slope * t - 0.5 * curvature * t**2
    log += strength * np.log(1.0 + t[:, None] * bodies).sum(axis=1)
    law = np.cumsum(np.exp(log - log.max()))
    rng = np.random.default_rng(0)
    begin = np.interp(rng.random(count), law / law[-1], t)
    # On a line about another point everything is measured from there.
    there = 1.0 + begin[:, None] * rates
    moved = begin + drawn_on_lines(
        slope + curvature * begin,
        curvature,
        strength,
        (rates / there)[:, : len(bodies)],
        rates / there,
        rng,
    )
    assert kstest(np.interp(moved, t, law / law[-1]), "uniform").pvalue > FALSE_ALARM
    assert not np.any(moved == begin)


@given(seed=st.integers(0, 10**6), size=st.sampled_from([4, 6]))
def test_a_line_leaves_the_cone_where_an_eigenvalue_says(seed: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    X, D = rng.standard_normal((2, size, size))
    F, D = X @ X.T + 0.01 * np.eye(size), D + D.T
    values = relative_eigenvalues(F[None, None], D[None])[0]
    far = np.linalg.eigvalsh(F - D / values[0])
    assert np.abs(far).min() == pytest.approx(0.0, abs=1e-9 * np.abs(far).max())
    if values[0] < 0.0:
        assert np.linalg.eigvalsh(F - (1.0 - 1e-6) * D / values[0])[0] > 0.0
