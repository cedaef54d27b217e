"""Robust costs: what they are, that their optimum is global, and what they are good for."""

from __future__ import annotations

from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sdpid._common.arrays import Array
from sdpid.assurance.certificate.certificate import GAP, certify
from sdpid.errors import DataError, SolverError
from sdpid.estimation.compression.covariance import Weighting
from sdpid.estimation.constraints.constraints import Constraints
from sdpid.estimation.local.starts import random_start
from sdpid.estimation.prior.prior import Prior
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.robust.huber import HuberLoss
from sdpid.estimation.robust.solve import RobustEstimate, solve_robust
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.wls import solve_wls
from sdpid.robot.inertia import Consistency, matrix_basis
from sdpid.robot.model.model import RobotModel
from tests.helpers.data import (
    brute_force_cost,
    flat_links,
    make_samples,
    matrix_power,
    random_covariance,
    random_theta,
    raw_rows,
)
from tests.helpers.robots import planar_arm, small_arm
from tests.helpers.small_robots import MODELS
from tests.helpers.strategies import SEEDS
from tests.helpers.tolerances import COST, SAME_OPTIMUM

BOTH: tuple[Consistency, ...] = ("pseudo_inertia", "spatial_inertia")
ROBOTS = {"planar": planar_arm(), "arm2": small_arm(2), **MODELS}
ARM3 = small_arm(3)
COUNT = 200

# A tenth of the rows is off by this many standard deviations.
OUTLIER = 60.0


def spoiled(
    robot: RobotModel,
    seed: int,
    *,
    count: int = COUNT,
    noise: float = 0.3,
    flat: bool = True,
    masked: bool = False,
    covariance: Array | None = None,
    **options: Any,
) -> tuple[Problem, Array]:
    """Return a problem with gross errors in a tenth of the rows, and the true parameters."""
    rng = np.random.default_rng(seed)
    theta = random_theta(robot, rng)
    if flat:
        theta[: 10 * robot.n_links] = flat_links(rng, robot.n_links).ravel()
    error = rng.standard_normal((count, robot.n))
    error[rng.random(error.shape) < 0.1] += OUTLIER
    mask = rng.random(error.shape) < 0.7 if masked else None
    samples = make_samples(
        robot, theta, rng, count=count, noise=noise * error, mask=mask, covariance=covariance
    )
    return build_problem(robot, samples, **options), theta


def whitened(problem: Problem) -> tuple[Array, Array]:
    """Return the rows (K, n, b) and efforts (K, n) whitened sample by sample, masked ones zero."""
    W, effort, mask = raw_rows(problem)
    rows, efforts = np.zeros_like(W), np.zeros_like(effort)
    for k in range(len(W)):
        used = np.flatnonzero(mask[k])
        if used.size:
            sigma = problem.sigma if problem.sigma.ndim == 2 else problem.sigma[k]
            root = matrix_power(sigma[np.ix_(used, used)], -0.5)
            rows[k, used], efforts[k, used] = root @ W[k, used], root @ effort[k, used]
    return rows, efforts


def independent_optimum(problem: Problem, thresholds: Array) -> float:
    """Return the least Huber cost, from whitened raw rows and the textbook constraints."""
    rows, efforts = whitened(problem)
    theta = cp.Variable(problem.n_theta)
    limits = problem.constraints
    links = problem.robot.n_links
    bodies = [theta[10 * i : 10 * i + 10] for i in range(links)]
    basis = matrix_basis(problem.consistency)
    constraints = [cp.abs(theta) <= limits.theta_max, theta[10 * links :] >= 0.0]
    for body in bodies:
        matrix = sum(body[k] * basis[k] for k in range(10))
        constraints += [matrix >> 0, body[0] >= limits.mass_min, body[0] <= limits.mass_max]
    base = problem.base.matrix @ theta
    cost = sum(
        cp.sum(cp.huber(rows[:, j] @ base - efforts[:, j], thresholds[j]))
        for j in range(problem.robot.n)
    )
    program = cp.Problem(cp.Minimize(cost), constraints)
    program.solve(solver=cp.CLARABEL, tol_gap_rel=1e-9, tol_gap_abs=1e-9, tol_feas=1e-9)
    assert program.status == "optimal"
    return float(program.value)


@pytest.mark.parametrize("consistency", BOTH)
@pytest.mark.parametrize(
    ("name", "weighting", "masked"),
    [("arm2", "gls", False), ("planar", "residual", True), ("arm2", "gls_per_sample", True)],
)
def test_an_independent_formulation_finds_the_same(
    name: str, weighting: Weighting, masked: bool, consistency: Consistency
) -> None:
    robot = ROBOTS[name]
    covariance = None
    if weighting == "gls_per_sample":
        covariance = random_covariance(np.random.default_rng(3), robot.n, COUNT)
    problem, _ = spoiled(
        robot,
        1,
        noise=1.0,
        masked=masked,
        covariance=covariance,
        weighting=weighting,
        consistency=consistency,
        constraints=Constraints(mass_max=10.0, theta_max=10.0),
    )
    found = solve_robust(problem)
    thresholds = HuberLoss.of(problem, threshold=1.345).thresholds
    other = independent_optimum(problem, thresholds)
    assert other == pytest.approx(found.robust_cost, rel=SAME_OPTIMUM)
    assert found.robust_gap is not None
    assert found.robust_gap <= GAP
    assert found.feasible
    assert certify(found).passed
    # The constraints were active, or this would compare less than it says.
    assert found.robust_cost > solve_robust(problem, solver=solve_wls).robust_cost * (1.0 + 1e-5)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("weighting", ["gls", "residual"])
def test_outliers_do_little(seed: int, weighting: Weighting) -> None:
    problem, theta = spoiled(ARM3, seed, flat=seed % 2 == 1, weighting=weighting)
    truth = problem.base_of(theta)
    quadratic, robust = solve_sdp(problem), solve_robust(problem)
    errors = [float(np.linalg.norm(e.base - truth)) for e in (quadratic, robust)]
    assert errors[1] < 0.35 * errors[0]


def test_with_a_huge_threshold_it_is_the_quadratic_cost() -> None:
    problem, _ = spoiled(ARM3, 5)
    quadratic = solve_sdp(problem)
    robust = solve_robust(problem, threshold=1e6)
    assert robust.rounds == 1
    assert robust.robust_cost == pytest.approx(quadratic.cost, rel=SAME_OPTIMUM)
    np.testing.assert_allclose(robust.base, quadratic.base, atol=1e-3)
    assert robust.robust_gap is not None
    assert robust.robust_gap <= GAP


def test_the_message_and_the_numbers() -> None:
    problem, _ = spoiled(ARM3, 1)
    found = solve_robust(problem)
    assert isinstance(found, RobustEstimate)
    assert "Huber" in found.message
    assert f"{found.rounds} rounds" in found.message
    loss = HuberLoss.of(problem, threshold=1.345)
    assert loss.cost(found.base) == pytest.approx(found.robust_cost, rel=1e-9)
    # The weighted problem's cost is above, and equal to within what counts as settled.
    assert found.robust_cost <= found.cost * (1.0 + 1e-12)
    assert found.cost == pytest.approx(found.robust_cost, rel=1e-6)
    assert found.method == "sdp"
    assert found.status == "optimal"


def test_the_same_problem_gives_the_same_numbers() -> None:
    first, second = (solve_robust(spoiled(ARM3, 6)[0]) for _ in range(2))
    np.testing.assert_array_equal(np.asarray(first.theta), np.asarray(second.theta))
    assert first.robust_gap == second.robust_gap


def test_rows_too_large_to_keep_are_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, theta = spoiled(ROBOTS["planar"], 6, masked=True)
    kept = HuberLoss.of(problem, threshold=1.0)
    monkeypatch.setattr("sdpid.estimation.robust.whitened_rows._KEPT", 0.0)
    fresh = HuberLoss.of(problem, threshold=1.0)
    np.testing.assert_array_equal(kept.thresholds, fresh.thresholds)
    base = problem.base_of(theta)
    assert kept.cost(base) == fresh.cost(base)
    assert not fresh.rows._kept
    assert kept.rows._kept


@given(SEEDS, st.sampled_from([0.5, 1.345, 4.0]), st.booleans())
@settings(max_examples=20)
def test_majorizers_touch_and_are_nowhere_below(seed: int, threshold: float, masked: bool) -> None:
    problem, theta = spoiled(ROBOTS["planar"], 7, masked=masked, count=60, weighting="residual")
    loss = HuberLoss.of(problem, threshold=threshold)
    rng = np.random.default_rng(seed)
    here, there = (problem.base_of(theta) + rng.standard_normal(problem.base.count) for _ in "ab")
    weighted = loss.majorized(here)
    scale = problem.cost(np.zeros(problem.base.count))
    assert weighted.cost(here) == pytest.approx(loss.cost(here), abs=COST * scale)
    assert weighted.cost(there) >= loss.cost(there) - COST * scale
    assert loss.cost(there) <= problem.cost(there) + COST * scale
    # The covariances that the problem shows are those of its rows, but for the constant.
    change = weighted.cost(there) - weighted.cost(here)
    brute = [brute_force_cost(weighted, base, weighted.sigma) for base in (there, here)]
    assert change == pytest.approx(brute[0] - brute[1], abs=COST * scale)


@pytest.mark.parametrize("consistency", BOTH)
def test_bounds_hold_wherever_they_come_from(consistency: Consistency) -> None:
    """Also from weights that have not settled no bound exceeds the optimum."""
    problem, theta = spoiled(ROBOTS["arm2"], 8, consistency=consistency, noise=1.0)
    loss = HuberLoss.of(problem, threshold=1.345)
    best = solve_robust(problem)
    rng = np.random.default_rng(9)
    for size in (0.0, 0.1, 1.0):
        base = problem.base_of(theta) + size * rng.standard_normal(problem.base.count)
        bound = loss.bound(solve_sdp(loss.majorized(base)))
        assert bound <= best.robust_cost * (1.0 + 1e-9)
    for _ in range(20):
        cost = loss.cost(problem.base_of(random_start(problem, rng)))
        assert cost >= best.robust_cost * (1.0 - GAP)


def test_thresholds_are_in_deviations_of_single_residuals() -> None:
    """Whatever the weighting makes of them: gross errors do not widen them, correlation neither."""
    robot, count, noise = ARM3, 2000, np.array([0.2, 1.0, 0.5])
    rng = np.random.default_rng(10)
    theta = random_theta(robot, rng)
    error = rng.standard_normal((count, 3))
    for k in range(1, count):
        error[k] = 0.8 * error[k - 1] + 0.6 * error[k]
    error[rng.random(error.shape) < 0.02] += OUTLIER
    samples = make_samples(robot, theta, rng, count=count, noise=noise * error)
    for weighting in ("gls", "residual"):
        problem = build_problem(robot, samples, weighting=weighting)
        thresholds = HuberLoss.of(problem, threshold=2.0).thresholds
        deviations = thresholds / 2.0 * np.sqrt(np.diag(problem.sigma))
        np.testing.assert_allclose(deviations, noise, rtol=0.2)
    given_ones = HuberLoss.of(problem, threshold=2.0, deviations=0.5)
    np.testing.assert_array_equal(given_ones.thresholds, np.ones(3))


def test_exact_data_need_no_deviation() -> None:
    rng = np.random.default_rng(11)
    theta = random_theta(ARM3, rng)
    problem = build_problem(ARM3, make_samples(ARM3, theta, rng))
    found = solve_robust(problem, solver=solve_wls)
    np.testing.assert_allclose(found.base, problem.base_of(theta), atol=1e-6)


def test_masked_rows_do_not_count() -> None:
    problem, _ = spoiled(ARM3, 12, masked=True, weighting="residual")
    samples = problem.samples
    effort = np.where(samples.mask, samples.effort, 1e5)
    fields = {name: getattr(samples, name) for name in ("position", "velocity", "acceleration")}
    other = build_problem(
        ARM3, type(samples)(effort=effort, mask=samples.mask, **fields), weighting="residual"
    )
    first, second = (solve_robust(p) for p in (problem, other))
    assert first.robust_cost == pytest.approx(second.robust_cost, rel=1e-9)


def test_with_a_prior() -> None:
    rng = np.random.default_rng(13)
    prior = Prior(bodies=random_theta(ARM3, rng)[:30].reshape(3, 10), strength=1.0)
    problem, theta = spoiled(ARM3, 13, weighting="residual", prior=prior)
    found = solve_robust(problem)
    assert found.robust_gap is not None
    assert found.robust_gap <= GAP
    assert certify(found).passed
    loss = HuberLoss.of(problem, threshold=1.345)

    def cost(values: Array) -> float:
        believed = problem.cost_of(values) - problem.cost(problem.base_of(values))
        return loss.cost(problem.base_of(values)) + believed

    assert cost(np.asarray(found.theta)) == pytest.approx(found.robust_cost, rel=1e-9)
    # No step towards other feasible parameters lowers it.
    for other in (theta, random_start(problem, rng), np.asarray(solve_sdp(problem).theta)):
        step = 1e-2 * (other - np.asarray(found.theta))
        assert cost(np.asarray(found.theta) + step) >= found.robust_cost * (1.0 - GAP)


def test_standard_errors_are_those_of_repeated_estimates() -> None:
    robot = ROBOTS["planar"]
    rng = np.random.default_rng(14)
    theta = random_theta(robot, rng)
    clean = make_samples(robot, theta, rng, count=COUNT)
    fields = {name: getattr(clean, name) for name in ("position", "velocity", "acceleration")}
    bases, errors = [], []
    for _ in range(80):
        noise = rng.standard_t(3, clean.effort.shape)
        problem = build_problem(robot, type(clean)(effort=clean.effort + noise, **fields))
        found = solve_robust(problem, solver=solve_wls)
        bases.append(found.base)
        errors.append(found.standard_errors)
    # A deviation of 80 estimates is itself known to 8 %, the largest of several to some 20 %.
    np.testing.assert_allclose(np.std(bases, axis=0), np.mean(errors, axis=0), rtol=0.3)


def test_what_has_not_settled_is_no_result() -> None:
    problem, _ = spoiled(ARM3, 1)
    assert solve_robust(problem).rounds > 1
    with pytest.raises(SolverError, match="not settled after 1 rounds") as info:
        solve_robust(problem, max_rounds=1)
    assert info.value.problem is problem
    assert isinstance(info.value.found, RobustEstimate)


def test_options_that_are_none() -> None:
    problem, _ = spoiled(ROBOTS["planar"], 17)
    with pytest.raises(DataError, match="max_rounds is 0"):
        solve_robust(problem, max_rounds=0)
    for threshold in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(DataError, match="threshold"):
            solve_robust(problem, threshold=threshold)
    with pytest.raises(DataError, match="deviations"):
        HuberLoss.of(problem, threshold=1.0, deviations=[1.0, 0.0])
    normal, _ = spoiled(ROBOTS["planar"], 17, weighting="eq18")
    with pytest.raises(DataError, match="eq18"):
        solve_robust(normal)
