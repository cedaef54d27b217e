"""On exact data every estimator returns the true base parameters."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings

from sdpid._common.arrays import Array
from sdpid.estimation.compression.covariance import WEIGHTINGS, Weighting
from sdpid.estimation.local.slsqp import solve_slsqp
from sdpid.estimation.local.starts import random_start
from sdpid.estimation.problem import Problem, build_problem
from sdpid.estimation.sdp.solve import solve_sdp
from sdpid.estimation.wls import solve_wls
from sdpid.robot.inertia import Consistency
from sdpid.robot.model.load import load_robot
from sdpid.robot.model.model import RobotModel
from tests.helpers.data import make_samples, random_covariance, random_theta, relative_error
from tests.helpers.robots import TREE, small_arm
from tests.helpers.strategies import SEEDS, dh_tables
from tests.helpers.tolerances import EXACT, LOCAL_PARAMETERS

ARMS = {n: small_arm(n) for n in (2, 3)}
BOTH: tuple[Consistency, ...] = ("pseudo_inertia", "spatial_inertia")


def exact(robot: RobotModel, seed: int, **options: object) -> tuple[Problem, Array, Array]:
    """Return a problem without noise, the true theta and the true base parameters."""
    rng = np.random.default_rng(seed)
    theta = random_theta(robot, rng)
    count = 12 * robot.n + 40
    covariance = random_covariance(rng, robot.n, count)
    samples = make_samples(robot, theta, rng, count=count, covariance=covariance)
    problem = build_problem(robot, samples, **options)  # type: ignore[arg-type]
    return problem, theta, problem.base_of(theta)


def error_of(problem: Problem, base: Array, truth: Array) -> float:
    return relative_error(base, truth, problem.base.units)


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_wls_on_the_denso(denso: RobotModel, weighting: Weighting) -> None:
    problem, _, truth = exact(denso, 0, weighting=weighting)
    assert error_of(problem, solve_wls(problem).base, truth) <= EXACT


@pytest.mark.parametrize("weighting", ["gls", "gls_per_sample", "eq9", "eq18", "residual"])
@pytest.mark.parametrize("consistency", BOTH)
def test_sdp_on_the_denso(
    denso: RobotModel, weighting: Weighting, consistency: Consistency
) -> None:
    problem, _, truth = exact(denso, 1, weighting=weighting, consistency=consistency)
    estimate = solve_sdp(problem)
    assert estimate.status == "optimal"
    assert error_of(problem, estimate.base, truth) <= EXACT


@pytest.mark.parametrize("consistency", BOTH)
def test_sdp_on_a_tree(consistency: Consistency) -> None:
    problem, _, truth = exact(load_robot(TREE), 2, consistency=consistency)
    assert error_of(problem, solve_sdp(problem).base, truth) <= EXACT


@given(dh_tables(most=3, clear=True), SEEDS)
@settings(max_examples=10)
def test_wls_on_any_arm(table: object, seed: int) -> None:
    robot = RobotModel.from_mdh(table)  # type: ignore[arg-type]
    problem, _, truth = exact(robot, seed)
    assert error_of(problem, solve_wls(problem).base, truth) <= EXACT


@given(SEEDS)
@settings(max_examples=5)
def test_sdp_on_small_arms(seed: int) -> None:
    for consistency in BOTH:
        problem, _, truth = exact(ARMS[2], seed, consistency=consistency)
        estimate = solve_sdp(problem)
        assert error_of(problem, estimate.base, truth) <= EXACT
        assert estimate.feasible


@pytest.mark.parametrize("consistency", BOTH)
def test_slsqp_from_near_the_truth(consistency: Consistency) -> None:
    problem, theta, truth = exact(ARMS[3], 3, consistency=consistency)
    start = theta * (1.0 + 0.02 * np.random.default_rng(0).standard_normal(len(theta)))
    estimate = solve_slsqp(problem, start=start)
    assert estimate.status == "optimal"
    assert error_of(problem, estimate.base, truth) <= LOCAL_PARAMETERS


@pytest.mark.parametrize("consistency", BOTH)
def test_slsqp_from_a_random_start(consistency: Consistency) -> None:
    problem, _, truth = exact(ARMS[2], 4, consistency=consistency)
    start = random_start(problem, np.random.default_rng(5))
    estimate = solve_slsqp(problem, start=start)
    assert error_of(problem, estimate.base, truth) <= LOCAL_PARAMETERS
    np.testing.assert_array_equal(np.asarray(estimate.start), start)


def test_slsqp_at_the_truth_stays_there(denso: RobotModel) -> None:
    problem, theta, truth = exact(denso, 6)
    estimate = solve_slsqp(problem, start=theta)
    assert estimate.iterations <= 5
    assert error_of(problem, estimate.base, truth) <= EXACT
