"""Problems: their costs as the raw rows have them, and what is refused."""

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sdpid
from sdpid import Constraints, Recording, RobotModel, load_robot, solve_sdp, solve_slsqp, solve_wls
from sdpid._common.arrays import Array
from sdpid.errors import DataError, InfeasibleError, SdpidError
from sdpid.estimation.compression.covariance import WEIGHTINGS, Weighting
from sdpid.estimation.constraints.mass import TotalMass
from sdpid.estimation.local.log_cholesky import solve_log_cholesky
from sdpid.estimation.local.run import random_start
from sdpid.estimation.problem import Problem, build_problem
from sdpid.robot.inertia import Consistency
from tests.helpers import data
from tests.helpers.arm import BOTH
from tests.helpers.refusals import refuses
from tests.helpers.robots import TREE, small_arm
from tests.helpers.strategies import SEEDS, dh_tables
from tests.helpers.tolerances import COST, EXACT, LOCAL_PARAMETERS

ARM = small_arm(3)


def random_mask(rng: np.random.Generator, count: int, n: int) -> np.ndarray:
    mask = rng.random((count, n)) < 0.7
    mask[0], mask[1] = True, False
    return mask


def noisy_samples(seed: int, robot: RobotModel = ARM, **options: Any) -> Any:
    rng = np.random.default_rng(seed)
    count, n = 60, robot.n
    covariance = {
        "none": None,
        "one": data.random_covariance(rng, n),
        "each": data.random_covariance(rng, n, count),
    }[options.pop("covariance", "none")]
    mask = random_mask(rng, count, n) if options.pop("masked", False) else None
    theta = data.random_theta(robot, rng)
    samples = data.make_samples(robot, theta, rng, noise=0.3, covariance=covariance, mask=mask)
    return samples, theta, rng


@given(SEEDS, st.sampled_from(WEIGHTINGS), st.sampled_from(["none", "one", "each"]), st.booleans())
@settings(max_examples=40)
def test_cost_is_that_of_the_raw_rows(
    seed: int, weighting: Weighting, covariance: str, masked: bool
) -> None:
    samples, theta, rng = noisy_samples(seed, covariance=covariance, masked=masked)
    problem = build_problem(ARM, samples, weighting=weighting)
    sigma = np.eye(3) if samples.covariance is None else np.asarray(samples.covariance)
    if weighting == "gls" and sigma.ndim == 3:
        sigma = sigma.mean(axis=0)
    if weighting == "residual":
        sigma = problem.sigma
    used = 180 if samples.mask is None else int(samples.mask.sum())
    assert problem.n_rows == used
    zero = data.brute_force_cost(problem, np.zeros(problem.base.count), sigma)
    for base in (problem.base_of(theta), 3.0 * rng.standard_normal(problem.base.count)):
        expected = data.brute_force_cost(problem, base, sigma)
        assert problem.cost(base) == pytest.approx(expected, rel=1e-8, abs=COST * zero)
    assert problem.cost_of(theta) == problem.cost(problem.base_of(theta))
    assert problem.cost(np.zeros(problem.base.count)) == pytest.approx(zero, rel=1e-10)
    if weighting in ("eq9", "eq18"):
        assert problem.floor == 0.0
        assert problem.cost(solve_wls(problem).base) < 1e-15 * float(problem.rhs @ problem.rhs)


def test_other_constraints_keep_the_cost() -> None:
    samples, theta, _ = noisy_samples(14)
    problem = build_problem(ARM, samples)
    other = problem.constrained(consistency="spatial_inertia", constraints=Constraints(margin=0.01))
    assert other.A is problem.A
    assert other.cost_of(theta) == problem.cost_of(theta)
    assert (other.consistency, other.constraints.margin) == ("spatial_inertia", 0.01)
    assert problem.consistency == "pseudo_inertia"


def test_results_are_read_only() -> None:
    samples, _, _ = noisy_samples(16)
    problem = build_problem(ARM, samples)
    rows = sdpid.validate(solve_wls(problem)).rows
    for array in (problem.A, problem.rhs, problem.feasible.lower, solve_wls(problem).base, rows):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_a_singular_covariance_is_refused() -> None:
    samples, _, _ = noisy_samples(19)
    few = np.tile(np.eye(3), (60, 1, 1))
    few[30:] = np.outer([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])
    known = replace(samples, covariance=few)
    for weighting in ("gls_per_sample", "eq18"):
        refuses(DataError, "30 of 60 singular", build_problem, ARM, known, weighting=weighting)
    # Pooled it is regular again.
    assert build_problem(ARM, known).floor > 0.0


def test_bad_constraints() -> None:
    for options in ({"margin": -0.1}, {"margin": np.nan}, {"mass_min": 0.0}, {"mass_max": np.inf}):
        refuses(DataError, "Constraints", Constraints, **options)
    refuses(DataError, "Constraints", Constraints, theta_max=1.0, mass_max=2.0)
    refuses(InfeasibleError, "Constraints", Constraints, mass_min=2.0, mass_max=1.0)
    refuses(DataError, "'mass' among the others is not a Condition", Constraints, others="mass")
    # A single condition needs no tuple.
    total = TotalMass(3.0)
    assert Constraints(others=total).others == Constraints(others=[total]).others == (total,)


def test_unknown_options_and_arguments_of_another_kind() -> None:
    samples, _, _ = noisy_samples(17)
    renamed = replace(samples, joint_names=("joint_2", "joint_1", "joint_3"))
    for arguments, options, says in (
        ((small_arm(2), samples), {}, "samples have 3 joints, the robot 'arm2' has 2"),
        ((ARM, renamed), {}, "joint_2, joint_1, joint_3"),
        ((ARM, samples), {"weighting": "ols"}, "weighting is 'ols': use one of gls"),
        ((ARM, samples), {"consistency": "full"}, "consistency is 'full'"),
        (("denso_vp6242", "samples"), {}, "robot is str 'denso_vp6242'; give a RobotModel"),
        ((ARM, 3), {}, "samples: hold int 3; give Samples"),
        ((ARM, [np.zeros((5, 3))]), {}, "samples: hold ndarray"),
        ((ARM, "no such log.parquet"), {}, "no such log.parquet"),
    ):
        refuses(DataError if options else SdpidError, says, build_problem, *arguments, **options)


def test_a_recording_or_a_file_is_processed(tmp_path: Path) -> None:
    robot = load_robot(TREE)
    rng = np.random.default_rng(0)
    time = np.arange(2000) / 200.0
    phases = rng.uniform(0.0, 6.0, robot.n)
    position = np.sin(time[:, None] * (1.0 + 0.3 * np.arange(robot.n)) + phases)
    effort = rng.normal(size=position.shape)
    log = Recording(time=time, position=position, effort=effort, joint_names=robot.joint_names)
    path = tmp_path / "log.parquet"
    log.to_parquet(path)
    problems = [build_problem(robot, each, friction=()) for each in (log, path, str(path), [log])]
    zero = np.zeros(problems[0].base.count)
    for problem in problems:
        np.testing.assert_array_equal(problem.A, problems[0].A)
        assert problem.cost(zero) == problems[0].cost(zero)


@pytest.mark.parametrize("taken", [sdpid.solve_robust, sdpid.RecursiveEstimator])
@pytest.mark.parametrize("fields", [{"constant": 1.0}, {"meaning": "a second stage"}])
def test_costs_of_other_rows_are_refused(taken: Any, fields: dict[str, Any]) -> None:
    problem = build_problem(ARM, noisy_samples(0)[0]).with_origin(**fields)
    refuses(DataError, "not that of the measured samples", taken, problem)


# ---- On exact data every estimator returns the true base parameters.


def exact(robot: RobotModel, seed: int, **options: object) -> tuple[Problem, Array, Array]:
    """Return a problem without noise, the true theta and the true base parameters."""
    rng = np.random.default_rng(seed)
    theta = data.random_theta(robot, rng)
    count = 12 * robot.n + 40
    covariance = data.random_covariance(rng, robot.n, count)
    samples = data.make_samples(robot, theta, rng, count=count, covariance=covariance)
    problem = build_problem(robot, samples, **options)  # type: ignore[arg-type]
    return problem, theta, problem.base_of(theta)


def error_of(problem: Problem, base: Array, truth: Array) -> float:
    return data.relative_error(base, truth, problem.base.units)


@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize("consistency", ["none", *BOTH])
def test_the_denso(denso: RobotModel, weighting: Weighting, consistency: Consistency) -> None:
    problem, _, truth = exact(denso, 1, weighting=weighting, consistency=consistency)
    estimate = solve_wls(problem) if consistency == "none" else solve_sdp(problem)
    assert estimate.status == "optimal"
    assert error_of(problem, estimate.base, truth) <= EXACT


@given(dh_tables(most=3, clear=True), SEEDS)
@settings(max_examples=10)
def test_wls_on_any_arm(table: object, seed: int) -> None:
    robot = RobotModel.from_mdh(table)  # type: ignore[arg-type]
    problem, _, truth = exact(robot, seed)
    assert error_of(problem, solve_wls(problem).base, truth) <= EXACT


@given(SEEDS)
@settings(max_examples=5)
def test_sdp_on_small_arms_and_a_tree(seed: int) -> None:
    for robot, consistency in product((small_arm(2), load_robot(TREE)), BOTH):
        problem, _, truth = exact(robot, seed, consistency=consistency)
        estimate = solve_sdp(problem)
        assert error_of(problem, estimate.base, truth) <= EXACT
        assert estimate.feasible


@pytest.mark.parametrize("consistency", BOTH)
@pytest.mark.parametrize("solve", [solve_slsqp, solve_log_cholesky])
@pytest.mark.parametrize("near", [True, False])
def test_local_solvers_from_some_start(solve: Any, near: bool, consistency: Consistency) -> None:
    problem, theta, truth = exact(small_arm(2), 4, consistency=consistency)
    start = random_start(problem, np.random.default_rng(5))
    if near:
        start = theta * (1.0 + 0.02 * np.random.default_rng(0).standard_normal(len(theta)))
    estimate = solve(problem, start=start)
    assert estimate.status == "optimal"
    assert error_of(problem, estimate.base, truth) <= LOCAL_PARAMETERS
    np.testing.assert_array_equal(np.asarray(estimate.start), start)
