"""Robust costs: what they are, that their optimum is global, and what they are good for."""

from dataclasses import replace
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import null_space

import sdpid
from sdpid import Constraints, RobotModel, Samples, certify, solve_sdp, solve_wls
from sdpid._common.arrays import Array
from sdpid.assurance.certificate.certificate import GAP
from sdpid.errors import DataError, SolverError
from sdpid.estimation.compression.covariance import Weighting
from sdpid.estimation.compression.whitening import compress
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.robust.huber import HuberLoss
from sdpid.estimation.robust.solve import RobustEstimate, solve_robust
from sdpid.robot.inertia import Consistency
from sdpid.robot.model.jacobians import contact_jacobians
from tests.helpers import data, world
from tests.helpers.arm import BOTH
from tests.helpers.independent import Second
from tests.helpers.legged import FEET, NOISE, RADIUS, Gait, gait, quadruped
from tests.helpers.refusals import refuses
from tests.helpers.robots import planar_arm, small_arm
from tests.helpers.small_robots import MODELS
from tests.helpers.strategies import SEEDS
from tests.helpers.tolerances import COST, SAME_OPTIMUM

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
    theta = data.random_theta(robot, rng)
    if flat:
        theta[: 10 * robot.n_links] = data.flat_links(rng, robot.n_links).ravel()
    error = rng.standard_normal((count, robot.n))
    error[rng.random(error.shape) < 0.1] += OUTLIER
    mask = rng.random(error.shape) < 0.7 if masked else None
    samples = data.make_samples(
        robot, theta, rng, count=count, noise=noise * error, mask=mask, covariance=covariance
    )
    return build_problem(robot, samples, **options), theta


def independent_optimum(problem: Problem, thresholds: Array) -> float:
    """Return the least Huber cost, from whitened raw rows and the problem written down again."""
    rows, efforts = data.whitened(*data.raw_rows(problem), problem.sigma)
    second = Second(problem)
    base = problem.base.matrix @ second.theta
    cost = sum(
        cp.sum(cp.huber(rows[:, j] @ base - efforts[:, j], thresholds[0, j]))
        for j in range(problem.robot.n)
    )
    program = cp.Problem(cp.Minimize(cost), second.numbers())
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
        covariance = data.random_covariance(np.random.default_rng(3), robot.n, COUNT)
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


def test_rows_too_large_to_keep_are_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, theta = spoiled(ROBOTS["planar"], 6, masked=True)
    kept = HuberLoss.of(problem, threshold=1.0)
    monkeypatch.setattr("sdpid.estimation.robust.huber._KEPT", 0.0)
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
    brute = [data.brute_force_cost(weighted, base, weighted.sigma) for base in (there, here)]
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


def test_thresholds_are_in_deviations_of_single_residuals() -> None:
    """Whatever the weighting makes of them: gross errors do not widen them, correlation neither."""
    robot, count, noise = ARM3, 2000, np.array([0.2, 1.0, 0.5])
    rng = np.random.default_rng(10)
    theta = data.random_theta(robot, rng)
    error = rng.standard_normal((count, 3))
    for k in range(1, count):
        error[k] = 0.8 * error[k - 1] + 0.6 * error[k]
    error[rng.random(error.shape) < 0.02] += OUTLIER
    samples = data.make_samples(robot, theta, rng, count=count, noise=noise * error)
    for weighting in ("gls", "residual"):
        problem = build_problem(robot, samples, weighting=weighting)
        thresholds = HuberLoss.of(problem, threshold=2.0).thresholds[0]
        deviations = thresholds / 2.0 * np.sqrt(np.diag(problem.sigma))
        np.testing.assert_allclose(deviations, noise, rtol=0.2)
    given_ones = HuberLoss.of(problem, threshold=2.0, deviations=0.5)
    np.testing.assert_array_equal(given_ones.thresholds[0], np.ones(3))


def test_exact_data_need_no_deviation() -> None:
    samples, theta = world.samples(ARM3, 11)
    problem = build_problem(ARM3, samples)
    found = solve_robust(problem, solver=solve_wls)
    np.testing.assert_allclose(found.base, problem.base_of(theta), atol=1e-6)


def test_standard_errors_are_those_of_repeated_estimates() -> None:
    robot = ROBOTS["planar"]
    rng = np.random.default_rng(14)
    theta = data.random_theta(robot, rng)
    clean = data.make_samples(robot, theta, rng, count=COUNT)
    bases, errors = [], []
    for _ in range(80):
        noise = rng.standard_t(3, clean.effort.shape)
        problem = build_problem(robot, replace(clean, effort=clean.effort + noise))
        found = solve_robust(problem, solver=solve_wls)
        bases.append(found.base)
        errors.append(found.standard_errors)
    # A deviation of 80 estimates is itself known to 8 %, the largest of several to some 20 %.
    np.testing.assert_allclose(np.std(bases, axis=0), np.mean(errors, axis=0), rtol=0.3)


def test_what_has_not_settled_is_no_result() -> None:
    problem, _ = spoiled(ARM3, 1)
    found = solve_robust(problem)
    assert found.rounds > 1
    assert "Huber" in found.message
    assert f"{found.rounds} rounds" in found.message
    # The weighted problem's cost is above, and equal to within what counts as settled.
    assert 0.0 <= found.cost * (1.0 + 1e-12) - found.robust_cost <= 1e-6 * found.cost
    error = refuses(SolverError, "not settled after 1 rounds", solve_robust, problem, max_rounds=1)
    assert error.problem is problem
    assert isinstance(error.found, RobustEstimate)


def test_options_that_are_none() -> None:
    problem, _ = spoiled(ROBOTS["planar"], 17)
    refuses(DataError, "max_rounds is 0", solve_robust, problem, max_rounds=0)
    for threshold in (0.0, -1.0, np.inf, np.nan):
        refuses(DataError, "threshold", solve_robust, problem, threshold=threshold)
    refuses(DataError, "deviations", HuberLoss.of, problem, threshold=1.0, deviations=[1.0, 0.0])
    normal, _ = spoiled(ROBOTS["planar"], 17, weighting="eq18")
    refuses(DataError, "eq18", solve_robust, normal)


# ---- With contacts the Huber cost is one of samples, and is minimized as that of rows is.


def spoiled_gait(made: Gait, seed: int = 0) -> Samples:
    """Return samples, a tenth of which have a wrong torque."""
    rng = np.random.default_rng(seed)
    samples = made.noisy(seed)
    effort = samples.effort.copy()
    hit = np.flatnonzero(rng.random(len(effort)) < 0.1)
    effort[hit, 6 + rng.integers(12, size=len(hit))] += 3.0
    return replace(samples, effort=effort, covariance=np.diag(NOISE**2))


def problem(samples: Samples) -> Problem:
    return sdpid.build_problem(
        quadruped(), samples, friction=(), weighting="gls", prior=sdpid.Prior()
    )


def sizes(found: Problem, base: Array) -> tuple[Array, Array]:
    """Return norms of whitened residuals of samples, and how many rows each has, by null spaces."""
    samples = found.samples
    J = contact_jacobians(quadruped(), samples.position, FEET, RADIUS)
    residual = found.rows.regressor(slice(None)) @ base - samples.effort  # type: ignore[union-attr]
    size, count = [], []
    for k, down in enumerate(samples.contacts.down):
        N = null_space(J[k, down, :3].reshape(-1, 18)) if down.any() else np.eye(18)
        r = N.T @ residual[k]
        size.append(np.sqrt(r @ np.linalg.solve(N.T @ found.sigma @ N, r)))
        count.append(N.shape[1])
    return np.array(size), np.array(count)


def test_the_cost_is_that_of_samples_projected_densely() -> None:
    made = gait(60)
    found = problem(spoiled_gait(made))
    base = found.base_of(made.theta)
    loss = HuberLoss.of(found, threshold=1.345, deviations=1.0)
    assert np.isfinite(HuberLoss.of(found, threshold=1e3, deviations=1.0).thresholds).all()
    size, count = sizes(found, base)
    t = loss.thresholds[:, 0]
    # As many samples of normal errors are beyond as single rows are.
    draws = np.random.default_rng(1).normal(size=(20_000, 18))
    for m in np.unique(count):
        beyond = np.mean(np.linalg.norm(draws[:, :m], axis=1) > t[count == m][0])
        assert beyond == pytest.approx(0.179, abs=0.01)
    expected = np.where(size <= t, size**2, 2.0 * t * size - t**2).sum()
    assert loss.cost(base) == pytest.approx(expected, rel=1e-9)
    weighted = loss.majorized(base)
    assert weighted.cost(base) == pytest.approx(loss.cost(base))
    rng, h = np.random.default_rng(2), 1e-5
    for _ in range(3):
        other = base + 0.01 * np.abs(base).max() * rng.normal(size=base.shape)
        assert weighted.cost(other) >= loss.cost(other) * (1.0 - 1e-12)
    step = rng.normal(size=base.shape)
    second = sum(c * loss.cost(base + i * h * step) for i, c in ((-1, 1.0), (0, -2.0), (1, 1.0)))
    own = loss.curvature(base, step[:, None])
    assert own.item() == pytest.approx(second / (2.0 * h**2), rel=1e-2)


@pytest.mark.parametrize("measured", [False, True])
def test_outliers_do_little_in_contact(measured: bool) -> None:
    made = gait(400, seed=3)
    samples = spoiled_gait(made, 4)
    if measured:
        felt = made.forces + 0.1 * np.random.default_rng(5).normal(size=made.forces.shape)
        samples = replace(samples, contacts=made.measured(0.01 * np.eye(6), felt).contacts)
    found = problem(samples)
    robust, plain = sdpid.solve_robust(found), sdpid.solve_sdp(found)
    assert robust.robust_gap <= GAP
    assert sdpid.certify(robust).passed
    # The weighted problem is one of other covariances, so that certificates are of it.
    A = robust.problem.A
    again = compress(robust.problem.rows, robust.problem.sigma)[0].split()[0]  # type: ignore[arg-type]
    np.testing.assert_allclose(again.T @ again, A.T @ A, atol=1e-8 * np.abs(A.T @ A).max())
    clean = gait(200, seed=6).samples
    errors = [sdpid.validate(each, clean).relative for each in (robust, plain)]
    assert errors[0] < 0.5 * errors[1]
